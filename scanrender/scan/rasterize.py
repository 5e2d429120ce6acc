"""Rasterise triangles of a UV atlas: which face, and where on it, lies under each texel centre.

Span based and vectorised: triangle -> rows it crosses -> texels between its two edges there, so
that only covered texels are ever touched. Texel centres are at (i + 0.5) / size.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

_CHUNK = 40_000
LEAST_DOUBLE_AREA = 1e-12  # in texels; of a triangle without one no point is known


@dataclass(frozen=True)
class Texels:
    """Covered texels of a square map: flat index (k,) row-major, face (k,), barycentric (k, 3)."""

    size: int
    index: npt.NDArray[np.int64]
    face: npt.NDArray[np.int32]
    bary: npt.NDArray[np.float32]

    def scatter(self, values: npt.NDArray[Any], fill: float = 0.0) -> npt.NDArray[np.float32]:
        """A (size, size, c) map with `values` (k, c) at the covered texels."""
        values = values.reshape(len(self.index), -1)
        out = np.full((self.size * self.size, values.shape[1]), fill, np.float32)
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
    index, face, bary = spans(uv, faces, size)
    owner = np.full(size * size, -1, np.int64)
    owner[index] = np.arange(len(index))
    kept = owner[owner >= 0]
    return Texels(size, index[kept], face[kept], bary[kept])


def overlap_share(uv: npt.NDArray[Any], faces: npt.NDArray[Any], size: int) -> float:
    """Share of the covered texels that lie under more than one triangle."""
    index, _, bary = spans(uv, faces, size)
    # Centres on a common edge count for both triangles: only clear interiors are evidence.
    index = index[bary.min(axis=1) > 1e-3]
    count = np.bincount(index, minlength=1)
    return float((count > 1).sum() / max(1, (count > 0).sum()))


def spans(
    uv: npt.NDArray[Any], faces: npt.NDArray[Any], size: int
) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int32], npt.NDArray[np.float32]]:
    """Every (texel, face) pair: flat texel index, face, barycentric coordinates."""
    pieces = [
        _spans(uv, faces[start : start + _CHUNK], size, start)
        for start in range(0, len(faces), _CHUNK)
    ]
    if not pieces:
        return np.zeros(0, np.int64), np.zeros(0, np.int32), np.zeros((0, 3), np.float32)
    index, face, bary = (np.concatenate(part) for part in zip(*pieces, strict=True))
    return index, face, bary


def covered(uv: npt.NDArray[Any], faces: npt.NDArray[Any], size: int) -> npt.NDArray[np.int64]:
    """The flat texel index of each of the same pairs alone."""
    corner = uv[faces].astype(np.float64) * size - 0.5
    face, row, column = _centres(corner, size)
    valid = np.abs(_double_areas(corner)) > LEAST_DOUBLE_AREA
    return np.asarray((row * size + column)[valid[face]])


def _spans(uv: npt.NDArray[Any], faces: npt.NDArray[Any], size: int, first: int) -> Any:
    corner = uv[faces].astype(np.float64) * size - 0.5  # texel centres are the integers
    face, row, column = _centres(corner, size)
    bary, valid = _barycentric(corner, face, column, row)
    index = row * size + column
    return index[valid], (face[valid] + first).astype(np.int32), bary[valid]


def _centres(corner: npt.NDArray[Any], size: int) -> tuple[Any, Any, Any]:
    """Face, row and column of each texel centre that lies in a triangle (m, 3, 2) in texels."""
    y = corner[:, :, 1]
    top = np.clip(np.ceil(y.min(axis=1)), 0, size).astype(np.int64)
    bottom = np.clip(np.floor(y.max(axis=1)), -1, size - 1).astype(np.int64)
    rows = np.maximum(bottom - top + 1, 0)
    triangle = np.repeat(np.arange(len(corner)), rows)
    row = np.arange(rows.sum()) - np.repeat(np.cumsum(rows) - rows, rows) + top[triangle]
    low, high = _crossings(corner[triangle], row.astype(np.float64))
    left = np.clip(np.ceil(low - 1e-9), 0, size).astype(np.int64)
    right = np.clip(np.floor(high + 1e-9), -1, size - 1).astype(np.int64)
    width = np.maximum(right - left + 1, 0)
    span = np.repeat(np.arange(len(width)), width)
    column = np.arange(width.sum()) - np.repeat(np.cumsum(width) - width, width) + left[span]
    return triangle[span], row[span], column


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


def _barycentric(
    corner: npt.NDArray[Any], face: npt.NDArray[Any], x: npt.NDArray[Any], y: npt.NDArray[Any]
) -> tuple[npt.NDArray[np.float32], npt.NDArray[np.bool_]]:
    """(k, 3) clamped barycentric coordinates; false where the triangle has no area."""
    a, b, c = corner[:, 0], corner[:, 1], corner[:, 2]
    ab, ac = b - a, c - a
    area = _double_areas(corner)
    valid = np.abs(area) > LEAST_DOUBLE_AREA
    inverse = np.where(valid, 1.0 / np.where(valid, area, 1.0), 0.0)
    px, py = x - a[face, 0], y - a[face, 1]
    v = (px * ac[face, 1] - py * ac[face, 0]) * inverse[face]
    w = (ab[face, 0] * py - ab[face, 1] * px) * inverse[face]
    bary = np.clip(np.stack([1.0 - v - w, v, w], axis=1), 0.0, 1.0)
    bary /= np.maximum(bary.sum(axis=1, keepdims=True), 1e-12)
    return bary.astype(np.float32), valid[face]
