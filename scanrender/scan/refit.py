"""Move the vertices of a simplified surface to where the raw points around them lie on average.

Quadric collapse puts a vertex where the planes of a few raw triangles meet, and keeps their noise.
Least squares over all raw points that a triangle stands for keeps little of it: Hoppe, DeRose,
Duchamp, McDonald, Stuetzle: Mesh Optimization, SIGGRAPH 1993, section 4.1, with the connectivity
and the nearest points fixed and vertices free along their normals only. Runs in a child process.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from scipy import sparse
from scipy.sparse.linalg import cg

from scanrender.scan.curvature import noise_level
from scanrender.scan.rays import barycentric
from scanrender.scan.topology import edges_of, span, vertex_normals

Array = npt.NDArray[Any]

POINTS = 400_000  # of the raw surface at most
# Each vertex is held where it was as firmly as this share of the mean weight of raw points pulls.
HOLD = 0.05
REACH = 0.5  # a vertex moves by at most this share of its shortest edge
BANDS, BAND_FACES = 8, 150_000  # the noise is measured in slices of the surface


def noise_mm(positions: Array, faces: Array) -> float:
    """`curvature.noise_level` in slices across the longest extent, for a surface of many faces."""
    share = BAND_FACES / max(len(faces), 1)
    if share < 1.0:
        axis = int(np.argmax(span(positions)))
        along = positions[:, axis] - positions[:, axis].min()
        inside = (along * (BANDS / max(float(along.max()), 1e-300))) % 1.0 < share
        faces = faces[inside[faces].all(axis=1)]
        used, index = np.unique(faces, return_inverse=True)
        positions, faces = positions[used], index.reshape(-1, 3)
    return noise_level(positions, faces) if len(faces) else 0.0


def refitted(positions: Array, faces: Array, points: Array, tree: Any) -> Array:
    """New positions (n, 3) for positions, faces (m, 3), from raw points (k, 3).

    tree: an igl.AABB of positions and faces. Vertices on an open border stay where they are.
    """
    if len(points) > POINTS:
        points = points[np.random.default_rng(4).choice(len(points), POINTS, replace=False)]
    _, face, closest = tree.squared_distance(positions, faces, points)
    face = np.asarray(face, np.int64)
    weight = barycentric(np.asarray(closest), positions[faces[face]]).astype(np.float64)
    normals = vertex_normals(positions, faces)
    normal = np.einsum("kc,kcd->kd", weight, normals[faces[face]])
    height = np.einsum("kd,kd->k", points - closest, normal)
    rows = np.repeat(np.arange(len(points)), 3)
    shape = (len(points), len(positions))
    average = sparse.csr_matrix((weight.reshape(-1), (rows, faces[face].reshape(-1))), shape=shape)
    system = average.T @ average
    hold = HOLD * float(system.diagonal().mean())
    system = system + hold * sparse.identity(len(positions))
    move, _ = cg(system, average.T @ height, rtol=1e-4, maxiter=60)
    return np.asarray(positions + _bounded(move, positions, faces)[:, None] * normals)


def _bounded(move: Array, positions: Array, faces: Array) -> Array:
    """`move` (n,) in mm without borders, and never so far that a triangle could turn over."""
    edges = edges_of(faces)
    length = np.linalg.norm(positions[edges.pairs[:, 0]] - positions[edges.pairs[:, 1]], axis=1)
    shortest = np.full(len(positions), np.inf)
    for end in edges.pairs.T:
        np.minimum.at(shortest, end, length)
    shortest[edges.pairs[edges.count == 1]] = 0.0
    shortest[~np.isfinite(shortest)] = 0.0
    return np.clip(move, -REACH * shortest, REACH * shortest)
