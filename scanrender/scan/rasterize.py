"""Rasterise triangles of a UV atlas: which face, and where on it, lies under each texel centre.

Span based and vectorised: triangle -> rows it crosses -> texels between its two edges there, so
that only covered texels are ever touched. Texel centres are at (i + 0.5) / size.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

# At a time: temporary arrays stay near the caches.
_CHUNK_FACES, _CHUNK_TEXELS = 4_000, 100_000
LEAST_DOUBLE_AREA = 1e-12  # in texels; of a triangle without one no point is known


@dataclass(frozen=True)
class Texels:
    """Covered texels of a square map: flat index (k,) row-major, face (k,), barycentric (k, 3)."""

    size: int
    index: npt.NDArray[np.int64]
    face: npt.NDArray[np.int32]
    bary: npt.NDArray[np.float32]

    def scatter(self, values: npt.NDArray[Any]) -> npt.NDArray[np.float32]:
        """A (size, size, c) map with `values` (k, c) at the covered texels, 0 elsewhere."""
        values = values[:, None] if values.ndim == 1 else values
        out = np.zeros((self.size * self.size, values.shape[1]), np.float32)
        out[self.index] = values
        return out.reshape(self.size, self.size, -1)

    @property
    def mask(self) -> npt.NDArray[np.bool_]:
        covered = np.zeros(self.size * self.size, bool)
        covered[self.index] = True
        return covered.reshape(self.size, self.size)

    def interpolate(self, corner_values: npt.NDArray[Any]) -> npt.NDArray[Any]:
        """(k, c) from values (m, 3, c) at the faces' corners."""
        table = np.ascontiguousarray(corner_values, np.float32)
        return np.asarray(np.einsum("kc,kcd->kd", self.bary, np.take(table, self.face, axis=0)))

    def rows(self, start: int, stop: int) -> Texels:
        """The samples start:stop, for work in pieces."""
        cut = slice(start, stop)
        return Texels(self.size, self.index[cut], self.face[cut], self.bary[cut])


def rasterize(uv: npt.NDArray[Any], faces: npt.NDArray[Any], size: int) -> Texels:
    """uv (n, 2) in [0, 1], origin top left; faces (m, 3). Where triangles overlap the last wins."""
    corner = in_texels(uv, faces, size)
    index, face = owners(corner, size)
    bary = np.empty((len(index), 3), np.float32)
    for start in range(0, len(index), _CHUNK_TEXELS):
        cut = slice(start, start + _CHUNK_TEXELS)
        bary[cut] = barycentric_at(corner, face[cut], index[cut], size)
    return Texels(size, index, face, bary)


def in_texels(uv: npt.NDArray[Any], faces: npt.NDArray[Any], size: int) -> npt.NDArray[np.float64]:
    """Corners (m, 3, 2) of the faces on a map of `size`, where texel centres are the integers."""
    return np.asarray(uv[faces].astype(np.float64) * size - 0.5)


def owners(
    corner: npt.NDArray[np.float64], size: int
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int32]]:
    """Flat index (k,) of each covered texel in the map's order, and the last face there."""
    owner = np.full(size * size, -1, np.int32)
    for start in range(0, len(corner), _CHUNK_FACES):
        index, face = _centres(corner[start : start + _CHUNK_FACES], size)
        owner[index] = face + start
    index = np.flatnonzero(owner >= 0)
    return index, owner[index]


def overlap_share(uv: npt.NDArray[Any], faces: npt.NDArray[Any], size: int) -> float:
    """Share of the covered texels that lie under more than one triangle."""
    corner = in_texels(uv, faces, size)
    count = np.zeros(size * size, np.int32)
    for start in range(0, len(corner), _CHUNK_FACES):
        part = corner[start : start + _CHUNK_FACES]
        index, face = _centres(part, size)
        # Centres on a common edge count for both triangles: only clear interiors are evidence.
        inside = barycentric_at(part, face, index, size).min(axis=1) > 1e-3
        count += np.bincount(index[inside], minlength=len(count)).astype(np.int32)
    return float((count > 1).sum() / max(1, (count > 0).sum()))


def covered(uv: npt.NDArray[Any], faces: npt.NDArray[Any], size: int) -> npt.NDArray[np.int64]:
    """The flat texel index of every pair of a triangle and a texel centre in it."""
    return _centres(in_texels(uv, faces, size), size)[0]


def _centres(
    corner: npt.NDArray[Any], size: int
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int32]]:
    """Flat texel index and face of each centre that lies in a triangle (m, 3, 2) with an area."""
    y = corner[:, :, 1]
    top = np.clip(np.ceil(y.min(axis=1)), 0, size).astype(np.int64)
    bottom = np.clip(np.floor(y.max(axis=1)), -1, size - 1).astype(np.int64)
    rows = np.maximum(bottom - top + 1, 0)
    rows[np.abs(_double_areas(corner)) <= LEAST_DOUBLE_AREA] = 0
    triangle = np.repeat(np.arange(len(corner), dtype=np.int32), rows)
    row = np.arange(len(triangle)) + np.repeat(top - np.cumsum(rows) + rows, rows)
    low, high = _crossings(corner[triangle], row.astype(np.float64))
    left = np.clip(np.ceil(low - 1e-9), 0, size).astype(np.int64)
    right = np.clip(np.floor(high + 1e-9), -1, size - 1).astype(np.int64)
    width = np.maximum(right - left + 1, 0)
    first = row * size + left - np.cumsum(width) + width
    face = np.repeat(triangle, width)
    return np.arange(len(face)) + np.repeat(first, width), face


def _double_areas(corner: npt.NDArray[Any]) -> npt.NDArray[np.float64]:
    ab, ac = corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]
    return np.asarray(ab[:, 0] * ac[:, 1] - ab[:, 1] * ac[:, 0])


def _crossings(corner: npt.NDArray[Any], row: npt.NDArray[Any]) -> tuple[Any, Any]:
    """Smallest and largest x at which the triangle's edges cross each row."""
    low, high = np.full(len(row), np.inf), np.full(len(row), -np.inf)
    for i in range(3):
        a, b = corner[:, i], corner[:, (i + 1) % 3]
        rise = b[:, 1] - a[:, 1]
        with np.errstate(divide="ignore", invalid="ignore"):
            t = np.where(rise != 0.0, (row - a[:, 1]) / rise, np.nan)
        hit = (t >= 0.0) & (t <= 1.0)
        x = a[:, 0] + np.where(hit, t, 0.0) * (b[:, 0] - a[:, 0])
        low = np.where(hit, np.minimum(low, x), low)
        high = np.where(hit, np.maximum(high, x), high)
    return np.where(np.isfinite(low), low, 1.0), np.where(np.isfinite(high), high, 0.0)


def barycentric_at(
    corner: npt.NDArray[np.float64],
    face: npt.NDArray[Any],
    index: npt.NDArray[np.int64],
    size: int,
) -> npt.NDArray[np.float32]:
    """(k, 3) clamped barycentric coordinates of texel centres (k,) in faces that have an area."""
    y, x = np.divmod(index, size)
    origin, ab, ac = corner[:, 0], corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]
    inverse = 1.0 / np.where(area := _double_areas(corner), area, 1.0)
    ab, ac = ab * inverse[:, None], ac * inverse[:, None]
    px, py = x - np.take(origin[:, 0], face), y - np.take(origin[:, 1], face)
    v = px * np.take(ac[:, 1], face) - py * np.take(ac[:, 0], face)
    w = py * np.take(ab[:, 0], face) - px * np.take(ab[:, 1], face)
    parts = [np.clip(part, 0.0, 1.0) for part in (1.0 - v - w, v, w)]
    total = np.maximum(parts[0] + parts[1] + parts[2], 1e-12)
    bary = np.empty((len(index), 3), np.float32)
    for column, part in enumerate(parts):
        np.divide(part, total, out=bary[:, column], casting="same_kind")
    return bary
