"""Folders, patterns, assets and files: which scans a command line means."""

from __future__ import annotations

from pathlib import Path

import pytest

from scanrender.batch.scans import find_scans
from scanrender.errors import UsageError


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name in ("b/model.obj", "a/model.PLY", "a/skin.png", "a/.hidden.obj", ".trash/c.obj",
                 "out/s/asset/mesh.glb", "out/s/asset/asset.json", "made/asset.json",
                 "made/mesh.glb", "deep/er/c.glb", "deep/er/c.bin"):  # fmt: skip
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("x")
    return tmp_path


def names(found: list[Path], folder: Path) -> list[str]:
    return [path.relative_to(folder).as_posix() for path in found]


def test_a_folder_stands_for_what_is_below_it(folder: Path):
    found = find_scans([folder], folder / "out")
    assert names(found, folder) == ["made", "a/model.PLY", "b/model.obj", "deep/er/c.glb"]
    everything = names(find_scans([folder], folder / "elsewhere"), folder)
    assert "out/s/asset" in everything
    assert "out/s/asset/mesh.glb" not in everything


def test_patterns(folder: Path):
    out = folder / "out"
    assert names(find_scans([folder / "*/model.*"], out), folder) == ["a/model.PLY", "b/model.obj"]
    found = names(find_scans([folder / "**/*.glb"], out), folder)
    assert "deep/er/c.glb" in found
    assert names(find_scans([folder / "d*"], out), folder) == ["deep/er/c.glb"]
    assert names(find_scans([folder / "out/*/asset"], out), folder) == ["out/s/asset"]


def test_what_is_meant_twice_is_taken_once(folder: Path):
    found = find_scans([folder / "b", folder / "*/model.obj", folder], folder / "out")
    assert len(found) == len({path.resolve() for path in found})
    assert names(found, folder)[0] == "b/model.obj"


def test_what_is_named_twice_stays_a_slip(folder: Path):
    scan = folder / "b" / "model.obj"
    assert find_scans([scan, folder / "a" / ".." / "b" / "model.obj"], folder / "out") != [scan]


@pytest.mark.parametrize("name", ["nothing.obj", "a/*.stl", "empty"])
def test_nothing_is_told(folder: Path, name: str):
    (folder / "empty").mkdir()
    with pytest.raises(UsageError):
        find_scans([folder / name], folder / "out")
