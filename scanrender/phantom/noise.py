"""Seeded band-limited noise: a periodic lattice of random values, blended by quintic weights.

The blend is C2, so displacing by it leaves no creases, and the spectrum falls fast above the
lattice frequency, so that a caller can decide by the mesh spacing alone whether an octave is used.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

_BITS = 6
_SIZE = 1 << _BITS
_CHUNK = 32_768


@lru_cache(maxsize=64)
def _lattice(seed: int) -> NDArray[np.float32]:
    """Flat (64^3,) lattice, scaled so that the interpolated field has standard deviation 1."""
    values = np.random.default_rng((seed, 0x5EED)).standard_normal(_SIZE**3, dtype=np.float32)
    # Per axis the two weights are w and 1 - w, w quintic: mean w^2 + (1 - w)^2 = 181/231.
    return np.asarray(values / np.float32((181.0 / 231.0) ** 1.5), dtype=np.float32)


@lru_cache(maxsize=64)
def _rotation(seed: int) -> Array:
    """(3, 3) random rotation: turns the lattice so that its planes never line up with the face."""
    matrix, _ = np.linalg.qr(np.random.default_rng((seed, 0x0707)).standard_normal((3, 3)))
    return np.asarray(matrix, dtype=np.float64)


def noise(points: Array, scale_mm: float, seed: int) -> Array:
    """Smooth noise of zero mean and unit standard deviation; `scale_mm` is the lattice spacing.

    points: (n, 3) in mm. Returns (n,).
    """
    out = np.empty(len(points))
    matrix = _rotation(seed) / scale_mm
    for start in range(0, len(points), _CHUNK):
        part = slice(start, start + _CHUNK)
        out[part] = _lattice_noise(points[part] @ matrix, _lattice(seed))
    return out


def _lattice_noise(p: Array, lattice: NDArray[np.float32]) -> NDArray[np.float32]:
    whole = np.floor(p)
    t = (p - whole).astype(np.float32)
    w = t * t * t * (t * (t * np.float32(6.0) - np.float32(15.0)) + np.float32(10.0))
    low = whole.astype(np.int64) & (_SIZE - 1)
    high = (low + 1) & (_SIZE - 1)
    x = (low[:, 0] << (2 * _BITS), high[:, 0] << (2 * _BITS))
    y = (low[:, 1] << _BITS, high[:, 1] << _BITS)
    wx, wy, wz = w[:, 0], w[:, 1], w[:, 2]
    planes = []
    for z in (low[:, 2], high[:, 2]):
        rows = []
        for row in y:
            corner = row + z
            a = lattice[x[0] + corner]
            rows.append(a + wx * (lattice[x[1] + corner] - a))
        planes.append(rows[0] + wy * (rows[1] - rows[0]))
    return np.asarray(planes[0] + wz * (planes[1] - planes[0]), dtype=np.float32)


def fbm(points: Array, scale_mm: float, octaves: int, seed: int, gain: float = 0.5) -> Array:
    """Sum of `octaves` noises, each at half the spacing and `gain` of the last; std about 1."""
    total = np.zeros(len(points))
    power = 0.0
    for octave in range(octaves):
        weight = gain**octave
        total += weight * noise(points, scale_mm / 2.0**octave, seed + 101 * octave)
        power += weight * weight
    return np.asarray(total / np.sqrt(power), dtype=np.float64)


def smoothstep(low: float, high: float, value: Array) -> Array:
    """0 below `low`, 1 above `high`, cubic between; `low` > `high` reverses it."""
    t = np.clip((value - low) / (high - low), 0.0, 1.0)
    return np.asarray(t * t * (3.0 - 2.0 * t), dtype=np.float64)
