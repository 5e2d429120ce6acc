"""Light from 1e-8 to 1e8: the same picture times the light, in any buffer and precision."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from render.synthetic import AMBIENT, pipeline, plane, render, sphere, turned

from scanrender.metrics import delta_e_2000_linear
from scanrender.render.device import Device
from scanrender.render.frame import Renderer

pytestmark = pytest.mark.gl

LAMP = {"type": "directional", "azimuth_deg": 50, "shadow_px": 64}
CAMERA = {"width_px": 64, "height_px": 64}
BALL = sphere(30.0, (0.7, 0.5, 0.4), rings=16)
LEVELS = [1e-8, 1e-5, 1e-3, 1.0, 90.0, 1e4, 1e8]


def lit(level: float, *more: dict[str, Any], **quality: Any) -> Any:
    lights = [{**light, "irradiance": level} for light in (LAMP, AMBIENT)]
    return pipeline({"camera": CAMERA, "lights": lights}, *more,
                    quality={"supersampling": 1, "check": True, **quality})  # fmt: skip


@pytest.mark.parametrize("level", LEVELS)
@pytest.mark.parametrize("method", ["gaussian_sum", "separable_preintegrated", "disk"])
def test_light_is_linear_and_ratios_have_no_unit(gl: Device, level: float, method: str):
    diffusion = {"diffusion": {"method": method}}
    one = render(gl, BALL, lit(1.0, diffusion), "energy_ratio", "transmission")
    other = render(gl, BALL, lit(level, diffusion), "energy_ratio", "transmission")
    for name in ("beauty", "transmission"):
        np.testing.assert_allclose(
            other[name], one[name] * level, rtol=1e-3, atol=1e-6 * level, err_msg=name
        )
    np.testing.assert_allclose(other["energy_ratio"], one["energy_ratio"], rtol=1e-3, atol=1e-4)


@pytest.mark.parametrize("level", LEVELS)
def test_half_floats_do_not_show_at_any_light(gl: Device, level: float):
    """Where they would lose the light, full ones are used, and that is said."""
    full = render(gl, BALL, lit(level))["beauty"]
    renderer = Renderer(gl, BALL, lit(level, precision="half"))
    half = renderer.render(renderer.view(0)).buffers["beauty"]
    assert delta_e_2000_linear(half / full.max(), full / full.max()).max() < 0.5
    told = [d.reason for d in renderer.decisions if d.what == "quality.precision: half"]
    assert bool(told) == (not 1e-3 <= 2 * level <= 100)


def test_half_floats_hold_grazing_highlights(gl: Device):
    """With specular and radiance in half floats, highlights of a lamp of 99 stood at 65504."""
    lamp = {**LAMP, "azimuth_deg": 160, "elevation_deg": 0, "shadow": False, "irradiance": 99}
    specular = {"roughness": [0.03, 0.03], "strength": 10}
    sharp = {"lights": [lamp], "skin": {"specular": specular}, "camera": {"elevation_deg": 0}}
    shots = [pipeline(lit(1.0, precision=p).model_dump(), sharp) for p in ("full", "half")]
    mirror = turned(plane(30.0), 80.0, "y")
    full, half = (render(gl, mirror, shot, "specular") for shot in shots)
    # Normals in half floats move so narrow a lobe; it must not be cut off.
    for name in ("specular", "beauty"):
        assert min(full[name].max(), half[name].max()) > 2 * 65504.0


@pytest.mark.parametrize("halo", ["cbf", "cbf_normalized", "measure"])
@pytest.mark.parametrize(
    ("height_mm", "focal_mm", "size_px"), [(6e3, 2000.0, 400), (0.5, 85.0, 48), (30.0, 4.0, 48)]
)
def test_half_floats_hold_any_distance(gl: Device, halo: str, height_mm, focal_mm, size_px):
    """From half a kilometre the guide of `cbf` was infinite: inf - inf, the paper's black dots."""
    camera = {
        "height_mm": height_mm,
        "focal_mm": focal_mm,
        "width_px": size_px,
        "height_px": size_px,
    }
    big = sphere(1000.0 if height_mm > 1e3 else 30.0, (0.7, 0.5, 0.4), rings=16)
    shots = [
        lit(40.0, {"camera": camera, "diffusion": {"halo": halo, "samples": 5}}, precision=p)
        for p in ("full", "half")
    ]
    full, half = (render(gl, big, shot)["beauty"] for shot in shots)
    off = delta_e_2000_linear(half / full.max(), full / full.max())
    assert full.max() > 0.0
    assert np.quantile(off, 0.95) < 0.5
