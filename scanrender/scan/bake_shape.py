"""Ambient occlusion and thickness by rays, per vertex of the prepared mesh."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from scanrender.scan.rays import Target
from scanrender.scan.tangents import any_perpendicular

Array = npt.NDArray[Any]

START_MM = 0.05  # rays begin this far off the surface, so that they do not meet their own triangle
THICKNESS_CAP_MM = 150.0  # an open shell has no other side, and no light comes this far
THICKNESS_CONE = np.radians(30.0)
# Light through skin falls with distance: thin ways count most; red's T(d) is close to this.
THICKNESS_FALL_MM = 5.0
_BATCH = 1_500_000


def ambient_occlusion(
    target: Target, positions: Array, normals: Array, rays: int, reach_mm: float, seed: int = 0
) -> npt.NDArray[np.float32]:
    """(n,) cosine-weighted share of the hemisphere that is free within reach_mm; 1 is open."""
    disk = _spiral(rays)
    height = np.sqrt(np.maximum(0.0, 1.0 - (disk**2).sum(axis=1)))
    local = np.concatenate([disk, height[:, None]], axis=1)
    free = np.empty(len(positions), np.float32)
    for start, stop, way, origin in _bundles(positions, normals, local, seed, START_MM):
        hit = target.occluded(origin, way, reach_mm)
        free[start:stop] = 1.0 - hit.reshape(stop - start, rays).mean(axis=1)
    return free


def thickness(
    target: Target, positions: Array, normals: Array, rays: int, seed: int = 0
) -> npt.NDArray[np.float32]:
    """(n,) mm to the other side along a cone about the inward normal.

    Ways are averaged in transmitted light, -L ln mean e^(-d/L), not in distance: half a cone that
    leaves through a thin ear must not be hidden by the half that goes through the head.
    """
    disk = _spiral(rays) * np.sin(THICKNESS_CONE)
    height = np.sqrt(1.0 - (disk**2).sum(axis=1))
    local = np.concatenate([disk, height[:, None]], axis=1)
    result = np.empty(len(positions), np.float32)
    for start, stop, way, origin in _bundles(positions, -normals, local, seed, START_MM):
        distance = target.cast(origin, way, THICKNESS_CAP_MM).distance + START_MM
        distance = np.minimum(distance, THICKNESS_CAP_MM).reshape(stop - start, rays)
        light = np.exp(-distance / THICKNESS_FALL_MM).mean(axis=1)
        result[start:stop] = -THICKNESS_FALL_MM * np.log(np.maximum(light, 1e-30))
    return np.minimum(result, THICKNESS_CAP_MM)


def _spiral(count: int) -> Array:
    """Points (count, 2) evenly spread over the unit disk (Vogel 1979)."""
    radius = np.sqrt((np.arange(count) + 0.5) / count)
    angle = np.arange(count) * np.pi * (3.0 - np.sqrt(5.0))
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)


def _bundles(positions: Array, axes: Array, local: Array, seed: int, lift: float) -> Any:
    """Batches of rays: local (r, 3) turned about each axis by a random angle seeded by `seed`."""
    angle = np.random.default_rng(seed).uniform(0.0, 2.0 * np.pi, len(positions))
    step = max(1, _BATCH // len(local))
    for start in range(0, len(positions), step):
        stop = min(start + step, len(positions))
        axis = axes[start:stop].astype(np.float64)
        u = any_perpendicular(axis)
        v = np.cross(axis, u)
        c, s = np.cos(angle[start:stop])[:, None], np.sin(angle[start:stop])[:, None]
        frame = np.stack([c * u + s * v, c * v - s * u, axis], axis=1)
        way = np.einsum("rj,kjd->krd", local, frame).reshape(-1, 3)
        origin = positions[start:stop] + axis * lift
        yield start, stop, way, np.repeat(origin, len(local), axis=0)
