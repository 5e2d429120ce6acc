"""Colour: scene-linear Rec.709 albedo and label at any point of the template.

The values are a light skin (about 0.55, 0.34, 0.25). Redness (blood) and tan (melanin) vary
separately, as they do in skin; hair is colour on the surface, as a scanner records it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from scanrender.phantom.features import (
    EYE_CENTRE,
    IRIS_RADIUS_MM,
    PUPIL_RADIUS_MM,
    fissure,
    lip_lines,
)
from scanrender.phantom.masks import Masks
from scanrender.phantom.noise import Array, fbm, noise, smoothstep
from scanrender.phantom.relief import held, pore_density, pores, strands
from scanrender.phantom.sdf import bump, ellipsoid

LABELS = ("skin", "lips", "brow", "hair", "eye")

_SKIN = np.array([0.55, 0.34, 0.25])
_BLOOD = np.array([-0.10, -0.42, -0.40])  # log change of reflectance per unit of redness
_TAN = np.array([-0.30, -0.46, -0.62])  # per unit of melanin
_LIPS = np.array([0.45, 0.195, 0.165])
_BROW = np.array([0.075, 0.048, 0.034])
_HAIR = np.array([0.040, 0.026, 0.018])
_SCLERA = np.array([0.65, 0.60, 0.56])
_PUPIL = np.array([0.010, 0.010, 0.010])
_MOLES = 7


def albedo_at(
    t: Array, masks: Masks, spacing_mm: float, seed: int
) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    """Albedo (n, 3) linear Rec.709 and label (n,) at template points t (n, 3) mm.

    `spacing_mm` is the distance of samples: finer detail is left out.
    """
    colour = _skin(t, masks, spacing_mm, seed)
    colour = _mix(colour, _lip_colour(t, spacing_mm, seed), masks.lips)
    strand = strands(t, seed, spacing_mm)
    shade = np.exp(0.22 * strand)[:, None]
    # Short hair lets the scalp through in a pattern of strands, most at the hairline.
    cover = smoothstep(0.0, 0.8, masks.hair * 1.2 - 0.25 + 0.17 * strand * (1.12 - masks.hair))
    cover *= smoothstep(0.0, 0.12, masks.hair)
    colour = _mix(colour, _HAIR * shade, 0.93 * cover)
    brow = _brow_cover(t, masks, spacing_mm, seed)
    colour = _mix(colour, np.broadcast_to(_BROW, colour.shape), 0.9 * brow)
    colour = _mix(colour, np.broadcast_to(_BROW * 0.7, colour.shape), 0.85 * masks.lashes)
    eyes = np.flatnonzero(masks.eye > 0.0)
    if len(eyes):
        iris = _eye_colour(t[eyes], spacing_mm, seed)
        colour[eyes] = _mix(colour[eyes], iris, masks.eye[eyes])
    colour *= _caves(t)[:, None]
    label = np.select(
        [masks.eye > 0.5, masks.lips > 0.5, masks.brow > 0.4, cover > 0.5], [4, 1, 2, 3], 0
    )
    return np.clip(colour, 0.004, 0.9).astype(np.float32), label.astype(np.uint8)


def _mix(a: Array, b: Array, weight: Array) -> Array:
    return a + (b - a) * weight[:, None]


def _skin(t: Array, masks: Masks, spacing_mm: float, seed: int) -> Array:
    blood = _redness(t, masks) + 0.11 * fbm(t, 14.0, 3, seed + 301)
    tan = 0.11 * fbm(t, 30.0, 2, seed + 311) + _eye_rings(t) - 0.10 * (t[:, 1] < -112.0)
    tan += 0.07 * smoothstep(30.0, 60.0, t[:, 1])
    for scale, weight in ((2.2, 0.10), (0.8, 0.08)):
        fade = held(scale, spacing_mm)
        if fade > 0.0:
            blood += fade * weight * noise(t, scale, seed + int(1000 * scale))
    fade = held(0.42, spacing_mm)
    if fade > 0.0:
        tan += 0.22 * fade * pores(t, seed) * pore_density(t) * masks.front
    tan += _freckles(t, masks, seed) + _moles(t, seed)
    colour = _SKIN * np.exp(blood[:, None] * _BLOOD + tan[:, None] * _TAN)
    return _stubble(colour, t, masks, spacing_mm, seed)


def _redness(t: Array, masks: Masks) -> Array:
    x, y = np.abs(t[:, 0]), t[:, 1]
    red = 0.42 * bump(x, y, (0.0, -37.0), (14.0, 10.0))  # nose
    red += 0.42 * bump(x, y, (36.0, -30.0), (15.0, 13.0))  # cheeks
    red += 0.22 * bump(x, y, (0.0, -101.0), (14.0, 8.0))  # chin
    red += 0.20 * bump(x, y, (24.0, 9.0), (13.0, 5.0))  # upper lids
    red -= 0.15 * bump(x, y, (0.0, 48.0), (36.0, 18.0))  # forehead is paler
    return red * masks.front + 0.45 * masks.ear


def _eye_rings(t: Array) -> Array:
    x, y = np.abs(t[:, 0]), t[:, 1]
    ring = 0.20 * bump(x, y, (26.0, -9.5), (10.0, 3.6)) + 0.16 * bump(x, y, (17.0, 1.0), (4.0, 8.0))
    return ring * (t[:, 2] > 55.0)


def _freckles(t: Array, masks: Masks, seed: int) -> Array:
    spots = smoothstep(1.7, 2.5, noise(t, 1.5, seed + 331))
    return 0.35 * spots * masks.front


def _moles(t: Array, seed: int) -> Array:
    """A few dark spots of 0.8-1.8 mm at seeded places on face and neck."""
    rng = np.random.default_rng((seed, 71))
    total = np.zeros(len(t))
    for _ in range(_MOLES):
        x, y = rng.uniform(-58.0, 58.0), rng.uniform(-125.0, 55.0)
        radius, strength = rng.uniform(0.7, 1.5), rng.uniform(0.9, 2.0)
        close = np.flatnonzero((np.abs(t[:, 0] - x) < 4.0) & (np.abs(t[:, 1] - y) < 4.0))
        close = close[t[close, 2] > 20.0]
        off = np.hypot(t[close, 0] - x, t[close, 1] - y)
        total[close] += strength * smoothstep(1.25 * radius, 0.7 * radius, off)
    return total


def _stubble(colour: Array, t: Array, masks: Masks, spacing_mm: float, seed: int) -> Array:
    """A shaved beard: bluish grey veil, and dots where the samples can hold them."""
    patchy = masks.beard * (0.8 + 0.2 * np.clip(noise(t, 9.0, seed + 341), -1.5, 1.5))
    veil = np.array([0.30, 0.235, 0.205])
    colour = _mix(colour, np.broadcast_to(veil, colour.shape), 0.34 * patchy)
    fade = held(0.5, spacing_mm)
    if fade > 0.0:
        dots = smoothstep(0.9, 1.6, noise(t, 0.5, seed + 351))
        colour = _mix(colour, np.broadcast_to(_BROW, colour.shape), 0.42 * fade * dots * patchy)
    return colour


def _lip_colour(t: Array, spacing_mm: float, seed: int) -> Array:
    parting, _, _, _ = lip_lines(t[:, 0])
    wet = np.exp(-(((t[:, 1] - parting) / 1.0) ** 2))
    mottle = 0.09 * noise(t, 3.0, seed + 361)
    if held(0.9, spacing_mm) > 0.0:
        mottle += 0.07 * noise(t * np.array([1.0, 0.22, 0.5]), 0.9, seed + 61)
    return np.asarray(_LIPS * np.exp(mottle - 0.85 * wet)[:, None])


def _brow_cover(t: Array, masks: Masks, spacing_mm: float, seed: int) -> Array:
    out = np.zeros(len(t))
    index = np.flatnonzero(masks.brow > 0.0)
    q = t[index]
    # Hairs lie along x and rise away from the nose at the inner end.
    slant = q[:, 1] - np.abs(q[:, 0]) * np.clip(1.6 - np.abs(q[:, 0]) / 22.0, -0.4, 1.2)
    hairs = np.stack([0.16 * q[:, 0], slant, 0.16 * q[:, 2]], axis=1)
    strand = 0.6 * noise(hairs, 1.3, seed + 371)
    if held(0.5, spacing_mm) > 0.0:
        strand += 0.8 * noise(hairs, 0.5, seed + 372)
    out[index] = smoothstep(0.05, 0.8, masks.brow[index] * (1.0 + 0.25 * strand))
    return out


def _eye_colour(t: Array, spacing_mm: float, seed: int) -> Array:
    """Sclera with pink corners and faint veins, iris with fibres and limbal ring, pupil."""
    s, y = np.abs(t[:, 0]) - EYE_CENTRE[0], t[:, 1] - EYE_CENTRE[1]
    radius = np.hypot(s, y)
    pink = np.maximum(smoothstep(-9.5, -14.0, s), 0.6 * smoothstep(10.5, 14.5, s))
    pink = np.maximum(pink, 0.18 * smoothstep(6.0, 12.0, radius))
    colour = np.broadcast_to(_SCLERA, t.shape) * (1.0 + 0.02 * noise(t, 3.0, seed + 381))[:, None]
    if held(0.7, spacing_mm) > 0.0:
        vein = np.exp(-((noise(t, 2.5, seed + 382) / 0.10) ** 2))
        pink = np.maximum(pink, 0.25 * vein * smoothstep(6.0, 11.0, radius))
    colour = _mix(colour, np.broadcast_to(np.array([0.52, 0.24, 0.20]), t.shape), pink)
    # The lids keep light off the edge of the globe, most under the upper one.
    gap = fissure(np.stack([np.abs(t[:, 0]), t[:, 1], t[:, 2]], axis=1))
    shade = smoothstep(0.0, -2.6, gap) * (0.75 + 0.25 * smoothstep(6.5, 1.0, y))
    angle = np.arctan2(y, s)
    spokes = np.stack([np.cos(angle) * 9.0, np.sin(angle) * 9.0, 0.35 * radius], axis=1)
    fibre = noise(spokes + 40.0 * np.sign(t[:, :1]), 0.9, seed + 391)
    base = _iris_base(seed)
    inner = smoothstep(4.4, 2.0, radius)[:, None]
    iris = (base * (1.0 - 0.45 * inner) + np.array([0.17, 0.11, 0.05]) * 0.55 * inner) * np.exp(
        0.28 * fibre
    )[:, None]
    iris *= (1.0 - 0.72 * smoothstep(4.5, 5.8, radius))[:, None]
    colour = _mix(colour, iris, smoothstep(IRIS_RADIUS_MM + 0.25, IRIS_RADIUS_MM - 0.3, radius))
    pupil = smoothstep(PUPIL_RADIUS_MM + 0.2, PUPIL_RADIUS_MM - 0.2, radius)
    colour = _mix(colour, np.broadcast_to(_PUPIL, t.shape), pupil)
    return np.asarray(colour * (0.55 + 0.45 * shade)[:, None])


def _iris_base(seed: int) -> Array:
    """Blue-grey, green-grey or brown."""
    choices = np.array([[0.15, 0.185, 0.21], [0.15, 0.17, 0.11], [0.13, 0.07, 0.035]])
    return np.asarray(choices[seed % 3])


def _caves(t: Array) -> Array:
    """The scanner's own darkness: nostrils and ear canals are never lit."""
    mirrored = t.copy()
    mirrored[:, 0] = np.abs(t[:, 0])
    nostril = ellipsoid(mirrored, (7.0, -45.0, 97.0), (3.4, 5.5, 6.0))
    canal = ellipsoid(mirrored, (64.0, -23.0, -4.0), (4.5, 4.5, 4.5))
    deep = smoothstep(1.0, -2.2, np.minimum(nostril, canal))
    return np.asarray(1.0 - 0.72 * deep)
