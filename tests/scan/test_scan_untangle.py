"""A flattened border that crosses itself is seen, and loses only the corner that overlaps."""

from __future__ import annotations

import numpy as np

from scanrender.scan.flatten import flattenings, signed_areas
from scanrender.scan.rasterize import overlap_share
from scanrender.scan.untangle import border_crossings, simple_part


def strip(count: int, bend: float) -> tuple[np.ndarray, np.ndarray]:
    """A band of 2 * count triangles along a ring of radius 1 to 2, over `bend` full turns."""
    angle = np.linspace(0.0, 2.0 * np.pi * bend, count + 1)
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    uv = np.concatenate([2.0 * ring, ring])
    i = np.arange(count)
    inner = i + count + 1
    faces = np.concatenate([np.stack([i, i + 1, inner], 1), np.stack([i + 1, inner + 1, inner], 1)])
    return uv, faces


def test_a_simple_border_keeps_all_faces():
    uv, faces = strip(40, 0.9)
    assert (signed_areas(uv, faces) > 0).all()
    assert not len(border_crossings(uv, faces)[0])
    assert simple_part(uv, faces).all()


def test_overlapping_ends_are_taken_and_nothing_else():
    uv, faces = strip(40, 1.04)  # the last 2 of 40 steps lie over the first
    assert (signed_areas(uv, faces) > 0).all(), "no triangle is flipped, and still it overlaps"
    assert overlap_share(uv / 4.0 + 0.5, faces, 256) > 0.0
    kept = simple_part(uv, faces)
    assert 0 < (~kept).sum() <= 8
    assert not len(border_crossings(uv, faces[kept])[0])
    assert overlap_share(uv / 4.0 + 0.5, faces[kept], 256) == 0.0


def test_too_much_overlap_is_left_to_a_cut():
    uv, faces = strip(200, 1.5)
    assert simple_part(uv, faces) is None


def test_earlier_states_are_more_stretched_and_none_is_flipped():
    x, y = np.meshgrid(np.arange(12.0), np.arange(12.0), indexing="ij")
    positions = np.stack([x, y, 3.0 * np.cos(x / 3.0) * np.cos(y / 4.0)], axis=-1).reshape(-1, 3)
    i = np.arange(144).reshape(12, 12)
    a, b, c, d = (v.ravel() for v in (i[:-1, :-1], i[1:, :-1], i[1:, 1:], i[:-1, 1:]))
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    states = flattenings(positions, faces)
    assert len(states) > 1
    assert all((signed_areas(uv, faces) > 0).all() for uv in states)
    edges = [np.linalg.norm(p[faces[:, 0]] - p[faces[:, 1]], axis=1) for p in (positions, *states)]
    spread = [float(np.abs(np.log(e / edges[0])).mean()) for e in edges[1:]]
    assert spread[0] < spread[-1]
