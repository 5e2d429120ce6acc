"""What keeps light from crossing depth steps, and what it costs: the paper's figures 2, 3 and 5."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from render.edges import CLOSE
from render.synthetic import (
    AMBIENT,
    MATT,
    flat_map,
    joined,
    mesh,
    pipeline,
    plane,
    quad,
    render,
    sphere,
    sphere_mesh,
    turned,
)

from scanrender.asset import Asset
from scanrender.render.device import Device
from scanrender.render.frame import Renderer

pytestmark = pytest.mark.gl

HALOS = ("none", "depth", "cbf", "cbf_normalized", "measure")
METHODS = ("gaussian_sum", "separable_preintegrated", "separable_artistic")
FRONT = {"type": "directional", "azimuth_deg": 0, "elevation_deg": 0, "shadow": False}
Floats = npt.NDArray[np.floating]


def scaled(asset: Asset, factor: float) -> Asset:
    old = asset.mesh
    return Asset(mesh(old.positions_mm * factor, old.normals, old.uv, old.faces, old.tangents),
                 asset.maps)  # fmt: skip


# --- figure 2: the guide and distance ------------------------------------------------------------


def guide(gl: Device, asset: Asset, halo: str) -> tuple[Floats, npt.NDArray[np.bool_]]:
    made = render(gl, asset, pipeline(MATT, diffusion={"halo": halo}), "edge_guide")
    return made["edge_guide"][:, :, 0].astype(np.float64), made["alpha"][:, :, 0] == 1


@pytest.mark.parametrize("factor", [2.0, 4.0, 16.0])
def test_scaling_about_the_eye_leaves_the_normalized_guide_alone(gl: Device, factor: float):
    """The camera frames the subject: `factor` times as large is `factor` times as far."""
    asset = sphere(20.0, (0.6, 0.4, 0.2))
    (near, seen), (far, also_seen) = (
        guide(gl, made, "cbf_normalized") for made in (asset, scaled(asset, factor))
    )
    both = seen & also_seen
    assert both.sum() > 4000
    np.testing.assert_allclose(far[both], near[both], rtol=1e-4)
    (near, _), (far, _) = (guide(gl, made, "cbf") for made in (asset, scaled(asset, factor)))
    np.testing.assert_allclose(far[both] / near[both], factor**2, rtol=1e-3)


def test_the_guides_are_their_closed_forms(gl: Device):
    made = render(gl, turned(plane(20.0, (0.6, 0.3, 0.3)), 40.0, "y"), pipeline(MATT),
                  "edge_guide", "position", "normal_geometry")  # fmt: skip
    seen = made["alpha"][:, :, 0] == 1
    p = made["position"][seen].astype(np.float64)
    length = np.linalg.norm(p, axis=1)
    cos_i = -p[:, 2] / length
    cos_j = np.abs(np.sum(made["normal_geometry"][seen] * p, axis=1)) / length
    np.testing.assert_allclose(made["edge_guide"][seen][:, 0], 0.4 * cos_i / cos_j, rtol=1e-3)
    whole = guide(gl, turned(plane(20.0, (0.6, 0.3, 0.3)), 40.0, "y"), "cbf")[0][seen]
    expected = 0.4 * cos_i**3 * (1e-3 * length) ** 2 / cos_j
    np.testing.assert_allclose(whole, expected, rtol=1e-3)


def test_light_does_not_move_the_guide(gl: Device):
    """Grey albedo, not lit light: a shadow's edge is no edge."""
    found = [
        render(gl, sphere(20.0, (0.5, 0.5, 0.5)), pipeline(MATT, lights=[light]), "edge_guide")
        for light in (AMBIENT, {**FRONT, "azimuth_deg": 80, "irradiance": 30.0})
    ]
    np.testing.assert_array_equal(found[0]["edge_guide"], found[1]["edge_guide"])


# --- figure 3: black dots ------------------------------------------------------------------------


def crumpled() -> Asset:
    """Silhouettes, steps, an edge-on sheet, vanishing normals: where the paper has black dots."""
    sheet = quad((-14, -14), (14, 14), z=-6)
    edge_on = turned(plane(10.0), 89.9, "y").mesh
    ball = sphere_mesh(8.0, 12, (4, 3, 4))
    flipped = mesh(ball.positions_mm - np.array([11, 8, 0]), -ball.normals, ball.uv, ball.faces)
    return Asset(joined([sheet, edge_on, ball, flipped]), {"albedo": flat_map(0.7, 0.5, 0.4)})


@pytest.mark.parametrize("halo", HALOS)
@pytest.mark.parametrize("method", METHODS)
def test_no_pixel_is_black_or_not_a_number(gl: Device, halo: str, method: str):
    contrast = 1e6 if halo == "cbf" else 10.0
    settings = pipeline(
        MATT, diffusion={"method": method, "halo": halo, "edge_contrast": contrast,
                         "limit": "lab", "samples": 16},
        camera={"fill": 1.2},
    )  # fmt: skip
    made = render(gl, crumpled(), settings, "diffuse", "nan_map", "weight_sum", "rejected")
    seen = made["alpha"][:, :, 0] == 1
    assert made["nan_map"].max() == 0
    assert all(np.isfinite(made[name]).all() for name in made)
    # Everything is lit by the same light, whichever way it faces.
    np.testing.assert_allclose(made["diffuse"][seen] / [0.7, 0.5, 0.4], 1.0, atol=1e-3)


# --- figure 5: leaks -----------------------------------------------------------------------------


def terrace(step_mm: float, far: float, near: float) -> Asset:
    """A far unlit floor on the left, a near lit one on the right, no wall between; grey albedos."""
    h = 10.0
    halves = (
        quad((-h, -h), (0, h), z=-step_mm / 2, u=(0.25, 0.25), v=(0.5, 0.5)),
        quad((0, -h), (h, h), z=step_mm / 2, u=(0.75, 0.75), v=(0.5, 0.5)),
    )
    maps = {
        "albedo": np.array([[[far] * 3, [near] * 3]], np.float32),
        "normal_ts": np.array([[(1.0, 0, 0), (0, 0, 1.0)]], np.float32),
    }
    return Asset(joined(halves), maps)


def leaked(gl: Device, asset: Asset, **diffusion: Any) -> float:
    """Light on the unlit floor."""
    settings = pipeline(MATT, CLOSE, lights=[FRONT], diffusion={"samples": 25, **diffusion})
    made = render(gl, asset, settings, "diffuse", "diffusion_input")
    dark = (made["diffusion_input"][:, :, 0] == 0) & (made["alpha"][:, :, 0] == 1)
    return float(made["diffuse"][dark].sum())


@pytest.mark.parametrize("method", ["gaussian_sum", "separable_preintegrated"])
@pytest.mark.parametrize("step_mm", [2.0, 5.0, 15.0])
def test_each_mode_leaks_less_across_a_depth_step(gl: Device, method: str, step_mm: float):
    asset = terrace(step_mm, far=0.5, near=0.8)
    none, depth, both, measure = (
        leaked(gl, asset, method=method, halo=halo)
        for halo in ("none", "depth", "cbf_normalized", "measure")
    )
    assert none > 100
    assert none >= depth >= both
    assert both <= 0.1 * none
    assert measure < 0.3 * none


def test_skin_of_one_colour_leaks_by_depth_alone(gl: Device, capsys: pytest.CaptureFixture[str]):
    """Two sheets of equal albedo and tilt are one to the guide: only depth tells them apart.

    2 mm is less than red's own reach of 8 mm: a fifth crosses by right, as `measure` has it too.
    """
    rows = {}
    for step_mm in (2.0, 5.0, 15.0):
        asset = terrace(step_mm, far=0.7, near=0.7)
        none = leaked(gl, asset, halo="none")
        rows[step_mm] = [leaked(gl, asset, halo=halo) / none for halo in HALOS[1:]]
    with capsys.disabled():
        print(f"\nleak across a step in skin of one colour, of `none`: {HALOS[1:]}")
        for step_mm, values in rows.items():
            print(f"  {step_mm:4} mm" + "".join(f"{value:10.4f}" for value in values))
    for step_mm, (depth, cbf, both, measure) in rows.items():
        assert both == pytest.approx(depth, abs=1e-3), step_mm
        assert cbf > 0.9
        assert measure < 0.3
    assert rows[15.0][0] < 1e-3


@pytest.mark.parametrize("halo", ["depth", "cbf_normalized", "measure"])
def test_scattering_across_a_shadow_s_edge_survives(gl: Device, halo: str):
    """On a gently curved cheek (a ball of 60 mm), away from any silhouette."""
    found = {mode: shadow_edge_on_ball(gl, mode) for mode in ("none", halo)}
    assert found["none"] > 100.0
    assert found[halo] >= 0.85 * found["none"]


def test_a_huge_contrast_stops_leaks_by_stopping_scattering(gl: Device):
    """Measure both, or a filter that does nothing wins figure 5. Skin is never of one colour."""
    noise = np.random.default_rng(0).normal(0.6, 0.02, (256, 256, 1))
    dark_left = np.repeat(np.arange(256)[None] >= 128, 256, axis=0).astype(np.float32)
    maps = {"albedo": np.repeat(noise, 3, axis=2), "ao": dark_left[:, :, None]}
    crossed = {}
    for contrast in (0.0, 10.0, 1e4):
        settings = pipeline(MATT, CLOSE, skin={"texturing": "post"}, diffusion={
            "halo": "cbf_normalized", "edge_contrast": contrast})  # fmt: skip
        made = render(gl, Asset(plane(10.0).mesh, maps), settings, "scattered", "diffusion_input")
        dark = made["diffusion_input"][:, :, 0] == 0
        crossed[contrast] = float(made["scattered"][dark].sum())
    assert crossed[10.0] > 0.75 * crossed[0.0]
    assert crossed[1e4] < 0.2 * crossed[0.0]


def shadow_edge_on_ball(gl: Device, halo: str, contrast: float = 10.0) -> float:
    """Light that crosses a hard edge on a ball of 60 mm, within 30 mm of its middle."""
    ball = sphere_mesh(60.0, 64)
    lit = ball.positions_mm[ball.faces].mean(axis=1)[:, 0] > 0
    # Vertices of their own for each side, so that the normal map's step is sharp.
    sides = []
    for side, u in ((lit, 0.75), (~lit, 0.25)):
        used = np.unique(ball.faces[side])
        renumber = np.zeros(len(ball.positions_mm), np.uint32)
        renumber[used] = np.arange(len(used))
        uv = np.tile([u, 0.5], (len(used), 1))
        sides.append(mesh(ball.positions_mm[used], ball.normals[used], uv,
                          renumber[ball.faces[side]]))  # fmt: skip
    maps = {
        "albedo": flat_map(0.7, 0.7, 0.7),
        # The sky is closed to one side: ambient light with a hard edge, at any normal.
        "ao": np.array([[[0.0], [1.0]]], np.float32),
    }
    settings = pipeline(
        MATT,
        camera={"width_px": 150, "height_px": 150, "fill": 2.0},
        diffusion={"halo": halo, "samples": 25, "edge_contrast": contrast},
    )
    made = render(gl, Asset(joined(sides), maps), settings, "diffuse", "diffusion_input",
                  "position")  # fmt: skip
    dark = (made["diffusion_input"][:, :, 0] == 0) & (made["alpha"][:, :, 0] == 1)
    x, y = made["position"][:, :, 0], made["position"][:, :, 1]
    return float(made["diffuse"][dark & (np.hypot(x, y) < 25)].sum())


# --- what the filters say about themselves -------------------------------------------------------


@pytest.mark.parametrize("method", METHODS)
def test_weight_sum_and_rejected_are_whole_on_a_plane_and_fall_at_a_step(gl: Device, method: str):
    settings = pipeline(MATT, CLOSE, diffusion={"method": method, "halo": "depth"})
    flat = render(gl, plane(30.0), settings, "weight_sum", "rejected")
    middle = np.s_[60:100, 60:100]
    np.testing.assert_allclose(flat["weight_sum"][middle], 1.0, atol=1e-3)
    assert flat["rejected"][middle].max() == 0
    step = render(gl, terrace(15.0, 0.7, 0.7), settings, "weight_sum", "rejected")
    row = step["weight_sum"][80, :, 0]
    beside = row[72:88]
    # Half of the horizontal taps at the very edge, but its own, and none of the vertical ones.
    assert beside.min() == pytest.approx(0.78, abs=0.05)
    assert step["rejected"][80, 72:88].max() > 0.1


def test_weight_sum_does_not_run_for_the_picture(gl: Device):
    renderer = Renderer(gl, sphere(10.0), pipeline(MATT))
    names = [step.name for step in renderer.graph.order({"radiance"})]
    assert "weight_sum" not in names
    assert "edge_guide" not in names
    guided = Renderer(gl, sphere(10.0), pipeline(MATT, diffusion={"halo": "cbf_normalized"}))
    names = [step.name for step in guided.graph.order({"radiance"})]
    assert "edge_guide" in names
    assert "jacobian" not in names
