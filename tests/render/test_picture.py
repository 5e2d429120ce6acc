"""The picture: which way is up, what is cut off, what is left out, and the view at its end."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from render.synthetic import (
    AMBIENT,
    MATT,
    flat_map,
    joined,
    pipeline,
    plane,
    quad,
    render,
    sphere,
    sphere_mesh,
)

from scanrender.asset import Asset
from scanrender.render.device import Device
from scanrender.render.frame import Renderer
from scanrender.render.scene import NEUTRAL_MAPS
from scanrender.render.view import LOG2_RANGE, apply_view, view_table

pytestmark = pytest.mark.gl


def centre_of(mask: npt.NDArray[np.bool_]) -> tuple[float, float]:
    rows, columns = np.nonzero(mask)
    return float(columns.mean()), float(rows.mean())


# --- orientation ---------------------------------------------------------------------------------


def four_patches() -> Asset:
    """Red at +X +Y, green at -X +Y, blue at -X -Y, white at +X -Y."""
    colours = np.array([[[1, 0, 0], [0, 1, 0]], [[0, 0, 1], [1, 1, 1]]], np.float32)
    patches = [
        quad((0, 0), (10, 10), u=(0.25, 0.25), v=(0.25, 0.25)),
        quad((-10, 0), (0, 10), u=(0.75, 0.75), v=(0.25, 0.25)),
        quad((-10, -10), (0, 0), u=(0.25, 0.25), v=(0.75, 0.75)),
        quad((0, -10), (10, 0), u=(0.75, 0.75), v=(0.75, 0.75)),
    ]
    return Asset(joined(patches), {"albedo": colours})


def quadrants(picture: npt.NDArray[np.float32]) -> list[list[float]]:
    """Mean colour of top left, top right, bottom left, bottom right, rounded."""
    h, w = picture.shape[:2]
    a, b = np.s_[h // 4 : h // 2 - 4], np.s_[h // 2 + 4 : 3 * h // 4]
    c, d = np.s_[w // 4 : w // 2 - 4], np.s_[w // 2 + 4 : 3 * w // 4]
    parts = (picture[a, c], picture[a, d], picture[b, c], picture[b, d])
    return [np.round(part.mean(axis=(0, 1)), 1).tolist() for part in parts]


def test_the_subjects_left_is_on_the_right_and_its_top_at_the_top(gl: Device):
    settings = pipeline(MATT, diffusion={"method": "none"})
    made = render(gl, four_patches(), settings, "albedo")
    red, green, blue, white = [1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 1, 1]
    assert quadrants(made["albedo"]) == [green, red, blue, white]
    assert quadrants(made["beauty"]) == [green, red, blue, white]


def test_a_texture_is_read_from_its_top_left_corner(gl: Device):
    """glTF: (0, 0) is the first texel row's corner; +V runs down the picture."""
    texture = np.zeros((8, 8, 3), np.float32)
    texture[0, 0] = 1.0
    asset = Asset(quad((-10, -10), (10, 10)), {"albedo": texture})
    made = render(gl, asset, pipeline(MATT, diffusion={"method": "none"}), "albedo")
    column, row = centre_of(made["albedo"][:, :, 0] > 0.5)
    assert column < 30
    assert row < 30


@pytest.mark.parametrize("mode", ["subject", "camera"])
def test_a_positive_turn_shows_the_subjects_own_left_first(gl: Device, mode: str):
    ear = joined([sphere_mesh(4.0, 8, (20, 0, 0)), sphere_mesh(10.0, 8)])
    settings = pipeline(MATT, turntable={"mode": mode, "frames": 4, "degrees": 360})
    renderer = Renderer(gl, Asset(ear, {"albedo": flat_map(1, 1, 1)}), settings)
    position = renderer.render(renderer.view(1), ["position"]).buffers["position"]
    # After a quarter turn the left ear points at the camera: nearest, in the middle.
    nearest = np.argmax(np.where(position[:, :, 2] < 0, position[:, :, 2], -1e9))
    row, column = np.unravel_index(nearest, position.shape[:2])
    assert abs(column - 48) < 4
    assert abs(row - 48) < 4


def test_what_turns_decides_where_the_light_stays(gl: Device):
    lamp = {"type": "directional", "azimuth_deg": 90, "elevation_deg": 0, "shadow": False}
    base = pipeline(MATT, lights=[lamp], turntable={"frames": 4})
    lit = {}
    for mode in ("subject", "camera"):
        settings = pipeline(base.model_dump(mode="json"), turntable={"mode": mode})
        made = render(gl, sphere(10.0), settings, "irradiance", index=1)["irradiance"][:, :, 0]
        lit[mode] = (made[:, :44].mean(), made[:, 52:].mean())
    assert lit["subject"][1] > 5 * lit["subject"][0], "lit from +X: the right side, at any turn"
    np.testing.assert_allclose(*lit["camera"], rtol=0.05), "the camera went round to the light"


def test_light_from_above_lights_the_upper_side(gl: Device):
    lamp = {"type": "directional", "azimuth_deg": 0, "elevation_deg": 60, "shadow": False}
    made = render(gl, sphere(10.0), pipeline(MATT, lights=[lamp]), "irradiance")["irradiance"]
    assert made[:40].mean() > 2 * made[56:].mean()


@pytest.mark.parametrize(("axis", "component"), [("right", 0), ("up", 1)])
def test_the_normal_map_tilts_toward_x_and_y_as_it_says(gl: Device, axis: str, component: int):
    """+Y: a green above a half leans up the picture, where v falls."""
    tilt = np.zeros(3, np.float32)
    tilt[component], tilt[2] = 0.6, 0.8
    asset = plane(10.0, normal_ts=flat_map(*tilt))
    made = render(gl, asset, pipeline(MATT), "normal_shading", "normal_geometry")
    middle = made["normal_shading"][48, 48]
    np.testing.assert_allclose(middle, tilt, atol=2e-3)
    np.testing.assert_allclose(made["normal_geometry"][48, 48], [0, 0, 1], atol=1e-5)


def test_a_bump_lit_from_above_is_bright_above(gl: Device):
    size = 64
    y, x = np.mgrid[0:size, 0:size] / (size - 1) * 2 - 1  # y runs down, as rows do
    bump = np.exp(-(x**2 + y**2) * 8)
    normal = np.stack([x * bump * 3, -y * bump * 3, np.ones_like(x)], axis=2)
    normal /= np.linalg.norm(normal, axis=2, keepdims=True)
    lamp = {"type": "directional", "azimuth_deg": 0, "elevation_deg": 45, "shadow": False}
    settings = pipeline(MATT, lights=[lamp], diffusion={"method": "none"})
    light = render(gl, plane(10.0, normal_ts=normal), settings, "irradiance")["irradiance"]
    assert light[36:46, 44:52].mean() > 1.3 * light[50:60, 44:52].mean()


# --- what belongs to the picture -----------------------------------------------------------------


def test_nothing_of_the_subject_is_lost(gl: Device):
    """The scissor that skips the background must not cut the subject, at any turn and size."""
    body = joined([sphere_mesh(10.0, 16, (25, 18, -5)), sphere_mesh(6.0, 12, (-30, -20, 14))])
    asset = Asset(body, {"albedo": flat_map(1, 1, 1)})
    for camera in ({}, {"fill": 4.0}, {"width_px": 33, "height_px": 90}, {"look_up_mm": 30.0}):
        settings = pipeline(MATT, camera=camera, diffusion={"method": "none"})
        renderer = Renderer(gl, asset, settings)
        for index in range(4):
            frame = renderer.render(renderer.view(index), ["depth_mm", "diffuse"])
            drawn = frame.buffers["depth_mm"][:, :, 0] > 0  # the mesh itself has no scissor
            np.testing.assert_array_equal(frame.alpha == 1, drawn)
            np.testing.assert_allclose(frame.buffers["diffuse"][drawn], 1.0, atol=1e-5)


@pytest.mark.parametrize("distance_px", [0.25, -0.25])
def test_supersamples_follow_the_edge(gl: Device, distance_px: float):
    """A vertical edge a quarter of a pixel off leaves that quarter in the coverage."""
    settings = pipeline(MATT, quality={"supersampling": 4}, diffusion={"method": "none"})
    renderer = Renderer(gl, plane(10.0), settings)
    per_mm = renderer.camera.px_per_mm(renderer.camera.distance_mm)
    edge_mm = distance_px / per_mm
    strip = Asset(quad((-10, -10), (edge_mm, 10)), {"albedo": flat_map(1, 1, 1)})
    moved = Renderer(gl, strip, settings)
    object.__setattr__(moved.camera, "distance_mm", renderer.camera.distance_mm)
    row = moved.render(moved.view(0)).alpha[48]
    expected = [1.0, 0.25] if distance_px > 0 else [0.75, 0.0]
    np.testing.assert_allclose(row[47:49], expected, atol=0.07)


@pytest.mark.parametrize(("jitter", "covered"), [(-0.4, True), (0.0, False), (0.4, False)])
def test_a_sample_to_the_left_sees_what_lies_to_the_left(gl: Device, jitter: float, covered: bool):
    """The strip ends a quarter into pixel 48: only samples left of that see it."""
    settings = pipeline(MATT, diffusion={"method": "none"})
    whole = Renderer(gl, plane(10.0), settings)
    edge_mm = 0.25 / whole.camera.px_per_mm(whole.camera.distance_mm)
    strip = Asset(quad((-10, -10), (edge_mm, 10)), {"albedo": flat_map(1, 1, 1)})
    renderer = Renderer(gl, strip, settings)
    object.__setattr__(renderer.camera, "distance_mm", whole.camera.distance_mm)
    shot = renderer._shot(renderer.view(0), (jitter, 0.0), 0)
    made = renderer.graph.run(gl, renderer.pool, shot, {"radiance"})
    row = renderer._read(made["radiance"])[48, :, 3]
    assert row[47] == 1.0
    assert row[48] == float(covered)
    assert row[49] == 0.0


def test_antialiasing_converges_to_coverage(gl: Device):
    asset = sphere(10.0, rings=64)
    pictures = [
        render(gl, asset, pipeline(MATT, quality={"supersampling": n}))["alpha"] for n in (1, 4)
    ]
    assert set(np.unique(pictures[0])) == {0.0, 1.0}
    partial = pictures[1][(pictures[1] > 0) & (pictures[1] < 1)]
    assert len(partial) > 100
    assert abs(pictures[0].sum() - pictures[1].sum()) < 0.01 * pictures[1].sum()


EXTREMES: dict[str, dict[str, Any]] = {
    "grazing and bright": {"lights": [{"type": "directional", "azimuth_deg": 90,
                                       "irradiance": 1e6, "shadow_px": 64}]},
    "light inside": {"lights": [{"type": "spot", "distance_mm": 1, "shadow_px": 64}]},
    "light far away": {"lights": [{"type": "spot", "distance_mm": 1e7, "cone_deg": 1,
                                   "shadow_px": 64}]},
    "mirror": {"skin": {"specular": {"f0": 1.0, "roughness": [0.01, 0.01], "strength": 10}}},
    "very rough": {"skin": {"specular": {"roughness": [1.0, 1.0]}}},
    "camera inside": {"camera": {"fill": 50.0}},
    "thick profile": {"skin": {"scale": 1000.0}},
    "no profile": {"skin": {"scale": 0.0}},
    "thin profile": {"skin": {"scale": 1e-9}},
    "one pixel": {"camera": {"width_px": 1, "height_px": 1}},
    "long exposure": {"view": {"exposure_ev": 30}},
    "no exposure": {"view": {"exposure_ev": -30}},
    "overhead": {"camera": {"elevation_deg": 89}},
    "no lights": {"lights": []},
}  # fmt: skip
PLAIN = {
    "camera": {"width_px": 48, "height_px": 40},
    "lights": [{"type": "directional", "azimuth_deg": 140, "shadow_px": 64}, AMBIENT],
    "quality": {"supersampling": 1},
}


@pytest.mark.parametrize("kind", EXTREMES)
def test_pictures_stay_finite_and_never_negative(gl: Device, kind: str):
    settings = pipeline(PLAIN, EXTREMES[kind])
    asset = sphere(12.0, (0.6, 0.3, 0.2), rings=12)
    renderer = Renderer(gl, asset, settings)
    frame = renderer.render(renderer.view(0), renderer.buffer_names)
    for name, pixels in frame.buffers.items():
        assert np.isfinite(pixels).all(), name
    assert (frame.buffers["beauty"] >= 0).all()
    assert not frame.buffers["nan_map"].any()
    display = frame.buffers["display"]
    assert ((display >= 0) & (display <= 1)).all()


@settings(max_examples=12)
@given(
    roughness=st.tuples(st.floats(0.01, 1), st.floats(0.01, 1)),
    f0=st.floats(0, 1),
    cone=st.floats(1, 170),
    distance=st.floats(1, 1e7),
    azimuth=st.floats(-360, 360),
    scale=st.floats(0, 1000),
)
def test_any_valid_settings_give_a_picture(gl, roughness, f0, cone, distance, azimuth, scale):
    lamp = {"type": "spot", "cone_deg": cone, "distance_mm": distance, "azimuth_deg": azimuth,
            "shadow_px": 32}  # fmt: skip
    made = render(
        gl, sphere(12.0, rings=8),
        pipeline(PLAIN, lights=[lamp, AMBIENT], camera={"width_px": 24, "height_px": 24},
                 skin={"scale": scale, "specular": {"roughness": roughness, "f0": f0}}),
    )  # fmt: skip
    assert (made["beauty"] >= 0).all()
    assert made["alpha"].max() == 1


def test_a_scan_without_maps_is_drawn_with_neutral_ones(gl: Device):
    bare = Asset(sphere_mesh(10.0, 12), {})
    made = render(gl, bare, pipeline(MATT), "albedo", "skin", "ao")
    inside = made["alpha"][:, :, 0] == 1
    for name in ("albedo", "skin", "ao"):
        expected = np.broadcast_to(NEUTRAL_MAPS[name], made[name][inside].shape)
        np.testing.assert_allclose(made[name][inside], expected, atol=1e-3)


def test_the_inside_of_an_open_scan_is_lit_and_is_no_skin(gl: Device):
    made = render(
        gl, Asset(quad((-10, -10), (10, 10), facing=-1.0), {"albedo": flat_map(1, 0, 0)}),
        pipeline(MATT), "normal_geometry", "skin", "albedo",
    )  # fmt: skip
    inside = made["alpha"][:, :, 0] == 1
    assert inside.any()
    assert (made["normal_geometry"][inside][:, 2] > 0.99).all()
    assert (made["skin"][inside] == 0).all()
    assert not np.allclose(made["albedo"][inside], [1, 0, 0])


# --- the view transform --------------------------------------------------------------------------


@pytest.mark.parametrize("transform", ["filmic", "neutral"])
def test_the_table_is_opencolorio(gl: Device, transform: str):
    """Through the shader: each pixel is one scene-linear colour, shown by table and by OCIO."""
    rng = np.random.default_rng(0)
    side = 64
    stops = rng.uniform(-9, 4, size=(side, side, 1))
    colours = np.exp2(stops) * rng.uniform(0.05, 1, size=(side, side, 3))
    colours[:8] = np.exp2(stops[:8])  # greys
    colours[8:16] *= [[[1.0, 0.55, 0.42]]]  # skins
    linear = colours.astype(np.float32)
    shown = tonemapped(gl, linear, {"transform": transform})
    error = np.abs(shown - np.clip(apply_view(linear, transform), 0, 1))
    assert error.mean() <= 0.002
    assert error.max() <= 0.01


def tonemapped(
    gl: Device, linear: npt.NDArray[np.float32], view: dict[str, Any], alpha: float = 1.0
) -> npt.NDArray[np.float32]:
    """`linear` as beauty through the tonemap pass."""
    height, width = linear.shape[:2]
    settings = pipeline(MATT, camera={"width_px": width, "height_px": height}, view=view,
                        diffusion={"method": "none"})  # fmt: skip
    renderer = Renderer(gl, plane(10.0), settings)
    rgba = np.concatenate([linear, np.full((height, width, 1), alpha, np.float32)], axis=2)
    texture = renderer.pool.take((width, height), 4)
    texture.write(np.ascontiguousarray(rgba[::-1], np.float32).tobytes())
    shot = renderer._shot(renderer.view(0), (0.0, 0.0), 0)
    made = renderer.graph.run(gl, renderer.pool, shot, {"display"}, {"beauty": texture})
    return renderer._read(made["display"])[:, :, :3]


def test_exposure_is_in_stops(gl: Device):
    linear = np.full((4, 4, 3), 0.05, np.float32)
    np.testing.assert_allclose(
        tonemapped(gl, linear, {"exposure_ev": 2.0}), tonemapped(gl, 4 * linear, {}), atol=1e-5
    )


def test_the_background_fills_what_the_subject_leaves(gl: Device):
    view = {"background": [0.2, 0.1, 0.05], "transform": "neutral"}
    empty = np.zeros((4, 4, 3), np.float32)
    behind = np.broadcast_to(np.float32(view["background"]), (4, 4, 3))
    expected = apply_view(np.ascontiguousarray(behind), "neutral")
    np.testing.assert_allclose(tonemapped(gl, empty, view, alpha=0.0), expected, atol=0.01)
    assert (tonemapped(gl, empty, view, alpha=1.0) < 0.01).all()
    made = render(gl, sphere(5.0, rings=8), pipeline(MATT, view=view))
    np.testing.assert_allclose(made["display"][0, 0], expected[0, 0], atol=0.01)
    np.testing.assert_allclose(made["beauty"][0, 0], 0.0)


def test_black_is_black_and_white_saturates():
    for transform in ("filmic", "neutral"):
        table = view_table(transform)
        assert np.abs(table[0, 0, 0]).max() < 1e-3
        assert table[-1, -1, -1].min() > 0.95
        steps = np.diff(table[range(64), range(64), range(64)], axis=0)
        assert (steps >= -1e-5).all(), "more light is never darker"
    assert LOG2_RANGE[1] >= 6


def test_the_environment_cannot_change_the_view(monkeypatch: pytest.MonkeyPatch):
    grey = np.full((1, 1, 3), 0.18, np.float32)
    before = apply_view(grey, "filmic")
    monkeypatch.setenv("OCIO", "/nowhere/config.ocio")
    np.testing.assert_array_equal(apply_view(grey, "filmic"), before)
