"""Slabs from nothing to a metre thick, curvature from nothing to a micrometre of radius."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from render.synthetic import AMBIENT, flat_map, joined, pipeline, quad, render, sphere_mesh

from scanrender.asset import Asset
from scanrender.optics.profiles.gaussians import D_EON_SKIN
from scanrender.render.device import Device

pytestmark = pytest.mark.gl

BEHIND = {"type": "directional", "azimuth_deg": 180, "elevation_deg": 0, "shadow_px": 64}
CAMERA = {"width_px": 24, "height_px": 24, "height_mm": 20.0, "elevation_deg": 0}
THICK_MM = [0.0, 1e-3, 0.1, 1.0, 3.0, 10.0, 1e3]


def slab(thick_mm: float) -> Asset:
    front = quad((-20.0, -20.0), (20.0, 20.0), z=0.5 * thick_mm)
    back = quad((20.0, -20.0), (-20.0, 20.0), z=-0.5 * thick_mm)
    return Asset(joined([front, back]), {"albedo": flat_map(0.8, 0.6, 0.5)})


@pytest.mark.parametrize("thick_mm", THICK_MM)
@pytest.mark.parametrize("scale", [1e-4, 1.0, 100.0])
def test_light_through_a_slab_is_that_of_its_thickness(gl: Device, thick_mm: float, scale: float):
    """T(d) of the profile's closed form; below the bias it is the lit face itself, and nothing."""
    bias_mm = 0.1
    made = render(gl, slab(thick_mm), pipeline(
        camera=CAMERA, lights=[BEHIND, AMBIENT], quality={"check": True, "supersampling": 1},
        skin={"scale": scale, "transmission": {"bias_mm": bias_mm, "blur_mm": 0.5}},
    ), "transmittance", "transmission")  # fmt: skip
    assert np.isfinite(made["beauty"]).all()
    middle = made["transmittance"][12, 12]
    if thick_mm >= 1.0:
        expected = D_EON_SKIN.scaled(scale).transmittance(np.array([thick_mm]))[0]
        np.testing.assert_allclose(middle, expected, atol=3e-3)
    if thick_mm < bias_mm:
        assert middle.max() < 0.05


@pytest.mark.parametrize("per_mm", [0.0, 1e-3, 1.0, 1e3, -1e3])
@pytest.mark.parametrize("modulation", ["increase", "reduce", "reduce_to_minimum"])
def test_any_baked_curvature_gives_a_kernel_between_its_limits(
    gl: Device, per_mm: float, modulation: str
):
    maps: dict[str, Any] = {
        "albedo": flat_map(0.8, 0.6, 0.5),
        "curvature": np.full((4, 4, 1), per_mm, np.float32),
    }
    made = render(gl, Asset(sphere_mesh(9.0, 12), maps), pipeline(
        camera={**CAMERA, "projection": "orthographic"},
        lights=[{**BEHIND, "azimuth_deg": 60}, AMBIENT],
        quality={"check": True, "supersampling": 1},
        curvature={"source": "baked", "modulation": modulation},
    ), "kernel_px", "depth_mm")  # fmt: skip
    red = made["kernel_px"][made["depth_mm"][:, :, 0] > 0.0][:, 0]
    plain = float(D_EON_SKIN.radius_for(0.999)[0]) * 24 / 20.0
    least, most = {"increase": (1.0, 2.0), "reduce": (0.0, 1.0)}.get(modulation, (0.05, 1.0))
    assert red.min() >= (least - 1e-3) * plain
    assert red.max() <= (most + 1e-3) * plain
    assert np.isfinite(made["beauty"]).all()
