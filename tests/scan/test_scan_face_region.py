"""The face is one region, and one chart of the atlas."""

from __future__ import annotations

import numpy as np
import pytest

from scanrender.phantom import make_head
from scanrender.scan.face_region import face_region
from scanrender.scan.segment import pieces_of
from scanrender.scan.topology import face_pairs
from scanrender.scan.unwrap_charts import unwrap_by_charts
from tests.scan.scan_shapes import cube, sphere


@pytest.fixture(scope="module")
def head():
    made = make_head(20_000)
    return np.asarray(made.positions_mm, np.float64), np.asarray(made.faces, np.int64)


def nose_and_cheeks(positions, faces):
    """Faces on the front of the face's middle: the foremost quarter of the upper two thirds."""
    centre = positions[faces].mean(axis=1)
    low, high = positions.min(axis=0), positions.max(axis=0)
    share = (centre - low) / (high - low)
    return (share[:, 1] > 0.45) & (share[:, 1] < 0.85) & (share[:, 2] > 0.85)


def test_it_holds_the_front_and_not_the_back(head):
    positions, faces = head
    found = face_region(positions, faces)
    assert found[nose_and_cheeks(positions, faces)].all()
    centre = positions[faces].mean(axis=1)
    depth = (centre[:, 2] - centre[:, 2].min()) / np.ptp(centre[:, 2])
    assert not found[depth < 0.3].any()
    height = (centre[:, 1] - centre[:, 1].min()) / np.ptp(centre[:, 1])
    assert not found[height < 0.15].any(), "the neck is not the face"


def test_it_is_connected(head):
    positions, faces = head
    found = face_region(positions, faces)
    first, second, _ = face_pairs(faces)
    assert len(np.unique(pieces_of(found, first, second)[found])) == 1


def test_no_seam_runs_through_it(head):
    positions, faces = head
    charts, _ = unwrap_by_charts({"positions": positions, "faces": faces}, {"padding": 1 / 256})
    assert len(np.unique(charts["chart"][face_region(positions, faces)])) == 1


@pytest.mark.parametrize("size", [1e-3, 1.0, 1e3])
def test_what_is_no_head_gives_a_region_or_none(size):
    for positions, faces in (sphere()[:2], cube()[:2]):
        found = face_region(np.asarray(positions, np.float64) * size, faces)
        assert found.shape == (len(faces),)


def test_a_single_triangle_has_no_face():
    positions = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
    faces = np.array([[0, 1, 2]])
    assert face_region(positions, faces).shape == (1,)
