"""The large forms: cranium, face loft, jaw, neck, and the relief of brow, cheeks and chin.

Truth frame: mm, +Y up, face toward +Z, origin mid-head. Lengths follow adult averages of facial
anthropometry (chin to crown 227, breadth 153, bizygomatic 138, bigonial 108).
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np

from scanrender.phantom.noise import Array, smoothstep
from scanrender.phantom.sdf import (
    bump,
    capsule,
    ellipsoid,
    intersect,
    length,
    smooth_path,
    tube,
    union,
)

# Horizontal sections of the face without nose: y, front z on the midline, half width at z = 10,
# and how far the back half reaches behind z = 10 (the jaw's ramus ends there).
_SECTIONS = np.array(
    [
        # y, front, width, back
        [-128.0, 73.0, 24.0, 20.0],
        [-116.0, 80.0, 39.0, 22.0],
        [-108.0, 85.0, 43.0, 22.0],
        [-100.0, 87.0, 46.5, 22.0],
        [-88.0, 86.5, 51.0, 23.0],
        [-78.0, 88.5, 54.5, 24.0],
        [-66.0, 90.5, 58.0, 26.0],
        [-50.0, 90.5, 62.5, 30.0],
        [-30.0, 88.5, 68.0, 40.0],
        [-10.0, 87.5, 69.5, 50.0],
        [5.0, 88.5, 69.5, 56.0],
        [20.0, 92.0, 68.5, 60.0],
        [40.0, 92.0, 67.0, 62.0],
        [60.0, 84.0, 62.0, 62.0],
        [90.0, 64.0, 44.0, 50.0],
    ]
)

# Hills and hollows added along +Z: x, y, sigma x, sigma y, height (mm), mirrored in x.
_FRONT_RELIEF = np.array(
    [
        [31.5, -0.5, 14.0, 8.5, -6.0],  # orbit
        [15.5, 1.5, 5.5, 7.5, -5.0],  # inner corner of the orbit
        [18.0, 15.5, 9.5, 5.0, 3.0],  # brow ridge, inner
        [37.0, 18.0, 10.5, 5.0, 3.8],  # brow ridge, outer
        [36.0, 10.5, 10.0, 4.0, 1.8],  # fat under the brow, over the outer lid
        [0.0, 20.0, 9.0, 7.0, 1.8],  # glabella
        [23.0, 50.0, 14.0, 13.0, 1.4],  # frontal eminence
        [45.0, -20.0, 13.0, 8.5, 4.4],  # cheekbone
        [31.0, -33.0, 12.0, 14.0, 2.8],  # cheek fat
        [50.0, -57.0, 13.0, 15.0, -2.0],  # hollow under the cheekbone
        [22.0, -14.0, 6.5, 7.0, -0.9],  # tear trough
        [0.0, -63.0, 21.0, 15.0, 3.2],  # muzzle
        [32.0, -70.0, 6.0, 10.0, -1.4],  # beside the mouth
        [0.0, -87.5, 16.0, 4.8, -2.6],  # fold between lip and chin
        [0.0, -101.0, 15.0, 8.0, 2.0],  # chin
        [9.0, -103.0, 8.0, 7.0, 1.2],  # its two mounds
        [29.0, -97.0, 8.0, 9.0, -1.2],  # beside the chin
    ]
)


@lru_cache(maxsize=1)
def _section_spline() -> Any:
    from scipy.interpolate import CubicSpline

    return CubicSpline(_SECTIONS[:, 0], _SECTIONS[:, 1:], bc_type="natural")


def front_relief(x: Array, y: Array) -> Array:
    """Depth of the facial forms, mm toward +Z, at |x| and y."""
    total = np.zeros_like(x)
    for at_x, at_y, sigma_x, sigma_y, height in _FRONT_RELIEF:
        total += height * bump(x, y, (at_x, at_y), (sigma_x, sigma_y))
        if at_x - 4.0 * sigma_x < 0.0 < at_x:  # the mirror image reaches across the midline
            total += height * bump(x, y, (-at_x, at_y), (sigma_x, sigma_y))
    return total


def _cranium(p: Array) -> Array:
    """Egg: a super-ellipsoid whose radii and fullness differ up/down and front/back."""
    offset = p - np.array([0.0, 27.0, -20.0])
    radii = np.empty_like(p)
    radii[:, 0] = 76.5
    radii[:, 1] = np.where(offset[:, 1] > 0.0, 86.0, 82.0)
    radii[:, 2] = np.where(offset[:, 2] > 0.0, 112.5, 79.0)
    full = smoothstep(-20.0, 60.0, offset[:, 2]) * smoothstep(-10.0, 40.0, offset[:, 1])
    power = 2.0 + 0.4 * full
    unit = np.abs(offset / radii) + 1e-9
    k0 = np.hypot(unit[:, 0], (unit[:, 1] ** power + unit[:, 2] ** power) ** (1.0 / power))
    k1 = length(unit / radii)
    return np.asarray(k0 * (k0 - 1.0) / np.maximum(k1, 1e-9), dtype=np.float64)


def _face_loft(p: Array) -> Array:
    """Elliptic sections stacked in y, cut from below by the tilted lower border of the jaw."""
    x, y, z = p[:, 0], p[:, 1], p[:, 2] - 10.0
    front, width, back = _section_spline()(np.clip(y, -128.0, 90.0)).T
    depth = np.where(z > 0.0, front - 10.0, back)
    k0 = np.sqrt((x / width) ** 2 + (z / depth) ** 2)
    k1 = np.sqrt((x / width**2) ** 2 + (z / depth**2) ** 2)
    walls = k0 * (k0 - 1.0) / np.maximum(k1, 1e-9)
    border = -0.909 * (y + 118.5) - 0.418 * (p[:, 2] - 82.0)
    return intersect(intersect(walls, border, 17.0), y - 62.0, 12.0)


def _neck(p: Array) -> Array:
    """Leaning column, two sternomastoid cords, larynx, and the slope of the trapezius."""
    t = (p[:, 1] + 80.0) / -100.0
    column = np.stack([p[:, 0] / 56.0, (p[:, 2] + 19.0 + 15.0 * t) / 53.0], axis=1)
    radius = np.sqrt(np.square(column).sum(axis=1))
    neck = (radius - 1.0) * 54.0
    neck = intersect(neck, p[:, 1] + 45.0, 20.0)
    mirrored = p.copy()
    mirrored[:, 0] = np.sqrt(np.square(p[:, 0]) + 16.0)  # rounded: no crease down the spine
    cord = capsule(mirrored, (52.0, -58.0, -18.0), (12.0, -190.0, 22.0), 8.0, 6.5)
    neck = union(neck, cord, 14.0)
    slope = capsule(mirrored, (16.0, -128.0, -64.0), (130.0, -226.0, -52.0), 14.0, 34.0)
    neck = union(neck, slope, 40.0)
    collar = capsule(mirrored, (10.0, -196.0, 26.0), (110.0, -206.0, -10.0), 10.0, 12.0)
    neck = union(neck, collar, 26.0)
    return union(neck, ellipsoid(p, (0.0, -136.0, 22.0), (8.0, 16.0, 6.5)), 14.0)


@lru_cache(maxsize=1)
def _cheek_arch() -> Array:
    return smooth_path(
        [[51.0, -17.0, 54.0, 4.0], [58.0, -13.0, 36.0, 4.0], [61.5, -9.0, 12.0, 4.0]], 5
    )


def head_base(p: Array) -> Array:
    """Distance (mm) of skull, face and neck without nose, eyes, lips and ears.

    p: (n, 3) mm.
    """
    x, y, z = np.abs(p[:, 0]), p[:, 1], p[:, 2]
    shifted = p.copy()
    front = np.flatnonzero(z > 5.0)
    shifted[front, 2] -= front_relief(x[front], y[front]) * smoothstep(5.0, 45.0, z[front])
    side = -4.2 * bump(y, z, (24.0, 50.0), (17.0, 15.0))  # temple
    side += 2.0 * bump(y, z, (-66.0, 14.0), (17.0, 14.0))  # masseter
    side += 1.4 * bump(y, z, (-88.0, 12.0), (9.0, 13.0))  # angle of the jaw
    side += -0.8 * bump(y, z, (-40.0, 40.0), (14.0, 14.0))  # hollow cheek
    face = union(_cranium(shifted), _face_loft(shifted), 22.0)
    mirrored = p.copy()
    mirrored[:, 0] = x
    face = union(face, tube(mirrored, _cheek_arch()), 20.0)
    face = face - side
    low = np.flatnonzero(y < -20.0)
    face[low] = union(face[low], _neck(p[low]), 20.0)
    return face
