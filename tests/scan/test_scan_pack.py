"""Packing: no overlap, nothing mirrored or scaled apart, gaps kept, little wasted."""

from __future__ import annotations

import numpy as np
import pytest

from scanrender.scan.flatten import signed_areas
from scanrender.scan.pack import MAX_CHARTS, pack_charts
from scanrender.scan.rasterize import rasterize

SIDE = 1024


def fan(radius, corners, angle, squash):
    """A convex polygon as triangles (corners, 3, 2), turned and anywhere."""
    around = angle + 2.0 * np.pi * np.arange(corners) / corners
    rim = radius * np.stack([np.cos(around), squash * np.sin(around)], axis=1)
    c, s = np.cos(angle), np.sin(angle)
    rim = rim @ np.array([[c, -s], [s, c]])
    rim = rim + 1000.0 * angle
    middle = np.broadcast_to(rim.mean(axis=0), rim.shape)
    return np.stack([middle, rim, np.roll(rim, -1, axis=0)], axis=1)


@pytest.fixture(scope="module")
def charts():
    rng = np.random.default_rng(0)
    parts = [
        fan(rng.uniform(10, 40), int(rng.integers(4, 9)), rng.uniform(0, 6), rng.uniform(0.4, 1.0))
        for _ in range(30)
    ]
    chart = np.repeat(np.arange(len(parts)), [len(part) for part in parts])
    return chart, np.concatenate(parts)


@pytest.fixture(scope="module")
def packed(charts):
    return pack_charts(*charts, padding=8 / SIDE)


def flat_of(corner_uv):
    uv = corner_uv.reshape(-1, 2)
    return uv, np.arange(len(uv)).reshape(-1, 3)


def test_charts_are_turned_and_moved_but_neither_mirrored_nor_scaled_apart(charts, packed):
    before, after = signed_areas(*flat_of(charts[1])), signed_areas(*flat_of(packed))
    assert (after > 0).all()
    np.testing.assert_allclose(after / before, after.sum() / before.sum(), rtol=1e-6)
    sides = [np.linalg.norm(uv[:, 1] - uv[:, 0], axis=1) for uv in (charts[1], packed)]
    ratio = sides[1] / sides[0]
    np.testing.assert_allclose(ratio, ratio[0], rtol=1e-6)


def test_everything_is_inside_and_apart_by_the_padding(charts, packed):
    assert packed.min() >= 0.0
    assert packed.max() <= 1.0
    texels = rasterize(*flat_of(packed), SIDE)
    owner = texels.scatter(charts[0][texels.face] + 1.0)[:, :, 0]
    assert len(np.unique(owner)) == charts[0].max() + 2
    for shift in range(1, 8):
        for axis in (0, 1):
            other = np.roll(owner, shift, axis=axis)
            inside = np.s_[shift:, :] if axis == 0 else np.s_[:, shift:]
            a, b = owner[inside], other[inside]
            assert not ((a > 0) & (b > 0) & (a != b)).any(), f"closer than 8 px: {shift}"


def test_most_of_the_atlas_is_used(packed):
    assert signed_areas(*flat_of(packed)).sum() > 0.6


def test_one_chart_fills_the_atlas():
    square = np.array([[[0, 0], [3, 0], [3, 3]], [[0, 0], [3, 3], [0, 3]]], float)
    assert signed_areas(*flat_of(pack_charts(np.zeros(2, int), square, 0.002))).sum() > 0.9


def test_too_many_charts_are_refused():
    count = MAX_CHARTS + 1
    triangle = np.tile(np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]), (count, 1, 1))
    with pytest.raises(ValueError, match="too many"):
        pack_charts(np.arange(count), triangle, 0.001)
