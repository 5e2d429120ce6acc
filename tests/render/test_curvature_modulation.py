"""Curvature as a source and as a modulation: figures 7 to 9 of the paper, and why it is off."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from render.synthetic import MATT, flat_map, merged, pipeline, plane, render, slab, sphere

from scanrender.asset import Asset
from scanrender.render.device import Device
from scanrender.render.frame import Renderer

pytestmark = pytest.mark.gl

MODES = ("increase", "reduce", "reduce_to_minimum")
RADIUS_MM = 20.0
FULL_AT_MM = 10.0
BENT = FULL_AT_MM / RADIUS_MM  # how far the modulation is on the ball below
Made = dict[str, npt.NDArray[np.float32]]


def ball(curvature: float | None = None, **maps: Any) -> Asset:
    asset = sphere(RADIUS_MM, rings=96)
    extra = {} if curvature is None else {"curvature": flat_map(curvature)}
    return Asset(asset.mesh, {**asset.maps, **extra, **maps})


def facing(made: Made) -> npt.NDArray[np.bool_]:
    return (made["alpha"][:, :, 0] == 1) & (made["normal_geometry"][:, :, 2] > 0.7)


@pytest.mark.parametrize("source", ["screen", "baked"])
@pytest.mark.parametrize(
    ("mode", "factor"),
    [("increase", 1 + BENT), ("reduce", BENT), ("reduce_to_minimum", 0.3 + 0.7 * BENT)],
)
def test_each_mode_scales_the_kernel_as_it_says(gl: Device, source: str, mode: str, factor: float):
    asset = ball(1 / RADIUS_MM)
    curvature = {"modulation": mode, "source": source, "full_at_mm": FULL_AT_MM, "minimum": 0.3}
    plain = render(gl, asset, pipeline(MATT), "kernel_px", "normal_geometry", "depth_mm")
    made = render(gl, asset, pipeline(MATT, curvature=curvature), "kernel_px", "depth_mm")
    middle = np.s_[44:52, 44:52]
    wider = made["kernel_px"][middle] * made["depth_mm"][middle]
    usual = plain["kernel_px"][middle] * plain["depth_mm"][middle]
    # The guard band differs with the reach, the pixels per millimetre do not.
    np.testing.assert_allclose(wider / usual, factor, rtol=0.03)


@pytest.mark.parametrize("method", ["gaussian_sum", "separable_preintegrated"])
def test_the_light_follows_the_kernel(gl: Device, method: str):
    """On a plane whose map claims a curvature: width of the edge as at that `skin.scale`."""
    ao = (np.arange(256)[None, :, None] >= 128).astype(np.float32)
    asset = Asset(plane(20.0).mesh, {"albedo": flat_map(1, 1, 1), "ao": ao,
                                     "curvature": flat_map(0.05)})  # fmt: skip
    base = pipeline(MATT, diffusion={"method": method, "samples": 35})
    settings = [
        pipeline(base.model_dump(mode="json"), curvature={
            "source": "baked", "modulation": "reduce_to_minimum", "minimum": 0.3,
            "full_at_mm": 10.0}),
        pipeline(base.model_dump(mode="json"), skin={"scale": 0.3 + 0.7 * 0.5}),
    ]  # fmt: skip
    found = [render(gl, asset, s, "diffuse")["diffuse"][30:66, 30:66] for s in settings]
    np.testing.assert_allclose(*found, atol=0.02)
    full = render(gl, asset, base, "diffuse")["diffuse"][30:66, 30:66]
    assert np.abs(full - found[0]).max() > 0.03


def test_hollows_count_as_flat(gl: Device):
    curvature = {"modulation": "increase", "source": "baked"}
    flat, hollow = (
        render(gl, ball(value), pipeline(MATT, curvature=curvature), "diffuse", "kernel_px")
        for value in (0.0, -0.3)
    )
    np.testing.assert_array_equal(flat["kernel_px"], hollow["kernel_px"])


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("method", ["gaussian_sum", "separable_preintegrated"])
def test_constant_light_stays_constant(gl: Device, mode: str, method: str):
    rng = np.random.default_rng(0)
    noisy = rng.normal(0.05, 0.1, (64, 64, 1)).astype(np.float32)
    settings = pipeline(MATT, diffusion={"method": method},
                        curvature={"modulation": mode, "source": "baked"})  # fmt: skip
    asset = sphere(RADIUS_MM)
    asset.maps["curvature"] = noisy
    made = render(gl, asset, settings, "diffuse")
    seen = made["alpha"][:, :, 0] == 1
    np.testing.assert_allclose(made["diffuse"][seen], 1.0, atol=1e-3)


def test_baked_and_screen_curvature_agree(gl: Device):
    """Within 15 % on skin that nothing hides; the map is what a bake of this ball holds."""
    found = [
        render(gl, ball(1 / RADIUS_MM), pipeline(MATT, curvature={"source": source}),
               "curvature", "normal_geometry")
        for source in ("screen", "baked")
    ]  # fmt: skip
    here = facing(found[0])
    screen, baked = (made["curvature"][here] for made in found)
    np.testing.assert_allclose(screen, baked, rtol=0.15)


def test_what_the_bake_has_smoothed_is_not_smoothed_again(gl: Device):
    steps = (np.arange(64)[None, :, None] % 8 < 4).astype(np.float32) * 0.1
    maps = {"albedo": flat_map(1, 1, 1), "curvature": np.repeat(steps, 64, axis=0)}
    spread = {}
    for done_mm in (0.0, 2.0):
        info = {"stages": [{"name": "report", "notes": {"curvature_scale_mm": done_mm}}]}
        settings = pipeline(MATT, curvature={"source": "baked", "smooth_mm": 2.0})
        made = render(gl, Asset(plane(20.0).mesh, maps, info), settings, "curvature")
        spread[done_mm] = float(made["curvature"][44:52, 30:66].std())
    assert spread[2.0] > 0.03
    assert spread[0.0] < 0.5 * spread[2.0]


def high_frequency(curvature: npt.NDArray[np.floating], here: npt.NDArray[np.bool_]) -> float:
    """Energy of second differences along rows: what a smooth shape has little of."""
    second = curvature[:, 2:] - 2 * curvature[:, 1:-1] + curvature[:, :-2]
    both = here[:, 2:] & here[:, 1:-1] & here[:, :-2]
    return float(np.square(second[both]).mean())


def test_figure_7_the_normal_map_is_too_rough_and_smoothing_helps(gl: Device):
    """Normal map > geometry normals > smoothed. The first is made here: we never use it."""
    rng = np.random.default_rng(0)
    bumps = rng.normal(0.0, 0.15, (64, 64, 3)) + np.array([0, 0, 1])
    bumps /= np.linalg.norm(bumps, axis=2, keepdims=True)
    made = render(gl, ball(normal_ts=bumps.astype(np.float32)), pipeline(MATT), "curvature_raw",
                  "curvature", "position", "normal_shading", "normal_geometry")  # fmt: skip
    here = facing(made)
    dn = np.diff(made["normal_shading"], axis=1, prepend=np.nan)
    dp = np.diff(made["position"], axis=1, prepend=np.nan)
    bumpy = np.sum(dn * dp, axis=2) / np.maximum(np.sum(dp * dp, axis=2), 1e-12)
    here[:, 1:] &= here[:, :-1]
    here[:, 0] = False
    of_map, raw, smooth = (
        high_frequency(image, here)
        for image in (bumpy, made["curvature_raw"][:, :, 0], made["curvature"][:, :, 0])
    )
    assert of_map > 10 * raw
    assert raw > 2 * smooth


def test_off_by_default_and_then_it_costs_nothing(gl: Device):
    renderer = Renderer(gl, ball(), pipeline(MATT))
    names = [step.name for step in renderer.graph.order({"radiance"})]
    assert not [name for name in names if name.startswith(("curvature", "baked"))]
    modulated = Renderer(gl, ball(0.1), pipeline(MATT, curvature={
        "modulation": "reduce", "source": "baked"}))  # fmt: skip
    names = [step.name for step in modulated.graph.order({"radiance"})]
    assert "baked" in names
    assert "curvature_raw" not in names


def test_a_scan_without_the_map_falls_back_and_says_so(gl: Device):
    settings = pipeline(MATT, curvature={"modulation": "reduce", "source": "baked"})
    renderer = Renderer(gl, ball(), settings)
    assert renderer.pipeline.curvature.source == "screen"
    assert any("no curvature map" in decision.reason for decision in renderer.decisions)


def test_figure_9_scaling_transmission_by_curvature_brightens_what_is_bent(gl: Device):
    """The mistake: two sheets of one thickness differ only because one claims to be bent."""
    lamp = {"type": "directional", "azimuth_deg": 180, "elevation_deg": 0}
    modulation = {"modulation": "reduce", "source": "baked", "full_at_mm": 10.0}
    base = merged(MATT, {"lights": [lamp], "skin": {"transmission": {"method": "baked"}}})
    found = {}
    for bent in (0.02, 0.08):
        sheets = slab(20.0, 2.0)
        maps = {**sheets.maps, "thickness_mm": flat_map(2.0), "curvature": flat_map(bent)}
        for wrong in (False, True):
            settings = pipeline(base, curvature={**modulation, "forward_scattering": wrong})
            made = render(gl, Asset(sheets.mesh, maps), settings, "transmission")
            found[bent, wrong] = float(made["transmission"][48, 48, 0])
    assert found[0.02, False] == pytest.approx(found[0.08, False], rel=1e-4)
    assert found[0.08, True] == pytest.approx(4 * found[0.02, True], rel=0.02)
    assert found[0.08, True] == pytest.approx(0.8 * found[0.08, False], rel=0.02)
