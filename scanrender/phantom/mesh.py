"""From distance function to triangles: a coarse marching-cubes mesh, evened out, then subdivided
and pulled onto the surface, so that no dense fine grid is ever evaluated.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from scanrender.phantom.noise import Array, smoothstep
from scanrender.phantom.shape import BOUNDS_MM, CUT_Y_MM, distance, value_and_gradient

Faces = NDArray[np.int32]

# A base mesh of at most this many triangles is made by marching cubes, and the rest by splitting.
BASE_TRIANGLES = 450_000
_BLOCK = 4  # fine cells per coarse cell, per axis
_FOCUS_MM = ((0.0, 50.0), (-92.0, 26.0), (62.0, 112.0))  # x (of |x|), y, z
_FOCUS_GAIN = 1.9
_TRIANGLES_PER_SQUARE = 9.9e5  # triangles of a head at 1 mm cells, found by counting; a first guess


@dataclass(frozen=True)
class Surface:
    """positions (n, 3) mm float64; faces (m, 3) int32, counter-clockwise from outside."""

    positions: Array
    faces: Faces


def build_surface(triangles: int) -> Surface:
    """The smooth template head of about `triangles` faces (within 10 %), open only at the neck."""
    levels = 0
    while triangles / 4**levels > BASE_TRIANGLES:
        levels += 1
    surface = _base_surface(triangles / 4**levels)
    for _ in range(levels):
        surface = subdivide(surface)
        surface = Surface(project(surface.positions, steps=1), surface.faces)
    return surface


def _base_surface(target: float) -> Surface:
    """Marching cubes at the cell size that gives `target` triangles, corrected until within 5 %."""
    cell = float(np.sqrt(_TRIANGLES_PER_SQUARE / target))
    surface = _marched(cell)
    for _ in range(3):
        ratio = len(surface.faces) / target
        if abs(ratio - 1.0) < 0.05:
            break
        cell *= float(np.sqrt(ratio))
        surface = _marched(cell)
    return _evened(surface, rounds=8)


def _marched(cell: float) -> Surface:
    """Largest component of the zero level on a grid of `cell` mm whose first layer is the cut."""
    from skimage import measure

    axes = [_axis(a, cell) for a in range(3)]
    values = _sparse_grid(axes)
    vertices, faces, _, _ = measure.marching_cubes(values, 0.0, allow_degenerate=False)
    positions = np.stack(
        [np.interp(vertices[:, a], np.arange(len(axes[a])), axes[a]) for a in range(3)], axis=1
    )
    surface = _largest_component(Surface(positions, faces.astype(np.int32)))
    surface.positions[np.abs(surface.positions[:, 1] - CUT_Y_MM) < 1e-3, 1] = CUT_Y_MM
    return _outward(surface)


def _axis(axis: int, cell: float) -> Array:
    """Grid planes along one axis: `cell` mm apart, closer where eyes, nose, mouth and ears are.

    The number of intervals is a multiple of _BLOCK.
    """
    low, high = BOUNDS_MM[:, axis]
    at = np.linspace(low, high, 4001)
    (first, last), fade = _FOCUS_MM[axis], 25.0
    if axis == 0:
        inside = smoothstep(last + fade, last, np.abs(at))
    else:
        inside = smoothstep(first - fade, first, at) * smoothstep(last + fade, last, at)
    density = (1.0 + (_FOCUS_GAIN - 1.0) * inside) / cell
    index = np.concatenate([[0.0], np.cumsum(0.5 * (density[1:] + density[:-1]) * np.diff(at))])
    count = int(np.ceil(index[-1] / _BLOCK)) * _BLOCK
    return np.interp(np.linspace(0.0, index[-1], count + 1), index, at)


def _sparse_grid(axes: list[Array]) -> NDArray[np.float32]:
    """Distances on a grid: exact in blocks near the surface, else interpolated, as sign counts."""
    from scipy import ndimage

    nodes = np.stack(np.meshgrid(*[a[::_BLOCK] for a in axes], indexing="ij"), axis=-1)
    coarse = distance(nodes.reshape(-1, 3)).reshape(nodes.shape[:3])
    fine = coarse
    for axis in range(3):
        fine = _upsampled(fine, axis)
    # A surface inside a block is within half its diagonal of a corner; 1.5 allows for distances
    # that are not exact.
    sizes = np.meshgrid(*[np.diff(a[::_BLOCK]) for a in axes], indexing="ij")
    reach = 1.5 * 0.5 * np.sqrt(sizes[0] ** 2 + sizes[1] ** 2 + sizes[2] ** 2)
    close = ndimage.minimum_filter(np.abs(coarse), size=2)[1:, 1:, 1:] < reach
    mask = np.zeros(fine.shape, dtype=bool)
    for i, j, k in np.argwhere(close):
        mask[tuple(slice(b * _BLOCK, b * _BLOCK + _BLOCK + 1) for b in (i, j, k))] = True
    where = np.nonzero(mask)
    fine[mask] = distance(np.stack([axes[a][where[a]] for a in range(3)], axis=1))
    return fine.astype(np.float32)


def _upsampled(grid: Array, axis: int) -> Array:
    """Insert _BLOCK - 1 linearly interpolated layers between neighbours along `axis`."""
    grid = np.moveaxis(grid, axis, 0)
    out = np.empty(((len(grid) - 1) * _BLOCK + 1, *grid.shape[1:]))
    for k in range(_BLOCK):
        t = k / _BLOCK
        out[k:-1:_BLOCK] = (1.0 - t) * grid[:-1] + t * grid[1:]
    out[-1] = grid[-1]
    return np.moveaxis(out, 0, axis)


def _largest_component(surface: Surface) -> Surface:
    from scipy.sparse.csgraph import connected_components

    count = len(surface.positions)
    _, label = connected_components(adjacency(surface.faces, count), directed=False)
    keep = label == np.bincount(label).argmax()
    renumber = np.cumsum(keep) - 1
    faces = surface.faces[keep[surface.faces[:, 0]]]
    return Surface(surface.positions[keep], renumber[faces].astype(np.int32))


def _outward(surface: Surface) -> Surface:
    """Orient by the signed volume seen from the origin, which is inside the head."""
    a, b, c = (surface.positions[surface.faces[:, k]] for k in range(3))
    if float(np.einsum("ij,ij->", a, np.cross(b, c))) < 0.0:
        return Surface(surface.positions, np.ascontiguousarray(surface.faces[:, ::-1]))
    return surface


def adjacency(faces: Faces, count: int) -> Any:
    """Symmetric (count, count) CSR matrix of ones between vertices that share an edge."""
    from scipy.sparse import coo_matrix

    i = faces[:, [0, 1, 2, 1, 2, 0]].ravel()
    j = faces[:, [1, 2, 0, 0, 1, 2]].ravel()
    matrix = coo_matrix((np.ones(len(i), dtype=np.float64), (i, j)), shape=(count, count)).tocsr()
    matrix.data[:] = 1.0
    return matrix


def boundary_edges(faces: Faces) -> NDArray[np.int64]:
    """(k, 2) vertex pairs of edges that belong to exactly one face."""
    edges = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2).astype(np.int64), axis=1)
    key, count = np.unique(edges[:, 0] << 32 | edges[:, 1], return_counts=True)
    once = key[count == 1]
    return np.stack([once >> 32, once & 0xFFFFFFFF], axis=1)


def _evened(surface: Surface, rounds: int) -> Surface:
    """Slide vertices along the surface toward their neighbours' mean: no marching-cubes slivers."""
    graph = adjacency(surface.faces, len(surface.positions))
    weight = 1.0 / np.asarray(graph.sum(axis=1)).ravel()
    fixed = np.unique(boundary_edges(surface.faces))
    positions = project(surface.positions, steps=1)
    for _ in range(rounds):
        normals = vertex_normals(positions, surface.faces)
        shift = (graph @ positions) * weight[:, None] - positions
        shift -= (shift * normals).sum(axis=1, keepdims=True) * normals
        shift[fixed] = 0.0
        positions = positions + 0.6 * shift
    return Surface(project(positions, steps=2), surface.faces)


def project(positions: Array, steps: int) -> Array:
    """Newton steps onto the surface; a vertex of the neck cut stays in its plane."""
    for _ in range(steps):
        value, gradient = value_and_gradient(positions)
        on_cut = positions[:, 1] <= CUT_Y_MM + 1e-6
        gradient[on_cut, 1] = 0.0
        length = np.maximum(np.square(gradient).sum(axis=1), 0.25)
        # The step is bounded: near a crease the gradient may belong to another sheet.
        step = np.clip(value / length, -0.8, 0.8)
        positions = positions - step[:, None] * gradient
        positions[:, 1] = np.maximum(positions[:, 1], CUT_Y_MM)
        positions[on_cut, 1] = CUT_Y_MM
    return positions


def subdivide(surface: Surface) -> Surface:
    """Each triangle into four at its edge midpoints."""
    faces = surface.faces.astype(np.int64)
    edges = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    key, inverse = np.unique(edges[:, 0] << 32 | edges[:, 1], return_inverse=True)
    middle = 0.5 * (surface.positions[key >> 32] + surface.positions[key & 0xFFFFFFFF])
    ab, bc, ca = (inverse.reshape(-1, 3) + len(surface.positions)).T
    a, b, c = faces.T
    split = np.stack([a, ab, ca, ab, b, bc, ca, bc, c, ab, bc, ca], axis=1).reshape(-1, 3)
    positions = np.concatenate([surface.positions, middle])
    return Surface(positions, split.astype(np.int32))


def vertex_normals(positions: Array, faces: Faces) -> Array:
    """(n, 3) area-weighted unit normals."""
    a, b, c = (positions[faces[:, k]] for k in range(3))
    cross = np.cross(b - a, c - a)
    normals = np.empty_like(positions)
    for axis in range(3):
        weights = np.repeat(cross[:, axis], 3)
        normals[:, axis] = np.bincount(faces.ravel(), weights, minlength=len(positions))
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    return np.asarray(normals / np.maximum(length, 1e-12))
