"""Colour: scene-linear Rec.709 albedo and label at any point of the template.

The values are a light, pink skin (about 0.57, 0.36, 0.29). Redness (blood) and tan (melanin) vary
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
from scanrender.phantom.masks import Masks, brow_line
from scanrender.phantom.noise import Array, fbm, noise, smoothstep
from scanrender.phantom.relief import held, pore_density, pores, strands
from scanrender.phantom.sdf import bump, ellipsoid

LABELS = ("skin", "lips", "brow", "hair", "eye")

_SKIN = np.array([0.62, 0.374, 0.308])
_BLOOD = np.array([-0.08, -0.44, -0.36])  # log change of reflectance per unit of redness
_TAN = np.array([-0.30, -0.46, -0.62])  # per unit of melanin
_LIPS = np.array([0.48, 0.192, 0.184])
_BROW = np.array([0.038, 0.025, 0.019])
_HAIR = np.array([0.046, 0.031, 0.023])
_VEIL = np.array([0.315, 0.250, 0.255])  # hairs under the skin of a shaved jaw
_SCLERA = np.array([0.60, 0.53, 0.49])
_PUPIL = np.array([0.010, 0.010, 0.010])
_MOLES = 4
_FACE_SPACING = 0.77  # the mesh is finer there than on average


def albedo_at(
    t: Array, masks: Masks, spacing_mm: float, seed: int
) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    """Albedo (n, 3) linear Rec.709 and label (n,) at template points t (n, 3) mm.

    `spacing_mm` is the distance of samples: finer detail is left out.
    """
    colour = _skin(t, masks, spacing_mm, seed)
    colour = _mix(colour, _lip_colour(t, spacing_mm, seed), 0.92 * masks.lips)
    strand = strands(t, seed, spacing_mm)
    shade = np.exp(0.20 * strand)[:, None]
    # Short hair lets the scalp through in a pattern of strands, most at the hairline.
    cover = 1.25 * masks.hair - 0.06 + 0.20 * strand * (1.05 - masks.hair)
    cover = np.clip(cover, 0.0, 1.0) * smoothstep(0.0, 0.2, masks.hair)
    colour = _mix(colour, _HAIR * shade, 0.92 * cover)
    brow = _brow_cover(t, masks, spacing_mm, seed)
    colour = _mix(colour, np.broadcast_to(_BROW, colour.shape), 0.94 * brow)
    colour = _mix(colour, np.broadcast_to(_BROW * 0.7, colour.shape), 0.85 * masks.lashes)
    eyes = np.flatnonzero(masks.eye > 0.0)
    if len(eyes):
        iris = _eye_colour(t[eyes], spacing_mm, seed)
        colour[eyes] = _mix(colour[eyes], iris, masks.eye[eyes])
    colour *= _caves(t)[:, None]
    label = np.select([masks.eye > 0.5, masks.lips > 0.4, brow > 0.6, cover > 0.5], [4, 1, 2, 3], 0)
    return np.clip(colour, 0.004, 0.9).astype(np.float32), label.astype(np.uint8)


def _mix(a: Array, b: Array, weight: Array) -> Array:
    return a + (b - a) * weight[:, None]


def _skin(t: Array, masks: Masks, spacing_mm: float, seed: int) -> Array:
    blood = _redness(t, masks) + 0.045 * fbm(t, 26.0, 2, seed + 301)
    tan = 0.035 * fbm(t, 40.0, 2, seed + 311) + _eye_rings(t)
    for scale, weight in ((3.0, 0.045), (1.2, 0.05)):
        fade = held(scale, spacing_mm)
        if fade > 0.0:
            blood += fade * weight * noise(t, scale, seed + int(1000 * scale))
    fade = held(0.42, spacing_mm)
    if fade > 0.0:
        tan += 0.18 * fade * pores(t, seed) * pore_density(t) * masks.front
    tan += _freckles(t, masks, seed) + _moles(t, seed)
    colour = _SKIN * np.exp(blood[:, None] * _BLOOD + tan[:, None] * _TAN)
    return _stubble(colour, t, masks, spacing_mm, seed)


def _redness(t: Array, masks: Masks) -> Array:
    x, y = np.abs(t[:, 0]), t[:, 1]
    red = 0.32 * bump(x, y, (0.0, -37.0), (13.0, 9.0))  # nose
    red += 0.37 * bump(x, y, (39.0, -30.0), (19.0, 17.0))  # cheeks
    red += 0.14 * bump(x, y, (0.0, -101.0), (16.0, 9.0))  # chin
    red += 0.18 * bump(x, y, (27.0, 2.0), (13.0, 8.0))  # lids
    red -= 0.12 * bump(x, y, (0.0, 48.0), (44.0, 22.0))  # forehead is paler
    return red * masks.front + 0.34 * masks.ear


def _eye_rings(t: Array) -> Array:
    x, y = np.abs(t[:, 0]), t[:, 1]
    ring = 0.12 * bump(x, y, (26.0, -10.0), (10.0, 4.0))
    ring += 0.10 * bump(x, y, (16.5, 1.0), (4.0, 8.0))
    return ring * (t[:, 2] > 55.0)


def _freckles(t: Array, masks: Masks, seed: int) -> Array:
    spots = smoothstep(1.8, 2.6, noise(t, 1.5, seed + 331))
    return 0.16 * spots * masks.front


def _moles(t: Array, seed: int) -> Array:
    """A few dark spots of 0.8-1.8 mm at seeded places on face and neck."""
    rng = np.random.default_rng((seed, 71))
    total = np.zeros(len(t))
    for _ in range(_MOLES):
        x, y = rng.uniform(-58.0, 58.0), rng.uniform(-125.0, 55.0)
        radius, strength = rng.uniform(0.6, 1.1), rng.uniform(0.5, 1.3)
        close = np.flatnonzero((np.abs(t[:, 0] - x) < 4.0) & (np.abs(t[:, 1] - y) < 4.0))
        close = close[t[close, 2] > 20.0]
        off = np.hypot(t[close, 0] - x, t[close, 1] - y)
        total[close] += strength * smoothstep(1.25 * radius, 0.7 * radius, off)
    return total


def _stubble(colour: Array, t: Array, masks: Masks, spacing_mm: float, seed: int) -> Array:
    """A shaved beard: bluish grey veil, and dots where the samples can hold them."""
    patchy = masks.beard * (0.9 + 0.1 * np.clip(noise(t, 14.0, seed + 341), -1.5, 1.5))
    colour = _mix(colour, np.broadcast_to(_VEIL, colour.shape), 0.40 * patchy)
    fade = held(0.5, spacing_mm)
    if fade > 0.0:
        dots = smoothstep(0.9, 1.6, noise(t, 0.5, seed + 351))
        colour = _mix(colour, np.broadcast_to(_BROW, colour.shape), 0.34 * fade * dots * patchy)
    return colour


def _lip_colour(t: Array, spacing_mm: float, seed: int) -> Array:
    parting, _, _, _ = lip_lines(t[:, 0])
    wet = np.exp(-(((t[:, 1] - parting) / 1.2) ** 2))
    lower = smoothstep(0.0, -6.0, t[:, 1] - parting)  # the lower lip turns up to the light
    mottle = 0.05 * noise(t, 4.0, seed + 361) - 0.10 + 0.18 * lower
    if held(0.9, spacing_mm) > 0.0:
        mottle += 0.07 * noise(t * np.array([1.0, 0.22, 0.5]), 0.9, seed + 61)
    return np.asarray(_LIPS * np.exp(mottle - 0.8 * wet)[:, None])


def _brow_cover(t: Array, masks: Masks, spacing_mm: float, seed: int) -> Array:
    """Hairs where the samples can hold them, else what a camera would average them to."""
    out = np.zeros(len(t))
    index = np.flatnonzero(masks.brow > 0.0)
    q, density = t[index], masks.brow[index]
    x = np.abs(q[:, 0])
    along, line, _ = brow_line(x)
    # Hairs stand up at the nose, then lie along the brow, and droop at the tail.
    lean = np.radians(np.interp(along, [0.0, 0.2, 0.6, 1.0], [72.0, 44.0, 14.0, -18.0]))
    u, v = x - 30.0, q[:, 1] - line
    across = v * np.cos(lean) - u * np.sin(lean) * 0.5
    length = v * np.sin(lean) + u * np.cos(lean)
    hairs = np.stack([0.16 * length + 50.0 * np.sign(q[:, 0]), across, 0.16 * q[:, 2]], axis=1)
    strand, held_share = np.zeros(len(index)), 0.0
    for scale, weight in ((1.3, 0.7), (0.5, 0.9)):
        fade = held(scale, _FACE_SPACING * spacing_mm)
        held_share = max(held_share, fade)
        if fade > 0.0:
            strand += fade * weight * noise(hairs, scale, seed + int(370 * scale))
    solid = 0.94 * density
    split = 0.94 * smoothstep(0.1, 1.0, density + 0.24 * strand * (0.3 + density))
    out[index] = solid + (split - solid) * held_share
    return out


def _eye_colour(t: Array, spacing_mm: float, seed: int) -> Array:
    """Sclera with pink corners and faint veins, iris with fibres and limbal ring, pupil."""
    s, y = np.abs(t[:, 0]) - EYE_CENTRE[0], t[:, 1] - EYE_CENTRE[1]
    radius = np.hypot(s, y)
    pink = np.maximum(smoothstep(-9.0, -13.5, s), 0.55 * smoothstep(9.5, 14.0, s))
    pink = np.maximum(pink, 0.16 * smoothstep(6.0, 12.0, radius))
    white = _SCLERA * (1.0 - 0.28 * smoothstep(6.0, 13.0, np.abs(s)))[:, None]
    colour = white * (1.0 + 0.02 * noise(t, 3.0, seed + 381))[:, None]
    if held(0.7, spacing_mm) > 0.0:
        vein = np.exp(-((noise(t, 2.5, seed + 382) / 0.10) ** 2))
        pink = np.maximum(pink, 0.25 * vein * smoothstep(6.0, 11.0, radius))
    colour = _mix(colour, np.broadcast_to(np.array([0.52, 0.24, 0.20]), t.shape), pink)
    # The lids keep light off the edge of the globe, most under the upper one.
    gap = fissure(np.stack([np.abs(t[:, 0]), t[:, 1], t[:, 2]], axis=1))
    shade = smoothstep(0.3, -2.8, gap) * (0.6 + 0.4 * smoothstep(5.0, 0.0, y))
    angle = np.arctan2(y, s)
    spokes = np.stack([np.cos(angle) * 9.0, np.sin(angle) * 9.0, 0.35 * radius], axis=1)
    fibre = noise(spokes + 40.0 * np.sign(t[:, :1]), 0.9, seed + 391)
    base = _iris_base(seed)
    inner = smoothstep(4.4, 2.0, radius)[:, None]
    iris = (base * (1.0 - 0.45 * inner) + np.array([0.12, 0.08, 0.04]) * 0.55 * inner) * np.exp(
        0.28 * fibre
    )[:, None]
    iris *= (1.0 - 0.72 * smoothstep(4.5, 5.8, radius))[:, None]
    colour = _mix(colour, iris, smoothstep(IRIS_RADIUS_MM + 0.25, IRIS_RADIUS_MM - 0.3, radius))
    pupil = smoothstep(PUPIL_RADIUS_MM + 0.2, PUPIL_RADIUS_MM - 0.2, radius)
    colour = _mix(colour, np.broadcast_to(_PUPIL, t.shape), pupil)
    return np.asarray(colour * (0.55 + 0.45 * shade)[:, None])


def _iris_base(seed: int) -> Array:
    """Blue-grey, green-grey or brown."""
    choices = np.array([[0.105, 0.132, 0.150], [0.11, 0.125, 0.08], [0.11, 0.06, 0.03]])
    return np.asarray(choices[seed % 3])


def _caves(t: Array) -> Array:
    """The scanner's own darkness: nostrils and ear canals are never lit."""
    mirrored = t.copy()
    mirrored[:, 0] = np.abs(t[:, 0])
    nostril = ellipsoid(mirrored, (7.0, -47.2, 96.5), (2.9, 5.0, 5.6))
    canal = ellipsoid(mirrored, (64.0, -23.0, -4.0), (4.5, 4.5, 4.5))
    deep = smoothstep(1.0, -2.2, np.minimum(nostril, canal))
    return np.asarray(1.0 - 0.72 * deep)
