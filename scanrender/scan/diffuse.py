"""Smoothing of values on a surface: heat flow, backward Euler, cotangent Laplacian.

Desbrun, Meyer, Schroeder, Barr: Implicit Fairing of Irregular Meshes using Diffusion and Curvature
Flow, SIGGRAPH 1999. Heat flow for time t is, on a plane, a Gaussian of standard deviation sqrt(2t).
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from scipy import sparse

from scanrender.scan.topology import cross, edges_of, lengths, unit, vertex_areas

Array = npt.NDArray[Any]

MAX_ITERATIONS = 400
MAX_ROUNDS = 4  # averages with the neighbours; a wider smoothing is solved for instead
STEPS = 2  # one backward Euler step has a pole at the centre and long tails; two are near Gaussian


def cotangent_laplacian(positions: Array, faces: Array) -> Any:
    """Positive semi-definite (n, n) stiffness matrix; weights are clamped to stay non-negative."""
    count = len(positions)
    rows, columns, weights = [], [], []
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        u = positions[faces[:, j]] - positions[faces[:, i]]
        v = positions[faces[:, k]] - positions[faces[:, i]]
        least = 1e-12 * np.einsum("ij,ij->i", u, u) + 1e-300
        cotangent = np.einsum("ij,ij->i", u, v) / np.maximum(lengths(cross(u, v)), least)
        rows.append(faces[:, j])
        columns.append(faces[:, k])
        # Slivers have cotangents of any size: clamped, they neither freeze nor repel their ends.
        weights.append(0.5 * np.clip(cotangent, -10.0, 10.0))
    half = sparse.coo_matrix(
        (np.concatenate(weights), (np.concatenate(rows), np.concatenate(columns))), (count, count)
    ).tocsr()
    adjacency = half + half.T
    # A negative weight (obtuse pair) would make the flow overshoot: the maximum principle is kept.
    adjacency.data = np.maximum(adjacency.data, 0.0)
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
    a, b = edges_of(faces).pairs.T
    offset = positions[a] - positions[b]
    weight = np.exp(np.einsum("ij,ij->i", offset, offset) / (-2.0 * sigma * sigma))
    count = len(positions)
    half = sparse.coo_matrix((weight, (a, b)), (count, count)).tocsr()
    for _ in range(rounds):
        weighted = weighted + half @ weighted + half.T @ weighted
        weighted /= np.maximum(lengths(weighted).mean(), 1e-300)
    return unit(weighted, fallback=(0.0, 0.0, 1.0))
