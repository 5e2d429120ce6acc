"""Cleaning: each defect put in is found, counted and gone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scan_shapes import cube, grid, sphere

from scanrender.errors import ConfigError
from scanrender.scan.clean import clean
from scanrender.scan.floaters import drop_floaters
from scanrender.scan.frame import find_frame
from scanrender.scan.holes import fill_holes, least_area
from scanrender.scan.orient import orient
from scanrender.scan.raw import RawMesh
from scanrender.scan.repair import drop_extra_faces, split_vertices
from scanrender.scan.spikes import flatten_spikes
from scanrender.scan.surface import surface_from_raw
from scanrender.scan.topology import boundary_loops, edges_of
from scanrender.scan.weld import drop_degenerate, drop_duplicates, weld
from scanrender.settings.prep import CleanSettings
from scanrender.settings.scan import ScanSettings


def surface(positions, faces, **extra):
    return surface_from_raw(RawMesh(np.asarray(positions, float), np.asarray(faces), **extra))


def volume(s):
    a, b, c = (s.positions[s.faces[:, i]] for i in range(3))
    return float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6.0)


def test_weld_joins_a_triangle_soup_and_averages_colours():
    positions, faces = cube()
    soup = surface(
        positions[faces].reshape(-1, 3),
        np.arange(36).reshape(-1, 3),
        colors=np.linspace(0, 1, 108, dtype=np.float32).reshape(36, 3),
    )
    joined = weld(soup)
    assert len(joined.positions) == 8
    assert (edges_of(joined.faces).count == 2).all()
    corner = soup.colors[faces.reshape(-1) == faces[0, 0]].mean(axis=0)
    np.testing.assert_allclose(joined.colors[joined.faces[0, 0]], corner, rtol=1e-5)


def test_degenerate_and_duplicate_faces_go():
    positions, faces = cube()
    bad = np.concatenate([faces, [[0, 0, 1], [1, 3, 0], [0, 3, 1]]])
    left = drop_duplicates(drop_degenerate(surface(positions, bad)))
    assert left.faces.tolist() == faces.tolist()


def test_floaters_go_and_large_pieces_stay():
    big, faces, _ = sphere(50.0)
    small = np.asarray(cube()[0]) * 0.5 + 200.0
    both = surface(
        np.concatenate([big, small, big + 300]),
        np.concatenate([faces, cube()[1] + len(big), faces + len(big) + 8]),
    )
    assert len(drop_floaters(both, 0.01).faces) == 2 * len(faces)


def test_crowded_edges_and_touching_fans_become_manifold():
    positions, faces = cube()
    fin = np.concatenate([positions, [[2.0, 2.0, 2.0]]])
    edges = edges_of(drop_extra_faces(surface(fin, np.concatenate([faces, [[0, 1, 8]]]))).faces)
    assert edges.count.max() == 2
    # Two cubes that share one corner only.
    two = np.concatenate([positions, -positions[1:]])
    other = np.where(faces == 0, 0, faces + 7)[:, ::-1]
    split = split_vertices(surface(two, np.concatenate([faces, other])))
    assert len(split.positions) == 16


def fan(apex, ring, first, closed):
    """Faces around vertex `apex` over the vertices first, first + 1, …, first + ring - 1."""
    rim = first + np.arange(ring)
    ends = np.roll(rim, -1)
    faces = np.stack([np.full(ring, apex), rim, ends], axis=1)
    return faces if closed else faces[:-1]


@pytest.mark.parametrize(
    ("fans", "copies"),
    [
        ([True], 1),
        ([False], 1),
        ([True, True], 2),
        ([True, False], 2),
        ([False, True], 2),
        ([False, False, True], 3),
    ],
)
@pytest.mark.parametrize("agree", [True, False])
def test_each_fan_gets_a_vertex_of_its_own(fans, copies, agree):
    rings = [fan(0, 5, 1 + 5 * i, closed) for i, closed in enumerate(fans)]
    faces = np.concatenate(rings)
    if not agree:
        faces[1] = faces[1][::-1].copy()
    positions = np.random.default_rng(1).normal(size=(1 + 5 * len(fans), 3))
    split = split_vertices(surface(positions, faces))
    same_place = (split.positions == positions[0]).all(axis=1)
    assert same_place.sum() == copies
    np.testing.assert_array_equal(split.positions[split.faces], positions[faces])


def test_orientation_is_repaired_and_inside_out_turned():
    positions, faces, uv = sphere()
    rng = np.random.default_rng(0)
    flipped = rng.random(len(faces)) < 0.3
    mixed = faces.copy()
    mixed[flipped] = mixed[flipped][:, ::-1]
    mixed_uv = uv.copy()
    mixed_uv[flipped] = mixed_uv[flipped][:, ::-1]
    raw = surface(positions, mixed, corner_uv=mixed_uv.astype(np.float32))
    fixed, turned = orient(raw)
    assert turned["turned_to_agree"] == flipped.sum()
    assert volume(fixed) == pytest.approx(volume(surface(positions, faces)))
    np.testing.assert_allclose(fixed.corner_uv, uv, atol=1e-6)  # corners travel with their UV
    fixed, turned = orient(surface(positions, faces[:, ::-1]))
    assert turned["turned_inside_out"] == len(faces)
    assert volume(fixed) > 0


def test_small_holes_are_filled_outward_and_large_ones_stay():
    positions, faces, _ = sphere()
    keep = np.ones(len(faces), bool)
    keep[301:303] = False  # one quad: closed by least area
    keep[(faces == len(positions) - 2).any(axis=1)] = False  # the polar cap, 48 edges: by a fan
    holed = surface(positions, faces[keep])
    closed, holes = fill_holes(holed, 60.0)
    assert holes == 2
    assert not boundary_loops(closed.faces)
    assert volume(closed) == pytest.approx(volume(surface(positions, faces)), rel=2e-3)
    assert fill_holes(holed, 1.0)[1] == 0


def test_least_area_triangulation_of_a_flat_ring():
    angle = 2 * np.pi * np.arange(12) / 12
    ring = np.stack([np.cos(angle), np.sin(angle), np.zeros(12)], axis=1)
    faces = least_area(ring)
    area = np.cross(ring[faces[:, 1]] - ring[faces[:, 0]], ring[faces[:, 2]] - ring[faces[:, 0]])
    assert 0.5 * np.abs(area[:, 2]).sum() == pytest.approx(3.0)  # 12-gon: 6 sin 30


def test_a_spike_is_pulled_back_and_anatomy_is_not():
    positions, faces = grid(lambda x, y: 0.01 * x * x)
    middle = len(positions) // 2
    spiked = positions.copy()
    spiked[middle, 2] += 30.0
    fixed, count = flatten_spikes(surface(spiked, faces), 6.0)
    assert count == 1
    assert abs(fixed.positions[middle, 2] - positions[middle, 2]) < 0.1
    assert flatten_spikes(surface(*cube()), 6.0)[1] == 0


@pytest.mark.parametrize(
    ("size", "settings", "mm", "confidence"),
    [
        (300.0, {}, 1.0, "medium"),
        (0.3, {}, 1000.0, "medium"),
        (30.0, {}, 10.0, "medium"),
        (7.0, {}, 320.0 / 7.0, "low"),
        (300.0, {"units": "m"}, 1000.0, "stated"),
        (300.0, {"units": 2.5}, 2.5, "stated"),
        (10.0, {"height_mm": 388}, 38.8, "stated"),
    ],
)
def test_units(size, settings, mm, confidence):
    positions, faces, _ = sphere(size / 2)
    raw = RawMesh(positions, faces)
    frame = find_frame(raw, positions, faces, ScanSettings(**settings))
    assert frame.mm_per_unit == pytest.approx(mm)
    assert frame.units["confidence"] == confidence
    assert frame.units["reason"]


def test_far_away_scans_are_recentred_without_loss():
    positions, faces, _ = sphere(150.0)
    far = positions + np.array([4.4e5, 5.3e6, 120.0])
    cleaned = clean(RawMesh(far, faces), ScanSettings(units="mm"), CleanSettings())
    np.testing.assert_allclose(cleaned.surface.positions, positions, atol=1e-6)
    back = np.array(cleaned.frame.raw_from_asset) @ [*cleaned.surface.positions[7], 1.0]
    np.testing.assert_allclose(back[:3], far[7], atol=1e-6)


def test_axes_turn_without_mirroring():
    positions, faces, _ = sphere(150.0)
    settings = ScanSettings(units="mm", up="+z", front="-y")
    cleaned = clean(RawMesh(positions, faces), settings, CleanSettings())
    assert np.linalg.det(cleaned.frame.rotation) == pytest.approx(1.0)
    np.testing.assert_allclose(cleaned.frame.rotation @ [0, 0, 1], [0, 1, 0], atol=1e-12)
    np.testing.assert_allclose(cleaned.frame.rotation @ [0, -1, 0], [0, 0, 1], atol=1e-12)
    assert volume(cleaned.surface) > 0
    with pytest.raises(ConfigError, match="same axis"):
        clean(RawMesh(positions, faces), ScanSettings(up="+z", front="-z"), CleanSettings())


def test_clean_counts_each_step():
    positions, faces, _ = sphere(150.0)
    crumbs = np.concatenate([positions, np.asarray(cube()[0]) + 500.0])
    dirty = np.concatenate([faces, faces[:5], [[0, 0, 1]], cube()[1] + len(positions)])
    cleaned = clean(RawMesh(crumbs, dirty), ScanSettings(units="mm"), CleanSettings())
    counts = {step["step"]: step["faces"] for step in cleaned.steps}
    n = len(faces)
    assert counts["drop degenerate faces"] == [n + 18, n + 17]
    assert counts["drop duplicate faces"] == [n + 17, n + 12]
    assert counts["drop floaters"] == [n + 12, n]
    assert len(cleaned.surface.positions) == len(positions)


def test_surface_attributes_follow_their_faces():
    positions, faces, uv = sphere(rows=6, columns=8)
    raw = RawMesh(positions, faces, uv.astype(np.float32), np.arange(len(faces)).astype(np.int16))
    kept = surface_from_raw(raw).keep_faces(np.arange(len(faces)) % 3 == 0).compact()
    np.testing.assert_allclose(kept.corner_uv, uv[::3], atol=1e-6)
    assert kept.page.tolist() == list(range(0, len(faces), 3))
    np.testing.assert_allclose(kept.positions[kept.faces], positions[faces[::3]])
    assert replace(kept, colors=None).colors is None
