"""Fields of view to 160 degrees, from inside and outside a subject, with few taps and many."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from render.synthetic import AMBIENT, pipeline, render, sphere

from scanrender.render.device import Device

pytestmark = pytest.mark.gl

LAMP = {"type": "directional", "azimuth_deg": 50, "shadow_px": 64}
BALL = sphere(30.0, (0.7, 0.5, 0.4), rings=16)


@given(
    height_mm=st.sampled_from([0.1, 12.0, 45.0, 150.0, 300.0]),
    focal_mm=st.sampled_from([2.1, 4.0, 8.0, 20.0]),
    scale=st.sampled_from([0.3, 0.5, 1.0, 2.0]),
    samples=st.sampled_from([3, 4, 5, 9, 255]),
    method=st.sampled_from(["gaussian_sum", "separable_preintegrated", "disk"]),
)
def test_a_kernel_wide_on_screen_and_narrow_on_the_surface_is_finite(
    gl: Device, height_mm, focal_mm, scale, samples, method
):
    """Below 110 degrees it never happens; beyond, with 5 taps, the root of a negative variance made
    half the picture NaN."""
    camera = {"width_px": 48, "height_px": 48, "height_mm": height_mm, "focal_mm": focal_mm}
    render(gl, BALL, pipeline(
        camera=camera, lights=[LAMP, AMBIENT], skin={"scale": scale},
        diffusion={"method": method, "samples": samples},
        quality={"supersampling": 1, "check": True},
    ))  # fmt: skip
