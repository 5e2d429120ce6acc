"""The truth: its size, topology, proportions, colours, and that it is the same every time."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from scanrender.phantom import LABELS, Head, make_head
from scanrender.phantom.features import EYE_CENTRE
from scanrender.phantom.mesh import boundary_edges
from scanrender.phantom.noise import noise
from scanrender.phantom.shape import (
    CUT_Y_MM,
    make_shape,
    template_from_truth,
    truth_from_template,
)

TRIANGLES = 50_000


def _components(pairs: NDArray[np.int64]) -> int:
    """Connected components of the graph whose edges are `pairs`, isolated numbers left out."""
    names, local = np.unique(pairs, return_inverse=True)
    i, j = local.reshape(-1, 2).T
    graph = coo_matrix((np.ones(len(i)), (i, j)), shape=(len(names),) * 2)
    return int(connected_components(graph, directed=False)[0])


def test_same_arguments_give_the_same_bytes(head: Head) -> None:
    again = make_head(TRIANGLES, seed=0)
    for name in ("positions_mm", "faces", "albedo_linear", "label"):
        assert getattr(again, name).tobytes() == getattr(head, name).tobytes(), name


def test_another_seed_gives_another_head(head: Head) -> None:
    other = make_head(TRIANGLES, seed=1)
    apart = np.linalg.norm(other.positions_mm - head.positions_mm, axis=1)
    assert 0.2 < apart.mean() < 8.0
    assert np.abs(other.albedo_linear - head.albedo_linear).mean() > 0.005


@pytest.mark.parametrize("triangles", [60_000, 120_000])
def test_triangle_count_within_a_tenth(triangles: int) -> None:
    assert abs(len(make_head(triangles).faces) / triangles - 1.0) < 0.10


def test_splitting_keeps_count_and_topology(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("scanrender.phantom.mesh.BASE_TRIANGLES", 20_000)
    split = make_head(TRIANGLES)
    assert abs(len(split.faces) / TRIANGLES - 1.0) < 0.10
    assert _components(boundary_edges(split.faces)) == 1


def test_closed_but_for_the_neck(head: Head) -> None:
    directed = head.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2).astype(np.int64)
    key = directed[:, 0] << 32 | directed[:, 1]
    assert len(np.unique(key)) == len(key), "an edge is used twice in one direction"
    undirected = np.sort(directed, axis=1)
    _, uses = np.unique(undirected[:, 0] << 32 | undirected[:, 1], return_counts=True)
    assert uses.max() == 2
    rim = boundary_edges(head.faces)
    assert _components(rim) == 1
    assert np.bincount(rim.ravel()).max() == 2
    assert np.abs(head.positions_mm[rim.ravel(), 1] - CUT_Y_MM).max() < 8.0
    assert _components(undirected) == 1
    assert len(np.unique(head.faces)) == len(head.positions_mm)


def test_one_loop_and_no_tunnels(head: Head) -> None:
    edges = np.sort(head.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2).astype(np.int64), axis=1)
    count = len(np.unique(edges[:, 0] << 32 | edges[:, 1]))
    assert len(head.positions_mm) - count + len(head.faces) == 1  # Euler number of a disc


def test_faces_look_outward_and_have_area(head: Head) -> None:
    a, b, c = (head.positions_mm[head.faces[:, k]] for k in range(3))
    cross = np.cross(b - a, c - a)
    assert np.einsum("ij,ij->", a, cross) > 0.0
    area = 0.5 * np.linalg.norm(cross, axis=1)
    assert area.min() > 0.0
    assert np.percentile(area, 1) > 0.05 * np.median(area)


def test_proportions_of_an_adult(head: Head) -> None:
    x, y, z = head.positions_mm.T
    chin = y[(np.abs(x) < 8.0) & (z > 72.0)].min()
    assert 220.0 < y.max() - chin < 238.0
    above_ears = (y > 24.0) & (y < 60.0)
    assert 146.0 < np.ptp(x[above_ears]) < 162.0
    assert 180.0 < np.ptp(z[above_ears]) < 205.0
    tip = z[(np.abs(x) < 12.0) & (y > -50.0) & (y < -25.0)].max()
    base = z[(np.abs(x) < 3.0) & (y > -56.0) & (y < -51.0)].max()
    assert 14.0 < tip - base < 26.0
    ears = (np.abs(x) > 76.0) & (y < 24.0) & (y > -60.0) & (z < 25.0)
    assert 45.0 < np.ptp(y[ears]) < 70.0


def test_eyes_and_mouth_are_where_they_should_be(head: Head) -> None:
    x, y, _ = head.positions_mm.T
    eye = head.label == LABELS.index("eye")
    left, right = x[eye & (x > 0.0)].mean(), x[eye & (x < 0.0)].mean()
    assert 58.0 < left - right < 68.0
    assert abs(y[eye].mean()) < 5.0
    lips = head.label == LABELS.index("lips")
    assert 44.0 < np.ptp(x[lips]) < 58.0
    assert -75.0 < y[lips].mean() < -62.0


def test_labels_and_albedo(head: Head) -> None:
    assert set(np.unique(head.label)) == set(range(len(LABELS)))
    assert head.albedo_linear.min() > 0.0
    assert head.albedo_linear.max() < 1.0
    mean = {name: head.albedo_linear[head.label == k].mean(axis=0) for k, name in enumerate(LABELS)}
    assert np.allclose(mean["skin"], (0.57, 0.345, 0.285), atol=0.04)
    assert mean["lips"][0] > 2.0 * mean["lips"][1]
    assert mean["hair"].max() < 0.12
    assert mean["brow"].max() < 0.2
    spread = head.albedo_linear[head.label == 0].std(axis=0)
    assert (spread > 0.01).all()
    assert (spread < 0.12).all()


def test_pupil_is_dark_and_sclera_pale() -> None:
    from scanrender.phantom.head import albedo_of_truth

    shape = make_shape(0)
    at = EYE_CENTRE + np.array([[0.0, 0.0, 12.9], [8.5, 0.3, 8.5]])
    pupil, sclera = albedo_of_truth(truth_from_template(at, shape), 0.2, 0)
    assert pupil.max() < 0.03
    assert sclera.min() > 0.3


def test_truth_and_template_are_inverse() -> None:
    points = np.random.default_rng(5).uniform(-100.0, 100.0, (500, 3))
    shape = make_shape(3)
    back = template_from_truth(truth_from_template(points, shape), shape)
    assert np.abs(back - points).max() < 1e-3


def test_noise_is_normalised_and_continuous() -> None:
    points = np.random.default_rng(1).uniform(-200.0, 200.0, (40_000, 3))
    value = noise(points, 5.0, 9)
    assert abs(value.mean()) < 0.05
    assert abs(value.std() - 1.0) < 0.05
    assert np.abs(noise(points + 1e-4, 5.0, 9) - value).max() < 1e-3


def test_import_is_light() -> None:
    code = "import sys, scanrender.phantom; sys.exit('numpy' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
