"""Curvature of whole heads, from the screen and from the bake, on skin that nothing hides."""

from __future__ import annotations

import numpy as np
import pytest
from render.test_halo_heads import head as head  # noqa: PLC0414  the fixture: both heads
from scipy.ndimage import distance_transform_edt, maximum_filter, minimum_filter

from scanrender.asset import Asset
from scanrender.render.device import Device
from scanrender.render.frame import Renderer
from scanrender.settings.loading import load_pipeline

pytestmark = pytest.mark.gl

STEP_MM = 2.0  # to the next pixel: a silhouette
SHOT = (
    "camera.width_px=560", "camera.height_px=560", "quality.supersampling=1",
    "camera.aim=head", "camera.height_mm=252",
    "diffusion.method=separable_preintegrated", "curvature.modulation=reduce",
)  # fmt: skip


def test_baked_and_screen_curvature_agree_on_heads(
    gl: Device, head: tuple[str, Asset], capsys: pytest.CaptureFixture[str]
):
    """Within 15 % (root mean square), further from silhouettes than the smoothing reaches."""
    name, asset = head
    made = {}
    for source in ("screen", "baked"):
        settings = load_pipeline("turntable", (*SHOT, f"curvature.source={source}"))
        renderer = Renderer(gl, asset, settings)
        made[source] = renderer.render(renderer.view(0), ("curvature", "depth_mm"))
    reach_mm = 2.0 * max(settings.curvature.smooth_mm, renderer.scene.baked_curvature_mm)
    frame = made["screen"]
    depth = np.where(frame.alpha == 1, frame.buffers["depth_mm"][:, :, 0], 1e5)
    steps = maximum_filter(depth, 3) - minimum_filter(depth, 3) > STEP_MM
    scale = renderer.camera.px_per_mm(renderer.camera.distance_mm)
    open_skin = distance_transform_edt(~steps) / scale > reach_mm
    open_skin &= frame.alpha == 1
    assert open_skin.sum() > 20_000
    screen, baked = (made[source].buffers["curvature"][:, :, 0][open_skin] for source in made)
    error = np.sqrt(np.mean((screen - baked) ** 2) / np.mean(baked**2))
    median = np.median(np.abs(screen - baked) / np.maximum(np.abs(baked), 0.005))
    with capsys.disabled():
        print(f"\n{name}: screen against baked curvature {error:.3f} RMS, {median:.3f} median")
    assert error <= 0.15
