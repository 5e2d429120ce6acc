"""Flatten one disk-shaped piece with low distortion and without flipped triangles.

Start: Tutte, How to Draw a Graph, 1963 (convex boundary: never a flip). Then SLIM: Rabinovich,
Poranne, Panozzo, Sorkine-Hornung: Scalable Locally Injective Mappings, ACM TOG 36(2), 2017, from
libigl's MPL-2 core. Runs in a child process only.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from scipy import sparse
from scipy.sparse.linalg import spsolve

from scanrender.scan.topology import area_normals, boundary_loops, edges_of

Array = npt.NDArray[Any]
ITERATIONS = (3, 2, 3, 2, 2)  # between the states that are kept; 12 in all


def is_flattenable(faces: Array) -> bool:
    """Whether a manifold piece is a disk, perhaps with holes: genus 0 and at least one boundary."""
    loops = boundary_loops(faces)
    edges = edges_of(faces)
    if not loops or (edges.count > 2).any() or sum(map(len, loops)) != (edges.count == 1).sum():
        return False
    vertices = len(np.unique(faces))
    return bool(vertices - len(edges.pairs) + len(faces) == 2 - len(loops))


def flatten(positions: Array, faces: Array) -> Array:
    """UV (n, 2) in the units of positions, counter-clockwise, with the area of the piece.

    `faces` must pass `is_flattenable` and use every vertex. May still contain flips when SLIM
    fails numerically: check with `signed_areas`.
    """
    return flattenings(positions, faces)[0]


def flattenings(positions: Array, faces: Array) -> list[Array]:
    """What `flatten` gives, then earlier states of its iteration: more stretched, but closer to the
    circle from which it starts, whose border cannot cross itself."""
    import igl

    start = tutte(positions, faces)
    area = 0.5 * np.linalg.norm(area_normals(positions, faces), axis=1).sum()
    start *= np.sqrt(area / max(signed_areas(start, faces).sum(), 1e-300))
    if len(faces) == 1:
        return [isometric_triangle(positions[faces[0]])[np.argsort(faces[0])]]
    data = igl.slim_precompute(
        np.asfortranarray(positions),
        np.asfortranarray(faces.astype(np.int32)),
        np.asfortranarray(start),
        igl.MappingEnergyType.SYMMETRIC_DIRICHLET,
        np.zeros(0, np.int32),
        np.asfortranarray(np.zeros((0, 2))),
        0.0,
    )
    states = []
    for count in ITERATIONS:
        uv = np.array(igl.slim_solve(data, count))[:, :2]
        if not np.isfinite(uv).all() or (signed_areas(uv, faces) <= 0).any():
            break
        states.append(uv * np.sqrt(area / max(signed_areas(uv, faces).sum(), 1e-300)))
    return states[::-1] or [start]


def isometric_triangle(corners: Array) -> Array:
    """One triangle (3, 3) laid flat, (3, 2), counter-clockwise."""
    ab, ac = corners[1] - corners[0], corners[2] - corners[0]
    length = max(float(np.linalg.norm(ab)), 1e-300)
    x = float(ab @ ac) / length
    y = float(np.linalg.norm(np.cross(ab, ac))) / length
    return np.array([[0.0, 0.0], [length, 0.0], [x, y]])


def tutte(positions: Array, faces: Array) -> Array:
    """The longest boundary on a circle, each inner vertex at its neighbours' mean.

    Other boundaries are closed by a virtual vertex, so that the graph is a disk's and the theorem
    holds; the virtual vertices are dropped from the result.
    """
    count = len(positions)
    loops = boundary_loops(faces)
    lengths = [_perimeter(positions[loop]) for loop in loops]
    outer = loops[int(np.argmax(lengths))]
    extra = [loop for i, loop in enumerate(loops) if i != int(np.argmax(lengths))]
    closed = [faces]
    for number, loop in enumerate(extra):
        hub = np.full(len(loop), count + number)
        closed.append(np.stack([loop, np.roll(loop, -1), hub], axis=1))
    total = count + len(extra)
    pairs = edges_of(np.concatenate(closed)).pairs
    half = sparse.coo_matrix((np.ones(len(pairs)), pairs.T), shape=(total, total))
    adjacency = (half + half.T).tocsr()
    laplacian = sparse.diags(np.asarray(adjacency.sum(axis=1)).ravel()) - adjacency
    # boundary_loops runs as a hole-filling face would, clockwise around the piece: reverse it.
    rim = outer[::-1]
    step = np.linalg.norm(positions[rim] - positions[np.roll(rim, 1)], axis=1)
    angle = 2.0 * np.pi * np.cumsum(step) / max(step.sum(), 1e-300)
    uv = np.zeros((total, 2))
    uv[rim] = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    inner = np.setdiff1d(np.arange(total), rim)
    if len(inner):
        system = laplacian.tocsr()[inner]
        right = -(system[:, rim] @ uv[rim])
        uv[inner] = spsolve(system[:, inner].tocsc(), right).reshape(len(inner), 2)
    return uv[:count]


def signed_areas(uv: Array, faces: Array) -> Array:
    """(m,) areas, positive where the triangle is counter-clockwise."""
    a, b, c = (uv[faces[:, i]] for i in range(3))
    u, v = b - a, c - a
    return np.asarray(0.5 * (u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]))


def distortion(positions: Array, faces: Array, uv: Array) -> float:
    """Area-weighted symmetric Dirichlet energy divided by its minimum 4: 1 is an isometry."""
    normal = area_normals(positions, faces)
    double = np.maximum(np.linalg.norm(normal, axis=1), 1e-300)
    a, b, c = (positions[faces[:, i]] for i in range(3))
    e1 = (b - a) / np.maximum(np.linalg.norm(b - a, axis=1, keepdims=True), 1e-300)
    e2 = np.cross(normal / double[:, None], e1)
    x1, x2 = np.einsum("ij,ij->i", b - a, e1), np.einsum("ij,ij->i", c - a, e1)
    y2 = np.maximum(np.einsum("ij,ij->i", c - a, e2), 1e-300)
    p, q = uv[faces[:, 1]] - uv[faces[:, 0]], uv[faces[:, 2]] - uv[faces[:, 0]]
    along = p / np.maximum(x1, 1e-300)[:, None]
    across = (q - along * x2[:, None]) / y2[:, None]
    squared = (along**2).sum(axis=1) + (across**2).sum(axis=1)
    determinant = along[:, 0] * across[:, 1] - along[:, 1] * across[:, 0]
    energy = squared * (1.0 + 1.0 / np.maximum(determinant**2, 1e-12))
    return float((np.minimum(energy, 400.0) * double).sum() / (4.0 * double.sum()))


def _perimeter(ring: Array) -> float:
    return float(np.linalg.norm(ring - np.roll(ring, 1, axis=0), axis=1).sum())
