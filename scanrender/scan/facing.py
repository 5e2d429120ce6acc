"""Where a head looks, from its shape alone: the mirror plane first, then which side has the nose.

A head mirrors left to right and not front to back. Along the mirror plane the nose stands out of
its surroundings as nothing at the back of a head does: a few per cent of the head's depth within
a tenth of its width, where a skull is smooth and a bun of hair is broad.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[Any]
SAMPLES = 12_000
MIRRORED = 900  # of them are reflected and looked up, per angle
STEP_DEG = 5
ROLL_DEG = 9.0  # how far a head may lean to its side
NOSE_ROWS = 4  # slices of a fortieth of the head each
SHEET_OPEN = 0.12  # horizontal part of the mean normal above which the surface is an open shell


@dataclass(frozen=True)
class Facing:
    """yaw: radians from the first horizontal axis toward the second; confidence and reason; head:
    the height from the neck's narrowest place to the crown, None where no neck was found."""

    yaw: float
    confidence: str
    reason: str
    head: float | None = None


def find_facing(points: Array, normals: Array) -> Facing | None:
    """Where the face looks, or None when the shape does not say.

    points (n, 3): spread evenly over the surface, the third coordinate is up; normals (n, 3): of
    the surface there, unit, outward. The yaw is counted from the first coordinate.
    """
    mean = normals[:, :2].mean(axis=0)
    if float(np.linalg.norm(mean)) > SHEET_OPEN:
        yaw = float(np.arctan2(mean[1], mean[0]))
        return Facing(yaw, "high", "the surface is open at the opposite side")
    head = points[head_part(points)]
    if len(head) < 500:
        return None
    size = float(np.ptp(head, axis=0).max())
    mirror = _Mirror(head)
    angles = np.radians(np.arange(0, 180, STEP_DEG))
    upright = np.array([mirror.error(angle, 0.0) for angle in angles])
    # A head that leans mirrors across a leaning plane: the likeliest few are tried with a roll.
    tried = [(mirror.best_roll(angles[i]), float(angles[i])) for i in upright.argsort()[:8]]
    (error, roll), yaw = min(tried)
    across = min(e for e, y in zip(upright, angles, strict=True) if _is_across(y, yaw))
    across = min([across, *(e for (e, _), y in tried if _is_across(y, yaw))])
    if error > 0.02 * size or error > 0.8 * across:
        return None
    fine = [yaw + np.radians(step) for step in (-4, -3, -2, -1, 0, 1, 2, 3, 4)]
    yaw = min(fine, key=lambda angle: mirror.error(angle, roll))
    front, back = nose(head, yaw, roll), nose(head, yaw + np.pi, -roll)
    if back > front:
        yaw, front, back = yaw + np.pi, back, front
    if front < 0.02 or front < 1.25 * back:
        return None
    confidence = "high" if front > 0.04 and front > 2.0 * back else "medium"
    crown, cut = float(head[:, 2].max()), float(head[:, 2].min())
    height = crown - cut if cut > points[:, 2].min() + 0.05 * (crown - cut) else None
    reason = "it mirrors left to right, and the nose stands out there"
    return Facing(yaw, confidence, reason, height)


def head_part(points: Array) -> Array:
    """Mask of the part above the neck: down to the narrowest slice under the broadest one."""
    height = points[:, 2]
    low, high = np.quantile(height, [0.001, 0.999])
    edges = np.linspace(low, high, 33)
    which = np.clip(np.searchsorted(edges, height) - 1, 0, 31)
    breadth = np.zeros(32)
    for row in range(32):
        chosen = points[which == row, :2]
        if len(chosen) >= 20:
            spread = np.quantile(chosen, 0.95, axis=0) - np.quantile(chosen, 0.05, axis=0)
            breadth[row] = float(np.sqrt(np.maximum(spread, 0.0).prod()))
    widest, row = breadth[-1], 31
    narrowest, neck = np.inf, 0
    # Downward from the crown; the lowest slices of a bust that leans are cut slantwise.
    for row in range(31, 2, -1):
        if narrowest == np.inf and breadth[row] >= widest:
            widest = breadth[row]
        elif breadth[row] < 0.85 * widest and breadth[row] < narrowest:
            narrowest, neck = breadth[row], row
        elif breadth[row] > 1.15 * narrowest:  # the shoulders begin
            break
    return np.asarray(height >= edges[neck])


class _Mirror:
    """A shape and how well it mirrors across upright planes."""

    def __init__(self, points: Array) -> None:
        from scipy.spatial import cKDTree

        self.points, self.tree = points, cKDTree(points)
        self.some = points[:: max(1, len(points) // MIRRORED)]

    def error(self, yaw: float, roll: float) -> float:
        """Median distance of the reflected shape from itself, across the plane of `_axes`."""
        side = _axes(yaw, roll)[1]
        # The plane goes through the middle of the widest extent, not through the centroid: hair
        # or a missing ear moves that.
        middle = 0.5 * float(np.sum(np.quantile(self.points @ side, [0.01, 0.99])))
        mirrored = self.some - 2.0 * ((self.some @ side) - middle)[:, None] * side
        return float(np.median(self.tree.query(mirrored)[0]))

    def best_roll(self, yaw: float) -> tuple[float, float]:
        """(error, roll) of the best plane that leans by at most ROLL_DEG."""
        rolls = np.radians(np.arange(-ROLL_DEG, ROLL_DEG + 1.0, 3.0))
        return min((self.error(yaw, float(roll)), float(roll)) for roll in rolls)


def _axes(yaw: float, roll: float) -> tuple[Array, Array, Array]:
    """Forward, sideways and up of a head that looks along yaw and leans about that by roll."""
    forward = np.array([np.cos(yaw), np.sin(yaw), 0.0])
    level = np.array([-np.sin(yaw), np.cos(yaw), 0.0])
    side = np.cos(roll) * level + np.sin(roll) * np.array([0.0, 0.0, 1.0])
    return forward, side, np.cross(forward, side)


def _is_across(angle: float, yaw: float) -> bool:
    return bool(abs(np.sin(angle - yaw)) > np.sin(np.radians(75.0)))


def nose(points: Array, yaw: float, roll: float = 0.0) -> float:
    """How far the middle of the head stands out of what lies beside it, over the head's depth.

    The foremost point within 4 % of the width from the mirror plane, minus that at 10 to 18 % on
    both sides, in slices between a fifth and nine tenths of the height: the most that NOSE_ROWS
    slices on end all reach.
    """
    depth, offset, height = (points @ axis for axis in _axes(yaw, roll))
    left, right = np.quantile(offset, [0.02, 0.98])
    out = np.abs(offset - 0.5 * (left + right)) / max(right - left, 1e-300)
    low, high = height.min(), height.max()
    level = np.floor((height - low) / max(high - low, 1e-300) * 40).astype(np.int64)
    out_of_beside = np.zeros(40)
    for row in range(8, 36):
        near = np.abs(level - row) <= 1
        middle, beside = near & (out < 0.04), near & (out > 0.10) & (out < 0.18)
        if middle.sum() >= 3 and beside.sum() >= 3:
            # Not the foremost sample, which one spike could be, but the foremost few.
            out_of_beside[row] = _foremost(depth[middle]) - _foremost(depth[beside])
    # A nose is as long as NOSE_ROWS; the lower edge of a bun or of the neck's cut is not.
    runs = np.lib.stride_tricks.sliding_window_view(out_of_beside, NOSE_ROWS)
    best = float(runs.min(axis=1).max())
    return best / max(float(np.ptp(np.quantile(depth, [0.01, 0.99]))), 1e-300)


def _foremost(values: Array) -> float:
    return float(np.sort(values)[-3:].mean())


def spread_samples(positions: Array, faces: Array, count: int = SAMPLES) -> tuple[Array, Array]:
    """At most `count` points (n, 3) evenly over the surface and their normals, always the same."""
    from scanrender.scan.topology import area_normals, lengths, unit

    normal = area_normals(positions, faces)
    area = lengths(normal)
    rng = np.random.default_rng(0)
    count = min(count, 8 * len(faces))  # a few dozen triangles draw no face anyway
    # Stratified along the list of faces: no clumps where faces lie in order.
    passed = np.cumsum(area)
    place = (np.arange(count) + rng.random(count)) / count * passed[-1]
    face = np.minimum(np.searchsorted(passed, place), len(faces) - 1)
    u, v = rng.random(count), rng.random(count)
    flip = u + v > 1.0
    u, v = np.where(flip, 1.0 - u, u), np.where(flip, 1.0 - v, v)
    a, b, c = (positions[faces[face, i]] for i in range(3))
    return a + u[:, None] * (b - a) + v[:, None] * (c - a), unit(normal[face])
