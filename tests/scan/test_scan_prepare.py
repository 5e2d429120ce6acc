"""The whole preparation: loadable, faithful to the raw scan, safe when children die."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time

import numpy as np
import pytest
from scan_shapes import SCANS, cube, sphere, write_obj, write_ply

from scanrender import images
from scanrender.asset import MAPS, load_asset
from scanrender.errors import OutputError, ScanError, StageError
from scanrender.scan.child import run_task
from scanrender.scan.inspect import inspect_scan
from scanrender.scan.prepare import prepare
from scanrender.scan.rays import Target
from scanrender.scan.tangents import from_tangent_space
from scanrender.scan.topology import unit
from scanrender.settings.prep import BakeSettings, CleanSettings, PrepSettings, SimplifySettings
from scanrender.settings.scan import ScanSettings

SMALL = PrepSettings(
    simplify=SimplifySettings(triangles=1500),
    bake=BakeSettings(albedo_px=512, normal_px=512, data_px=256, ao_rays=16, thickness_rays=4),
)


def lookup(image, uv):
    """Nearest texel of uv (k, 2), origin top left."""
    height, width = image.shape[:2]
    column = np.clip((uv[:, 0] * width).astype(int), 0, width - 1)
    return image[np.clip((uv[:, 1] * height).astype(int), 0, height - 1), column]


def latitude_longitude(size=256):
    """A colour that says where on the sphere it is, and changes slowly."""
    v, u = np.meshgrid(
        (np.arange(size) + 0.5) / size, (np.arange(size) + 0.5) / size, indexing="ij"
    )
    angle = 2.0 * np.pi * u
    return np.stack([0.2 + 0.6 * v, 0.5 + 0.3 * np.cos(angle), 0.5 + 0.3 * np.sin(angle)], axis=-1)


def colour_at(direction):
    """The same colour, from unit directions (k, 3) on the sphere; sRGB-encoded."""
    angle = np.arctan2(direction[:, 0], direction[:, 2])
    v = np.arccos(np.clip(direction[:, 1], -1.0, 1.0)) / np.pi
    return np.stack([0.2 + 0.6 * v, 0.5 + 0.3 * np.cos(angle), 0.5 + 0.3 * np.sin(angle)], axis=-1)


@pytest.fixture(scope="module")
def textured(tmp_path_factory):
    folder = tmp_path_factory.mktemp("textured")
    positions, faces, uv = sphere(100.0, 36, 72)
    images.write_png8(folder / "map.png", latitude_longitude())
    # A normal map that leans everywhere toward the north pole: x 0, y sin 20, z cos 20.
    lean = np.array([0.0, np.sin(np.radians(20)), np.cos(np.radians(20))]) * 0.5 + 0.5
    images.write_png8(folder / "lean.png", np.tile(lean, (16, 16, 1)))
    (folder / "m.mtl").write_text("newmtl skin\nmap_Kd map.png\nnorm lean.png\n")
    scan = write_obj(folder / "ball.obj", positions, faces, uv, "m.mtl")
    stages = []
    asset = prepare(
        scan,
        ScanSettings(units="mm"),
        SMALL,
        folder / "asset",
        progress=lambda *x: stages.append(x),
    )
    return folder, scan, asset, stages


@pytest.fixture(scope="module")
def hits(textured):
    """Random points of the prepared surface: positions, interpolated normal, tangent, uv."""
    mesh = textured[2].mesh
    rng = np.random.default_rng(0)
    way = unit(rng.normal(size=(4000, 3)))
    way = way[np.abs(way[:, 1]) < 0.9]
    target = Target(mesh.positions_mm, mesh.faces.astype(np.int64))
    found = target.cast(way * 200.0, -way, 400.0)
    assert (found.face >= 0).all()

    def at(values):
        return target.interpolate(found, values)

    return at(mesh.positions_mm), at(mesh.normals), at(mesh.tangents), at(mesh.uv)


def test_the_asset_is_complete_and_says_what_happened(textured):
    folder, _, asset, stages = textured
    assert set(asset.maps) == set(MAPS)
    for name, pixels in asset.maps.items():
        assert np.isfinite(pixels).all(), name
    info = load_asset(folder / "asset", maps=()).info
    assert info["units"]["confidence"] == "stated"
    assert info["counts"]["prepared"]["triangles"] <= 1530
    assert info["lost"]["symmetric_mm"]["p99"] < 1.0
    assert info["lost"]["flipped_triangles"] == 0
    assert {stage["name"] for stage in info["stages"]} >= {"clean", "unwrap", "albedo", "skin"}
    assert [fraction for _, fraction in stages] == sorted(fraction for _, fraction in stages)
    assert sorted(p.name for p in folder.iterdir() if p.name.startswith(".")) == []


def test_albedo_agrees_with_the_raw_scan(textured, hits):
    position, _, _, uv = hits
    expected = images.linear_from_srgb(colour_at(unit(position)))
    assert np.abs(lookup(textured[2].maps["albedo"], uv) - expected).max() < 0.03


def test_normals_agree_with_the_raw_scan_and_its_normal_map(textured, hits):
    position, normal, tangent, uv = hits
    outward = unit(position)
    north = unit(np.array([0.0, 1.0, 0.0]) - outward[:, 1:2] * outward)
    expected = np.cos(np.radians(20)) * outward + np.sin(np.radians(20)) * north
    baked = from_tangent_space(lookup(textured[2].maps["normal_ts"], uv), normal, tangent)
    cosine = np.einsum("ij,ij->i", baked, expected)
    assert np.degrees(np.arccos(np.clip(cosine, -1, 1))).max() < 3.0
    geometry = lookup(textured[2].maps["normal_geometry"], uv)
    assert np.einsum("ij,ij->i", geometry, outward).min() > np.cos(np.radians(2.5))


def test_shape_maps_of_a_sphere(textured, hits):
    maps, uv = textured[2].maps, hits[3]
    np.testing.assert_allclose(lookup(maps["curvature"], uv), 0.01, rtol=0.15)
    assert lookup(maps["ao"], uv).min() > 0.9
    assert lookup(maps["thickness_mm"], uv).min() > 100.0


def test_no_black_gutters(textured):
    assert textured[2].maps["albedo"].min() > 0.01
    assert np.abs(np.linalg.norm(textured[2].maps["normal_ts"], axis=2) - 1.0).max() < 1e-3


def test_the_same_input_gives_the_same_bytes(textured, tmp_path):
    folder, scan, _, _ = textured
    prepare(scan, ScanSettings(units="mm"), SMALL, tmp_path / "again")
    for file in ["mesh.glb", *(MAPS[name].file for name in MAPS)]:
        assert (folder / "asset" / file).read_bytes() == (tmp_path / "again" / file).read_bytes()


def test_as_is_keeps_triangles_and_texture_coordinates(textured, tmp_path):
    _, scan, _, _ = textured
    asset = prepare(scan, ScanSettings(units="mm"), SMALL, tmp_path / "a", as_is=True)
    assert len(asset.mesh.faces) == inspect_scan(scan)["triangles"]
    coarse = images.read_image(scan.parent / "map.png")
    uv = np.array([[0.25, 0.25], [0.6, 0.7]])
    expected = images.linear_from_srgb(lookup(coarse, uv))
    assert np.abs(lookup(asset.maps["albedo"], uv) - expected).max() < 0.02


def test_vertex_colours_and_no_colours(tmp_path):
    positions, faces, _ = sphere(100.0, 12, 24)
    colors = (255 * colour_at(unit(positions))).astype(np.uint8)
    scan = write_ply(tmp_path / "a.ply", positions, faces, colors)
    asset = prepare(scan, ScanSettings(units="mm"), SMALL, tmp_path / "colours")
    mesh = asset.mesh
    expected = images.linear_from_srgb(colour_at(unit(mesh.positions_mm)))
    inside = np.abs(unit(mesh.positions_mm)[:, 1]) < 0.9
    assert np.abs(lookup(asset.maps["albedo"], mesh.uv) - expected)[inside].max() < 0.1
    plain = prepare(
        write_ply(tmp_path / "b.ply", positions, faces), ScanSettings(), SMALL, tmp_path / "none"
    )
    assert (plain.maps["skin"] == 1.0).all()
    assert any("no colour" in warning for warning in plain.info["warnings"])


def test_a_bad_scan_leaves_nothing_behind(tmp_path):
    positions, _ = cube()
    scan = tmp_path / "a.obj"
    scan.write_text("".join(f"v {x} {y} {z}\n" for x, y, z in positions))
    with pytest.raises(ScanError, match="no faces"):
        prepare(scan, ScanSettings(), SMALL, tmp_path / "out")
    assert [p.name for p in tmp_path.iterdir()] == ["a.obj"]


def test_a_folder_that_is_no_asset_is_not_replaced(tmp_path):
    positions, faces, _ = sphere(100.0, 8, 16)
    scan = write_obj(tmp_path / "a.obj", positions, faces)
    out = tmp_path / "documents"
    out.mkdir()
    (out / "thesis.txt").write_text("years of work")
    with pytest.raises(OutputError, match="holds other files"):
        prepare(scan, ScanSettings(), SMALL, out)
    assert [p.name for p in out.iterdir()] == ["thesis.txt"]


@pytest.mark.parametrize(
    ("params", "sentence"),
    [
        ({"how": "SIGSEGV"}, "crashed .SIGSEGV"),
        ({"how": "SIGKILL"}, "memory ran out"),
        ({"how": "raise"}, "asked to fail"),
        ({"how": "allocate", "mib": 1 << 30}, "'fail' ran out of memory"),
    ],
)
def test_a_dying_child_is_a_stage_error(params, sentence):
    with pytest.raises(StageError, match=sentence):
        run_task("fail", {}, params, 30.0)


def test_a_hanging_child_is_stopped():
    start = time.monotonic()
    with pytest.raises(StageError, match="longer than 1 s"):
        run_task("fail", {}, {"how": "hang"}, 1.0)
    assert time.monotonic() - start < 15.0


def test_killing_the_preparation_leaves_no_folder(tmp_path, children):
    positions, faces, _ = sphere(100.0, 12, 24)
    scan = write_ply(tmp_path / "a.ply", positions, faces)

    def kill(stage, fraction):
        if stage == "clean":
            os.kill(children[0].pid, signal.SIGKILL)

    with pytest.raises(StageError):
        prepare(scan, ScanSettings(), SMALL, tmp_path / "out", progress=kill)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.ply"]


def test_the_calling_process_imports_no_native_mesh_library(tmp_path):
    positions, faces, _ = sphere(100.0, 12, 24)
    scan = write_ply(tmp_path / "a.ply", positions, faces)
    program = (
        "import sys\n"
        "from scanrender.scan.prepare import prepare\n"
        "from scanrender.settings.prep import PrepSettings\n"
        "from scanrender.settings.scan import ScanSettings\n"
        f"prep = PrepSettings.model_validate({SMALL.model_dump()!r})\n"
        f"prepare({str(scan)!r}, ScanSettings(), prep, {str(tmp_path / 'out')!r})\n"
        "bad = {'pymeshlab', 'xatlas', 'fast_simplification', 'igl', 'embreex'}\n"
        "bad &= set(sys.modules)\n"
        "sys.exit(f'imported {bad}' if bad else 0)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("name", ["lee_perry_smith/LeePerrySmith.obj", "james_3dmd/james.obj"])
def test_real_scans(name, tmp_path):
    scan = SCANS / name
    if not scan.exists():
        pytest.skip(f"the real scan {name} is not on this machine")
    prep = SMALL.model_copy(update={"simplify": SimplifySettings(triangles=6000)})
    asset = prepare(scan, ScanSettings(), prep, tmp_path / "out")
    info = asset.info
    assert info["lost"]["flipped_triangles"] == 0
    assert info["lost"]["symmetric_mm"]["mean"] < 0.25
    assert info["lost"]["charts"] < 150
    assert next(s for s in info["stages"] if s["name"] == "unwrap")["notes"]["rung"] == "charts"
    skin = asset.maps["skin"]
    assert 0.3 < skin.mean() < 1.0


def test_inspect_counts_defects_without_preparing(tmp_path):
    positions, faces, _ = sphere(100.0, 12, 24)
    crumbs = np.concatenate([positions, np.asarray(cube()[0]) + 300.0])
    dirty = np.concatenate([faces[5:], faces[20:22], [[0, 0, 1]], cube()[1] + len(positions)])
    health = inspect_scan(write_ply(tmp_path / "a.ply", crumbs, dirty), ScanSettings(units="mm"))
    assert health["components"] == 2
    assert health["duplicate_faces"] == 2
    assert health["degenerate_faces"] == 1
    assert health["boundary_edges"] > 0
    assert not health["watertight"]
    assert health["color"] == "none"
    assert health["size_mm"][1] == pytest.approx(200.0)


def test_as_is_unwraps_anew_where_texture_coordinates_overlap(tmp_path):
    positions, faces, uv = sphere(100.0, 12, 24)
    folded = np.where(uv[..., :1] > 0.5, 1.0 - uv[..., :1], uv[..., :1])
    scan = write_obj(tmp_path / "a.obj", positions, faces, np.concatenate([folded, uv[..., 1:]], 2))
    asset = prepare(scan, ScanSettings(units="mm"), SMALL, tmp_path / "out", as_is=True)
    notes = next(s for s in asset.info["stages"] if s["name"] == "unwrap")["notes"]
    assert notes["rung"] == "charts"
    assert len(asset.mesh.faces) == len(faces)


def test_maps_are_no_finer_than_asked_for_on_the_surface(textured, tmp_path):
    """A sphere of 100 mm has 125 664 mm2: half a texel a mm is 220 px, two thirds of them used."""
    scan = textured[1]
    bake = SMALL.bake.model_copy(update={"texel_mm": 2.0, "maps": ("albedo", "normal_ts")})
    settings = SMALL.model_copy(update={"bake": bake, "report": "short"})
    asset = prepare(scan, ScanSettings(units="mm"), settings, tmp_path / "asset")
    assert asset.maps["albedo"].shape[0] == asset.maps["normal_ts"].shape[0] == 256
    assert set(asset.maps) == {"albedo", "normal_ts"}


def unwrapped_as_is(tmp_path, positions, faces, uv, **clean):
    """The asset and what its report says of the unwrapping, with tiny maps of colour alone."""
    scan = write_obj(tmp_path / "a.obj", positions, faces, uv)
    bake = {"albedo_px": 64, "normal_px": 64, "data_px": 64, "maps": ["albedo"]}
    prep = PrepSettings.model_validate({"report": "short", "bake": bake, "clean": clean})
    asset = prepare(scan, ScanSettings(units="mm"), prep, tmp_path / "out", as_is=True)
    return asset, next(s for s in asset.info["stages"] if s["name"] == "unwrap")["notes"]


@pytest.mark.parametrize(
    ("changed", "reason"),
    [
        (lambda uv: 0.0 * uv, "100 % of the surface"),
        (lambda uv: 0.02 * uv + 0.4, "only 0.035 % of the map"),
        (lambda uv: 2.0 * uv, "outside the map"),
        (lambda uv: 0.5 - np.abs(uv - 0.5), "more than one face"),
    ],
)
def test_as_is_unwraps_anew_and_says_why(tmp_path, changed, reason):
    """Texture coordinates that lie at one point, in a corner of the map, outside it, or folded."""
    positions, faces, uv = sphere(100.0, 8, 16)
    asset, notes = unwrapped_as_is(tmp_path, positions, faces, changed(uv))
    assert notes["rung"] == "charts"
    assert reason in notes["failed_rungs"][0]
    assert any(reason in warning for warning in asset.info["warnings"])
    assert len(asset.mesh.faces) == len(faces)


def test_as_is_unwraps_anew_where_a_piece_has_no_place_in_the_map(tmp_path):
    """An eyeball beside the head, all of it at one point of the map: no texel would hold it."""
    positions, faces, uv = sphere(100.0, 12, 24)
    eye, eye_faces, eye_uv = sphere(20.0, 6, 12)
    both = np.concatenate([positions, eye + np.array([0.0, 0.0, 130.0])])
    all_faces = np.concatenate([faces, eye_faces + len(positions)])
    all_uv = np.concatenate([uv, np.full(eye_uv.shape, 0.25)])
    _, notes = unwrapped_as_is(tmp_path, both, all_faces, all_uv)
    assert notes["rung"] == "charts"
    assert "4 % of the surface" in notes["failed_rungs"][0]


@pytest.mark.parametrize("hole_mm", [0.0, 120.0])
def test_as_is_says_that_a_filled_hole_has_no_texture_coordinates(tmp_path, hole_mm):
    positions, faces, uv = sphere(100.0, 12, 24)
    whole = (faces != 130).all(axis=1)
    asset, notes = unwrapped_as_is(tmp_path, positions, faces[whole], uv[whole], hole_mm=hole_mm)
    if hole_mm == 0.0:
        assert notes["rung"] == "as is"
        assert notes["failed_rungs"] == []
        assert not any("unwrapping" in warning for warning in asset.info["warnings"])
    else:
        assert notes["rung"] == "charts"
        assert "no texture coordinates" in notes["failed_rungs"][0]


def test_the_cap_of_the_neck_counts_in_the_budget(tmp_path):
    positions, faces, _ = sphere(100.0, 32, 64)
    above = (positions[faces][:, :, 1] > -80.0).all(axis=1)
    scan = write_ply(tmp_path / "a.ply", positions, faces[above])
    prep = SMALL.model_copy(
        update={
            "clean": CleanSettings(close_neck=True),
            "simplify": SimplifySettings(triangles=500, error_mm=0.001),
            "bake": SMALL.bake.model_copy(update={"maps": ("albedo",)}),
            "report": "short",
        }
    )
    asset = prepare(scan, ScanSettings(units="mm"), prep, tmp_path / "out")
    notes = next(s for s in asset.info["stages"] if s["name"] == "simplify")["notes"]
    assert notes["cap_faces"] > 4
    assert 480 < len(asset.mesh.faces) == notes["triangles"][1] <= 500
    assert asset.info["counts"]["prepared"]["boundary_edges"] == 2 * (notes["cap_faces"] + 2)
