"""The taps that soften a shadow: all samples' together fill the disk, and favour no side."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from scanrender.measure.float_lights import disk_point, spirals_of
from scanrender.render.passes._lamp import DISK_TAPS, turn_rad

Array = NDArray[np.float64]
EDGES = np.linspace(-0.98, 0.98, 99)
DIRECTIONS = np.linspace(0.0, 2.0 * np.pi, 72, endpoint=False)


def taps(samples: int, pixels: tuple[int, int] = (1, 1)) -> Array:
    """(n, 2): of all pixels and samples together."""
    spirals = [spirals_of(pixels, turn_rad(s), pixels != (1, 1)) for s in range(samples)]
    found = [disk_point(i, DISK_TAPS, own) for own in spirals for i in range(DISK_TAPS)]
    return np.concatenate(found).reshape(-1, 2)


def beside(points: Array) -> Array:
    """Share of `points` on one side of straight edges: (directions, edges)."""
    ways = np.stack([np.cos(DIRECTIONS), np.sin(DIRECTIONS)])
    return np.mean((points @ ways)[:, :, None] < EDGES, axis=0)


@pytest.mark.parametrize(
    ("samples", "pixels", "rms"),
    [
        (1, (1, 1), 0.038), (4, (1, 1), 0.015), (9, (1, 1), 0.0085), (16, (1, 1), 0.0055),
        # What is scattered once a pixel has one sample's taps, and diffusion averages neighbours.
        (1, (2, 2), 0.020), (4, (2, 2), 0.008),
    ],
)  # fmt: skip
def test_a_straight_shadow_is_as_soft_as_the_disk_says(samples: int, pixels, rms: float):
    """A circle's segment. Turned by a 16th of the golden angle, 16 samples left 0.011."""
    area = 1.0 - (np.arccos(EDGES) - EDGES * np.sqrt(1.0 - EDGES**2)) / np.pi
    assert np.sqrt(np.mean((beside(taps(samples, pixels)) - area) ** 2)) < rms


@pytest.mark.parametrize("samples", [1, 3, 16])
def test_two_columns_have_no_hand(samples: int):
    points = taps(samples, (1, 2))
    mirrored = beside(points * [-1.0, 1.0])
    assert np.abs(beside(points) - mirrored).max() < 1.5 / len(points), "rounding at an edge"


def test_every_tap_is_in_the_disk_and_none_twice():
    points = taps(16, (2, 2))
    assert np.linalg.norm(points, axis=1).max() < 1.0
    assert len(np.unique(np.round(points, 9), axis=0)) == len(points)
