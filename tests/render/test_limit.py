"""Scattering limited to skin of like colour (CIE Lab of the albedo): the paper's figure 6."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from render.edges import CLOSE
from render.synthetic import AMBIENT, MATT, flat_map, joined, pipeline, plane, quad, render, sphere

from scanrender.asset import Asset
from scanrender.metrics import lab_from_linear_rec709
from scanrender.render.device import Device
from scanrender.render.frame import Renderer

pytestmark = pytest.mark.gl

GAUSSIANS, SEPARABLE = "gaussian_sum", "separable_preintegrated"
SKIN = (0.55, 0.33, 0.24)
BORDERS = {"brow": (0.12, 0.07, 0.05), "lip": (0.42, 0.17, 0.14), "eye": (0.62, 0.58, 0.55)}
# Texels of a quarter millimetre over the plane of 20 mm, as of a scan's atlas.
TEXELS = 80


def patch(left: Any, right: Any, noise: float = 0.0) -> Asset:
    """A plane of two colours; `noise` is the deviation of each texel's brightness."""
    texture = np.empty((TEXELS, TEXELS, 3))
    texture[:, : TEXELS // 2], texture[:, TEXELS // 2 :] = left, right
    rng = np.random.default_rng(1)
    texture *= np.clip(1.0 + rng.normal(0.0, noise, (TEXELS, TEXELS, 1)), 0.2, 2.0)
    return Asset(plane(10.0).mesh, {"albedo": texture.astype(np.float32)})


def blur_across(gl: Device, asset: Asset, texturing: str, limit: str, method: str) -> float:
    """Light that crosses the border: what one side gains from the other, all channels."""
    found = {}
    for kind in (method, "none"):
        settings = pipeline(MATT, CLOSE, skin={"texturing": texturing},
                            diffusion={"method": kind, "limit": limit, "samples": 25})  # fmt: skip
        made = render(gl, asset, settings, "diffuse")
        found[kind] = made["diffuse"][20:140].astype(np.float64)
    width = found["none"].shape[1]
    middle = slice(width // 2 - 20, width // 2)  # 3 mm
    # The noise's own blur takes from one texel what it gives the next.
    return float(np.abs((found[method] - found["none"]).mean(axis=0)[middle].sum(axis=0)).sum())


@pytest.mark.parametrize("border", BORDERS)
@pytest.mark.parametrize("noise", [0.0, 0.1], ids=["clean", "noisy"])
def test_borders_of_colour_keep_their_edge(
    gl: Device, border: str, noise: float, capsys: pytest.CaptureFixture[str]
):
    """At least 60 % of the blur is gone with `texturing: pre`, as in the paper."""
    asset = patch(SKIN, BORDERS[border], noise)
    left = {}
    for texturing, method in (("pre", GAUSSIANS), ("pre", SEPARABLE), ("mixed", GAUSSIANS)):
        off, on = (blur_across(gl, asset, texturing, limit, method) for limit in ("none", "lab"))
        assert off > 0.05
        left[texturing, method] = on / off
    with capsys.disabled():
        shown = ", ".join(f"{' '.join(key)} {value:.3f}" for key, value in left.items())
        print(f"\nblur left across {border} (noise {noise:g}): {shown}")
    assert all(left["pre", method] <= 0.4 for method in (GAUSSIANS, SEPARABLE))


@pytest.mark.parametrize("noise", [0.0, 0.05, 0.1])
@pytest.mark.parametrize("method", [GAUSSIANS, SEPARABLE])
def test_skin_of_one_colour_scatters_as_before(gl: Device, noise: float, method: str):
    """A shadow's edge on smooth and on noisy skin loses no more than a tenth of its scattering."""
    asset = patch(SKIN, SKIN, noise)
    asset.maps["ao"] = (np.arange(TEXELS)[None, :, None] >= TEXELS // 2).astype(np.float32)
    crossed = {}
    for limit in ("none", "lab"):
        settings = pipeline(MATT, CLOSE, skin={"texturing": "post"},
                            diffusion={"method": method, "limit": limit})  # fmt: skip
        made = render(gl, asset, settings, "scattered", "diffusion_input")
        dark = made["diffusion_input"][:, :, 0] == 0
        crossed[limit] = float(made["scattered"][dark].sum())
    assert crossed["lab"] >= 0.9 * crossed["none"]


def test_without_smoothing_noise_takes_more_scattering(gl: Device):
    """What the guide is smoothed for, and that the test above could fail."""
    asset = patch(SKIN, SKIN, 0.15)
    asset.maps["ao"] = (np.arange(TEXELS)[None, :, None] >= TEXELS // 2).astype(np.float32)
    crossed = {}
    for smooth_mm in (0.0, 1.0):
        settings = pipeline(MATT, CLOSE, skin={"texturing": "post"}, diffusion={
            "limit": "lab", "limit_smooth_mm": smooth_mm, "limit_delta_e": 2.0})  # fmt: skip
        made = render(gl, asset, settings, "scattered", "diffusion_input")
        dark = made["diffusion_input"][:, :, 0] == 0
        crossed[smooth_mm] = float(made["scattered"][dark].sum())
    assert crossed[0.0] < 0.95 * crossed[1.0]


def test_the_guide_is_cie_lab_of_the_albedo(gl: Device):
    colours = np.random.default_rng(0).uniform(0, 1, (4, 4, 3)).astype(np.float32)
    colours[0, 0], colours[0, 1], colours[1, 0] = 0.0, 1.0, 0.004
    halves = [
        quad((5 * i - 10, 5 * j - 10), (5 * i - 5, 5 * j - 5),
             u=((i + 0.5) / 4,) * 2, v=((3.5 - j) / 4,) * 2)
        for i in range(4) for j in range(4)
    ]  # fmt: skip
    settings = pipeline(MATT, diffusion={"limit": "lab", "limit_smooth_mm": 0.0})
    made = render(gl, Asset(joined(halves), {"albedo": colours}), settings, "lab", "albedo")
    seen = made["alpha"][:, :, 0] == 1
    expected = lab_from_linear_rec709(made["albedo"][seen].astype(np.float64))
    np.testing.assert_allclose(made["lab"][seen], expected, atol=0.02)


def test_the_guide_knows_no_light(gl: Device):
    """Exposure must not move the limit, nor a shadow be a border."""
    lamp = {"type": "directional", "azimuth_deg": 70, "irradiance": 50.0, "shadow": False}
    found = [
        render(gl, sphere(10.0, SKIN), pipeline(MATT, lights=[light]), "lab")["lab"]
        for light in (AMBIENT, lamp)
    ]
    np.testing.assert_array_equal(*found)


def test_the_guide_is_smooth_on_skin_and_sharp_at_its_borders(gl: Device):
    asset = patch(SKIN, BORDERS["lip"], 0.1)
    settings = pipeline(MATT, CLOSE, diffusion={"limit": "lab"})
    made = render(gl, asset, settings, "lab", "albedo")
    raw = lab_from_linear_rec709(made["albedo"].astype(np.float64))
    left, right = np.s_[40:120, 25:70], np.s_[40:120, 90:135]
    for side in (left, right):
        assert made["lab"][side][:, :, 0].std() < 0.4 * raw[side][:, :, 0].std()
    step = np.abs(raw[left].mean(axis=(0, 1)) - raw[right].mean(axis=(0, 1)))
    across = np.abs(made["lab"][:, 77].mean(axis=0) - made["lab"][:, 82].mean(axis=0))
    assert (across[:2] > 0.75 * step[:2]).all(), "five pixels: 0.7 mm"


def test_constant_light_stays_constant_under_the_limit(gl: Device):
    settings = pipeline(MATT, skin={"texturing": "post"}, diffusion={"limit": "lab"})
    made = render(gl, patch(SKIN, BORDERS["brow"], 0.2), settings, "scattered")
    seen = made["alpha"][:, :, 0] == 1
    np.testing.assert_allclose(made["scattered"][seen], 1.0, atol=1e-3)


def test_the_mask_works_beside_the_limit(gl: Device):
    asset = plane(10.0)
    asset.maps["skin"] = np.array([[[1.0], [0.0]]], np.float32)
    settings = pipeline(MATT, CLOSE, diffusion={"limit": "lab", "mask": "skin"})
    made = render(gl, asset, settings, "diffuse")
    np.testing.assert_allclose(made["diffuse"][made["alpha"][:, :, 0] == 1], 1.0, atol=1e-3)


def test_no_limit_makes_no_guide(gl: Device):
    asset = Asset(plane(10.0).mesh, {"albedo": flat_map(*SKIN)})
    off, on = (
        Renderer(gl, asset, pipeline(MATT, diffusion={"limit": limit})) for limit in ("none", "lab")
    )
    assert not [s.name for s in off.graph.order({"radiance"}) if s.name.startswith("lab")]
    assert [s.name for s in on.graph.order({"radiance"}) if s.name.startswith("lab")] == [
        "lab_raw",
        "lab_horizontal",
        "lab",
    ]
    idle = Renderer(gl, asset, pipeline(MATT, diffusion={"limit": "lab", "limit_floor": 1.0}))
    assert [d.what for d in idle.decisions] == ["diffusion.limit"]
