"""Fine relief: pores, creases, lip lines, strands; displacement along the normal in mm.

An octave is used only where the mesh can hold it (lattice spacing above about twice the edge), so
that a coarse phantom is smooth instead of aliased.
"""

from __future__ import annotations

import numpy as np

from scanrender.phantom.features import lip_lines
from scanrender.phantom.masks import Masks
from scanrender.phantom.noise import Array, fbm, noise, smoothstep
from scanrender.phantom.sdf import bump

# The nasolabial fold in the frontal plane: from beside the wing of the nose to beside the mouth.
_NASOLABIAL = np.array([[18.5, -36.0], [22.0, -43.5], [26.5, -52.0], [30.0, -61.0], [31.5, -69.0]])


def held(scale_mm: float, spacing_mm: float) -> float:
    """1 if a mesh or texture of `spacing_mm` can hold noise of `scale_mm`, 0 if it would alias."""
    ratio = np.array([scale_mm / spacing_mm])
    return float(smoothstep(1.0, 2.0, ratio)[0])


def relief_mm(t: Array, masks: Masks, spacing_mm: float, seed: int) -> Array:
    """(n,) outward displacement at template points t (n, 3)."""
    bare = (1.0 - masks.eye) * (1.0 - 0.8 * masks.hair)
    total = _skin(t, masks, spacing_mm, seed) * bare
    total += _creases(t, seed) * masks.front * bare
    total += _lip_lines(t, masks, spacing_mm, seed)
    total += masks.hair * (0.2 + 0.05 * strands(t, seed, spacing_mm))
    total += 0.25 * masks.brow
    return total


def strands(t: Array, seed: int, spacing_mm: float) -> Array:
    """Scalp hair as noise stretched along its flow out of the whorl; about unit deviation."""
    whorl = np.array([7.0, 96.0, -58.0])
    offset = t - whorl
    reach = np.linalg.norm(offset, axis=1)
    turn = np.arctan2(offset[:, 0], offset[:, 2])
    # Along the strand the coordinate runs slowly, across it fast.
    swirl = turn + 0.25 * np.log1p(reach / 8.0)
    across = np.stack([np.cos(swirl), np.sin(swirl)], axis=1) * np.maximum(reach, 4.0)[:, None]
    flow = np.stack([across[:, 0], 0.16 * t[:, 1] + 0.10 * reach, across[:, 1]], axis=1)
    total = np.zeros(len(t))
    for scale, weight in ((3.2, 0.25), (1.6, 0.8), (0.7, 0.7)):
        fade = held(scale, spacing_mm)
        if fade > 0.0:
            total += fade * weight * noise(flow, scale, seed + int(10 * scale))
    return total


def _skin(t: Array, masks: Masks, spacing_mm: float, seed: int) -> Array:
    total = 0.03 * fbm(t, 9.0, 2, seed + 1) * (1.0 - 0.5 * masks.ear)
    for scale, height in ((2.4, 0.013), (1.1, 0.012)):
        fade = held(scale, spacing_mm)
        if fade > 0.0:
            total += fade * height * noise(t, scale, seed + int(100 * scale))
    fade = held(0.42, spacing_mm)
    if fade > 0.0:
        total -= fade * 0.075 * pores(t, seed) * pore_density(t)
    return total


def pores(t: Array, seed: int) -> Array:
    """0 between pores, up to 1 in them; about 0.4 mm apart."""
    return smoothstep(0.5, 1.9, noise(t, 0.42, seed + 7))


def pore_density(t: Array) -> Array:
    """Larger pores on nose, inner cheeks and forehead; (n,) in about [0.35, 1]."""
    x, y = np.abs(t[:, 0]), t[:, 1]
    dense = 0.65 * bump(x, y, (0.0, -30.0), (16.0, 16.0))
    dense += 0.5 * bump(x, y, (28.0, -32.0), (14.0, 16.0))
    dense += 0.35 * bump(x, y, (0.0, 45.0), (34.0, 20.0))
    return np.minimum(0.35 + dense * smoothstep(20.0, 60.0, t[:, 2]), 1.0)


def _creases(t: Array, seed: int) -> Array:
    x, y = np.abs(t[:, 0]), t[:, 1]
    wave = noise(t, 16.0, seed + 51)
    depth = np.zeros(len(t))
    for level, strength in ((37.0, 0.05), (45.5, 0.09), (54.0, 0.09), (62.0, 0.05)):
        line = y - level - 1.5 * wave - 0.0022 * x**2
        depth += strength * np.exp(-((line / 0.9) ** 2)) * smoothstep(44.0, 22.0, x)
    frown = np.exp(-(((x - 7.0 - 0.12 * (y - 18.0) - 0.5 * wave) / 1.0) ** 2))
    depth += 0.07 * frown * bump(x, y, (7.0, 20.0), (9.0, 5.5))
    depth += _crow_feet(x, y, wave)
    for at, strength in ((-13.5, 0.09), (-16.5, 0.06)):
        line = y - at + 0.35 * wave - 0.014 * (x - 30.0) ** 2
        depth += strength * np.exp(-((line / 0.8) ** 2)) * smoothstep(17.0, 8.0, np.abs(x - 30.0))
    return _nasolabial(x, y) - depth


def _crow_feet(x: Array, y: Array, wave: Array) -> Array:
    reach = np.hypot(x - 41.0, y - 1.0)
    angle = np.degrees(np.arctan2(y - 1.0, x - 41.0)) + 4.0 * wave
    lines = sum(
        np.exp(-((np.radians(angle - at) * reach / 0.75) ** 2)) for at in (-38.0, -17.0, 2.0, 21.0)
    )
    return np.asarray(0.10 * lines * smoothstep(8.0, 12.0, reach) * smoothstep(24.0, 14.0, reach))


def _nasolabial(x: Array, y: Array) -> Array:
    """A soft valley, with the cheek fuller on its outer side."""
    at = np.interp(-y, -_NASOLABIAL[:, 1], _NASOLABIAL[:, 0])
    side = (x - at) * 0.88
    fade = smoothstep(-33.0, -41.0, y) * smoothstep(-76.0, -60.0, y)
    valley = np.exp(-((side / 1.7) ** 2))
    full = np.exp(-(((side - 6.0) / 5.0) ** 2))
    return np.asarray((0.65 * full - 0.5 * valley) * fade)


def _lip_lines(t: Array, masks: Masks, spacing_mm: float, seed: int) -> Array:
    fade = held(0.9, spacing_mm)
    if fade <= 0.0:
        return np.zeros(len(t))
    upright = t * np.array([1.0, 0.22, 0.5])
    parting, _, _, _ = lip_lines(t[:, 0])
    outside = smoothstep(0.7, 2.2, np.abs(t[:, 1] - parting))
    return -0.055 * fade * masks.lips * outside * (0.6 + noise(upright, 0.9, seed + 61))
