"""Make a mesh manifold: at most two faces at an edge, one fan of faces at a vertex.

Gueziec, Taubin, Lazarus, Horn: Cutting and Stitching: Converting Sets of Polygons to Manifold
Surfaces, IEEE TVCG 7(2), 2001 (the cutting half: vertices are split where fans only touch).
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from scipy import sparse
from scipy.sparse import csgraph

from scanrender.scan.surface import Surface
from scanrender.scan.topology import edges_of, face_areas, sorted_order

Array = npt.NDArray[Any]


def drop_extra_faces(surface: Surface) -> Surface:
    """Without the smallest faces at each edge that has more than two."""
    while True:
        edges = edges_of(surface.faces)
        crowded = edges.count > 2
        if not crowded.any():
            return surface
        count = len(surface.faces)
        area = face_areas(surface.positions, surface.faces)
        half = np.flatnonzero(crowded[edges.half])
        face, edge = half % count, edges.half[half]
        order = np.lexsort((-area[face], edge))
        face, edge = face[order], edge[order]
        start = np.concatenate([[True], edge[1:] != edge[:-1]])
        place = np.arange(len(edge))
        rank = place - np.maximum.accumulate(np.where(start, place, 0))
        kept = np.ones(count, bool)
        kept[face[rank >= 2]] = False
        surface = surface.keep_faces(kept)


def split_vertices(surface: Surface) -> Surface:
    """A copy of each vertex for each fan of faces around it. Edges must be manifold already."""
    faces = surface.faces
    count = len(faces)
    edges = edges_of(faces)
    order = edges.order
    first_of_edge = np.cumsum(edges.count) - edges.count
    two = np.flatnonzero(edges.count == 2)
    one, other = order[first_of_edge[two]], order[first_of_edge[two] + 1]
    if _has_single_fans(faces, one, other, len(surface.positions)):
        return surface
    rows, columns = [], []
    # Half-edge h = corner * m + face runs from that corner to the next; both its ends are shared
    # with the other face, at the corner of that face which has the same vertex.
    corner_vertex = faces.T.reshape(-1)
    for end in (0, 1):
        a = (one + end * count) % (3 * count)
        b0, b1 = other, (other + count) % (3 * count)
        rows.append(a)
        columns.append(np.where(corner_vertex[b0] == corner_vertex[a], b0, b1))
    row, column = np.concatenate(rows), np.concatenate(columns)
    graph = sparse.coo_matrix((np.ones(len(row), np.int8), (row, column)), (3 * count, 3 * count))
    fans, label = csgraph.connected_components(graph, directed=False)
    source = np.empty(fans, np.int64)
    source[label] = corner_vertex
    order = sorted_order(source)
    position = np.empty(fans, np.int64)
    position[order] = np.arange(fans)
    return surface.renumber(position[label].reshape(3, count).T.copy(), source[order])


def _has_single_fans(faces: Array, one: Array, other: Array, vertices: int) -> bool:
    """Whether a walk around each vertex, from face to face, meets all of its faces. `one` and
    `other` are the two half-edges of each inner edge. Only for consistently wound faces, where each
    runs against the other; false where they are not.
    """
    count = len(faces)
    # Half the memory to look things up in, where the numbers of the half-edges allow it.
    whole: Any = np.int32 if 3 * count < 1 << 31 else np.int64
    start, half = faces.T.reshape(-1), np.arange(3 * count, dtype=whole)
    if (start[one] == start[other]).any():
        return False
    twin = np.full(3 * count, -1, whole)
    twin[one], twin[other] = other, one
    # A walk begins at a boundary where there is one, so that it goes through the whole fan.
    begin = np.full(vertices, -1, whole)
    begin[start] = half
    open_half = np.flatnonzero(twin < 0)
    begin[start[open_half]] = open_half
    valence = np.bincount(start, minlength=vertices)
    walker = np.flatnonzero(begin >= 0)
    begin, valence = begin[walker], valence[walker]
    # Leaving a vertex along a half-edge, the next that leaves it: across the one before.
    around = np.roll(twin, count)
    at, met = begin, 1
    while len(at):
        at = np.take(around, at)
        going = (at >= 0) & (at != begin)
        if (valence[~going] != met).any():
            return False
        at, begin, valence = at[going], begin[going], valence[going]
        met += 1
    return True
