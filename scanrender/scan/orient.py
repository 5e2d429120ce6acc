"""Give all faces of a piece the same side, and turn pieces that are inside out.

Two faces agree when they run along their common edge in opposite directions. Each face becomes two
nodes, "as is" and "turned"; agreement joins like nodes and disagreement unlike ones, so that one
connected-components call orients every piece (the orientation double cover).
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy import sparse
from scipy.sparse import csgraph

from scanrender.scan.surface import Surface
from scanrender.scan.topology import (
    BLOCK,
    area_normals,
    components,
    edges_of,
    face_centres,
    face_pairs,
    lengths,
    span,
    used_vertices,
)

Array = npt.NDArray[Any]


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
    """By the sign of the flux of (x - centre) through each piece, which is 3 volumes if closed.

    In one pass over the faces: sums about one of a piece's own vertices are taken to its centre
    afterwards. About another point they would cancel, were something else far away.
    """
    count, piece = components(surface.faces, len(surface.positions))
    some_face = np.zeros(count, np.int64)
    some_face[piece] = np.arange(len(piece))
    anchor = surface.positions[surface.faces[some_face, 0]]
    total, flux, square = np.zeros(count), np.zeros(count), np.zeros(count)
    middle, normal_sum = np.zeros((count, 3)), np.zeros((count, 3))
    for of, normal, area, centre in _by_blocks(surface, piece):
        centre -= np.take(anchor, of, axis=0)
        total += np.bincount(of, area, minlength=count)
        flux += np.bincount(of, np.einsum("ij,ij->i", centre, normal), minlength=count)
        square += np.bincount(of, np.einsum("ij,ij->i", centre, centre) * area, minlength=count)
        for axis in range(3):
            middle[:, axis] += np.bincount(of, area * centre[:, axis], minlength=count)
            normal_sum[:, axis] += np.bincount(of, normal[:, axis], minlength=count)
    total = np.maximum(total, 1e-300)
    middle /= total[:, None]
    flux -= np.einsum("ij,ij->i", middle, normal_sum)
    reach = np.sqrt(np.maximum(square / total - np.einsum("ij,ij->i", middle, middle), 0.0))
    # A nearly flat sheet has hardly any flux: its file's orientation is the better evidence.
    inside_out = flux < -0.05 * reach * total
    # A single triangle has none at all: what is left is rounding.
    used = used_vertices(surface.faces, len(surface.positions))
    inside_out &= reach > 1e-9 * float(span(surface.positions[used]).max())
    flipped = inside_out[piece]
    if not flipped.any():
        return surface, 0
    return surface.flip_faces(flipped), int(flipped.sum())


def _by_blocks(surface: Surface, piece: Array) -> Iterator[tuple[Array, Array, Array, Array]]:
    """The piece, normal, its length and the centre of some faces after the other: the temporary
    arrays of all of them would be fresh memory, which takes longer than the sums."""
    for start in range(0, len(piece), BLOCK):
        faces = surface.faces[start : start + BLOCK]
        normal = area_normals(surface.positions, faces)
        centre = face_centres(surface.positions, faces)
        yield piece[start : start + BLOCK], normal, lengths(normal), centre
