"""Which parts of the surface belong together: the sheets that a picture shows.

A normalized screen-space method averages over what the picture shows around a pixel, up to where
depth steps. Here a sheet is a set of triangles that the camera sees and that share edges: it ends
at silhouettes and where something nearer hides it, and nowhere else.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from scanrender.reference.rays import Faces, Flags
from scanrender.reference.surface import Surface

Labels = npt.NDArray[np.int64]


def sheets(surface: Surface, is_seen: Flags) -> Labels:
    """(m,) the number of each face's sheet; -1 for a face that is not seen (m,).

    Vertices at the same place are one: texture seams do not part the skin.
    """
    _, place = np.unique(surface.positions, axis=0, return_inverse=True)
    corners = place.reshape(-1)[surface.faces]
    face, other = _neighbours(corners)
    both = is_seen[face] & is_seen[other]
    count = len(corners)
    links = coo_matrix((np.ones(int(both.sum())), (face[both], other[both])), (count, count))
    _, label = connected_components(links, directed=False)
    return np.where(is_seen, label, -1).astype(np.int64)


def _neighbours(corners: Faces) -> tuple[Faces, Faces]:
    """Pairs of faces that share an edge; an edge of three or more links them in a row."""
    edges = np.sort(np.concatenate([corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [2, 0]]]), 1)
    owner = np.tile(np.arange(len(corners)), 3)
    order = np.lexsort((edges[:, 1], edges[:, 0]))
    edges, owner = edges[order], owner[order]
    same = (edges[1:] == edges[:-1]).all(axis=1)
    return owner[:-1][same], owner[1:][same]
