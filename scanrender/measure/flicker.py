"""`scanrender bench flicker`: what changes from frame to frame on the same point of the skin.

The camera goes around a subject that stands under lights that stand: without highlights, light at a
point is the same in each frame. Each frame's points are looked up in the next frame, and what
differs is flicker, or the texture sampled at other places. The same turn without diffusion, whose
sampling is the same, tells the two apart.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy import ndimage

from scanrender.asset import load_asset
from scanrender.buffers import Frame
from scanrender.files import make_folder
from scanrender.measure import tables
from scanrender.measure.own_head import own_head
from scanrender.measure.prep_bench import write_rows
from scanrender.metrics import delta_e_2000_linear, summarize
from scanrender.render.camera import Camera
from scanrender.render.device import device
from scanrender.render.frame import Renderer
from scanrender.settings.loading import load_pipeline

Array = npt.NDArray[Any]

WAYS = {
    "none": ("diffusion.method=none", "skin.transmission.method=none"),
    "gaussian_sum": ("diffusion.method=gaussian_sum",),
    "separable_preintegrated": ("diffusion.method=separable_preintegrated",),
    "jitter": ("diffusion.method=separable_preintegrated", "diffusion.jitter=true"),
}
# Nothing that the eye moves: highlights are left out, the camera turns and the light does not.
STILL = ("skin.specular.strength=0", "turntable.mode=camera")
BUFFERS = ("position", "normal_geometry")
SAME_MM = 0.5  # the next frame shows the same point when it is as near as that
FACING = 0.35  # cosine to the eye: where skin is turned away, a pixel's footprint is no point
BORDER_PX = 3


def bench_flicker(
    ways: Sequence[str],
    out: Path,
    say: Callable[[str], None],
    asset: Path | None = None,
    overrides: Sequence[str] = (),
) -> list[dict[str, Any]]:
    """One row a way, of the shipped turntable; writes OUT/flicker.json and OUT/flicker.csv.

    asset: a prepared folder; without it our own head. `overrides` change the turntable. Raises
    ScanrenderError's kinds.
    """
    loaded = load_asset(asset or own_head(out, say))
    make_folder(out)
    rows: list[dict[str, Any]] = []
    for way in ways:
        pipeline = load_pipeline("turntable", (*STILL, *WAYS[way], *overrides))
        renderer = Renderer(device(), loaded, pipeline)
        count = pipeline.turntable.frames
        pairs = []
        before: tuple[Frame, Camera] | None = None
        for index in range(count + (abs(pipeline.turntable.degrees) == 360.0)):
            view = renderer.view(index % count)
            now = renderer.render(view, BUFFERS), renderer.camera.turned(view.camera_deg)
            if before is not None:
                pairs.append(asdict(summarize(*residual(*before, *now))))
            before = now
        rows.append({"case": way, "frames": count, **_summary(pairs), "pairs": pairs})
        say(f"{way}: dE2000 mean {rows[-1]['mean']:.3f}, 95 % {rows[-1]['p95']:.3f}")
        write_rows(out, "flicker", rows)
    return rows


def residual(
    first: Frame, first_camera: Camera, second: Frame, second_camera: Camera
) -> tuple[Array, npt.NDArray[np.bool_]]:
    """dE2000 (h, w) between the light at each pixel of the first picture and at the same point of
    the subject in the second, and the mask of the pixels whose point both show."""
    height, width = first.alpha.shape
    eye = first.buffers["position"].astype(np.float64)
    world_from_eye = np.linalg.inv(first_camera.view_from_world)
    world = eye @ world_from_eye[:3, :3].T + world_from_eye[:3, 3]
    there = _moved(second_camera.view_from_world, world)
    matrix = second_camera.clip_from_view()
    clip = np.concatenate([there, np.ones_like(there[..., :1])], axis=2) @ matrix.T
    ndc = clip[..., :2] / np.where(np.abs(clip[..., 3:]) > 1e-9, clip[..., 3:], 1.0)
    at = np.stack(
        [(0.5 - 0.5 * ndc[..., 1]) * height - 0.5, (0.5 + 0.5 * ndc[..., 0]) * width - 0.5]
    )
    inside = _deep(first) & _deep(second)[_nearest(at, (height, width))]
    inside &= ((at >= 0.0) & (at <= np.array([height - 1, width - 1])[:, None, None])).all(axis=0)
    same = np.linalg.norm(_sampled(second.buffers["position"], at) - there, axis=2) < SAME_MM
    light = _sampled(second.buffers["beauty"], at)
    return delta_e_2000_linear(light, first.buffers["beauty"]), inside & same


def _moved(target_from_source: Array, points: Array) -> Array:
    return np.asarray(points @ target_from_source[:3, :3].T + target_from_source[:3, 3])


def _deep(frame: Frame) -> npt.NDArray[np.bool_]:
    """Pixels inside the subject, and turned to the eye."""
    position, normal = frame.buffers["position"], frame.buffers["normal_geometry"]
    away = np.maximum(np.linalg.norm(position, axis=2), 1e-9)
    facing = -np.einsum("hwc,hwc->hw", position, normal) / away
    return np.asarray(
        ndimage.binary_erosion(frame.alpha >= 1.0, iterations=BORDER_PX) & (facing > FACING)
    )


def _nearest(at: Array, shape: tuple[int, int]) -> tuple[Array, Array]:
    rounded = np.rint(np.nan_to_num(at)).astype(int)
    return np.clip(rounded[0], 0, shape[0] - 1), np.clip(rounded[1], 0, shape[1] - 1)


def _sampled(values: Array, at: Array) -> Array:
    """Cubic, (h, w, c): linear sampling would blur half of the frames and not the others."""
    planes = [
        ndimage.map_coordinates(values[:, :, i].astype(np.float64), at, order=3, mode="nearest")
        for i in range(values.shape[2])
    ]
    return np.stack(planes, axis=2)


def _summary(pairs: Sequence[dict[str, float]]) -> dict[str, float]:
    return {
        "mean": float(np.mean([pair["mean"] for pair in pairs])),
        "p95": float(np.mean([pair["p95"] for pair in pairs])),
        "worst_mean": float(np.max([pair["mean"] for pair in pairs])),
        "worst_p95": float(np.max([pair["p95"] for pair in pairs])),
        "pixels": float(np.mean([pair["count"] for pair in pairs])),
    }


LINES = (
    ("case", "case"),
    ("frames", "frames"),
    ("mean", "dE2000 mean"),
    ("p95", "dE2000 95 %"),
    ("worst_mean", "worst pair, mean"),
    ("worst_p95", "worst pair, 95 %"),
    ("pixels", "pixels compared"),
)


def flicker_text(rows: Sequence[dict[str, Any]]) -> str:
    """One column a way."""
    return tables.text(tables.case_table(rows, LINES))
