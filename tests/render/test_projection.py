"""Orthographic cameras in every pass that measures on screen, and framings in millimetres."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from render.synthetic import MATT, pipeline, plane, render, sphere, turned, two_tone_plane

from scanrender.optics.profiles.gaussians import D_EON_SKIN
from scanrender.optics.surface import SpecularLobes
from scanrender.reference.analytic import half_lit_plane
from scanrender.render.camera import HALF_HEAD_MM, frame_subject
from scanrender.render.device import Device
from scanrender.render.frame import Renderer
from scanrender.resources import shipped_presets
from scanrender.settings.loading import load_pipeline
from scanrender.settings.shot import CameraSettings

pytestmark = pytest.mark.gl

ORTHO: dict[str, Any] = {"camera": {"projection": "orthographic"}}
BALL = np.array([[0.0, 30, 0], [0, -30, 0], [30, 0, 0], [-30, 0, 0], [0, 0, 30], [0, 0, -30]])


def test_the_scale_is_the_same_at_every_depth(gl: Device):
    made = render(gl, turned(plane(20.0), 60.0, "y"), pipeline(MATT, ORTHO, camera={
        "height_mm": 48.0}), "position", "depth_mm", "kernel_px")  # fmt: skip
    inside = made["alpha"][:, :, 0] == 1
    assert np.ptp(made["depth_mm"][inside]) > 30
    y = made["position"][:, 48, 1]
    steps = np.diff(y[inside[:, 48]])
    np.testing.assert_allclose(steps, -48.0 / 96, atol=1e-4)
    reach = np.asarray(D_EON_SKIN.radius_for(0.999))
    np.testing.assert_allclose(made["kernel_px"][inside], np.tile(reach * 2.0, (inside.sum(), 1)),
                               rtol=1e-4)  # fmt: skip


@pytest.mark.parametrize("jitter", [(0.3, 0.0), (0.0, -0.4)])
@pytest.mark.parametrize("guard", [0, 13])
def test_jitter_and_guard_move_an_orthographic_picture_as_they_should(jitter, guard):
    camera = frame_subject(
        CameraSettings(projection="orthographic", width_px=100, height_px=60, height_mm=120.0,
                       elevation_deg=0), BALL, np.zeros(1),
    )  # fmt: skip
    view = camera.view_from_world @ [7.0, 11.0, 5.0, 1.0]
    x, y, z, w = camera.clip_from_view(guard, jitter) @ view
    assert w == 1.0
    assert abs(z) <= 1.0
    pixel = ((x + 1) / 2 * (100 + 2 * guard) - guard, (1 - y) / 2 * (60 + 2 * guard) - guard)
    np.testing.assert_allclose(pixel, (50 + 3.5 - jitter[0], 30 - 5.5 - jitter[1]), atol=1e-9)


@pytest.mark.parametrize("fill", [0.3, 0.9])
@pytest.mark.parametrize("size", [(120, 60), (60, 120)])
def test_an_orthographic_camera_fills_the_picture(fill: float, size: tuple[int, int]):
    settings = CameraSettings(projection="orthographic", fill=fill, width_px=size[0],
                              height_px=size[1], elevation_deg=0)  # fmt: skip
    camera = frame_subject(settings, BALL, np.zeros(1))
    clip = (
        np.column_stack([BALL, np.ones(6)]) @ (camera.clip_from_view() @ camera.view_from_world).T
    )
    assert np.abs(clip[:, :2]).max() == pytest.approx(fill)
    assert np.abs(clip[:, 2]).max() <= 1


def test_a_single_point_is_framed_by_an_orthographic_camera():
    camera = frame_subject(CameraSettings(projection="orthographic"), np.zeros((1, 3)), np.zeros(1))
    assert camera.half_height > 0
    assert np.isfinite(camera.clip_from_view()).all()


@pytest.mark.parametrize("tilt", [0, 55])
def test_a_half_lit_plane_is_a_sum_of_error_functions(gl: Device, tilt: float):
    """Across the tilt, where `measure` is exact; DESIGN 5's case, here without /z."""
    camera = {"width_px": 160, "height_px": 160, "projection": "orthographic", "height_mm": 22.0}
    asset = turned(two_tone_plane(10.0), tilt, "x")
    made = render(gl, asset, pipeline(MATT, camera=camera, diffusion={"samples": 25}), "diffuse",
                  "position")  # fmt: skip
    x = made["position"][80, :, 0].astype(np.float64)
    here = (np.abs(x) < 7.0) & (x != 0)
    error = np.abs(made["diffuse"][80] - half_lit_plane(x, D_EON_SKIN)).max(axis=1)[here]
    assert here.sum() > 80
    # The two pixels that the edge touches see their footprint, not a point.
    assert np.delete(error, np.argsort(np.abs(x[here]))[:2]).max() < 0.01


def test_the_jacobian_is_one_over_the_cosine(gl: Device):
    made = render(gl, turned(plane(20.0), 60.0, "y"), pipeline(MATT, ORTHO), "jacobian")
    inside = made["alpha"][:, :, 0] == 1
    np.testing.assert_allclose(made["jacobian"][inside], 2.0, rtol=1e-4)


def test_highlights_are_seen_along_the_axis(gl: Device):
    lamp = {"type": "directional", "azimuth_deg": 50, "elevation_deg": 0, "shadow": False,
            "irradiance": 1.0}  # fmt: skip
    specular = {"strength": 1.0, "roughness": [0.4, 0.4], "f0": 0.04}
    made = render(gl, sphere(10.0), pipeline(MATT, ORTHO, skin={"specular": specular},
                  lights=[lamp]), "specular", "normal_shading")  # fmt: skip
    inside = made["alpha"][:, :, 0] == 1
    normal = made["normal_shading"][inside].astype(np.float64)
    to_light = np.array([np.sin(np.deg2rad(50)), 0, np.cos(np.deg2rad(50))])
    brdf = SpecularLobes(0.4, 0.4, 1.0, 0.04).brdf(normal, to_light, np.array([0.0, 0, 1]))
    expected = np.pi * brdf * np.maximum(normal @ to_light, 0)
    facing = normal[:, 2] > 0.05
    found = made["specular"][inside][facing, 1]
    np.testing.assert_allclose(found, expected[facing], rtol=0.01, atol=1e-4)


@pytest.mark.parametrize("projection", ["perspective", "orthographic"])
def test_height_mm_is_the_height_at_the_point_looked_at(projection: str):
    settings = CameraSettings(projection=projection, height_mm=200.0, height_px=400, focal_mm=50)
    camera = frame_subject(settings, BALL, np.zeros(1))
    assert camera.px_per_mm(camera.distance_mm) == pytest.approx(2.0)


@pytest.mark.parametrize(("name", "share"), [("close", 0.90), ("mid", 0.45), ("far", 0.15)])
def test_the_framings_show_a_head_as_large_as_they_say(name: str, share: float, tmp_path):
    assert f"camera/{name}" in shipped_presets()
    (tmp_path / "p.yaml").write_text(f"version: 1\nextends: [camera/hd, camera/{name}]\n")
    settings = load_pipeline(tmp_path / "p.yaml").camera
    bust = np.array([[0.0, 300, 0], [0, -300, 0], [250, -300, 0]])
    camera = frame_subject(settings, bust, np.zeros(1))
    assert camera.target_mm[1] == pytest.approx(300 - HALF_HEAD_MM)
    head_px = 227.0 * camera.px_per_mm(camera.distance_mm)
    assert head_px / settings.height_px == pytest.approx(share, rel=1e-3)
    assert camera.near_mm > 0


def test_the_rest_of_the_picture_works_in_parallel_too(gl: Device):
    lamp = {"type": "spot", "azimuth_deg": 150, "shadow_px": 64, "distance_mm": 60}
    renderer = Renderer(gl, sphere(10.0, rings=12), pipeline(MATT, ORTHO, lights=[lamp]))
    frame = renderer.render(renderer.view(1), renderer.buffer_names)
    for name, pixels in frame.buffers.items():
        assert np.isfinite(pixels).all(), name
    assert not frame.buffers["nan_map"].any()
    assert frame.alpha.max() == 1
