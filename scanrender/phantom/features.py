"""Nose, lips and eyes: the parts by which a face is recognised.

Truth frame and mm as in `skull`. All functions take mirrored points (x = |x|) unless they say
otherwise; `SIDE` features therefore exist once.
"""

from __future__ import annotations

import numpy as np

from scanrender.phantom.noise import Array, smoothstep
from scanrender.phantom.sdf import (
    bump,
    capsule,
    ellipsoid,
    intersect,
    near,
    sphere,
    subtract,
    union,
)

EYE_CENTRE = np.array([31.5, 0.0, 68.6])
EYE_RADIUS_MM = 12.0
CORNEA_OFFSET_MM = 5.0
CORNEA_RADIUS_MM = 7.9
IRIS_RADIUS_MM = 5.85
PUPIL_RADIUS_MM = 2.1
LID_RADIUS_MM = 13.9
LID_DEPTH_MM = 2.2

MOUTH_Y = -67.5
MOUTH_HALF_WIDTH_MM = 24.6


def add_nose(p: Array, distance: Array) -> Array:
    """Bridge, side walls, tip, wings and columella, with nostrils cut in."""
    index = near(p, (-1.0, -62.0, 60.0), (40.0, 34.0, 135.0))
    if not len(index):
        return distance
    q = p[index]
    wall = capsule(q, (4.6, 4.0, 75.4), (9.6, -33.0, 86.4), 4.2, 7.2)
    result = union(distance[index], wall, 15.0)
    bridge = capsule(q, (0.0, 12.0, 83.2), (0.0, -13.0, 94.0), 3.5, 4.0)
    bridge = union(bridge, capsule(q, (0.0, -13.0, 94.0), (0.0, -34.0, 102.6), 4.0, 5.0), 5.0)
    result = union(result, bridge, 12.0)
    tip = union(sphere(q, (0.0, -37.4, 104.2), 5.6), sphere(q, (2.8, -37.2, 104.0), 5.2), 3.0)
    tip = union(tip, capsule(q, (0.0, -47.4, 88.0), (0.0, -43.4, 101.0), 3.8, 3.4), 4.0)
    wing = ellipsoid(_turn(q, (11.6, -40.0, 93.0), -22.0), (0.0, 0.0, 0.0), (5.2, 6.4, 9.8))
    result = union(union(result, tip, 11.0), wing, 7.0)
    hole = ellipsoid(_turn(q, (7.0, -47.8, 96.5), 24.0), (0.0, 0.0, 0.0), (2.5, 4.6, 5.4))
    result = subtract(result, hole, 2.0)
    distance = distance.copy()
    distance[index] = result
    return distance


def _turn(p: Array, centre: tuple[float, float, float], yaw_deg: float) -> Array:
    """Points relative to `centre`, turned about +Y."""
    offset = p - np.asarray(centre)
    c, s = np.cos(np.radians(yaw_deg)), np.sin(np.radians(yaw_deg))
    return np.stack(
        [c * offset[:, 0] + s * offset[:, 2], offset[:, 1], c * offset[:, 2] - s * offset[:, 0]],
        axis=1,
    )


def lip_lines(x: Array) -> tuple[Array, Array, Array, Array]:
    """(parting, upper border, lower border, taper): y in mm at signed x, and 1 -> 0 at the corner.

    The upper border is the cupid's bow.
    """
    t = np.clip(np.abs(x) / MOUTH_HALF_WIDTH_MM, 0.0, 1.0)
    taper = np.sqrt(np.maximum(1.0 - t * t, 0.0))
    parting = MOUTH_Y - 0.8 * np.exp(-((x / 4.6) ** 2)) - 1.2 * t**3
    parting = parting + 0.8 * np.exp(-(((np.abs(x) - 10.0) / 6.0) ** 2))
    bow = 0.8 * np.exp(-(((np.abs(x) - 5.4) / 3.4) ** 2))
    upper = MOUTH_Y - 1.2 * t**3 + 7.2 * (1.0 - t**1.7) + bow
    lower = MOUTH_Y - 1.2 * t**3 - 10.2 * (1.0 - t**2.2)
    return parting, upper, lower, taper


def mouth_relief(p: Array) -> Array:
    """Height (mm toward +Z) of lips, philtrum and parting; p signed (n, 3)."""
    total = np.zeros(len(p))
    index = near(p, (-42.0, -96.0, 55.0), (42.0, -40.0, 125.0))
    if not len(index):
        return total
    x, y = p[index, 0], p[index, 1]
    parting, upper, lower, taper = lip_lines(x)
    up = np.clip((y - parting) / np.maximum(upper - parting, 0.6), 0.0, None)
    down = np.clip((parting - y) / np.maximum(parting - lower, 0.6), 0.0, None)
    # Each lip: rises steeply out of the parting, fullest past the middle of the wet line, then
    # rolls to the border, where the upper one ends in a faint ridge.
    upper_lip = 3.0 * _roll(up, 0.38) * (0.2 + 0.8 * taper)
    upper_lip += 0.7 * _roll(up, 0.5) * np.exp(-((x / 4.0) ** 2))
    lower_lip = 3.8 * _roll(down, 0.46) * (0.05 + 0.95 * taper)
    relief = np.where(y > parting, upper_lip, lower_lip) * smoothstep(0.0, 0.45, taper)
    relief += 0.12 * np.exp(-(((up - 1.08) / 0.16) ** 2)) * taper * (y > parting)
    inside = smoothstep(1.0, 0.82, np.abs(x) / (MOUTH_HALF_WIDTH_MM + 2.5))
    relief -= 1.6 * inside * np.exp(-(((y - parting) / 1.1) ** 2))
    relief -= 1.7 * bump(np.abs(x), y, (MOUTH_HALF_WIDTH_MM + 1.0, MOUTH_Y - 1.4), (3.4, 3.0))
    relief += 0.5 * bump(np.abs(x), y, (5.4, -56.0), (2.0, 4.8))
    relief -= 0.6 * bump(x, y, (0.0, -56.0), (2.5, 5.0))
    total[index] = relief
    return total


def _roll(t: Array, peak: float) -> Array:
    """Lip profile across its height: 0 at t = 0, 1 at `peak`, back to 0 a little past t = 1."""
    rising = np.sin(0.5 * np.pi * np.clip(t / peak, 0.0, 1.0))
    falling = 0.5 + 0.5 * np.cos(np.pi * np.clip((t - peak) / (1.35 - peak), 0.0, 1.0))
    return np.asarray(np.where(t < peak, rising, falling), dtype=np.float64)


def fissure(p: Array) -> Array:
    """Signed distance (mm) in the frontal plane to the opening between the lids; < 0 is open.

    p: mirrored points. Inner corner at x = 16.5, outer at 46, 2 mm higher.
    """
    s = p[:, 0] - EYE_CENTRE[0]
    y = p[:, 1] - EYE_CENTRE[1]
    t = (s + 15.0) / 29.6
    inside = np.clip(t, 0.0, 1.0)
    arch = 4.0 * inside * (1.0 - inside)
    line = -1.6 + 2.9 * t
    top = line + 2.9 * arch**0.8 * (1.14 - 0.28 * inside)
    bottom = line - 5.3 * arch**0.95 * (0.86 + 0.28 * inside)
    across = np.maximum(y - top, bottom - y) / 1.12
    along = np.maximum(-t, t - 1.0) * 29.6
    return np.asarray(np.where(along > 0.0, np.hypot(along, np.maximum(across, 0.0)), across))


def eyeball(p: Array) -> Array:
    """Globe with the slight bulge of the cornea; mirrored points."""
    globe = sphere(p, EYE_CENTRE, EYE_RADIUS_MM)
    front = EYE_CENTRE + np.array([0.0, 0.0, CORNEA_OFFSET_MM])
    return union(globe, sphere(p, front, CORNEA_RADIUS_MM), 1.2)


def add_eyes(p: Array, distance: Array) -> Array:
    """Lids stretched over the globe, slit by the fissure, the globe and its corner in the slit."""
    index = near(p, (6.0, -26.0, 40.0), (64.0, 28.0, 110.0))
    if not len(index):
        return distance
    q = p[index]
    result = distance[index]
    lids = ellipsoid(q, EYE_CENTRE + np.array([0.3, 0.0, 0.0]), (16.4, 13.7, LID_RADIUS_MM))
    result = union(result, lids, 6.5)
    s, y = q[:, 0] - EYE_CENTRE[0], q[:, 1] - EYE_CENTRE[1]
    # The fold of the upper lid, and the weak one under the lower.
    fold = y - (8.3 - 0.020 * (s - 0.5) ** 2 + 0.03 * s)
    reach = smoothstep(17.5, 9.0, np.abs(s - 0.5))
    result = result + 0.75 * np.exp(-((fold / 0.9) ** 2)) * reach
    result = result - 0.75 * np.exp(-(((fold - 3.0) / 2.4) ** 2)) * reach
    under = y - (-10.8 + 0.014 * s**2)
    result = result + 0.22 * np.exp(-((under / 1.8) ** 2)) * reach
    # The slit is a recess of bounded depth, so that its corners end in flesh and not in a cave.
    opening = np.maximum(fissure(q), EYE_CENTRE[2] - q[:, 2])
    result = union(intersect(result, -opening, 1.2), result + LID_DEPTH_MM, 0.5)
    result = union(result, sphere(q, (18.4, -1.3, EYE_CENTRE[2] + 7.8), 1.7), 1.4)  # caruncle
    result = union(result, eyeball(q), 1.0)
    distance = distance.copy()
    distance[index] = result
    return distance
