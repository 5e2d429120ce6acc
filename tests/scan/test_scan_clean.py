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
from scanrender.scan.neck import close_neck
from scanrender.scan.orient import orient
from scanrender.scan.raw import NO_PAGE, RawMesh
from scanrender.scan.repair import drop_extra_faces, split_vertices
from scanrender.scan.spikes import flatten_spikes
from scanrender.scan.surface import surface_from_raw
from scanrender.scan.topology import area_normals, boundary_loops, edges_of
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


@pytest.mark.parametrize("away", [1e3, 1e6, 3e8])
def test_a_ball_is_turned_outward_however_far_something_else_lies(away):
    positions, faces, _ = sphere(100.0)
    far = np.asarray(cube()[0]) + 100.0 * away
    both = pieces((positions, faces[:, ::-1]), (far, cube()[1]))
    turned, count = orient(both)
    assert count["turned_inside_out"] == len(faces)
    np.testing.assert_array_equal(np.sort(turned.faces, 1), np.sort(both.faces, 1))


@pytest.mark.parametrize(("spikes", "crumbs"), [(0, 0), (1, 0), (0, 1), (1, 1)])
def test_cleaning_pulls_spikes_back_with_and_without_floaters(spikes, crumbs):
    positions, faces, _ = sphere(100.0, 32, 64)
    positions = positions.copy()
    far = np.asarray(cube()[0]) + 500.0
    positions[900 : 900 + spikes] *= 1.4
    raw = pieces((positions, faces), *[(far, cube()[1])] * crumbs)
    cleaned = clean(RawMesh(raw.positions, raw.faces), ScanSettings(units="mm"), CleanSettings())
    step = next(x for x in cleaned.steps if x["step"] == "flatten spikes")
    assert step["vertices_moved"] == spikes
    assert len(cleaned.surface.faces) == len(faces)
    middle = cleaned.surface.positions.mean(axis=0)
    assert np.linalg.norm(cleaned.surface.positions - middle, axis=1).max() < 102.0


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


def test_the_height_of_a_sheet_that_has_none_is_no_scale():
    positions, faces = grid(lambda x, y: 0.0 * x, side=3)
    flat, stated = RawMesh(positions[:, [0, 2, 1]], faces), ScanSettings(height_mm=200.0, up="+y")
    with pytest.raises(ConfigError, match="has no height along its up axis"):
        find_frame(flat, flat.positions, flat.faces, stated)
    upright = find_frame(flat, positions, faces, stated)
    assert upright.mm_per_unit == pytest.approx(5.0)


@pytest.mark.parametrize(
    ("units", "size", "warned"),
    [
        ("mm", "0.24 mm", True),
        ("m", "240 mm", False),
        ("cm", "2.4 mm", True),
        (1e6, "e+05 mm", True),
    ],
)
def test_a_stated_unit_that_fits_nothing_is_warned_of(units, size, warned):
    positions, faces, _ = sphere(0.12)
    frame = find_frame(RawMesh(positions, faces), positions, faces, ScanSettings(units=units))
    said = [warning for warning in frame.warnings if "mm large" in warning]
    assert len(said) == warned
    assert all(size in warning for warning in said)


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


def pieces(*parts):
    """Several meshes as one surface; each part is (positions, faces)."""
    offset = np.cumsum([0] + [len(p) for p, _ in parts[:-1]])
    faces = [np.asarray(f) + o for (_, f), o in zip(parts, offset, strict=True)]
    return surface(np.concatenate([p for p, _ in parts]), np.concatenate(faces))


@pytest.mark.parametrize(
    ("radius", "gap", "kept"),
    [
        (2.0, 1.0, False),  # 0.04 % of the area: a crumb, however near
        (6.0, 5.0, True),  # 0.4 %, beside the surface: a torn-off ear tip
        (6.0, 15.0, False),  # the same further away
        (12.0, 50.0, True),  # 1.4 %
        (12.0, 150.0, False),  # 1.4 %, far away: a lump of background
        (30.0, 500.0, True),  # 9 %: a part of the subject, wherever it is
    ],
)
@pytest.mark.parametrize("scale", [1.0, 0.001])
def test_floaters_are_judged_by_size_and_distance(radius, gap, kept, scale):
    big, small = sphere(100.0, 48, 96), sphere(radius, 12, 24)
    loose = small[0] + np.array([100.0 + gap + radius, 0.0, 0.0])
    both = pieces((big[0] * scale, big[1]), (loose * scale, small[1]))
    left = drop_floaters(both, 0.01, 10.0 * scale)
    assert (len(left.faces) > len(big[1])) == kept


def test_what_a_person_would_call_the_subject_stays():
    """Two halves of a broken bust, its pedestal far below, glasses in front; not the dust."""
    half, frame = sphere(80.0, 32, 64), sphere(7.0, 12, 24)
    stand, face_of_stand = np.asarray(cube(120.0)[0]) - [60.0, 400.0, 60.0], cube()[1]
    glasses = frame[0] * [3.0, 1.0, 0.2] + [0.0, 20.0, 86.0]
    dust = frame[0] * 0.1 + [30.0, 30.0, 120.0]
    parts = [(half[0], half[1]), (half[0] + [170.0, 0.0, 0.0], half[1]), (stand, face_of_stand)]
    parts += [(glasses, frame[1]), (dust, frame[1])]
    left = drop_floaters(pieces(*parts), 0.01, 10.0)
    assert len(left.faces) == sum(len(f) for _, f in parts[:-1])


def test_the_unit_is_inferred_without_the_floaters_and_the_distance_is_in_mm():
    """A bust in metres with a far crumb, and an ear tip 4 mm off: kept, once the unit is known."""
    head, tip, far = sphere(0.15, 48, 96), sphere(0.009, 12, 24), sphere(0.01, 12, 24)
    raw = pieces(
        (head[0], head[1]), (tip[0] + [0.163, 0.0, 0.0], tip[1]), (far[0] + [0.0, 3.0, 0.0], far[1])
    )
    cleaned = clean(RawMesh(raw.positions, raw.faces), ScanSettings(), CleanSettings())
    assert cleaned.frame.mm_per_unit == 1000.0
    assert len(cleaned.surface.faces) == len(head[1]) + len(tip[1])
    none = CleanSettings(floater_distance_mm=0.0)
    cleaned = clean(RawMesh(raw.positions, raw.faces), ScanSettings(), none)
    assert len(cleaned.surface.faces) == len(head[1])


def bust(notch=False):
    """A ball cut open low down, and with a hole in its cheek; `notch` makes the cut a crescent."""
    positions, faces, _ = sphere(100.0, 48, 96)
    centre = positions[faces].mean(axis=1)
    floor = -70.0 + (
        60.0 * np.exp(-((centre[:, 0] / 25.0) ** 2)) * (centre[:, 2] > 0) if notch else 0
    )
    cheek = np.linalg.norm(centre - [0.0, 30.0, 95.0], axis=1) < 25.0
    return surface(positions, faces[(centre[:, 1] > floor) & ~cheek]).compact()


@pytest.mark.parametrize("notch", [False, True])
def test_the_neck_is_closed_flat_and_the_cheek_is_not(notch):
    open_ = bust(notch)
    closed, cap = close_neck(open_)
    loops = boundary_loops(open_.faces)
    neck = min(loops, key=lambda loop: open_.positions[loop][:, 1].mean())
    assert cap == len(neck) - 2
    added = closed.faces[-cap:]
    # The rim is doubled, so that its edge stays sharp; the skin's own faces are as they were.
    assert added.min() == len(open_.positions)
    np.testing.assert_array_equal(closed.faces[:-cap], open_.faces)
    assert (closed.page[-cap:] == NO_PAGE).all()
    normal = area_normals(closed.positions, added)
    assert (normal[:, 1] < 0).all(), "outward is down"
    # Seen from below it covers the opening once: the areas add up to the polygon's.
    x, z = closed.positions[neck][:, 0], closed.positions[neck][:, 2]
    polygon = 0.5 * abs(np.sum(x * np.roll(z, -1) - z * np.roll(x, -1)))
    assert 0.5 * np.abs(normal[:, 1]).sum() == pytest.approx(polygon)


def test_a_closed_ball_and_a_hole_high_up_have_no_neck():
    positions, faces, _ = sphere(100.0)
    assert close_neck(surface(positions, faces))[1] == 0
    high = surface(positions, faces[positions[faces][:, :, 1].max(axis=1) < 60.0])
    assert close_neck(high)[1] == 0


def test_the_cap_is_reported_and_can_be_taken_off():
    raw = bust()
    settings = CleanSettings(close_neck=True, hole_mm=0.0)
    stated = ScanSettings(units="mm", up="+y", front="+z")
    cleaned = clean(RawMesh(raw.positions, raw.faces), stated, settings)
    assert cleaned.steps[-1] == {
        "step": "close the neck", "cap_faces": cleaned.cap,
        "faces": [len(raw.faces), len(raw.faces) + cleaned.cap],
        "vertices": [len(raw.positions), len(raw.positions) + cleaned.cap + 2],
    }  # fmt: skip
    np.testing.assert_array_equal(cleaned.skin.faces, raw.faces)
    open_ = clean(RawMesh(raw.positions, raw.faces), stated, CleanSettings(hole_mm=0.0))
    assert open_.cap == 0
    assert open_.skin is open_.surface


def test_clean_counts_each_step():
    positions, faces, _ = sphere(150.0)
    crumbs = np.concatenate([positions, np.asarray(cube()[0]) + 500.0])
    dirty = np.concatenate([faces, faces[:5], [[0, 0, 1]], cube()[1] + len(positions)])
    cleaned = clean(RawMesh(crumbs, dirty), ScanSettings(units="mm"), CleanSettings())
    counts = {step["step"]: step["faces"] for step in cleaned.steps}
    n = len(faces)
    assert list(counts) == [
        "drop outliers", "weld", "drop degenerate faces", "drop duplicate faces",
        "drop extra faces at edges", "split vertices between fans", "drop unused vertices",
        "orient", "drop floaters", "flatten spikes", "fill holes", "drop what filling left over",
    ]  # fmt: skip
    assert counts["weld"] == [n + 18, n + 18]  # each step is counted, also where nothing changes
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


def test_vertices_in_order_of_use_are_the_same_surface():
    rng = np.random.default_rng(5)
    faces = rng.integers(0, 90, (120, 3))
    colors = rng.random((100, 3)).astype(np.float32)
    before = RawMesh(rng.normal(size=(100, 3)), faces, colors=colors)
    after = before.in_order_of_use()
    np.testing.assert_array_equal(after.positions[after.faces], before.positions[before.faces])
    np.testing.assert_array_equal(after.colors[after.faces], before.colors[before.faces])
    assert sorted(map(tuple, after.positions)) == sorted(map(tuple, before.positions))
    _, first = np.unique(after.faces, return_index=True)
    assert (np.diff(first) > 0).all(), "named in the order of their numbers"
    assert after.in_order_of_use() is after
