"""Give all faces of a piece the same side, and turn pieces that are inside out.

Two faces agree when they run along their common edge in opposite directions. Each face becomes two
nodes, "as is" and "turned"; agreement joins like nodes and disagreement unlike ones, so that one
connected-components call orients every piece (the orientation double cover).
"""

from __future__ import annotations

import numpy as np
from scipy import sparse
from scipy.sparse import csgraph

from scanrender.scan.surface import Surface
from scanrender.scan.topology import (
    area_normals,
    components,
    edges_of,
    face_centres,
    face_pairs,
    lengths,
    span,
    used_vertices,
)


def orient(surface: Surface) -> tuple[Surface, dict[str, int]]:
    """Consistent winding, outward. Returns the surface and how many faces were turned, and why."""
    consistent, turned = _make_consistent(surface)
    outward, inside_out = _turn_outward(consistent)
    return outward, {"turned_to_agree": turned, "turned_inside_out": inside_out}


def _make_consistent(surface: Surface) -> tuple[Surface, int]:
    faces = surface.faces
    count = len(faces)
    edges = edges_of(faces)
    # The sum of directions over an edge's two half-edges is 0 or 2 where the faces disagree.
    direction = np.bincount(edges.half[edges.forward], minlength=len(edges.count))
    if (direction[edges.count == 2] == 1).all():
        return surface, 0
    first, second, edge = face_pairs(faces, edges)
    agree = direction[edge] == 1
    rows = np.concatenate([first, first + count])
    columns = np.concatenate(
        [np.where(agree, second, second + count), np.where(agree, second + count, second)]
    )
    graph = sparse.coo_matrix((np.ones(len(rows), np.int8), (rows, columns)), (2 * count,) * 2)
    _, label = csgraph.connected_components(graph, directed=False)
    as_is, turned = label[:count], label[count:]
    # Each orientable piece owns two labels; the one under which most faces stay is chosen.
    weight = np.bincount(as_is, minlength=label.max() + 1)
    flipped = weight[turned] > weight[as_is]
    # On a tie the lower label wins, for both faces of a pair alike.
    flipped |= (weight[turned] == weight[as_is]) & (turned < as_is)
    flipped &= as_is != turned  # a piece that is its own mirror image (Moebius) has no sides
    if not flipped.any():
        return surface, 0
    return surface.flip_faces(flipped), int(flipped.sum())


def _turn_outward(surface: Surface) -> tuple[Surface, int]:
    """By the sign of the flux of (x - centre) through each piece, which is 3 volumes if closed."""
    count, piece = components(surface.faces, len(surface.positions))
    normal = area_normals(surface.positions, surface.faces)
    offset = face_centres(surface.positions, surface.faces)
    area = lengths(normal)
    total = np.maximum(np.bincount(piece, area, minlength=count), 1e-300)
    for axis in range(3):
        middle = np.bincount(piece, area * offset[:, axis], minlength=count) / total
        offset[:, axis] -= middle[piece]
    flux = np.bincount(piece, np.einsum("ij,ij->i", offset, normal), minlength=count)
    reach = np.bincount(piece, lengths(offset) * area, minlength=count)
    # A nearly flat sheet has hardly any flux: its file's orientation is the better evidence.
    inside_out = flux < -0.05 * reach
    # A single triangle has none at all: what is left is rounding.
    used = used_vertices(surface.faces, len(surface.positions))
    size = float(span(surface.positions[used]).max())
    inside_out &= reach > 1e-9 * size * total
    flipped = inside_out[piece]
    if not flipped.any():
        return surface, 0
    return surface.flip_faces(flipped), int(flipped.sum())
