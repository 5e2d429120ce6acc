"""Last rung of the unwrap ladder: six axis projections and a shelf packer. Always works."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from scanrender.scan.segment import edge_components
from scanrender.scan.topology import area_normals

Array = npt.NDArray[Any]

MOST_PADDING = 0.25  # of the side that a chart has when all are alike: more fills it with gaps


def project(positions: Array, faces: Array) -> tuple[Array, Array]:
    """chart (m,) and corner_uv (m, 3, 2) in the units of positions, counter-clockwise.

    Faces are projected along the axis they look at most; a face without area gets a dot.
    """
    normal = area_normals(positions, faces)
    axis = np.abs(normal).argmax(axis=1)
    positive = np.take_along_axis(normal, axis[:, None], axis=1)[:, 0] >= 0
    side = axis * 2 + positive
    chart = np.full(len(faces), -1, np.int64)
    corner_uv = np.zeros((len(faces), 3, 2))
    count = 0
    for number in range(6):
        chosen = np.flatnonzero(side == number)
        if not len(chosen):
            continue
        u, v = (number // 2 + 1) % 3, (number // 2 + 2) % 3
        flat = positions[faces[chosen]][:, :, [u, v]]
        corner_uv[chosen] = flat if number % 2 else flat * [-1.0, 1.0]
        piece = edge_components(faces[chosen])
        chart[chosen] = piece + count
        count += int(piece.max()) + 1
    return chart, corner_uv


def possible_padding(padding: float, charts: int) -> float:
    """The padding, as a share of the atlas side, or the most that leaves room for the charts."""
    return min(padding, MOST_PADDING / float(np.sqrt(charts)))


def pack_shelves(chart: Array, corner_uv: Array, padding: float) -> Array:
    """Packed corner_uv in [0, 1]: charts as boxes on shelves, `padding` as a share of the side."""
    count = int(chart.max()) + 1
    low, high = np.full((count, 2), np.inf), np.full((count, 2), -np.inf)
    for corner in range(3):
        np.minimum.at(low, chart, corner_uv[:, corner])
        np.maximum.at(high, chart, corner_uv[:, corner])
    size = high - low
    side = float(np.sqrt((size + 1e-12).prod(axis=1).sum())) * 1.1
    order = np.argsort(-size[:, 1], kind="stable")
    for _ in range(60):
        place = _shelves(size, order, side, padding * side)
        if place is not None:
            return np.asarray((corner_uv - low[chart][:, None] + place[chart][:, None]) / side)
        side *= 1.08
    raise ValueError("the charts do not fit into any atlas")


def _shelves(size: Array, order: Array, side: float, gap: float) -> Array | None:
    place = np.zeros_like(size)
    x, y, height = gap, gap, 0.0
    for number in order:
        width, tall = size[number]
        if x + width + gap > side:
            x, y, height = gap, y + height + gap, 0.0
        if x + width + gap > side or y + tall + gap > side:
            return None
        place[number] = (x, y)
        x, height = x + width + gap, max(height, tall)
    return place
