"""Signed-distance building blocks: negative inside, in mm, gradient length about one.

Exactness is not needed (meshing takes Newton steps along the gradient), but the sign is, and the
distance must not be far off near the surface, since smooth unions blend by it.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Vector = Sequence[float] | Array


def union(a: Array, b: Array, blend_mm: float) -> Array:
    """Polynomial smooth minimum; exactly min(a, b) where |a - b| > `blend_mm`."""
    h = np.maximum(blend_mm - np.abs(a - b), 0.0)
    return np.minimum(a, b) - h * h * (0.25 / blend_mm)


def intersect(a: Array, b: Array, blend_mm: float) -> Array:
    """Polynomial smooth maximum; exactly max(a, b) where |a - b| > `blend_mm`."""
    return -union(-a, -b, blend_mm)


def subtract(a: Array, b: Array, blend_mm: float) -> Array:
    """`a` without `b`."""
    return -union(-a, b, blend_mm)


def length(vectors: Array) -> Array:
    """(n,) Euclidean norms of (n, 3); einsum, since summing over a short axis is slow in NumPy."""
    return np.asarray(np.sqrt(np.einsum("ij,ij->i", vectors, vectors)), dtype=np.float64)


def sphere(points: Array, centre: Vector, radius_mm: float) -> Array:
    return length(points - np.asarray(centre)) - radius_mm


def ellipsoid(points: Array, centre: Vector, radii_mm: Vector) -> Array:
    """First-order distance k0 (k0 - 1) / k1: exact sign, right to first order at the surface."""
    radii = np.asarray(radii_mm, dtype=np.float64)
    unit = (points - np.asarray(centre)) / radii
    k0 = length(unit)
    k1 = length(unit / radii)
    return np.asarray(k0 * (k0 - 1.0) / np.maximum(k1, 1e-9), dtype=np.float64)


def capsule(points: Array, a: Vector, b: Vector, radius_a_mm: float, radius_b_mm: float) -> Array:
    """Segment a-b with a radius that changes linearly along it."""
    start = np.asarray(a, dtype=np.float64)
    axis = np.asarray(b, dtype=np.float64) - start
    offset = points - start
    t = np.clip(offset @ axis / float(axis @ axis), 0.0, 1.0)
    distance = length(offset - t[:, None] * axis)
    return np.asarray(distance - (radius_a_mm + (radius_b_mm - radius_a_mm) * t), dtype=np.float64)


def tube(points: Array, path: Array, blend_mm: float = 0.0) -> Array:
    """Chain of capsules through `path`, (m, 4): x, y, z and radius in mm."""
    result: Array | None = None
    for first, second in pairwise(path):
        part = capsule(points, first[:3], second[:3], float(first[3]), float(second[3]))
        if result is None:
            result = part
        elif blend_mm > 0.0:
            result = union(result, part, blend_mm)
        else:
            result = np.minimum(result, part)
    assert result is not None
    return result


def smooth_path(controls: Sequence[Sequence[float]], samples: int) -> Array:
    """(samples, d) points of the natural cubic spline through `controls`, by chord length."""
    from scipy.interpolate import CubicSpline

    knots = np.asarray(controls, dtype=np.float64)
    steps = np.linalg.norm(np.diff(knots[:, :3], axis=0), axis=1)
    along = np.concatenate([[0.0], np.cumsum(steps)])
    spline = CubicSpline(along, knots, bc_type="natural")
    return np.asarray(spline(np.linspace(0.0, along[-1], samples)), dtype=np.float64)


def near(points: Array, low: Vector, high: Vector) -> NDArray[np.intp]:
    """Indices of the points inside a box: local features are evaluated only there."""
    inside = np.ones(len(points), dtype=bool)
    for axis in range(3):
        column = points[:, axis]
        inside &= (column > low[axis]) & (column < high[axis])
    return np.flatnonzero(inside)


def bump(x: Array, y: Array, at: Sequence[float], sigma_mm: Sequence[float]) -> Array:
    """Gaussian hill of height one at `at`."""
    return np.asarray(
        np.exp(-0.5 * (((x - at[0]) / sigma_mm[0]) ** 2 + ((y - at[1]) / sigma_mm[1]) ** 2)),
        dtype=np.float64,
    )
