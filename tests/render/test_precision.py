"""Half floats between passes: the same picture within what is visible, and never infinite."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from render.synthetic import AMBIENT, pipeline, render, sphere

from scanrender.metrics import delta_e_2000_linear
from scanrender.render.device import Device
from scanrender.render.frame import Renderer

pytestmark = pytest.mark.gl

CAMERA = {"width_px": 96, "height_px": 96}


def shot(precision: str, irradiance: float, sampling: str = "everywhere", **more: Any) -> Any:
    lamp = {"type": "directional", "azimuth_deg": 50, "irradiance": irradiance}
    quality = {"precision": precision, "supersampling": 2, "sampling": sampling}
    return pipeline(lights=[lamp, AMBIENT], camera=CAMERA, quality=quality, **more)


@pytest.mark.parametrize("method", ["none", "gaussian_sum", "separable_preintegrated", "disk"])
@pytest.mark.parametrize("sampling", ["everywhere", "contrast"])
def test_half_floats_do_not_show(gl: Device, method: str, sampling: str):
    ball = sphere(30.0, (0.7, 0.5, 0.4))
    more = {"diffusion": {"method": method}}
    full, half = (
        render(gl, ball, shot(p, 1.0, sampling, **more), "position") for p in ("full", "half")
    )
    np.testing.assert_array_equal(full["position"], half["position"])
    off = delta_e_2000_linear(*(np.clip(made["beauty"], 0, 1) for made in (half, full)))
    assert np.quantile(off[full["alpha"][:, :, 0] > 0.0], 0.95) < 0.5
    assert 0.0 < off.max() < 3.0


@pytest.mark.parametrize("irradiance", [1e-8, 1.0, 50.0, 99.0, 1e4, 1e9])
def test_light_too_bright_for_half_floats_is_kept_whole(gl: Device, irradiance: float):
    ball = sphere(30.0, (0.7, 0.5, 0.4))
    sharp = {"skin": {"specular": {"roughness": [0.02, 0.02], "strength": 10.0}}}
    renderer = Renderer(gl, ball, shot("half", irradiance, **sharp))
    frame = renderer.render(renderer.view(0))
    assert np.isfinite(frame.buffers["beauty"]).all()
    told = [d for d in renderer.decisions if d.what == "quality.precision: half"]
    assert bool(told) == (irradiance + 1.0 > 100.0)
