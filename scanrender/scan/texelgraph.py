"""The texels of an atlas as one surface: neighbours across chart borders, smoothing, islands.

A brow that runs over three charts is one island here, and a blur does not stop at a seam. Texels
of a chart are joined to their four neighbours; texels at a chart's border to the nearest ones at
another border, where those lie within about a texel on the surface and face the same way.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from scipy import sparse
from scipy.sparse import csgraph

from scanrender.scan.rasterize import Texels
from scanrender.scan.topology import lengths

Array = npt.NDArray[Any]
Mask = npt.NDArray[np.bool_]

REACH = 1.6  # texels between the centres at two sides of a seam
TORN = 4.0  # texels on the surface: neighbours in the map that lie further apart are not joined
SAME_WAY = 0.2  # least cosine of the normals: not from one lip, or one side of an ear, to the other
LINKS = 2  # seam neighbours that one texel takes
_STEP = 0.18  # explicit heat flow on a grid is stable, and nearly isotropic, up to 1/4


class TexelGraph:
    """Nodes are the texels (k,); positions (k, 3) mm and unit normals (k, 3) at them."""

    def __init__(self, texels: Texels, positions: Array, normals: Array, texel_mm: float) -> None:
        self.count, self.texel_mm = len(texels.index), texel_mm
        pairs = _grid_pairs(texels)
        apart = lengths(positions[pairs[:, 0]] - positions[pairs[:, 1]])
        pairs = pairs[apart < TORN * texel_mm]
        seams = _seam_pairs(texels, pairs, positions, normals, texel_mm)
        grid, across = _symmetric(pairs, self.count), _symmetric(seams, self.count)
        # What flows through a seam is what the missing neighbours of both sides would let through.
        missing = np.clip(4.0 - _sums(grid), 0.0, 2.0) / np.maximum(_sums(across), 1.0)
        row = np.repeat(np.arange(self.count), np.diff(across.indptr))
        across.data = (0.5 * (missing[row] + missing[across.indices])).astype(np.float32)
        self.adjacency = grid + across
        self._degree = np.asarray(self.adjacency.sum(axis=1), np.float32)

    def smooth(self, values: Array, sigma_mm: float) -> npt.NDArray[np.float32]:
        """Values (k,) or (k, c) under about a Gaussian of sigma_mm along the surface, and of no
        less than half a texel; heat flow with explicit steps."""
        out = np.asarray(values, np.float32).reshape(self.count, -1)
        time = 0.5 * max(sigma_mm / self.texel_mm, 0.5) ** 2
        steps = int(np.ceil(time / _STEP))
        for _ in range(steps):
            out = out + np.float32(time / steps) * (self.adjacency @ out - self._degree * out)
        return out.reshape(np.shape(values))

    def islands(self, chosen: Mask) -> tuple[npt.NDArray[np.int64], Array, int]:
        """Connected pieces of the mask (k,): nodes (j,), the piece (j,) of each, their count."""
        nodes = np.flatnonzero(chosen)
        inner = self.adjacency[nodes][:, nodes]
        count, piece = csgraph.connected_components(inner, directed=False)
        return nodes, piece, int(count)

    def keep(self, chosen: Mask, wanted: Mask, share: float = 0.0) -> Mask:
        """Only those islands of `chosen` (k,) of which more than `share` is `wanted` (k,) too."""
        nodes, piece, count = self.islands(chosen)
        size = np.bincount(piece, minlength=count)
        holds = np.bincount(piece, wanted[nodes], minlength=count) > share * size
        out = np.zeros(self.count, bool)
        out[nodes] = holds[piece]
        return out

    def grown(self, chosen: Mask, reach_mm: float) -> Mask:
        """The mask (k,) with its neighbours up to reach_mm away, and one texel at least."""
        for _ in range(max(1, round(reach_mm / self.texel_mm))):
            chosen = chosen | (self.adjacency @ chosen.astype(np.float32) > 0.0)
        return chosen

    def areas_mm2(self, chosen: Mask) -> npt.NDArray[np.float64]:
        """(k,) area of the island of `chosen` that each of its texels belongs to, 0 elsewhere."""
        nodes, piece, count = self.islands(chosen)
        out = np.zeros(self.count)
        out[nodes] = np.bincount(piece, minlength=count)[piece] * self.texel_mm**2
        return out


def _symmetric(pairs: Array, count: int) -> Any:
    """(count, count) matrix with 1 for each pair, both ways round."""
    ones = np.ones(len(pairs), np.float32)
    half = sparse.coo_matrix((ones, (pairs[:, 0], pairs[:, 1])), (count, count)).tocsr()
    matrix = half + half.T
    matrix.data[:] = 1.0
    return matrix


def _sums(matrix: Any) -> Array:
    return np.asarray(matrix.sum(axis=1), np.float64).ravel()


def _grid_pairs(texels: Texels) -> npt.NDArray[np.int64]:
    """Pairs of nodes side by side, and one above the other."""
    size, index = texels.size, texels.index
    node = np.full(size * size + size, -1, np.int64)
    node[index] = np.arange(len(index))
    found = []
    for step, inside in ((1, index % size < size - 1), (size, np.ones(len(index), bool))):
        other = node[index + step]
        joined = np.flatnonzero(inside & (other >= 0))
        found.append(np.stack([joined, other[joined]], axis=1))
    return np.concatenate(found)


def _seam_pairs(
    texels: Texels, pairs: Array, positions: Array, normals: Array, texel_mm: float
) -> npt.NDArray[np.int64]:
    """Pairs of border nodes that are far in the map and near on the surface."""
    from scipy.spatial import cKDTree

    degree = np.bincount(pairs.reshape(-1), minlength=len(texels.index))
    border = np.flatnonzero(degree < 4)
    if len(border) < 2:
        return np.zeros((0, 2), np.int64)
    near = min(6, len(border))
    distance, other = cKDTree(positions[border]).query(
        positions[border], k=near, distance_upper_bound=REACH * texel_mm
    )
    other = np.minimum(other, len(border) - 1)
    row, column = np.divmod(texels.index[border], texels.size)
    taken = np.zeros(len(border), np.int64)
    found = []
    for rank in range(1, near):
        there = other[:, rank]
        far = np.maximum(np.abs(row - row[there]), np.abs(column - column[there])) > 2
        cosine = np.einsum("ij,ij->i", normals[border], normals[border[there]])
        joined = np.isfinite(distance[:, rank]) & far & (cosine > SAME_WAY) & (taken < LINKS)
        taken += joined
        found.append(np.stack([border[joined], border[there[joined]]], axis=1))
    return np.concatenate(found)
