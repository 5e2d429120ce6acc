"""The taps that soften a shadow: all samples' together fill the disk, and favour no side."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from scanrender.measure.float_lights import disk_point
from scanrender.render.passes._lamp import DISK_TAPS, spiral

Array = NDArray[np.float64]
EDGES = np.linspace(-0.98, 0.98, 99)
DIRECTIONS = np.linspace(0.0, 2.0 * np.pi, 72, endpoint=False)


def taps(samples: int) -> Array:
    """(samples * DISK_TAPS, 2)."""
    pairs = [(i, s) for s in range(samples) for i in range(DISK_TAPS)]
    return np.stack([disk_point(i, DISK_TAPS, spiral(s)) for i, s in pairs])


def beside(points: Array) -> Array:
    """Share of `points` on one side of straight edges: (directions, edges)."""
    ways = np.stack([np.cos(DIRECTIONS), np.sin(DIRECTIONS)])
    return np.mean((points @ ways)[:, :, None] < EDGES, axis=0)


@pytest.mark.parametrize(("samples", "rms"), [(1, 0.038), (4, 0.018), (9, 0.0100), (16, 0.0062)])
def test_a_straight_shadow_is_as_soft_as_the_disk_says(samples: int, rms: float):
    """Cauchy's segment. Turned by a 16th of the golden angle, 16 samples left 0.011."""
    area = 1.0 - (np.arccos(EDGES) - EDGES * np.sqrt(1.0 - EDGES**2)) / np.pi
    assert np.sqrt(np.mean((beside(taps(samples)) - area) ** 2)) < rms


@pytest.mark.parametrize("samples", [2, 4, 16, 64])
def test_taps_have_no_hand(samples: int):
    points = taps(samples)
    mirrored = beside(points * [-1.0, 1.0])
    assert np.abs(beside(points) - mirrored).max() < 1.5 / len(points), "rounding at an edge"


def test_every_tap_is_in_the_disk_and_none_twice():
    points = taps(64)
    assert np.linalg.norm(points, axis=1).max() < 1.0
    assert len(np.unique(np.round(points, 9), axis=0)) == len(points)
