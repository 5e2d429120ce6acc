"""Mean curvature of the geometry, in 1/mm, convex positive.

Cohen-Steiner and Morvan: Restricted Delaunay Triangulations and Normal Cycle, SoCG 2003. The
integral of mean curvature over a polyhedron is concentrated on its edges, length times half the
turning angle; summed at vertices and smoothed over the surface it becomes a density. It uses face
normals only: never a normal map, no quadric to fit, no trouble with slivers or obtuse triangles.
A sphere of radius r has 1/r, a cylinder 1/(2r), a plane and a minimal saddle 0.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from scanrender.scan.diffuse import diffuse, faired
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
# Noise of this share of an edge tilts triangles by 3 degrees: it is faired over 0.7 edges first.
NOISY = 0.03
FAIRED = 0.7
LARGE = 4.0  # times the median area of a vertex: more is no part of the scanner's own density


def mean_curvature(
    positions: Array, faces: Array, sigma_mm: float, laplacian: Any = None
) -> npt.NDArray[np.float64]:
    """(n,) mean curvature at vertices, smoothed on the surface with standard deviation sigma_mm."""
    integral = integrated_curvature(positions, faces)
    return diffuse(positions, faces, integral, sigma_mm, laplacian, STEPS)


def surface_curvature(
    positions: Array, faces: Array, least_mm: float, laplacian: Any
) -> tuple[npt.NDArray[np.float64], float]:
    """(n,) mean curvature in 1/mm of a scan, and the standard deviation in mm of its smoothing.

    Where the noise tilts triangles by degrees, the surface is faired over less than an edge first:
    the turning of an edge is not linear in such tilts, and what they add to it is white, which no
    smoothing afterwards takes out as fast as the noise itself.
    """
    rough = _roughness(positions, faces)
    scale = _scale(rough, least_mm)
    width = FAIRED * rough.spacing
    if rough.noise <= NOISY * rough.spacing or width >= scale:
        return mean_curvature(positions, faces, scale, laplacian), scale
    smooth = faired(positions, faces, width, laplacian)
    left = float(np.sqrt(scale * scale - width * width))
    return mean_curvature(smooth, faces, left, laplacian), scale


def curvature_scale(positions: Array, faces: Array, least_mm: float) -> float:
    """The standard deviation in mm over which curvature is worth smoothing: `least_mm`, or more
    where the mesh is coarser than that, or so noisy that the noise's own curvature would show."""
    return _scale(_roughness(positions, faces), least_mm)


@dataclass(frozen=True)
class _Roughness:
    """spacing: edge in mm of the equilateral mesh of that density; area: of a vertex in mm^2, as
    noise sees it; noise: its standard deviation in mm."""

    spacing: float
    area: float
    noise: float


def _roughness(positions: Array, faces: Array) -> _Roughness:
    areas = vertex_areas(positions, faces)
    middle = float(np.median(areas))
    # The few huge triangles of a closed base or a filled hole say nothing of the noise elsewhere.
    areas = np.minimum(areas, LARGE * middle)
    area = float((areas * areas).sum() / max(float(areas.sum()), 1e-300))
    return _Roughness(float(np.sqrt(1.1547 * middle)), area, noise_level(positions, faces))


def _scale(rough: _Roughness, least_mm: float) -> float:
    """White noise of deviation s along the normal, on vertices of area a each, has after a Gaussian
    of width w a mean curvature of deviation s / (2 w^3) * sqrt(a / 2 pi), and after STEPS steps of
    backward Euler sqrt(512 / 210) times as much. Where areas differ, the large ones count most:
    the power of such noise on the surface is s^2 times the area-weighted mean of a.
    """
    noise = np.sqrt(512.0 / 210.0) * rough.noise * np.sqrt(rough.area / (2.0 * np.pi))
    for_noise = (0.5 * noise / NOISE_GOAL) ** (1.0 / 3.0)
    return float(max(least_mm, LEAST_EDGES * rough.spacing, for_noise))


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
