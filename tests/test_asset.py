"""An asset comes back as it was saved, other tools open it, and a broken one is a ScanError."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import trimesh
from render.synthetic import sphere

from scanrender.asset import MAPS, Asset, load_asset, save_asset
from scanrender.errors import OutputError, ScanError, UsageError

RADIUS_MM = 30.0


@pytest.fixture(scope="module")
def asset() -> Asset:
    rng = np.random.default_rng(0)
    maps = {}
    for name, form in MAPS.items():
        pixels = rng.random((6, 5, form.channels)).astype(np.float32)
        if form.channels == 3 and name != "albedo":
            pixels = pixels - 0.5
            pixels /= np.linalg.norm(pixels, axis=2, keepdims=True)
        maps[name] = pixels
    maps["thickness_mm"] *= 400  # far beyond 1: stored as it is
    maps["curvature"] -= 0.5
    info = {"warnings": ["ü"], "source": {"file": "head.obj"}}
    return Asset(sphere(RADIUS_MM, rings=8).mesh, maps, info)


@pytest.fixture
def folder(asset: Asset, tmp_path: Path) -> Path:
    return save_asset(asset, tmp_path / "asset")


def test_the_mesh_comes_back_bit_for_bit(asset: Asset, folder: Path):
    back = load_asset(folder).mesh
    for name in ("positions_mm", "normals", "tangents", "uv", "faces"):
        saved, loaded = getattr(asset.mesh, name), getattr(back, name)
        assert loaded.dtype == saved.dtype
        np.testing.assert_array_equal(loaded, saved, err_msg=name)


@pytest.mark.parametrize("name", MAPS)
def test_each_map_comes_back(asset: Asset, folder: Path, name: str):
    back = load_asset(folder).maps[name]
    # Albedo is 8-bit sRGB, whose widest step is 0.9 % at white; directions have 16 bits.
    tolerance = {"albedo": 0.005, "normal_ts": 1e-4}.get(name, 0.0)
    np.testing.assert_allclose(back, asset.maps[name], atol=tolerance, rtol=0)
    assert back.dtype == np.float32


def test_info_comes_back_and_only_the_maps_asked_for(asset: Asset, folder: Path):
    back = load_asset(folder, ["albedo", "ao"])
    assert set(back.maps) == {"albedo", "ao"}
    assert back.info["warnings"] == ["ü"]
    assert set(back.info["maps"]) == set(MAPS)


def test_others_open_the_mesh_in_metres_with_its_textures(folder: Path):
    scene = trimesh.load_scene(folder / "mesh.glb")
    size = scene.bounds[1] - scene.bounds[0]
    np.testing.assert_allclose(size, 2 * RADIUS_MM / 1000, rtol=1e-5)
    (geometry,) = scene.geometry.values()
    assert geometry.visual.material.baseColorTexture.size == (5, 6)
    assert len(geometry.faces) == len(load_asset(folder).mesh.faces)


def test_saving_twice_replaces_the_whole_folder(asset: Asset, folder: Path):
    (folder / "stray.txt").write_text("of the first time")
    save_asset(asset, folder)
    assert not (folder / "stray.txt").exists()
    assert [path.name for path in folder.parent.iterdir()] == ["asset"]


def test_a_folder_that_is_no_asset_is_never_replaced(asset: Asset, tmp_path: Path):
    """`prep SCAN --out ~/Documents` must not empty it."""
    (tmp_path / "thesis.txt").write_text("years")
    with pytest.raises(OutputError, match="not an asset"):
        save_asset(asset, tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.txt"]


def test_a_failure_half_way_leaves_nothing(asset: Asset, tmp_path: Path):
    broken = Asset(asset.mesh, asset.maps, {"mean": float("nan")})
    with pytest.raises(ValueError, match="JSON"):
        save_asset(broken, tmp_path / "asset")
    assert list(tmp_path.iterdir()) == []


def test_two_saves_are_the_same_bytes(asset: Asset, folder: Path, tmp_path: Path):
    other = save_asset(asset, tmp_path / "other")
    for path in folder.iterdir():
        assert path.read_bytes() == (other / path.name).read_bytes(), path.name


def test_a_missing_folder_is_a_usage_error(tmp_path: Path):
    with pytest.raises(UsageError, match="no such asset"):
        load_asset(tmp_path / "absent")


def edit_json(folder: Path, **changes: object) -> None:
    document = json.loads((folder / "asset.json").read_text())
    document.update(changes)
    (folder / "asset.json").write_text(json.dumps(document))


def cut_mesh(folder: Path) -> None:
    data = (folder / "mesh.glb").read_bytes()
    (folder / "mesh.glb").write_bytes(data[: len(data) // 2])


BREAKAGE = {
    "no description": lambda f: (f / "asset.json").unlink(),
    "description is no JSON": lambda f: (f / "asset.json").write_text("{"),
    "description is a list": lambda f: (f / "asset.json").write_text("[]"),
    "another format": lambda f: edit_json(f, format=99),
    "maps are missing": lambda f: edit_json(f, maps=None),
    "a map nobody knows": lambda f: edit_json(f, maps={"nosuch": "a.png"}),
    "a map without its file": lambda f: (f / "ao.exr").unlink(),
    "a cut map": lambda f: (f / "albedo.png").write_bytes(b"\x89PNG"),
    "a grey albedo": lambda f: shutil.copy(f / "ao.exr", f / "albedo.png"),
    "no mesh": lambda f: (f / "mesh.glb").unlink(),
    "mesh is text": lambda f: (f / "mesh.glb").write_text("text"),
    "mesh is cut": cut_mesh,
    "mesh is empty": lambda f: (f / "mesh.glb").write_bytes(b""),
}


@pytest.mark.parametrize("kind", BREAKAGE)
def test_a_broken_asset_is_a_scan_error(folder: Path, kind: str):
    BREAKAGE[kind](folder)
    with pytest.raises(ScanError) as caught:
        load_asset(folder)
    assert caught.value.where
