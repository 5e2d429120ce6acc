"""Smoothing of values on a surface: heat flow, backward Euler, cotangent Laplacian.

Desbrun, Meyer, Schroeder, Barr: Implicit Fairing of Irregular Meshes using Diffusion and Curvature
Flow, SIGGRAPH 1999. Heat flow for time t is, on a plane, a Gaussian of standard deviation sqrt(2t).
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from scipy import sparse

from scanrender.scan.topology import cross, edge_lengths, edges_of, lengths, unit, vertex_areas

Array = npt.NDArray[Any]

MAX_ITERATIONS = 400
MOST_COTANGENT = 10.0  # that of 6 degrees
MAX_ROUNDS = 4  # averages with the neighbours; a wider smoothing is solved for instead
STEPS = 2  # one backward Euler step has a pole at the centre and long tails; two are near Gaussian


def cotangent_laplacian(positions: Array, faces: Array) -> Any:
    """Positive semi-definite (n, n) stiffness matrix of linear elements.

    Negative weights of obtuse corners stay: without them the flow is too fast across stretched
    triangles, and noise that it should flatten survives. A sliver, whose cotangents have any size,
    is weakened as a whole, so that its own energy stays positive and no system is ill-conditioned.
    """
    count = len(positions)
    corner = [np.take(positions, faces[:, i], axis=0) for i in range(3)]
    side = [corner[(i + 2) % 3] - corner[(i + 1) % 3] for i in range(3)]
    dots = [-np.einsum("ij,ij->i", side[(i + 1) % 3], side[(i + 2) % 3]) for i in range(3)]
    double = lengths(cross(side[0], side[1]))
    largest = np.maximum(np.maximum(np.abs(dots[0]), np.abs(dots[1])), np.abs(dots[2]))
    double = np.maximum(double, largest / MOST_COTANGENT + 1e-300)
    half = sparse.coo_matrix(
        (
            np.concatenate([0.5 * dot / double for dot in dots]),
            (faces[:, [1, 2, 0]].T.reshape(-1), faces[:, [2, 0, 1]].T.reshape(-1)),
        ),
        (count, count),
    ).tocsr()
    adjacency = half + half.T
    return sparse.diags(np.asarray(adjacency.sum(axis=1)).ravel()) - adjacency


def diffuse(
    positions: Array,
    faces: Array,
    integrated: Array,
    sigma: float,
    laplacian: Any = None,
    steps: int = STEPS,
) -> Array:
    """Smoothed densities (n, c) of `integrated` (n, c): value times vertex area at each vertex.

    sigma is the Gaussian's standard deviation in the unit of positions; 0 only divides by the area.
    The total of density times area is conserved.
    """
    area = vertex_areas(positions, faces)
    area = np.maximum(area, 1e-9 * float(area.mean()) + 1e-300)
    density = integrated.reshape(len(positions), -1) / area[:, None]
    if sigma <= 0.0:
        return density.reshape(integrated.shape)
    stiffness = cotangent_laplacian(positions, faces) if laplacian is None else laplacian
    step = sigma * sigma / (2.0 * steps)
    system = (sparse.diags(area) + step * stiffness).tocsr()
    for _ in range(steps):
        density = _solved(system, area[:, None] * density, density)
    return density.reshape(integrated.shape)


def faired(positions: Array, faces: Array, sigma: float, laplacian: Any) -> Array:
    """Positions (n, 3) after one implicit step of that flow: noise of the vertices is gone from
    slopes, at the price of shrinking by sigma^2 times the mean curvature."""
    area = vertex_areas(positions, faces)
    area = np.maximum(area, 1e-9 * float(area.mean()) + 1e-300)
    step = 0.5 * sigma * sigma
    system = (sparse.diags(area) + step * laplacian).tocsr()
    # Solved for the way moved, to a hundredth of it: positions themselves may be far from 0.
    moved = _solved(system, -step * (laplacian @ positions), np.zeros_like(positions), 0.01)
    return np.asarray(positions + moved)


def _solved(system: Any, right: Array, start: Array, rtol: float = 1e-4) -> Array:
    """Conjugate gradients (Hestenes and Stiefel 1952) with a diagonal preconditioner, all columns
    of `right` (n, c) at once: one pass over the matrix serves them all."""
    inverse = 1.0 / system.diagonal()[:, None]
    x = start.copy()
    residual = right - system @ x
    goal = (rtol * np.sqrt(np.einsum("ij,ij->j", right, right))) ** 2
    ahead = inverse * residual
    way = ahead.copy()
    energy = np.einsum("ij,ij->j", residual, ahead)
    for _ in range(MAX_ITERATIONS):
        if (np.einsum("ij,ij->j", residual, residual) <= goal).all():
            break
        image = system @ way
        length = energy / np.maximum(np.einsum("ij,ij->j", way, image), 1e-300)
        x += length * way
        residual -= length * image
        ahead = inverse * residual
        before, energy = energy, np.einsum("ij,ij->j", residual, ahead)
        way *= energy / np.maximum(before, 1e-300)
        way += ahead
    return x


def smooth_normals(
    positions: Array, faces: Array, normals: Array, sigma: float, laplacian: Any = None
) -> Array:
    """Unit normals (n, 3) averaged over about `sigma`; returned as they are when that is less than
    a quarter of the mesh's own spacing, which holds no finer detail to remove."""
    area = vertex_areas(positions, faces)
    spacing = float(np.sqrt(np.median(area) * 2.0 / np.sqrt(3.0)))
    if sigma <= 0.25 * spacing:
        return normals
    rounds = int(np.ceil((2.0 * sigma / spacing) ** 2))
    if rounds <= MAX_ROUNDS:
        return _averaged(positions, faces, normals * area[:, None], sigma / np.sqrt(rounds), rounds)
    mean = diffuse(positions, faces, normals * area[:, None], sigma, laplacian)
    return unit(mean, fallback=(0.0, 0.0, 1.0))


def _averaged(positions: Array, faces: Array, weighted: Array, sigma: float, rounds: int) -> Array:
    """Unit normals after `rounds` averages with the neighbours under a Gaussian of the distance:
    for widths below the spacing as good as heat flow, and no system to solve."""
    edges = edges_of(faces)
    weight = np.exp(edge_lengths(positions, edges.pairs) ** 2 / (-2.0 * sigma * sigma))
    half = edges.matrix(weight, len(positions))
    for _ in range(rounds):
        weighted = weighted + half @ weighted + half.T @ weighted
        weighted /= np.maximum(lengths(weighted).mean(), 1e-300)
    return unit(weighted, fallback=(0.0, 0.0, 1.0))
