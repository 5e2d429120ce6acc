"""Take from a flattened piece the few faces that make its border cross itself.

A map without flipped triangles covers nothing twice exactly when its border does not cross itself
(a point's covering is the winding number of the border about it). So the border alone is tested,
and exactly: a texel raster misses what lies between its samples.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from scanrender.scan.segment import edge_components
from scanrender.scan.topology import edges_of

Array = npt.NDArray[Any]
ROUNDS = 12  # what a taken face uncovers may cross again
# Faces that may be taken; beyond that, cutting the piece in two is the better cure.
MAX_TAKEN, MAX_SHARE = 24, 0.005


def simple_part(uv: Array, faces: Array) -> npt.NDArray[np.bool_] | None:
    """(m,) the faces to keep, so that the border of uv (n, 2), faces (m, 3) crosses itself nowhere;
    None where that takes too many. What is kept hangs together."""
    kept = np.ones(len(faces), bool)
    most = min(max(MAX_TAKEN, MAX_SHARE * len(faces)), 0.5 * len(faces))
    for _ in range(ROUNDS):
        rows = np.flatnonzero(kept)
        first, second = border_crossings(uv, faces[rows])
        if not len(first):
            return kept
        kept[rows[_cover(first, second, len(rows))]] = False
        # A part that is cut off could lie within the rest without a crossing: it goes as well.
        rows = np.flatnonzero(kept)
        part = edge_components(faces[rows])
        kept[rows[part != np.bincount(part).argmax()]] = False
        if (~kept).sum() > most:
            return None
    return None


def border_crossings(uv: Array, faces: Array) -> tuple[Array, Array]:
    """Pairs of faces (k,), (k,) where a border edge of one crosses a border edge of the other."""
    edges = edges_of(faces)
    half = np.flatnonzero(edges.count[edges.half] == 1)
    corner, face = np.divmod(half, len(faces))
    start, end = faces[face, corner], faces[face, (corner + 1) % 3]
    a, b = uv[start], uv[end]
    # side[i, j]: on which side of edge i the start (and the end) of edge j lies.
    side_a, side_b = _sides(a, b, a), _sides(a, b, b)
    apart = side_a * side_b < 0.0
    crossing = apart & apart.T
    for x, y in ((start, start), (start, end), (end, start), (end, end)):
        crossing &= x[:, None] != y[None, :]
    i, j = np.nonzero(np.triu(crossing, 1))
    return face[i], face[j]


def _sides(a: Array, b: Array, points: Array) -> Array:
    """(e, e) twice the signed area of each edge a-b with each point, as signs."""
    way = b - a
    dx = points[None, :, 0] - a[:, None, 0]
    dy = points[None, :, 1] - a[:, None, 1]
    return np.asarray(np.sign(way[:, None, 0] * dy - way[:, None, 1] * dx))


def _cover(first: Array, second: Array, count: int) -> Array:
    """Few faces that touch every crossing: the one with most first, then of the rest."""
    open_ = np.ones(len(first), bool)
    taken = []
    while open_.any():
        worst = int(np.bincount(np.r_[first[open_], second[open_]], minlength=count).argmax())
        taken.append(worst)
        open_ &= (first != worst) & (second != worst)
    return np.array(taken, np.int64)
