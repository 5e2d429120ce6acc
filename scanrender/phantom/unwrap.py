"""A plain texture atlas: box projection, connected charts, shelves; and its rasteriser.

Charts are where a smoothed normal keeps its dominant axis. A chart that folds under itself (deep in
the ear) shares texels; photogrammetry atlases do that too.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from scanrender.phantom.mesh import Faces, adjacency, vertex_normals
from scanrender.phantom.noise import Array

_GUTTER_PX = 4.0
_SMOOTHING = 12
_PIXELS_PER_CHUNK = 4_000_000


@dataclass(frozen=True)
class Atlas:
    """texels (k, 2): x right, y down in texels of its page; corner (m, 3): rows of `texels` per
    face corner; page (m,) of each face; mm_per_texel is the sampling distance on the surface."""

    texels: Array
    corner: NDArray[np.int64]
    page: NDArray[np.int64]
    mm_per_texel: float


def unwrap(positions_mm: Array, faces: Faces, pages: int, page_px: int) -> Atlas:
    """Atlas of `pages` square pages of `page_px`; positions (n, 3) finite."""
    axis = _dominant_axis(positions_mm, faces)
    chart = _charts(faces, axis)
    # One copy of a vertex per chart that uses it.
    key = chart[:, None].astype(np.int64) << 32 | faces.astype(np.int64)
    unique, corner = np.unique(key, return_inverse=True)
    corner = corner.reshape(-1, 3)
    owner, vertex = unique >> 32, unique & 0xFFFFFFFF
    axis_of_chart = np.zeros(int(chart.max()) + 1, dtype=np.int64)
    axis_of_chart[chart] = axis
    flat = _projected(positions_mm[vertex], axis_of_chart[owner])
    count = len(axis_of_chart)
    low, high = np.full((count, 2), np.inf), np.full((count, 2), -np.inf)
    np.minimum.at(low, owner, flat)
    np.maximum.at(high, owner, flat)
    scale, place, page = _packed(high - low, pages, page_px)
    texels = (flat - low[owner]) * scale + place[owner]
    return Atlas(texels, corner, page[chart], 1.0 / scale)


def _dominant_axis(positions: Array, faces: Faces) -> NDArray[np.int64]:
    """(m,) 0..5 for +X +Y +Z -X -Y -Z, from normals smoothed over rings of neighbours."""
    graph = adjacency(faces, len(positions))
    normals = vertex_normals(positions, faces)
    for _ in range(_SMOOTHING):
        normals = normals + graph @ normals
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    mean = normals[faces].sum(axis=1)
    return np.asarray(np.concatenate([mean, -mean], axis=1).argmax(axis=1), dtype=np.int64)


def _charts(faces: Faces, axis: NDArray[np.int64]) -> NDArray[np.int64]:
    """(m,) number of the edge-connected group of faces with one axis."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    edges = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2).astype(np.int64), axis=1)
    key = edges[:, 0] << 32 | edges[:, 1]
    order = np.argsort(key, kind="stable")
    same = key[order[1:]] == key[order[:-1]]
    first, second = order[:-1][same] // 3, order[1:][same] // 3
    joined = axis[first] == axis[second]
    first, second = first[joined], second[joined]
    graph = coo_matrix((np.ones(len(first)), (first, second)), shape=(len(faces),) * 2)
    _, label = connected_components(graph, directed=False)
    return np.asarray(label, dtype=np.int64)


def _projected(points: Array, axis: NDArray[np.int64]) -> Array:
    """(k, 2) right and down coordinates (mm) seen along each point's axis; never mirrored."""
    x, y, z = points.T
    right = np.choose(axis, [-z, x, x, z, x, -x])
    down = np.choose(axis, [-y, z, -y, -y, -z, -y])
    return np.stack([right, down], axis=1)


def _packed(sizes: Array, pages: int, page_px: int) -> tuple[float, Array, NDArray[np.int64]]:
    """Largest scale (texels per mm) at which shelves fit, with each chart's corner and page."""
    total = max(float(sizes.prod(axis=1).sum()), 1e-9)
    low, high = 1e-3, float(np.sqrt(pages * page_px**2 / total))
    order = np.argsort(-sizes[:, 1], kind="stable")
    best: tuple[Array, NDArray[np.int64]] | None = None
    scale = low
    for _ in range(24):
        trial = 0.5 * (low + high)
        placed = _shelves(sizes[order] * trial + 2.0 * _GUTTER_PX, pages, page_px)
        if placed is None:
            high = trial
        else:
            low, best, scale = trial, placed, trial
    if best is None:
        raise ValueError("the charts do not fit the pages at any scale")
    place, page = np.empty_like(best[0]), np.empty_like(best[1])
    place[order], page[order] = best[0] + _GUTTER_PX, best[1]
    return scale, place, page


def _shelves(sizes: Array, pages: int, page_px: int) -> tuple[Array, NDArray[np.int64]] | None:
    """Rows of falling height over the pages, or None if they do not fit."""
    place = np.empty_like(sizes)
    page = np.empty(len(sizes), dtype=np.int64)
    x = y = shelf = 0.0
    current = 0
    for k, (width, height) in enumerate(sizes.tolist()):
        if width > page_px or height > page_px:
            return None
        if x + width > page_px:
            x, y, shelf = 0.0, y + shelf, 0.0
        if y + height > page_px:
            x = y = shelf = 0.0
            current += 1
            if current == pages:
                return None
        place[k] = x, y
        page[k] = current
        x += width
        shelf = max(shelf, height)
    return place, page


def rasterised(
    atlas: Atlas, page: int, page_px: int
) -> Iterator[tuple[NDArray[np.int64], NDArray[np.int64], Array]]:
    """Yield (flat texel index, face, barycentric (k, 3)) for the texel centres inside faces."""
    rows = np.flatnonzero(atlas.page == page)
    corners = atlas.texels[atlas.corner[rows]] - 0.5
    low = np.clip(np.ceil(corners.min(axis=1) - 1e-6), 0, page_px - 1).astype(np.int64)
    high = np.clip(np.floor(corners.max(axis=1) + 1e-6), 0, page_px - 1).astype(np.int64)
    span = np.maximum(high - low + 1, 0)
    boxes = span.prod(axis=1)
    ends = np.cumsum(boxes)
    start = 0
    while start < len(rows):
        before = int(ends[start - 1]) if start else 0
        stop = max(int(np.searchsorted(ends, before + _PIXELS_PER_CHUNK, "right")), start + 1)
        yield _raster_chunk(rows, corners, low, span, boxes, slice(start, stop), page_px)
        start = stop


def _raster_chunk(
    rows: NDArray[np.int64],
    corners: Array,
    low: NDArray[np.int64],
    span: NDArray[np.int64],
    boxes: NDArray[np.int64],
    part: slice,
    page_px: int,
) -> tuple[NDArray[np.int64], NDArray[np.int64], Array]:
    """Test every texel of the faces' bounding boxes against the three edges."""
    count = boxes[part]
    face = np.repeat(np.arange(part.start, part.stop), count)
    within = np.arange(len(face)) - np.repeat(np.cumsum(count) - count, count)
    width = np.maximum(span[face, 0], 1)
    x, y = low[face, 0] + within % width, low[face, 1] + within // width
    a, b, c = (corners[face, k] for k in range(3))
    ab, ac = b - a, c - a
    area = ab[:, 0] * ac[:, 1] - ab[:, 1] * ac[:, 0]
    area = np.where(np.abs(area) < 1e-12, np.inf, area)
    px, py = x - a[:, 0], y - a[:, 1]
    v = (px * ac[:, 1] - py * ac[:, 0]) / area
    w = (ab[:, 0] * py - ab[:, 1] * px) / area
    inside = (v >= -1e-6) & (w >= -1e-6) & (v + w <= 1.0 + 1e-6) & np.isfinite(area)
    v, w = v[inside], w[inside]
    return (y * page_px + x)[inside], rows[face[inside]], np.stack([1.0 - v - w, v, w], axis=1)
