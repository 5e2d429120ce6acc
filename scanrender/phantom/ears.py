"""The outer ear: helix, antihelix with its fork, concha, tragus, antitragus and lobe.

Ear frame: u backward, v up, w outward from the head, origin near the canal, mm.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from scanrender.phantom.noise import Array
from scanrender.phantom.sdf import (
    capsule,
    ellipsoid,
    near,
    smooth_path,
    sphere,
    subtract,
    tube,
    union,
)

EAR_ORIGIN = np.array([68.0, -17.0, -8.0])
_LEAN_DEG = 13.0  # the top tips backward
_FLARE_DEG = 22.0  # the back edge stands off the head

_HELIX = [
    [-1.0, -2.0, -0.6, 1.8],
    [-6.0, 3.5, 3.0, 2.2],
    [-10.0, 11.0, 5.5, 2.3],
    [-9.5, 20.0, 6.0, 2.5],
    [-4.5, 27.0, 6.8, 2.6],
    [4.0, 30.0, 7.4, 2.7],
    [12.5, 27.0, 7.8, 2.7],
    [18.0, 19.0, 8.0, 2.6],
    [20.0, 9.0, 8.0, 2.4],
    [18.5, -2.0, 7.6, 2.2],
    [14.5, -12.0, 7.0, 2.1],
    [9.0, -20.0, 6.2, 2.1],
    [3.5, -26.5, 5.4, 2.4],
]
_ANTIHELIX = [
    [-0.5, -16.5, 5.6, 2.3],
    [6.5, -14.0, 6.2, 2.0],
    [11.0, -7.0, 7.0, 2.2],
    [12.4, 2.0, 7.6, 2.5],
    [10.5, 10.5, 7.6, 2.5],
    [6.0, 17.0, 6.6, 2.4],
    [2.0, 22.5, 5.2, 2.2],
]
_LOWER_FORK = [[10.5, 9.0, 7.2, 2.1], [4.0, 12.0, 6.0, 1.8], [-4.0, 13.5, 4.4, 1.5]]


@lru_cache(maxsize=1)
def _paths() -> tuple[Array, Array, Array]:
    return smooth_path(_HELIX, 20), smooth_path(_ANTIHELIX, 11), smooth_path(_LOWER_FORK, 4)


def ear_frame(p: Array) -> Array:
    """(n, 3) mirrored head points to (u, v, w)."""
    offset = p - EAR_ORIGIN
    lean, flare = np.radians(_LEAN_DEG), np.radians(_FLARE_DEG)
    back, up, out = -offset[:, 2], offset[:, 1], offset[:, 0]
    u = np.cos(lean) * back - np.sin(lean) * up
    v = np.cos(lean) * up + np.sin(lean) * back
    # Turning about v lifts the back edge away from the head.
    return np.stack(
        [np.cos(flare) * u + np.sin(flare) * out, v, np.cos(flare) * out - np.sin(flare) * u],
        axis=1,
    )


def add_ears(p: Array, distance: Array) -> Array:
    """Union the ear onto the head; p mirrored."""
    index = near(p, (58.0, -58.0, -52.0), (104.0, 28.0, 20.0))
    if not len(index):
        return distance
    q = ear_frame(p[index])
    helix_path, antihelix_path, fork_path = _paths()
    plate = ellipsoid(q, (4.6, 4.2, 4.6), (16.8, 26.2, 3.0))
    back = ellipsoid(q, (1.5, -1.5, -1.0), (11.5, 15.0, 8.0))
    ear = union(plate, back, 4.0)
    ear = union(ear, tube(q, antihelix_path), 2.6)
    ear = union(ear, tube(q, fork_path), 2.4)
    bowl = ellipsoid(q, (1.5, -4.5, 7.6), (8.2, 11.0, 8.2))
    ear = subtract(ear, bowl, 2.2)
    cymba = ellipsoid(q, (0.5, 7.0, 6.5), (8.5, 4.0, 4.6))
    ear = subtract(ear, cymba, 2.0)
    ear = union(ear, tube(q, helix_path), 2.4)
    lobe = ellipsoid(q, (0.0, -24.0, 3.6), (8.0, 8.5, 3.4))
    ear = union(ear, lobe, 4.5)
    ear = union(ear, sphere(q, (0.5, -15.8, 5.0), 2.5), 3.0)  # antitragus
    tragus = capsule(q, (-9.4, -9.0, 3.0), (-8.2, -3.0, 4.2), 2.8, 2.4)
    result = union(distance[index], ear, 4.5)
    result = subtract(result, sphere(q, (-4.6, -6.0, 0.5), 3.2), 2.5)  # canal
    result = union(result, tragus, 3.0)
    distance = distance.copy()
    distance[index] = result
    return distance
