"""Smoothed curvature against the dense Gaussian: no grid, at any radius."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest
from render.synthetic import MATT, flat_map, pipeline, plane, render, stepped_terrace
from scipy import ndimage

from scanrender.asset import Asset
from scanrender.render.device import Device

pytestmark = pytest.mark.gl

SIDE = 448
PX_PER_MM = 8.0
# An even scale, so that a radius in px is one everywhere.
EVEN = {"width_px": SIDE, "height_px": SIDE, "projection": "orthographic",
        "height_mm": SIDE / PX_PER_MM, "elevation_deg": 0}  # fmt: skip


def smoothed(gl: Device, asset: Asset, radius_px: float) -> npt.NDArray[np.float32]:
    settings = pipeline(
        MATT,
        camera=EVEN,
        curvature={"source": "baked", "smooth_mm": radius_px / PX_PER_MM},
        diffusion={"method": "none"},
    )
    return render(gl, asset, settings, "curvature")["curvature"][:, :, 0]


def high_pass(values: npt.NDArray[np.floating]) -> npt.NDArray[np.floating]:
    """What a pixel has and its neighbours have not: a grid is all of that."""
    return np.asarray(values - ndimage.uniform_filter(values, 3))


@pytest.mark.parametrize("radius_px", [0.5, 2.0, 3.0, 5.0, 9.0, 20.0, 35.0, 60.0])
def test_smoothing_is_the_dense_gaussian_on_noise(gl: Device, radius_px: float):
    """Noise is what raw curvature is like at lids and lips: no structure coarser than a pixel."""
    noise = np.random.default_rng(0).normal(0.0, 0.5, (1024, 1024, 1)).astype(np.float32)
    # One texel a pixel.
    half_mm = noise.shape[0] / PX_PER_MM / 2
    asset = Asset(plane(half_mm).mesh, {"albedo": flat_map(1, 1, 1), "curvature": noise})
    raw = smoothed(gl, asset, 0.0)
    assert raw.std() > 0.3
    truth = ndimage.gaussian_filter(raw.astype(np.float64), radius_px, truncate=5)
    found = smoothed(gl, asset, radius_px)
    # At the border of the picture each filter makes do with the taps that it has.
    border = min(round(3 * radius_px) + 3, SIDE // 2 - 40)
    inside = np.s_[border:-border, border:-border]
    assert (found - truth)[inside].std() < 0.02 * truth[inside].std()
    fine = high_pass(found)[inside].std()
    assert fine < 1.02 * high_pass(truth)[inside].std() + 2e-5 * raw.std()


def test_smoothing_does_not_cross_a_depth_step(gl: Device):
    claims = np.array([[-0.05, 0.05]], dtype=np.float32)[:, :, None]
    steps = stepped_terrace(SIDE / PX_PER_MM, 60.0)
    asset = Asset(steps.mesh, {**steps.maps, "curvature": claims})
    found = smoothed(gl, asset, 40.0)
    np.testing.assert_allclose(found[200, : SIDE // 2 - 2], -0.05, rtol=1e-3)
    np.testing.assert_allclose(found[200, SIDE // 2 + 2 :], 0.05, rtol=1e-3)
