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
from scanrender.scan.topology import area_normals, edges_of, face_pairs, unit

Array = npt.NDArray[Any]


def mean_curvature(positions: Array, faces: Array, sigma_mm: float) -> npt.NDArray[np.float64]:
    """(n,) mean curvature at vertices, smoothed on the surface with standard deviation sigma_mm."""
    return diffuse(positions, faces, integrated_curvature(positions, faces), sigma_mm)


def integrated_curvature(positions: Array, faces: Array) -> npt.NDArray[np.float64]:
    """(n,) mean curvature integrated over each vertex's share of the surface, in mm."""
    edges = edges_of(faces)
    first, second, edge = face_pairs(faces, edges)
    normal = unit(area_normals(positions, faces))
    pair = edges.pairs[edge]
    axis = positions[pair[:, 1]] - positions[pair[:, 0]]
    length = np.linalg.norm(axis, axis=1)
    cross = np.linalg.norm(np.cross(normal[first], normal[second]), axis=1)
    angle = np.arctan2(cross, np.einsum("ij,ij->i", normal[first], normal[second]))
    # Convex where the second face's centre lies below the plane of the first.
    centre = positions[faces].mean(axis=1)
    below = np.einsum("ij,ij->i", centre[second] - centre[first], normal[first]) < 0.0
    # Half of length * angle is the edge's integral; each of its two ends takes half of that.
    share = 0.25 * length * angle * np.where(below, 1.0, -1.0)
    # A fold of the reconstruction (over 150 degrees) is no anatomy: it would dominate its surround.
    share[angle > 2.6] = 0.0
    count = len(positions)
    ends = np.bincount(pair[:, 0], share, count), np.bincount(pair[:, 1], share, count)
    return np.asarray(ends[0] + ends[1], np.float64)
