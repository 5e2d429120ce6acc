"""Whether the seams of an atlas can be seen: close-ups of the asset, of the as-is asset, and where
the asset's seams lie in the picture.

A seam shows as an edge. Its strength is the gradient of L* (per pixel) on seam pixels over that on
pixels nearby. Charts end where the surface turns, so that seams prefer creases, which have edges of
their own: the same pixels of the as-is picture, where no seam is, say how strong those are.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy import ndimage

from scanrender.asset import Asset, Mesh, load_asset
from scanrender.buffers import Frame
from scanrender.measure.compare_views import (
    RENDERED_MAPS,
    picture_error,
    renderer_like,
    view_settings,
)
from scanrender.metrics import lab_from_linear_rec709, linear_from_srgb
from scanrender.outputs.png import bytes_from_unit, write_bytes_png, write_frame_png
from scanrender.render.camera import rotation_y
from scanrender.render.frame import Renderer, View

Array = npt.NDArray[Any]
Mask = npt.NDArray[np.bool_]

ZOOM = 3.2  # of a bust's picture: at 1024 px a pixel is 0.15 mm, finer than a texel at 4096
AZIMUTHS_DEG = (0.0, 60.0, 180.0, 300.0)
HEAD_ABOVE_CENTRE = 0.15  # of the bust's height: where the middle of the head is
SEAM_PX, NEAR_PX = 1.5, (4.0, 12.0)  # distances from the seam's line
DEPTH_MM = 0.5  # a seam further behind the surface that is seen is hidden
STEP_PX = 0.5
MARK = (255, 40, 40)


@dataclass(frozen=True)
class _Tally:
    """Sums over the close-ups: L* gradients of asset and as-is, dE2000, and how many pixels."""

    asset: float = 0.0
    as_is: float = 0.0
    error: float = 0.0
    count: int = 0

    def plus(self, gradients: tuple[Array, Array], error: Array, where: Mask) -> _Tally:
        return _Tally(
            self.asset + float(gradients[0][where].sum()),
            self.as_is + float(gradients[1][where].sum()),
            self.error + float(error[where].sum()),
            self.count + int(where.sum()),
        )


def seam_visibility(
    reference: Asset | Path, candidate: Asset | Path, out: Path, size_px: int = 1024
) -> dict[str, float]:
    """contrast: edge strength of the asset's seams over that of the as-is asset at the same places,
    1 where seams cannot be seen; error_ratio: dE2000 on seams over dE2000 nearby; seam_px counted.

    Writes OUT/seams_ANGLE_asset.png, _as_is.png and _where.png (seams in red).
    """
    asset, as_is = (x if isinstance(x, Asset) else _loaded(x) for x in (candidate, reference))
    height = float(np.ptp(asset.mesh.positions_mm[:, 1]))
    settings = view_settings(size_px, 2, _close_up(height))
    first = renderer_like(as_is, settings)
    second = renderer_like(asset, settings, first)
    lines = seam_edges(asset.mesh)
    seam, near = _Tally(), _Tally()
    for degrees in AZIMUTHS_DEG:
        view = View(0, 0.0, degrees)
        truth, frame = first.render(view), second.render(view, ("depth_mm",))
        distance = _distance_px(lines, second, view, frame)
        inside = ndimage.binary_erosion((frame.alpha >= 1.0) & (truth.alpha >= 1.0), iterations=4)
        on = inside & (distance <= SEAM_PX)
        beside = inside & (distance >= NEAR_PX[0]) & (distance <= NEAR_PX[1])
        gradients = _gradient(frame), _gradient(truth)
        error, _ = picture_error(frame, truth)
        seam, near = seam.plus(gradients, error, on), near.plus(gradients, error, beside)
        _write(out, f"seams_{degrees:03.0f}", frame, truth, distance <= SEAM_PX)
    return _verdict(seam, near)


def seam_edges(mesh: Mesh) -> Array:
    """(k, 2, 3) end points in mm of the edges at which the atlas is cut, not the surface."""
    _, vertex = np.unique(mesh.positions_mm, axis=0, return_inverse=True)
    ends = mesh.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2).astype(np.int64)
    split, whole = (np.sort(index[ends], axis=1) for index in (np.arange(len(vertex)), vertex))
    alone = _uses(split) == 1
    shared = _uses(whole) > 1
    return np.asarray(mesh.positions_mm[ends[alone & shared]], np.float64)


def _uses(pairs: Array) -> Array:
    """How many of (e, 2) sorted pairs equal each."""
    _, index, count = np.unique(pairs, axis=0, return_inverse=True, return_counts=True)
    return np.asarray(count[index.reshape(-1)])


def _loaded(folder: Path) -> Asset:
    return load_asset(folder, RENDERED_MAPS)


def _close_up(height_mm: float) -> tuple[str, ...]:
    """Lens and framing grow together: the camera stays where it is and sees a part."""
    return (
        f"camera.focal_mm={85.0 * ZOOM}",
        f"camera.fill={0.92 * ZOOM}",
        f"camera.look_up_mm={HEAD_ABOVE_CENTRE * height_mm}",
    )


def _distance_px(lines: Array, renderer: Renderer, view: View, frame: Frame) -> Array:
    """(h, w) distance of each pixel from the nearest seam that is seen."""
    camera = renderer.camera.turned(view.camera_deg)
    width, height = camera.size_px
    view_from_object = camera.view_from_world @ rotation_y(view.subject_deg)
    steps = max(2, int(np.ceil(_longest_px(lines, camera.px_per_mm(camera.near_mm)) / STEP_PX)))
    share = np.linspace(0.0, 1.0, steps)[None, :, None]
    points = (lines[:, :1] * (1.0 - share) + lines[:, 1:] * share).reshape(-1, 3)
    seen = points @ view_from_object[:3, :3].T + view_from_object[:3, 3]
    clip = np.concatenate([seen, np.ones((len(seen), 1))], axis=1) @ camera.clip_from_view().T
    place = clip[:, :2] / clip[:, 3:]
    column = np.floor((place[:, 0] * 0.5 + 0.5) * width).astype(np.int64)
    row = np.floor((0.5 - place[:, 1] * 0.5) * height).astype(np.int64)
    inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
    column, row, depth = column[inside], row[inside], -seen[inside, 2]
    visible = np.abs(depth - frame.buffers["depth_mm"][row, column, 0]) < DEPTH_MM
    mark = np.ones((height, width), bool)
    mark[row[visible], column[visible]] = False
    if mark.all():
        return np.full(mark.shape, np.inf)
    return np.asarray(ndimage.distance_transform_edt(mark))


def _longest_px(lines: Array, px_per_mm: float) -> float:
    lengths = np.linalg.norm(lines[:, 1] - lines[:, 0], axis=1)
    return float(lengths.max(initial=0.0)) * px_per_mm


def _gradient(frame: Frame) -> Array:
    """(h, w) gradient of L* per pixel of the finished picture."""
    lightness = lab_from_linear_rec709(linear_from_srgb(frame.buffers["display"]))[:, :, 0]
    down, right = np.gradient(lightness)
    return np.asarray(np.hypot(down, right))


def _verdict(seam: _Tally, near: _Tally) -> dict[str, float]:
    if not seam.count or not near.count:
        return {"seam_px": 0.0}
    edge = (seam.asset / seam.count) / (near.asset / near.count)
    natural = (seam.as_is / seam.count) / (near.as_is / near.count)
    return {
        "contrast": edge / natural,
        "edge_asset": edge,
        "edge_as_is": natural,
        "de2000_seam": seam.error / seam.count,
        "de2000_near": near.error / near.count,
        "seam_px": float(seam.count),
    }


def _write(out: Path, name: str, frame: Frame, truth: Frame, where: Mask) -> None:
    write_frame_png(out / f"{name}_asset.png", frame)
    write_frame_png(out / f"{name}_as_is.png", truth)
    marked = bytes_from_unit(frame.buffers["display"])
    marked[where] = MARK
    write_bytes_png(out / f"{name}_where.png", marked)
