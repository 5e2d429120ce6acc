"""Levels of detail: they meet at the seams, share the atlas, and say when they cannot."""

from __future__ import annotations

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scan_shapes import sphere, write_obj

from scanrender.asset import Mesh, load_asset, save_asset
from scanrender.errors import ScanError, StageError
from scanrender.phantom import make_head
from scanrender.scan import levels as module
from scanrender.scan import lods, pipeline
from scanrender.scan.journal import Journal
from scanrender.scan.levels import make_lods
from scanrender.scan.lods import _unflipped, _widest, lods_task
from scanrender.scan.lost import sample_hits, surface_distance
from scanrender.scan.mend import drop_pockets, plain_surface
from scanrender.scan.pipeline import NOTABLE_MM
from scanrender.scan.prepare import prepare
from scanrender.scan.rays import Target
from scanrender.scan.seams import Seams
from scanrender.scan.segment import segment
from scanrender.scan.simplify import simplify
from scanrender.scan.tangents import vertex_tangents
from scanrender.scan.topology import components, edges_of, vertex_normals
from scanrender.scan.unwrap import _joined, unwrap
from scanrender.settings.prep import PrepSettings, SimplifySettings, UnwrapSettings
from scanrender.settings.scan import ScanSettings


@pytest.fixture(scope="module")
def first():
    """A head of 12 000 triangles, unwrapped as the preparation does it."""
    made = make_head(40_000)
    raw = plain_surface(made.positions_mm, made.faces.astype(np.int64))
    positions, faces, _ = simplify(raw, SimplifySettings(triangles=12_000), 60.0)
    cut = unwrap(positions, faces, UnwrapSettings(), 1024)
    normals = vertex_normals(positions, faces)[cut.source].astype(np.float32)
    split, uv = positions[cut.source].astype(np.float32), cut.uv.astype(np.float32)
    tangents = vertex_tangents(split, cut.faces, normals, uv)
    return Mesh(split, normals, tangents, uv, cut.faces.astype(np.uint32))


@pytest.fixture(scope="module")
def made(first):
    return make_lods(first, [1500, 5000], 60.0)


def welded(mesh):
    _, place = np.unique(mesh.positions_mm, axis=0, return_inverse=True)
    return place.reshape(-1)[mesh.faces]


def signed(mesh):
    a, b, c = (mesh.uv[mesh.faces[:, k]].astype(float) for k in range(3))
    return (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]


def split_mesh(positions, faces, corner_uv, chart):
    """What an atlas as it is gives the child: split by chart and texture coordinates (top left)."""
    cut = _joined(faces, chart, np.stack([corner_uv[..., 0], 1.0 - corner_uv[..., 1]], axis=2))
    normals = vertex_normals(positions, faces)[cut.source].astype(np.float32)
    split, uv = positions[cut.source].astype(np.float32), cut.uv.astype(np.float32)
    tangents = vertex_tangents(split, cut.faces, normals, uv)
    names = ("positions_mm", "normals", "tangents", "uv", "faces")
    return dict(zip(names, (split, normals, tangents, uv, cut.faces), strict=True))


def mirrored_sphere():
    """A sphere whose southern half is a chart of its own and mirrored."""
    positions, faces, uv = sphere(100.0, 20, 40)
    chart = (positions[faces].mean(axis=1)[:, 1] < 0.0).astype(int)
    uv[chart == 1, :, 0] = 1.0 - uv[chart == 1, :, 0]
    return positions, faces, uv, chart


def test_finest_first_and_near_their_size(made):
    meshes, _, problems = made
    assert not problems
    assert [len(mesh.faces) for mesh in meshes] == pytest.approx([5000, 1500], rel=0.05)


def test_charts_still_meet_exactly(first, made):
    """Joined by equal positions they are as open as the first mesh: at the neck, nowhere else."""
    before = edges_of(welded(first))
    neck = np.unique(before.pairs[before.count == 1])
    rim = {tuple(p) for p in np.unique(first.positions_mm, axis=0)[neck].tolist()}
    for mesh in made[0]:
        edges = edges_of(welded(mesh))
        assert (edges.count <= 2).all()
        at = np.unique(edges.pairs[edges.count == 1])
        still = {tuple(p) for p in np.unique(mesh.positions_mm, axis=0)[at].tolist()}
        assert still
        assert still <= rim


def test_no_triangle_lies_upside_down_in_the_atlas(first, made):
    side = np.sign(signed(first).sum())
    for mesh in made[0]:
        assert (side * signed(mesh) > 0.0).all()


def test_texels_stay_where_they_are_on_the_skin(first, made):
    faces = first.faces.astype(np.int64)
    atlas = Target(np.pad(first.uv, ((0, 0), (0, 1))), faces)
    for mesh, said in zip(*made[:2], strict=True):
        corners = mesh.faces.astype(np.int64)
        hits = sample_hits(mesh.positions_mm, corners, 5000, 9)
        at = np.einsum("kc,kcd->kd", hits.bary, mesh.uv[corners[hits.face]])
        here = np.einsum("kc,kcd->kd", hits.bary, mesh.positions_mm[corners[hits.face]])
        near = atlas.nearest(np.pad(at, ((0, 0), (0, 1))))
        there = np.einsum("kc,kcd->kd", near.bary, first.positions_mm[faces[near.face]])
        slid = np.percentile(np.linalg.norm(here - there, axis=1), 99)
        assert slid == pytest.approx(said, rel=0.4)
        assert slid < 2.0
        texel = 1.0 / 1024  # outside the charts there are only gutters
        assert np.percentile(near.distance, 99) < 3.0 * texel


def test_normals_and_tangents_are_those_of_the_first_mesh(first, made):
    for mesh in made[0]:
        assert np.linalg.norm(mesh.normals, axis=1) == pytest.approx(1.0, abs=1e-5)
        dots = np.einsum("ij,ij->i", mesh.normals, mesh.tangents[:, :3])
        np.testing.assert_allclose(dots, 0.0, atol=1e-5)
        near = Target(first.positions_mm, first.faces.astype(np.int64)).nearest(mesh.positions_mm)
        corners = first.faces.astype(np.int64)[near.face]
        there = np.einsum("kc,kcd->kd", near.bary, first.normals[corners])
        there /= np.linalg.norm(there, axis=1, keepdims=True)
        agree = np.einsum("ij,ij->i", there, mesh.normals)
        assert np.percentile(agree, 1) > 0.98


def test_what_cannot_be_made_is_said(first, monkeypatch):
    meshes, _, problems = make_lods(first, [20_000], 60.0)
    assert not meshes
    assert problems == [f"20000 triangles: the mesh has {len(first.faces)}"]

    def crash(*_):
        raise StageError("the stage 'lods' crashed")

    monkeypatch.setattr(module, "run_task", crash)
    assert make_lods(first, [1000], 60.0) == ([], [], ["any size: the stage 'lods' crashed"])


def test_borders_are_thinned_alike_on_both_sides():
    positions, faces, _ = sphere(50.0, 32, 64)
    chart = segment(positions, faces, 6)
    number = chart[:, None] * len(positions) + faces
    used, split = np.unique(number, return_inverse=True)
    split = split.reshape(-1, 3)
    place = used % len(positions)
    points = positions[place]
    # A flat picture of each chart along its own mean normal.
    uv = np.zeros((len(points), 2))
    for one in range(chart.max() + 1):
        mine = used // len(positions) == one
        normal = points[mine].mean(axis=0)
        axis = np.cross(normal, np.eye(3)[np.abs(normal).argmin()])
        axis /= np.linalg.norm(axis)
        other = np.cross(normal / np.linalg.norm(normal), axis)
        uv[mine] = points[mine] @ np.stack([axis, other], axis=1) / 200.0
    thin = Seams(points, uv, split, place).thinned(0.4)
    before, after = edges_of(split), edges_of(thin)
    assert (after.count == 1).sum() < 0.6 * (before.count == 1).sum()
    joined = edges_of(place[thin])
    assert (joined.count == 2).all(), "no gap and no overlap"
    assert components(thin, len(points))[0] == components(split, len(points))[0]
    assert Seams(points, uv, split, place).thinned(1.0).shape == split.shape


def test_a_long_seam_keeps_its_shape_where_most_border_places_must_stay():
    """At the poles of this sphere each place of the border is a tip of several corners."""
    positions, faces, uv = sphere(100.0, 20, 40)
    arrays = split_mesh(positions, faces, uv, np.zeros(len(faces), int))
    result, report = lods_task(arrays, {"targets": [700]})
    assert not report["problems"]
    away = surface_distance(Target(positions, faces), result["1_positions_mm"], result["1_faces"])
    assert away["symmetric_mm"]["p99"] < 1.0


def test_a_level_further_from_the_scan_than_its_edges_are_long_is_warned_of(monkeypatch):
    positions, faces, _ = sphere(100.0, 20, 40)
    raw = SimpleNamespace(target=Target(positions, faces))
    coarse, corners, uv = sphere(98.0, 10, 20)
    sound = Mesh(**split_mesh(coarse, corners, uv, np.zeros(len(corners), int)))
    dented = sound.positions_mm.copy()
    dented[dented[:, 0] > 60.0, 0] = 60.0
    dent = replace(sound, positions_mm=dented)
    monkeypatch.setattr(pipeline, "make_lods", lambda *_: ([sound, dent], [0.0, 0.0], []))
    journal, settings = Journal(None), PrepSettings(simplify=SimplifySettings(lods=[500]))
    _, levels = pipeline._levels_of_detail(raw, SimpleNamespace(mesh=None), settings, journal)
    [warning] = journal.warnings
    assert warning.startswith("the level of detail of 360 triangles is up to")
    assert f"{levels[1]['error_mm']:.2f} mm" in warning
    assert levels[0]["error_mm"] > NOTABLE_MM, "a coarse level strays by that, and is sound"


def test_a_mirrored_chart_stays_mirrored():
    positions, faces, uv, chart = mirrored_sphere()
    arrays = split_mesh(positions, faces, uv, chart)
    result, report = lods_task(arrays, {"targets": [700]})
    assert not report["problems"]
    level = Mesh(**{key: result[f"1_{key}"] for key in arrays})
    south = level.positions_mm[level.faces].mean(axis=1)[:, 1] < 0.0
    area = signed(level)
    assert (area[south] < 0.0).all() or (area[south] > 0.0).all()
    assert (area[~south] * area[south][0] < 0.0).all()
    assert (level.tangents[:, 3] != level.tangents[0, 3]).any()


def test_a_closed_piece_on_one_texel_costs_no_level():
    positions, faces, uv = sphere(100.0, 20, 40)
    small, corners, _ = sphere(20.0, 6, 12)
    both = np.concatenate([positions, small + np.array([0.0, 0.0, 130.0])])
    all_faces = np.concatenate([faces, corners + len(positions)])
    coordinates = np.concatenate([uv, np.full((len(corners), 3, 2), 0.25)])
    chart = (np.arange(len(all_faces)) >= len(faces)).astype(int)
    arrays = split_mesh(both, all_faces, coordinates, chart)
    result, report = lods_task(arrays, {"targets": [1000]})
    assert not report["problems"]
    assert np.isfinite(report["slide_mm"]["1"])
    eye = result["1_positions_mm"][:, 2] > 105.0
    assert eye.sum() > 10
    np.testing.assert_allclose(result["1_uv"][eye], [[0.25, 0.25]] * eye.sum(), atol=1e-6)
    assert np.linalg.norm(result["1_normals"][eye], axis=1) == pytest.approx(1.0, abs=1e-6)


def test_one_failing_level_leaves_the_others(monkeypatch):
    positions, faces, uv = sphere(100.0, 20, 40)
    arrays = split_mesh(positions, faces, uv, np.zeros(len(faces), int))
    made = lods.coarser

    def failing(first, faces, target):
        if target == 1000:
            raise IndexError("no border")
        return made(first, faces, target)

    monkeypatch.setattr(lods, "coarser", failing)
    result, report = lods_task(arrays, {"targets": [1000, 700]})
    assert report["problems"] == ["1000 triangles: IndexError: no border"]
    assert list(report["slide_mm"]) == ["2"]
    assert len(result["2_faces"]) == pytest.approx(700, rel=0.05)


def test_a_pocket_that_hangs_by_an_edge_is_dropped():
    positions, faces, _ = sphere(50.0)
    # A tetrahedron on the edge of the first face.
    a, b = faces[100, :2]
    tip = np.array([len(positions), len(positions) + 1])
    pocket = [(a, tip[0], tip[1]), (b, tip[1], tip[0]), (a, b, tip[0]), (b, a, tip[1])]
    more = np.concatenate([positions, [[80.0, 0, 0], [80.0, 5.0, 0]]])
    hung = plain_surface(more, np.concatenate([faces, pocket]))
    np.testing.assert_array_equal(drop_pockets(hung).faces, faces)
    alone = plain_surface(np.concatenate([positions, positions + 200.0]),
                          np.concatenate([faces, faces + len(positions)]))  # fmt: skip
    assert drop_pockets(alone) is alone, "a piece of its own is no pocket"


def test_the_widest_place_of_a_ring_is_its_centre():
    angle = 2 * np.pi * np.arange(6) / 6
    uv = np.concatenate([[[0.9, 0.4]], np.stack([np.cos(angle), np.sin(angle)], axis=1)])
    ring = np.array([(0, 1 + k, 1 + (k + 1) % 6) for k in range(6)])
    np.testing.assert_allclose(_widest(uv, ring, 0, 1.0), [0.0, 0.0], atol=1e-9)
    outside = uv.copy()
    outside[0] = [3.0, 1.0]
    inner = np.arange(7) == 0
    assert _unflipped(outside, ring, inner, np.ones(6)) == 0
    assert np.linalg.norm(outside[0]) < 1.0
    np.testing.assert_array_equal(outside[1:], uv[1:])


def test_the_asset_lists_and_holds_its_levels(tmp_path):
    positions, faces, uv = sphere(100.0, 48, 96)
    scan = write_obj(tmp_path / "a.obj", positions, faces, uv)
    settings = PrepSettings.model_validate(
        {
            "report": "short",
            "simplify": {"triangles": 4000, "lods": [1500, 800, 60_000]},
            "bake": {"albedo_px": 64, "normal_px": 64, "maps": ["albedo", "normal_ts"]},
        }
    )
    asset = prepare(scan, ScanSettings(units="mm"), settings, tmp_path / "asset")
    listed = json.loads((tmp_path / "asset" / "asset.json").read_text())["lods"]
    assert [entry["file"] for entry in listed] == ["lod1.glb", "lod2.glb"]
    assert [entry["triangles"] for entry in listed] == [len(mesh.faces) for mesh in asset.lods]
    assert 0.0 < listed[0]["error_mm"] < listed[1]["error_mm"] < 3.0
    assert "no level of detail of 60000 triangles" in " ".join(asset.info["warnings"])
    again = load_asset(save_asset(replace(asset, lods=asset.lods[:1]), tmp_path / "copy"))
    assert len(again.lods) == len(again.info["lods"]) == 1
    np.testing.assert_array_equal(again.lods[0].uv, asset.lods[0].uv)
    broken = tmp_path / "copy" / "asset.json"
    broken.write_text(broken.read_text().replace('"lods": [', '"lods": 3, "x": ['))
    with pytest.raises(ScanError, match="lods"):
        load_asset(tmp_path / "copy")
