"""Smoothing of values on a surface: heat flow, backward Euler, cotangent Laplacian.

Desbrun, Meyer, Schroeder, Barr: Implicit Fairing of Irregular Meshes using Diffusion and Curvature
Flow, SIGGRAPH 1999. Heat flow for time t is, on a plane, a Gaussian of standard deviation sqrt(2t).
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from scipy import sparse
from scipy.sparse.linalg import cg

from scanrender.scan.topology import vertex_areas

Array = npt.NDArray[Any]

STEPS = 2  # one backward Euler step has a pole at the centre and long tails; two are near Gaussian


def cotangent_laplacian(positions: Array, faces: Array) -> Any:
    """Positive semi-definite (n, n) stiffness matrix; weights are clamped to stay non-negative."""
    count = len(positions)
    rows, columns, weights = [], [], []
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        u = positions[faces[:, j]] - positions[faces[:, i]]
        v = positions[faces[:, k]] - positions[faces[:, i]]
        cross = np.linalg.norm(np.cross(u, v), axis=1)
        cotangent = np.einsum("ij,ij->i", u, v) / np.maximum(cross, 1e-12 * (u**2).sum(1) + 1e-300)
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
    positions: Array, faces: Array, integrated: Array, sigma: float, laplacian: Any = None
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
    step = sigma * sigma / (2.0 * STEPS)
    mass = sparse.diags(area)
    system = (mass + step * stiffness).tocsr()
    inverse_diagonal = sparse.diags(1.0 / system.diagonal())
    for _ in range(STEPS):
        for column in range(density.shape[1]):
            right = area * density[:, column]
            density[:, column], _ = cg(
                system, right, x0=density[:, column], rtol=1e-4, maxiter=400, M=inverse_diagonal
            )
    return density.reshape(integrated.shape)


def smooth_normals(positions: Array, faces: Array, normals: Array, sigma: float) -> Array:
    """Unit normals (n, 3) averaged over about `sigma`; returned as they are when that is less than
    a quarter of the mesh's own spacing, which holds no finer detail to remove."""
    from scanrender.scan.topology import unit

    area = vertex_areas(positions, faces)
    if sigma <= 0.25 * float(np.sqrt(np.median(area))):
        return normals
    mean = diffuse(positions, faces, normals * area[:, None], sigma)
    return unit(mean, fallback=(0.0, 0.0, 1.0))
