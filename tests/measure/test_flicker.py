"""What `bench flicker` measures: nothing on a still picture, and a flicker that is put in."""

from __future__ import annotations

import numpy as np
import pytest

from scanrender.asset import save_asset
from scanrender.errors import UsageError
from scanrender.measure import flicker
from scanrender.render.frame import Renderer
from scanrender.settings.loading import load_pipeline
from tests.render.synthetic import sphere

SMALL = (
    "camera.width_px=96",
    "camera.height_px=96",
    "turntable.frames=72",
    "quality.supersampling=1",
)


@pytest.fixture(scope="module")
def frames(gl):
    """Two neighbouring frames of an even sphere with their cameras."""
    pipeline = load_pipeline("turntable", (*flicker.STILL, *SMALL))
    renderer = Renderer(gl, sphere(90.0), pipeline)
    views = [renderer.view(index) for index in (0, 1)]
    return [
        (renderer.render(view, flicker.BUFFERS), renderer.camera.turned(view.camera_deg))
        for view in views
    ]


@pytest.mark.gl
def test_an_even_sphere_does_not_flicker(frames):
    error, mask = flicker.residual(*frames[0], *frames[1])
    assert mask.sum() > 1000
    # What is left lies along the shadow's border, which 96 pixels cannot hold.
    assert np.median(error[mask]) < 0.02
    assert error[mask].mean() < 0.1


@pytest.mark.gl
def test_a_frame_that_is_brighter_is_found(frames):
    (first, camera), (second, turned) = frames
    second.buffers["beauty"][...] *= 1.1
    error, mask = flicker.residual(first, camera, second, turned)
    second.buffers["beauty"][...] /= 1.1
    still = flicker.residual(first, camera, second, turned)[0]
    assert error[mask].mean() > 5.0 * still[mask].mean()


@pytest.mark.gl
def test_points_are_looked_up_where_they_went(frames):
    """A mark on the sphere's front moves by 5 degrees: the lookup follows it, and not the pixel."""
    (first, camera), (second, turned) = frames
    for frame, seen_from in ((first, camera), (second, turned)):
        world = np.linalg.inv(seen_from.view_from_world)
        at = frame.buffers["position"] @ world[:3, :3].T + world[:3, 3]
        frame.buffers["beauty"] = frame.buffers["beauty"].copy()
        frame.buffers["beauty"][...] = 0.2 + 0.1 * np.sin(at[:, :, :1] / 5.0)
    error, mask = flicker.residual(first, camera, second, turned)
    stays = flicker.residual(first, camera, first, turned)
    assert error[mask].mean() < 0.3
    assert not stays[1].any() or stays[0][stays[1]].mean() > 1.0


@pytest.mark.gl
def test_a_turn_closes_and_is_written(tmp_path, gl):
    asset = save_asset(sphere(90.0), tmp_path / "asset")
    few = (*SMALL[:2], "turntable.frames=4", "quality.supersampling=1")
    (row,) = flicker.bench_flicker(["none"], tmp_path, lambda words: None, asset, few)
    assert len(row["pairs"]) == 4, "the last frame is compared with the first"
    assert (tmp_path / "flicker.json").exists()


def test_nothing_is_written_where_there_is_no_asset(tmp_path):
    with pytest.raises(UsageError, match="no such asset"):
        flicker.bench_flicker(["none"], tmp_path / "out", lambda words: None, tmp_path / "none")
    assert not (tmp_path / "out").exists()
