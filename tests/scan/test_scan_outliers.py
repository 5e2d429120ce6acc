"""A few wrong vertices far out decide nothing; what may be the subject stays."""

from __future__ import annotations

import numpy as np
import pytest
from scan_shapes import cube, grid, sphere, write_ply

from scanrender.scan.clean import clean
from scanrender.scan.inspect import inspect_scan
from scanrender.scan.outliers import bulk_extent, drop_outliers
from scanrender.scan.raw import RawMesh
from scanrender.scan.surface import surface_from_raw
from scanrender.settings.prep import CleanSettings
from scanrender.settings.scan import ScanSettings

BALL = sphere(0.1, 32, 64)[:2]  # a metre scan of 20 cm


def moved(where, positions=BALL[0]):
    positions = positions.copy()
    positions[1000] = where
    return positions, BALL[1]


def with_face(corners, named=()):
    """The ball and one more face, of new vertices and of those named."""
    new = np.concatenate([BALL[0], np.array(corners, float)])
    face = [*named, *range(len(BALL[0]), len(new))]
    return new, np.concatenate([BALL[1], [face]])


WRONG = {
    "30 m away, which read as cm would be a person's size": moved([30, 0, 0]),
    "so far that all else is one place": moved([1e5, 0, 0]),
    "a face that leads there": with_face([[0, 1e6, 0]], (3, 4)),
    "a face alone": with_face([[1e6, 0, 0], [1e6, 1, 0], [1e6, 0, 1]]),
    "of a soup of triangles": (
        moved([30, 0, 0])[0][BALL[1]].reshape(-1, 3), np.arange(BALL[1].size).reshape(-1, 3)),
}  # fmt: skip


@pytest.mark.parametrize("scale", [1.0, 1000.0])
@pytest.mark.parametrize("name", WRONG)
def test_a_vertex_far_out_decides_neither_the_unit_nor_what_is_one_place(name, scale):
    positions, faces = WRONG[name]
    cleaned = clean(RawMesh(positions * scale, faces), ScanSettings(), CleanSettings())
    assert cleaned.frame.mm_per_unit == pytest.approx(1000.0 / scale)
    radius = np.linalg.norm(cleaned.surface.positions, axis=1)
    np.testing.assert_allclose(radius, 100.0, atol=1.0)
    assert len(cleaned.surface.faces) >= len(BALL[1]) - 6
    before, after = cleaned.steps[0]["faces"]
    assert cleaned.steps[0]["step"] == "drop outliers"
    assert 1 <= before - after <= 6


def test_what_is_dropped_is_said_of_a_scan(tmp_path):
    health = inspect_scan(
        write_ply(tmp_path / "a.ply", *WRONG["so far that all else is one place"])
    )
    assert health["size_mm"] == pytest.approx([200.0, 200.0, 200.0], abs=1.0)
    assert any("6 faces lead to vertices" in note for note in health["notes"])
    health = inspect_scan(write_ply(tmp_path / "b.ply", *BALL))
    assert not health["notes"]


def placed(*parts):
    first = np.cumsum([0, *(len(p) for p, _ in parts[:-1])])
    faces = [np.asarray(f) + start for (_, f), start in zip(parts, first, strict=True)]
    return np.concatenate([p for p, _ in parts]), np.concatenate(faces)


def plate():
    """A wide plate of four corners whose middle is a finely meshed bump."""
    bump, faces = grid(lambda x, y: 0.1 * x * y, 101, 1.0)
    corners = 60.0 * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    place = {(-1, -1): 0, (1, -1): 100, (1, 1): 10200, (-1, 1): 10100}
    inner, outer = list(place.values()), [len(bump) + i for i in range(4)]
    rim = []
    for i in range(4):
        j = (i + 1) % 4
        rim += [(outer[i], outer[j], inner[i]), (outer[j], inner[j], inner[i])]
    return np.concatenate([bump, corners]), np.concatenate([faces, rim])


def needle():
    angle = 2.0 * np.pi * np.arange(1000) / 1000
    ring = np.stack([np.cos(angle), np.sin(angle), np.zeros(1000)], axis=1)
    faces = [(i, (i + 1) % 1000, 1000) for i in range(1000)]
    return np.concatenate([ring, [[0, 0, 1000.0]]]), np.array(faces)


WALL = grid(lambda x, y: 0.0 * x + 50.0, 2, 5.0)
SUBJECTS = {
    "a box": cube(300.0),
    "one triangle": (np.array([[0, 0, 0], [1, 0, 0], [0, 1e9, 0.0]]), np.array([[0, 1, 2]])),
    "a plate around a fine bump": plate(),
    "a needle": needle(),
    "a wall far behind": placed(BALL, WALL),
    "a wall of loose triangles": placed(
        BALL, (WALL[0][WALL[1]].reshape(-1, 3), np.arange(6).reshape(-1, 3))),
    "a box whose eye is finely meshed": placed(
        sphere(0.01, 64, 128)[:2], (np.asarray(cube(2.0)[0]) - 0.02, cube()[1])),
    "two halves apart": placed(BALL, (BALL[0] + [50.0, 0, 0], BALL[1])),
    "a pile of faces at one place": placed(
        (np.zeros((9000, 3)), np.arange(9000).reshape(-1, 3)), BALL),
}  # fmt: skip


@pytest.mark.parametrize("name", SUBJECTS)
def test_what_may_be_the_subject_stays(name):
    positions, faces = SUBJECTS[name]
    surface = surface_from_raw(RawMesh(positions, faces))
    assert drop_outliers(surface) is surface


def test_the_bulk_leaves_a_hundredth_at_either_end_and_nothing_of_a_few():
    line = np.arange(1000.0)[:, None] * [1.0, -1.0]
    low, high = bulk_extent(line)
    assert low.tolist() == [10.0, -989.0]
    assert high.tolist() == [989.0, -10.0]
    low, high = bulk_extent(line[:99])
    assert (low.tolist(), high.tolist()) == ([0.0, -98.0], [98.0, 0.0])


@pytest.mark.parametrize(("x", "confidence"), [(0.1, "medium"), (0.3, "medium"), (15.0, "low")])
def test_a_size_that_few_vertices_make_is_a_guess(x, confidence):
    positions, faces = moved([x, 0, 0])
    frame = clean(RawMesh(positions, faces), ScanSettings(), CleanSettings()).frame
    assert frame.units["confidence"] == confidence
    assert any("the scale is a guess" in text for text in frame.warnings) == (confidence == "low")
