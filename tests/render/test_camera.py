"""Framing, matrices, jitter and the turn: where a point of the subject lands on the picture."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st
from render.synthetic import MATT, pipeline, sphere

from scanrender.render.camera import Camera, frame_subject, rotation_x, rotation_y
from scanrender.render.device import Device
from scanrender.render.frame import Renderer
from scanrender.render.samples import sample_offsets_px
from scanrender.settings.shot import CameraSettings

ANGLES = np.arange(0.0, 360.0, 30.0)


def on_picture(camera: Camera, points: npt.ArrayLike, turn_deg: float = 0.0, **projection):
    """(x, y) in pixels from the top left corner, and depth, of world points."""
    points = np.asarray(points, dtype=np.float64)
    world = np.column_stack([points, np.ones(len(points))]) @ rotation_y(turn_deg).T
    view = world @ camera.view_from_world.T
    clip = view @ camera.clip_from_view(**projection).T
    ndc = clip[:, :3] / clip[:, 3:]
    guard = projection.get("guard_px", 0)
    width, height = (side + 2 * guard for side in camera.size_px)
    x, y = (ndc[:, 0] + 1) / 2 * width, (1 - ndc[:, 1]) / 2 * height
    return np.column_stack([x - guard, y - guard]), -view[:, 2], ndc[:, 2]


def cloud(seed: int, count: int, stretch: tuple[float, float, float]) -> npt.NDArray[np.float64]:
    rng = np.random.default_rng(seed)
    return rng.normal(size=(count, 3)) * np.asarray(stretch)


@given(
    seed=st.integers(0, 99),
    focal_mm=st.floats(10, 500),
    width=st.integers(16, 4000),
    height=st.integers(16, 4000),
    elevation=st.floats(-89, 89),
    azimuth=st.floats(-360, 360),
    fill=st.floats(0.1, 1.0),
    stretch=st.tuples(*[st.floats(0.1, 1000.0)] * 3),
)
def test_every_vertex_stays_inside_at_every_angle(
    seed, focal_mm, width, height, elevation, azimuth, fill, stretch
):
    points = cloud(seed, 400, stretch)
    settings = CameraSettings(
        width_px=width, height_px=height, focal_mm=focal_mm, fill=fill,
        elevation_deg=elevation, azimuth_deg=azimuth,
    )  # fmt: skip
    camera = frame_subject(settings, points, ANGLES)
    tightest = 0.0
    for angle in ANGLES:
        pixels, depth, ndc_z = on_picture(camera, points, angle)
        assert (depth > 0).all()
        assert (np.abs(ndc_z) <= 1 + 1e-9).all(), "the near or far plane cuts it"
        share = np.abs(pixels / (width, height) - 0.5).max() * 2
        tightest = max(tightest, share)
    assert tightest <= fill * (1 + 1e-6)
    radius = np.linalg.norm(points, axis=1).max()
    if camera.distance_mm > 1.021 * radius:
        assert tightest >= fill * (1 - 1e-6), "nearer would do"


def test_a_single_far_vertex_of_a_dense_mesh_is_not_forgotten():
    points = cloud(0, 50_001, (1.0, 1.0, 1.0)).clip(-3, 3)
    points[12_345] = (0.0, 40.0, 0.0)
    camera = frame_subject(CameraSettings(fill=1.0, elevation_deg=0), points, ANGLES)
    pixels, depth, ndc_z = on_picture(camera, points)
    assert pixels.min() >= -1e-6
    assert (np.abs(ndc_z) <= 1).all()
    assert depth.min() > 0


def test_a_flat_or_tiny_subject_is_framed_too():
    for points in (np.zeros((1, 3)), np.array([[-1.0, 0, 0], [1, 0, 0]]),
                   np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])):  # fmt: skip
        camera = frame_subject(CameraSettings(), points, ANGLES)
        assert camera.distance_mm > 0
        assert 0 < camera.near_mm < camera.far_mm


@pytest.mark.parametrize("angles", [np.linspace(0, 360, 97)[:-1], np.linspace(0, 720, 501)[:-1]])
def test_turns_with_many_frames_fit_as_well(angles: npt.NDArray[np.float64]):
    points = np.array([[100.0, 0, 0], [-100, 0, 0], [0, 30, 0]])
    camera = frame_subject(CameraSettings(fill=0.92, elevation_deg=10), points, angles)
    for angle in angles:
        pixels, _, _ = on_picture(camera, points, angle)
        assert np.abs(pixels / 720 - 0.5).max() <= 0.46 * (1 + 1e-6)


def test_right_is_right_and_up_is_up():
    """Azimuth 0 looks at the face: the subject's own left (+X) is on the picture's right."""
    camera = frame_subject(CameraSettings(elevation_deg=0), cloud(0, 100, (50, 50, 50)), ANGLES)
    (x, y), (x_up, y_up), _ = on_picture(camera, [[10, 0, 0], [0, 10, 0], [0, 0, 0]])[0]
    assert x > 360
    assert y == pytest.approx(360)
    assert y_up < 360
    assert x_up == pytest.approx(360)


def test_turning_the_camera_left_is_turning_the_subject_right():
    camera = frame_subject(CameraSettings(), cloud(0, 100, (50, 50, 50)), ANGLES)
    points = cloud(1, 20, (40, 40, 40))
    turned, _, _ = on_picture(camera.turned(35.0), points)
    np.testing.assert_allclose(turned, on_picture(camera, points, -35.0)[0], atol=1e-9)


@given(st.floats(-0.5, 0.5), st.floats(-0.5, 0.5), st.integers(0, 90))
def test_a_sample_to_the_right_sees_the_picture_moved_left(dx: float, dy: float, guard: int):
    camera = frame_subject(CameraSettings(height_px=300), cloud(0, 50, (60, 60, 60)), ANGLES)
    points = cloud(1, 20, (50, 50, 50))
    centre, _, _ = on_picture(camera, points)
    moved, _, _ = on_picture(camera, points, jitter_px=(dx, dy), guard_px=guard)
    np.testing.assert_allclose(moved, centre - (dx, dy), atol=1e-8)


def test_the_guard_band_moves_nothing():
    camera = frame_subject(CameraSettings(width_px=300), cloud(0, 50, (60, 60, 60)), ANGLES)
    points = cloud(1, 20, (50, 50, 50))
    np.testing.assert_allclose(
        on_picture(camera, points, guard_px=37)[0], on_picture(camera, points)[0], atol=1e-9
    )


@given(st.floats(20, 300), st.integers(64, 2000), st.integers(64, 2000))
def test_px_per_mm_is_what_the_projection_does(focal: float, width: int, height: int):
    settings = CameraSettings(focal_mm=focal, width_px=width, height_px=height, elevation_deg=0)
    camera = frame_subject(settings, cloud(0, 50, (60, 60, 60)), ANGLES)
    pixels, depth, _ = on_picture(camera, [[0, 0, 0], [1, 0, 0], [0, 1, 0]])
    scale = camera.px_per_mm(float(depth[0]))
    assert pixels[1, 0] - pixels[0, 0] == pytest.approx(scale, rel=1e-6)
    assert pixels[0, 1] - pixels[2, 1] == pytest.approx(scale, rel=1e-6), "pixels are square"


def test_rotations_are_right_handed():
    np.testing.assert_allclose(rotation_y(90) @ [0, 0, 1, 1], [1, 0, 0, 1], atol=1e-12)
    np.testing.assert_allclose(rotation_x(90) @ [0, 1, 0, 1], [0, 0, 1, 1], atol=1e-12)


@pytest.mark.parametrize("side", range(1, 17))
def test_samples_are_spread_and_centred(side: int):
    offsets = np.array(sample_offsets_px(side))
    assert len(offsets) == side * side
    assert np.abs(offsets).max() < 0.5
    np.testing.assert_allclose(offsets.mean(axis=0), 0, atol=1e-12)
    for axis in (0, 1):
        assert len(np.unique(np.round(offsets[:, axis], 9))) == side * side, "own column and row"
    cells = np.unique(np.floor((offsets + 0.5) * side), axis=0)
    assert len(cells) == side * side, "one in each cell of the grid"


@pytest.mark.parametrize("side", [2, 4, 8, 16])
def test_boxes_of_every_shape_hold_one_sample(side: int):
    """A texel of a surface seen nearly edge on is as wide as a pixel, and a part of one high."""
    count = side * side
    offsets = np.array(sample_offsets_px(side))
    for columns in 2 ** np.arange(count.bit_length()):
        boxes = np.floor((offsets + 0.5) * [columns, count // columns])
        assert len(np.unique(boxes, axis=0)) == count, f"{columns} x {count // columns}"


@pytest.mark.gl
@pytest.mark.parametrize("projection", ["perspective", "orthographic"])
def test_a_window_is_a_crop_of_the_picture(gl: Device, projection: str):
    """With light that diffuses in from outside the window, too."""
    settings = pipeline(
        MATT,
        camera={"projection": projection, "width_px": 120, "height_px": 96},
        lights=[{"type": "directional", "azimuth_deg": 70, "shadow": False}],
        quality={"supersampling": 2},
    )
    renderer = Renderer(gl, sphere(20.0), settings)
    names = ("beauty", "diffuse", "depth_mm", "kernel_px")
    whole = renderer.render(renderer.view(0), names)
    renderer.show_window((0.5, 0.25, 0.9, 0.75))
    part = renderer.render(renderer.view(0), names)
    assert part.alpha.shape == (48, 48)
    for name in names:
        np.testing.assert_allclose(
            part.buffers[name], whole.buffers[name][24:72, 60:108], rtol=1e-3, atol=1e-3
        )
