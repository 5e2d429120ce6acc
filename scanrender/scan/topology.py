"""Edges, components, loops and normals of a triangle mesh, vectorised."""

from __future__ import annotations

import weakref
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy import sparse
from scipy.sparse import csgraph

Array = npt.NDArray[Any]

REMEMBER_FACES = 5_000_000  # beyond this the memory is worth more than the second
_last_edges: tuple[Callable[[], Array | None], Edges | None] = (lambda: None, None)
_last_pieces: tuple[Callable[[], Array | None], tuple[int, Array] | None] = (lambda: None, None)


@dataclass(frozen=True)
class Edges:
    """Undirected edges of (m, 3) faces.

    pairs (e, 2) sorted vertex pairs; count (e,) faces on each; half (3m,) the edge of half-edge
    `corner * m + face`, which runs from corner to corner + 1; forward (3m,) true where that
    half-edge runs from the smaller to the larger vertex index.
    """

    pairs: Array
    count: Array
    half: Array
    forward: Array


def edges_of(faces: Array) -> Edges:
    """The edges of (m, 3) faces. Those of the last array asked about are remembered, since one
    cleaning step after the other asks about the same one."""
    global _last_edges
    of, edges = _last_edges
    if edges is not None and of() is faces:
        return edges
    edges = _edges_of(faces)
    if _is_remembered(faces):
        _last_edges = weakref.ref(faces), edges
    return edges


def _is_remembered(faces: Array) -> bool:
    """Make faces read-only, so that what is remembered of them stays true, where that is enough
    and worth the memory."""
    worth = faces.base is None and len(faces) <= REMEMBER_FACES
    if worth:
        faces.flags.writeable = False
    return worth


def _edges_of(faces: Array) -> Edges:
    start = faces.T.reshape(-1)
    end = faces[:, [1, 2, 0]].T.reshape(-1)
    low, high = np.minimum(start, end), np.maximum(start, end)
    stride = int(faces.max(initial=0)) + 1
    key = low * stride + high
    order = sorted_order(key)
    ordered = key[order]
    new = np.ones(len(key), bool)
    np.not_equal(ordered[1:], ordered[:-1], out=new[1:])
    half = np.empty(len(key), np.int64)
    half[order] = np.cumsum(new) - 1
    first = np.flatnonzero(new)
    count = np.diff(first, append=len(key))
    pairs = np.stack(np.divmod(ordered[first], stride), axis=1)
    return Edges(pairs, count, half, start < end)


def sorted_order(keys: Array) -> Array:
    """np.argsort(keys, kind="stable") of non-negative integers, four times as fast where key and
    position fit in 63 bits together: NumPy sorts values by vector instructions, indices not."""
    bits = max(1, len(keys).bit_length())
    if len(keys) == 0 or int(keys.max()).bit_length() + bits > 63:
        return np.argsort(keys, kind="stable")
    packed = (keys.astype(np.int64) << bits) | np.arange(len(keys))
    packed.sort()
    return packed & ((1 << bits) - 1)


def face_pairs(faces: Array, edges: Edges | None = None) -> tuple[Array, Array, Array]:
    """Faces that share a two-face edge: (k,) first, (k,) second, and (k,) edge index."""
    edges = edges if edges is not None else edges_of(faces)
    order = sorted_order(edges.half)
    start = np.cumsum(edges.count) - edges.count
    two = np.flatnonzero(edges.count == 2)
    first, second = order[start[two]], order[start[two] + 1]
    return first % len(faces), second % len(faces), two


def components(faces: Array, vertex_count: int) -> tuple[int, Array]:
    """Connected pieces by shared vertices: their number, and the piece (m,) of each face.
    Remembered like `edges_of`."""
    global _last_pieces
    of, pieces = _last_pieces
    if pieces is not None and of() is faces:
        return pieces
    pieces = _components(faces, vertex_count)
    if _is_remembered(faces):
        _last_pieces = weakref.ref(faces), pieces
    return pieces


def _components(faces: Array, vertex_count: int) -> tuple[int, Array]:
    ones = np.ones(2 * len(faces), np.int8)
    rows = np.concatenate([faces[:, 0], faces[:, 0]])
    columns = np.concatenate([faces[:, 1], faces[:, 2]])
    graph = sparse.coo_matrix((ones, (rows, columns)), shape=(vertex_count, vertex_count))
    _, label = csgraph.connected_components(graph, directed=False)
    of_face = label[faces[:, 0]]
    used = np.zeros(int(label.max(initial=-1)) + 1, bool)
    used[of_face] = True
    return int(used.sum()), (np.cumsum(used) - 1)[of_face]


def used_vertices(faces: Array, count: int) -> npt.NDArray[np.bool_]:
    """(count,) which vertices the faces name; a tenth of the time of np.unique."""
    used = np.zeros(count, bool)
    used[faces.reshape(-1)] = True
    return used


def extent(points: Array) -> tuple[Array, Array]:
    """Smallest and largest coordinates (k,) of points (n, k), column by column: along a short last
    axis NumPy's own reduction takes twenty times as long."""
    columns = points.T
    return np.array([c.min() for c in columns]), np.array([c.max() for c in columns])


def span(points: Array) -> Array:
    """(k,) size of the box around points (n, k)."""
    low, high = extent(points)
    return np.asarray(high - low)


def area_normals(positions: Array, faces: Array) -> Array:
    """(m, 3) face normals with the length of twice the area."""
    a, b, c = (np.take(positions, faces[:, i], axis=0) for i in range(3))
    return cross(b - a, c - a)


def face_centres(positions: Array, faces: Array) -> Array:
    """(m, 3) centroids; three times as fast as the mean over a gathered (m, 3, 3)."""
    a, b, c = (np.take(positions, faces[:, i], axis=0) for i in range(3))
    a += b
    a += c
    return np.asarray(a / 3.0)


def face_areas(positions: Array, faces: Array) -> Array:
    return np.asarray(0.5 * lengths(area_normals(positions, faces)))


def lengths(vectors: Array) -> Array:
    """(...) Euclidean lengths of vectors (..., k); three times as fast as np.linalg.norm."""
    return np.asarray(np.sqrt(np.einsum("...i,...i->...", vectors, vectors)))


def cross(a: Array, b: Array) -> Array:
    """(k, 3) cross products, by columns: np.cross makes more copies."""
    out = np.empty(np.broadcast_shapes(a.shape, b.shape), np.result_type(a, b))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        np.multiply(a[..., j], b[..., k], out=out[..., i])
        out[..., i] -= a[..., k] * b[..., j]
    return out


def corner_angles(positions: Array, faces: Array) -> Array:
    """(m, 3) interior angles in radians; 0 at degenerate corners."""
    corner = [np.take(positions, faces[:, i], axis=0) for i in range(3)]
    side = [corner[(i + 1) % 3] - corner[i] for i in range(3)]
    double = lengths(cross(side[0], side[1]))  # twice the area: the same at each corner
    angles = np.empty(faces.shape)
    for i in range(3):
        angles[:, i] = np.arctan2(double, -np.einsum("ij,ij->i", side[i], side[i - 1]))
    angles[double == 0.0] = 0.0
    return angles


def vertex_normals(positions: Array, faces: Array) -> Array:
    """(n, 3) unit normals weighted by corner angle (Thurmer and Wuthrich 1998)."""
    normal = unit(area_normals(positions, faces))
    angles = corner_angles(positions, faces)
    total = np.stack(
        [
            np.bincount(
                faces.T.reshape(-1),
                (angles * normal[:, [axis]]).T.reshape(-1),
                minlength=len(positions),
            )
            for axis in range(3)
        ],
        axis=1,
    )
    return unit(total, fallback=(0.0, 0.0, 1.0))


def unit(vectors: Array, fallback: tuple[float, ...] | None = None) -> Array:
    """Vectors (..., k) of length one; zero vectors stay zero, or become `fallback`."""
    length = lengths(vectors)
    zero = ~(length > 1e-300)
    if not zero.any():
        return np.asarray(vectors / length[..., None])
    result = np.asarray(vectors / np.where(zero, 1.0, length)[..., None])
    if fallback is not None:
        result[zero] = fallback
    return result


def vertex_areas(positions: Array, faces: Array) -> Array:
    """(n,) a third of the area around each vertex."""
    area = face_areas(positions, faces) / 3.0
    return np.bincount(faces.reshape(-1), np.repeat(area, 3), minlength=len(positions))


def boundary_loops(faces: Array) -> list[Array]:
    """Closed loops of boundary vertices, each in the order that *hole-filling* faces would follow.

    Vertices where several boundaries meet end a walk early: such a loop is left out.
    """
    edges = edges_of(faces)
    on_boundary = edges.count[edges.half] == 1
    start = faces.T.reshape(-1)[on_boundary]
    end = faces[:, [1, 2, 0]].T.reshape(-1)[on_boundary]
    following = dict(zip(end.tolist(), start.tolist(), strict=True))
    ambiguous = len(following) != len(end)
    loops = []
    while following:
        first, current = following.popitem()
        loop = [first]
        while current != first and current in following:
            loop.append(current)
            current = following.pop(current)
        if current == first and len(loop) >= 3 and not (ambiguous and _repeats(loop)):
            loops.append(np.array(loop, np.int64))
    return loops


def _repeats(loop: list[int]) -> bool:
    return len(set(loop)) != len(loop)
