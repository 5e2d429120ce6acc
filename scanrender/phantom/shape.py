"""One head as one distance function: the parts put together, made slightly uneven by the seed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from scanrender.phantom.ears import add_ears
from scanrender.phantom.features import add_eyes, add_nose, mouth_relief
from scanrender.phantom.noise import Array, noise
from scanrender.phantom.skull import head_base

CUT_Y_MM = -168.0  # the open neck
BOUNDS_MM = np.array([[-116.0, CUT_Y_MM, -116.0], [116.0, 122.0, 122.0]])
CHUNK = 32_768

_ASYMMETRY_MM = 0.9
_ASYMMETRY_SCALE_MM = 75.0


@dataclass(frozen=True)
class Shape:
    """What differs between seeds: `scale` (3,) about the origin, and the noise seed."""

    seed: int
    scale: Array


def make_shape(seed: int) -> Shape:
    rng = np.random.default_rng((seed, 11))
    return Shape(seed, 1.0 + np.clip(0.012 * rng.standard_normal(3), -0.02, 0.02))


def truth_from_template(t: Array, shape: Shape) -> Array:
    """(n, 3) points of the symmetric template, in which all parts are defined, to the truth."""
    return np.asarray((t + _ASYMMETRY_MM * _drift(t, shape)) * shape.scale, dtype=np.float64)


def template_from_truth(p: Array, shape: Shape) -> Array:
    """Inverse of `truth_from_template` by fixed-point steps (each gains about 1.5 digits)."""
    t = p / shape.scale
    for _ in range(4):
        t = p / shape.scale - _ASYMMETRY_MM * _drift(t, shape)
    return t


def _drift(t: Array, shape: Shape) -> Array:
    parts = [noise(t, _ASYMMETRY_SCALE_MM, shape.seed * 31 + axis) for axis in range(3)]
    return np.stack(parts, axis=1)


def template_distance(t: Array) -> Array:
    """Distance (mm, approximate) in the template; t (n, 3)."""
    shifted = t.copy()
    shifted[:, 2] -= mouth_relief(t)
    distance = head_base(shifted)
    mirrored = t.copy()
    mirrored[:, 0] = np.abs(t[:, 0])
    distance = add_nose(mirrored, distance)
    distance = add_eyes(mirrored, distance)
    return add_ears(mirrored, distance)


def distance(t: Array) -> Array:
    """Signed distance (mm) of the smooth head at template points t (n, 3), chunk by chunk."""
    out = np.empty(len(t))
    for start in range(0, len(t), CHUNK):
        part = slice(start, start + CHUNK)
        out[part] = template_distance(t[part])
    return out


def value_and_gradient(t: Array, step_mm: float = 0.02) -> tuple[Array, Array]:
    """Distance (n,) and its forward-difference gradient (n, 3)."""
    value = distance(t)
    gradient = np.empty_like(t)
    for axis in range(3):
        moved = t.copy()
        moved[:, axis] += step_mm
        gradient[:, axis] = (distance(moved) - value) / step_mm
    return value, gradient
