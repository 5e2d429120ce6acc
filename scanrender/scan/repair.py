"""Make a mesh manifold: at most two faces at an edge, one fan of faces at a vertex.

Gueziec, Taubin, Lazarus, Horn: Cutting and Stitching: Converting Sets of Polygons to Manifold
Surfaces, IEEE TVCG 7(2), 2001 (the cutting half: vertices are split where fans only touch).
"""

from __future__ import annotations

import numpy as np
from scipy import sparse
from scipy.sparse import csgraph

from scanrender.scan.surface import Surface
from scanrender.scan.topology import edges_of, face_areas, sorted_order, used_vertices


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
    order = sorted_order(edges.half)
    first_of_edge = np.cumsum(edges.count) - edges.count
    two = np.flatnonzero(edges.count == 2)
    one, other = order[first_of_edge[two]], order[first_of_edge[two] + 1]
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
    if fans == used_vertices(faces, len(surface.positions)).sum():
        return surface  # one fan around each vertex already
    source = np.empty(fans, np.int64)
    source[label] = corner_vertex
    order = sorted_order(source)
    position = np.empty(fans, np.int64)
    position[order] = np.arange(fans)
    return surface.renumber(position[label].reshape(3, count).T.copy(), source[order])
