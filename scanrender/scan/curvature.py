"""Mean curvature of the geometry, in 1/mm, convex positive.

Cohen-Steiner and Morvan: Restricted Delaunay Triangulations and Normal Cycle, SoCG 2003. The
integral of mean curvature over a polyhedron is concentrated on its edges, length times half the
turning angle; summed at vertices and smoothed over the surface it becomes a density. It uses face
normals only: never a normal map, no quadric to fit, no trouble with slivers or obtuse triangles.
A sphere of radius r has 1/r, a cylinder 1/(2r), a plane and a minimal saddle 0.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from scanrender.scan.diffuse import diffuse
from scanrender.scan.topology import (
    area_normals,
    cross,
    edges_of,
    face_centres,
    face_pairs,
    lengths,
    unit,
    vertex_areas,
    vertex_normals,
)

Array = npt.NDArray[Any]

STEPS = 4  # noise has its curvature at the mesh's own scale: two steps' long tails let it through
# The scale is never finer than this many edges: below, the turning of a single edge is no average.
LEAST_EDGES = 2.0
# Noise may add this much to the curvature, in 1/mm: a tenth of that of a cheek or forehead.
NOISE_GOAL = 0.0006


def mean_curvature(
    positions: Array, faces: Array, sigma_mm: float, laplacian: Any = None
) -> npt.NDArray[np.float64]:
    """(n,) mean curvature at vertices, smoothed on the surface with standard deviation sigma_mm."""
    integral = integrated_curvature(positions, faces)
    return diffuse(positions, faces, integral, sigma_mm, laplacian, STEPS)


def curvature_scale(positions: Array, faces: Array, least_mm: float) -> float:
    """The standard deviation in mm over which curvature is worth smoothing: `least_mm`, or more
    where the mesh is coarser than that, or so noisy that the noise's own curvature would show.

    White noise of deviation s along the normal, on vertices of area a each, has after a Gaussian
    of width w a mean curvature of deviation s / (2 w^3) * sqrt(a / 2 pi), and after STEPS steps of
    backward Euler sqrt(512 / 210) times as much.
    """
    area = float(np.median(vertex_areas(positions, faces)))
    spacing = np.sqrt(area * 2.0 / np.sqrt(3.0))  # edge of the equilateral mesh of that density
    tail = np.sqrt(512.0 / 210.0)
    noise = tail * noise_level(positions, faces) * np.sqrt(area / (2.0 * np.pi))
    return float(max(least_mm, LEAST_EDGES * spacing, (0.5 * noise / NOISE_GOAL) ** (1.0 / 3.0)))


def noise_level(positions: Array, faces: Array) -> float:
    """Standard deviation along the normal, in the unit of positions, of what changes from vertex
    to vertex: the offset from the neighbours' mean, less the neighbours' mean offset."""
    count = len(positions)
    a, b = edges_of(faces).pairs.T
    degree = np.maximum(np.bincount(a, minlength=count) + np.bincount(b, minlength=count), 1)

    def around(values: Array) -> Array:
        total = np.bincount(a, values[b], count) + np.bincount(b, values[a], count)
        return np.asarray(total / degree)

    normal = vertex_normals(positions, faces)
    mean = np.stack([around(positions[:, axis]) for axis in range(3)], axis=1)
    offset = np.einsum("ij,ij->i", positions - mean, normal)
    detail = offset - around(offset)
    # For independent vertices of valence 6: variance (1 + 1/6)^2 + (4/6)^2 / 6... of one vertex,
    # summed over the two rings that take part (a hexagonal lattice gives 1.72).
    return float(1.4826 * np.median(np.abs(detail)) / np.sqrt(1.72))


def integrated_curvature(positions: Array, faces: Array) -> npt.NDArray[np.float64]:
    """(n,) mean curvature integrated over each vertex's share of the surface, in mm."""
    edges = edges_of(faces)
    first, second, edge = face_pairs(faces, edges)
    normal = unit(area_normals(positions, faces))
    pair = edges.pairs[edge]
    axis = positions[pair[:, 1]] - positions[pair[:, 0]]
    length = lengths(axis)
    sine = lengths(cross(normal[first], normal[second]))
    angle = np.arctan2(sine, np.einsum("ij,ij->i", normal[first], normal[second]))
    # Convex where the second face's centre lies below the plane of the first.
    centre = face_centres(positions, faces)
    below = np.einsum("ij,ij->i", centre[second] - centre[first], normal[first]) < 0.0
    # Half of length * angle is the edge's integral; each of its two ends takes half of that.
    share = 0.25 * length * angle * np.where(below, 1.0, -1.0)
    # A fold of the reconstruction (over 150 degrees) is no anatomy: it would dominate its surround.
    share[angle > 2.6] = 0.0
    count = len(positions)
    ends = np.bincount(pair[:, 0], share, count), np.bincount(pair[:, 1], share, count)
    return np.asarray(ends[0] + ends[1], np.float64)
