"""Every defect that was asked for is there, in the number asked for, and nothing else changed."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray

from scanrender.errors import UsageError
from scanrender.phantom import Damage, Head, RawScan, scan_head
from scanrender.phantom.mesh import boundary_edges


def _edge_uses(faces: NDArray[np.int32]) -> NDArray[np.int64]:
    edges = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2).astype(np.int64), axis=1)
    edges = edges[edges[:, 0] != edges[:, 1]]
    return np.unique(edges[:, 0] << 32 | edges[:, 1], return_counts=True)[1]


def _only(**fields: float) -> Damage:
    return dataclasses.replace(Damage.none(), **fields)  # type: ignore[arg-type]


def test_none_changes_nothing(head: Head) -> None:
    raw = scan_head(head, Damage.none())
    assert np.array_equal(raw.positions, head.positions_mm)
    assert np.array_equal(raw.faces, head.faces)
    assert np.array_equal(raw.raw_from_truth, np.eye(4))


def test_deterministic(head: Head, raw: RawScan) -> None:
    again, other = scan_head(head, Damage(), seed=0), scan_head(head, Damage(), seed=1)
    assert again.positions.tobytes() == raw.positions.tobytes()
    assert again.faces.tobytes() == raw.faces.tobytes()
    assert again.colours_srgb_u8.tobytes() == raw.colours_srgb_u8.tobytes()
    assert other.positions.tobytes() != raw.positions.tobytes()


def test_transform_takes_truth_to_raw(head: Head) -> None:
    raw = scan_head(head, _only(tilt_deg=7.0, mm_per_unit=25.4))
    matrix = raw.raw_from_truth
    moved = head.positions_mm @ matrix[:3, :3].T + matrix[:3, 3]
    assert np.allclose(raw.positions, moved)
    rotation = matrix[:3, :3] * raw.mm_per_unit
    assert np.allclose(rotation @ rotation.T, np.eye(3))
    assert np.degrees(np.arccos((np.trace(rotation) - 1.0) / 2.0)) == pytest.approx(7.0)


def test_noise_has_the_stated_deviation(head: Head) -> None:
    raw = scan_head(head, _only(noise_mm=0.05))
    assert np.linalg.norm(raw.positions - head.positions_mm, axis=1).std() < 0.05
    rms = np.sqrt(np.square(raw.positions - head.positions_mm).sum(axis=1).mean())
    assert rms == pytest.approx(0.05, rel=0.03)


def test_spikes(head: Head) -> None:
    raw = scan_head(head, _only(spikes=20))
    assert (np.linalg.norm(raw.positions - head.positions_mm, axis=1) > 1.0).sum() == 20


def test_floaters_are_separate_bodies(head: Head) -> None:
    raw = scan_head(head, _only(floaters=12))
    mesh = trimesh.Trimesh(raw.positions, raw.faces, process=False)
    assert mesh.body_count == 13


def test_holes_open_the_surface(head: Head) -> None:
    raw = scan_head(head, _only(holes=6, hole_mm=6.0))
    rim = boundary_edges(raw.faces)
    graph = trimesh.graph.connected_components(rim, nodes=np.unique(rim))
    assert len(graph) == 7  # six and the neck
    assert len(raw.positions) < len(head.positions_mm)
    assert np.array_equal(raw.positions, head.positions_mm[raw.truth_vertex])


def test_duplicates_and_unreferenced(head: Head) -> None:
    raw = scan_head(head, _only(duplicate_vertices=200, unreferenced_vertices=50))
    used = np.zeros(len(raw.positions), dtype=bool)
    used[raw.faces] = True
    assert (~used).sum() == 50
    assert len(raw.positions) - len(np.unique(raw.positions, axis=0)) == 200


def test_nonmanifold_edges_and_zero_area(head: Head) -> None:
    raw = scan_head(head, _only(nonmanifold_edges=4))
    assert (_edge_uses(raw.faces) > 2).sum() == 4
    raw = scan_head(head, _only(zero_area_faces=10))
    a, b, c = raw.faces.T
    assert ((a == b) | (b == c) | (c == a)).sum() == 10


def test_flipped_faces(head: Head) -> None:
    raw = scan_head(head, _only(flipped_faces=30))
    assert (raw.faces != head.faces).any(axis=1).sum() == 30
    assert np.array_equal(np.sort(raw.faces, axis=1), np.sort(head.faces, axis=1))


def test_nan_and_baked_light(head: Head) -> None:
    raw = scan_head(head, _only(unreferenced_vertices=5, nan_vertices=3, baked_light=1.0))
    assert np.isnan(raw.positions).any(axis=1).sum() == 3
    count = len(head.positions_mm)
    plain = scan_head(head, Damage.none()).colours_srgb_u8
    assert raw.colours_srgb_u8[:count].mean() < plain.mean() - 5.0


def test_refuses_a_unit_of_no_length(head: Head) -> None:
    with pytest.raises(UsageError):
        scan_head(head, _only(mm_per_unit=0.0))
