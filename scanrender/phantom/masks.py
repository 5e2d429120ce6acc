"""Where on the head what is: hair, brows, lips, eyes, beard, ears; from template positions."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from scanrender.phantom.ears import ear_frame
from scanrender.phantom.features import EYE_CENTRE, MOUTH_HALF_WIDTH_MM, fissure, lip_lines
from scanrender.phantom.noise import Array, noise, smoothstep
from scanrender.phantom.sdf import bump

# Hairline: azimuth about the vertical through (0, y, -10) in degrees from the front, height in mm.
_HAIRLINE = [
    (0.0, 65.0),
    (14.0, 66.5),
    (27.0, 67.5),
    (37.0, 60.0),
    (45.0, 53.0),
    (52.0, 39.0),
    (57.0, 18.0),
    (61.0, 0.0),
    (65.0, -15.0),
    (75.0, -17.0),
    (81.0, 8.0),
    (90.0, 15.0),
    (104.0, 12.0),
    (114.0, -14.0),
    (124.0, -46.0),
    (140.0, -66.0),
    (160.0, -74.0),
    (180.0, -76.0),
]

_MM_PER_DEGREE = 1.4  # along the hairline


@dataclass(frozen=True)
class Masks:
    """Coverages in [0, 1], each (n,): soft where the real border is soft."""

    hair: Array
    brow: Array
    lips: Array
    eye: Array
    lashes: Array
    beard: Array
    ear: Array
    front: Array


@lru_cache(maxsize=1)
def _hairline() -> Any:
    from scipy.interpolate import PchipInterpolator

    table = np.array(_HAIRLINE)
    return PchipInterpolator(table[:, 0], table[:, 1])


def masks_at(t: Array, seed: int) -> Masks:
    """Masks at template points t (n, 3) mm."""
    mirrored = t.copy()
    mirrored[:, 0] = np.abs(t[:, 0])
    ear = _ear(mirrored)
    eye, lashes = _eye(mirrored)
    return Masks(
        hair=_hair(t, seed) * (1.0 - ear),
        brow=_brow(mirrored, t, seed),
        lips=_lips(t, seed),
        eye=eye,
        lashes=lashes,
        beard=_beard(mirrored) * (1.0 - ear),
        ear=ear,
        front=smoothstep(10.0, 45.0, t[:, 2]),
    )


def _ear(m: Array) -> Array:
    q = ear_frame(m)
    u, v, w = q.T
    inside = ((u - 4.0) / 19.5) ** 2 + ((v - 2.0) / 33.0) ** 2
    return smoothstep(1.1, 1.0, inside) * smoothstep(-3.5, -1.5, w + 0.22 * np.maximum(u, 0.0))


def _hair(t: Array, seed: int) -> Array:
    azimuth = np.degrees(np.arctan2(np.abs(t[:, 0]), t[:, 2] + 10.0))
    line = _hairline()
    # Height over the line, made a distance in front of the ears, where the line is steep.
    steep = line(azimuth, 1) / _MM_PER_DEGREE * smoothstep(74.0, 66.0, azimuth)
    edge = (t[:, 1] - line(azimuth)) / np.hypot(1.0, steep)
    # Far from the hairline the border noise cannot matter.
    close = np.flatnonzero(np.abs(edge) < 30.0)
    edge[close] += 1.9 * noise(t[close], 11.0, seed + 201) + 1.0 * noise(t[close], 4.0, seed + 202)
    return smoothstep(-11.0, 19.0, edge)


def brow_line(x: Array) -> tuple[Array, Array, Array]:
    """(along, y, half height) of the brow at |x|: along is 0 at the nose and 1 at the temple."""
    along = (x - 10.5) / 42.0
    inside = np.clip(along, 0.0, 1.0)
    line = 14.2 + 3.9 * np.sin(2.3 * inside) ** 1.2 - 3.6 * inside**3
    return along, line, 4.1 - 2.6 * inside**1.2


def _brow(m: Array, t: Array, seed: int) -> Array:
    """How densely the hairs stand: full in the body, thin at the nose, running out at the tail."""
    out = np.zeros(len(t))
    index = np.flatnonzero((m[:, 0] < 60.0) & (np.abs(m[:, 1] - 17.0) < 14.0) & (m[:, 2] > 40.0))
    along, line, half = brow_line(m[index, 0])
    # Sharper below than above, where the hairs comb out into the forehead.
    off = m[index, 1] - line + 0.3 * noise(t[index], 5.0, seed + 211)
    across = np.where(off > 0.0, off / (1.15 * half), -off / half)
    ends = smoothstep(-0.10, 0.30, along) * smoothstep(1.06, 0.66, along)
    out[index] = smoothstep(1.5, 0.3, across) * ends
    return out


def _lips(t: Array, seed: int) -> Array:
    out = np.zeros(len(t))
    near_mouth = (np.abs(t[:, 0]) < 30.0) & (np.abs(t[:, 1] + 68.0) < 16.0) & (t[:, 2] > 60.0)
    index = np.flatnonzero(near_mouth)
    x, y = t[index, 0], t[index, 1]
    _, upper, lower, _ = lip_lines(x)
    ragged = 0.22 * noise(t[index], 1.1, seed + 221)
    edge = np.minimum(upper + 0.6 - y, y - lower) + ragged
    corner = smoothstep(1.06, 0.80, np.abs(x) / MOUTH_HALF_WIDTH_MM)
    out[index] = smoothstep(-1.0, 1.1, edge) * corner
    return out


def _eye(m: Array) -> tuple[Array, Array]:
    """Opening between the lids, and the dark line of the lashes along its border."""
    eye, lashes = np.zeros(len(m)), np.zeros(len(m))
    offset = np.abs(m - EYE_CENTRE)
    front = m[:, 2] > EYE_CENTRE[2] - 5.0
    index = np.flatnonzero((offset[:, 0] < 19.0) & (offset[:, 1] < 12.0) & front)
    gap = fissure(m[index])
    eye[index] = smoothstep(-0.15, -0.75, gap)
    upper = m[index, 1] > EYE_CENTRE[1] - 0.5 + 0.1 * (m[index, 0] - EYE_CENTRE[0])
    line = np.where(
        upper,
        smoothstep(-1.2, -0.4, gap) * smoothstep(1.3, 0.1, gap),
        0.35 * smoothstep(0.0, 0.4, gap) * smoothstep(1.5, 0.7, gap),
    )
    lateral = 0.55 + 0.45 * smoothstep(-14.0, 4.0, m[index, 0] - EYE_CENTRE[0])
    lashes[index] = line * lateral * smoothstep(-15.5, -11.0, m[index, 0] - EYE_CENTRE[0])
    return eye, lashes


def _beard(m: Array) -> Array:
    """Shaved beard: moustache, chin, jaw up to the sideburns, upper throat."""
    x, y, z = m.T
    cheek_line = -52.0 + 0.0105 * np.maximum(x - 16.0, 0.0) ** 2
    cheek_line -= 9.0 * bump(x, y, (33.0, -58.0), (9.0, 12.0))
    lower_face = smoothstep(10.0, -15.0, y - cheek_line) * smoothstep(-135.0, -112.0, y)
    lip_clear = 1.0 - bump(x, y, (0.0, -79.5), (14.0, 3.0)) * 0.5
    return lower_face * lip_clear * smoothstep(-14.0, 12.0, z)
