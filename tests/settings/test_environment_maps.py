"""Where a pipeline's environment picture may lie, and what is said when it is not there."""

from __future__ import annotations

from pathlib import Path

import pytest

from scanrender.errors import ConfigError
from scanrender.settings.light import EnvironmentLight
from scanrender.settings.loading import load_pipeline


def pipeline_file(folder: Path, named: str) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "p.yaml"
    path.write_text(f"version: 1\nlights:\n  - {{type: environment, map: {named}}}\n")
    return path


def chosen(path: Path, *overrides: str) -> str:
    light = load_pipeline(path, overrides).lights[0]
    assert isinstance(light, EnvironmentLight)
    return light.map


def test_a_path_counts_from_its_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    path = pipeline_file(tmp_path / "a", "maps/hall.exr")
    (tmp_path / "a/maps").mkdir()
    (tmp_path / "a/maps/hall.exr").touch()
    monkeypatch.chdir(tmp_path)
    assert chosen(path) == str((tmp_path / "a/maps/hall.exr").resolve())
    # Also from a file that extends it from elsewhere.
    (tmp_path / "b.yaml").write_text("version: 1\nextends: a/p.yaml\n")
    assert chosen(tmp_path / "b.yaml") == str((tmp_path / "a/maps/hall.exr").resolve())


def test_built_in_skies_are_names(tmp_path: Path):
    assert chosen(pipeline_file(tmp_path, "dome")) == "dome"


def test_what_is_not_there_is_said_with_its_line(tmp_path: Path):
    path = pipeline_file(tmp_path, "gone.exr")
    with pytest.raises(ConfigError, match=r"no picture .*gone\.exr") as caught:
        load_pipeline(path)
    assert caught.value.where == f"{path.resolve()}:3"
    assert "studio" in str(caught.value.fix)


@pytest.mark.parametrize("named", ["../hall.exr", "/etc/hostname", "https://example.org/hall.exr"])
def test_a_file_reaches_nothing_outside_its_folder(tmp_path: Path, named: str):
    (tmp_path / "hall.exr").touch()
    with pytest.raises(ConfigError, match=r"outside|no picture"):
        load_pipeline(pipeline_file(tmp_path / "a", named))


def test_a_link_out_of_the_folder_is_no_way_round(tmp_path: Path):
    (tmp_path / "hall.exr").touch()
    path = pipeline_file(tmp_path / "a", "link.exr")
    (tmp_path / "a/link.exr").symlink_to(tmp_path / "hall.exr")
    with pytest.raises(ConfigError, match="outside"):
        load_pipeline(path)


def test_the_command_line_may_name_any(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    (tmp_path / "hall.exr").touch()
    path = pipeline_file(tmp_path / "a", "studio")
    monkeypatch.chdir(tmp_path)
    expected = str((tmp_path / "hall.exr").resolve())
    assert chosen(path, "lights.0.map=hall.exr") == expected
    assert chosen(path, f"lights.0.map={expected}") == expected
    with pytest.raises(ConfigError, match="no picture") as caught:
        load_pipeline(path, ["lights.0.map=hal.exr"])
    assert caught.value.where == "--set lights.0.map=hal.exr"
