"""A matrix: every combination of named changes is a pipeline of its own."""

from __future__ import annotations

from pathlib import Path

import pytest

from scanrender.errors import ConfigError
from scanrender.settings.loading import load_pipeline
from scanrender.settings.matrix import variants

FILE = """
version: 1
extends: turntable
camera: {width_px: 100}
matrix:
  look:
    natural: {}
    oily: {extends: skin/oily, camera: {height_px: 50}}
  light:
    key: {extends: light/key_only}
    dim: {lights.0.irradiance: 0.25}
"""


def load(tmp_path: Path, text: str, *overrides: str):
    (tmp_path / "p.yaml").write_text(text)
    return load_pipeline(tmp_path / "p.yaml", overrides)


def test_every_combination_in_order(tmp_path: Path):
    plain = load_pipeline("turntable", ["camera.width_px=100"])
    found = {v.name: v.pipeline for v in variants(load(tmp_path, FILE), "p.yaml")}
    assert list(found) == ["natural-key", "natural-dim", "oily-key", "oily-dim"]
    oily = load_pipeline("turntable", ["camera.width_px=100", "camera.height_px=50"])
    key = load(tmp_path, "extends: light/key_only")
    shine = load(tmp_path, "extends: skin/oily").skin
    assert found["natural-key"].lights == key.lights
    assert found["natural-key"].model_copy(update={"lights": plain.lights}) == plain
    assert found["natural-dim"].lights[0].irradiance == 0.25
    assert found["natural-dim"].lights[1:] == plain.lights[1:]
    assert found["oily-dim"].camera == oily.camera
    assert found["oily-dim"].skin.specular == shine.specular
    assert found["oily-dim"].skin != plain.skin
    assert all(not pipeline.matrix for pipeline in found.values())


def test_overrides_stand_under_the_matrix(tmp_path: Path):
    found = variants(load(tmp_path, FILE, "lights.1.irradiance=0.5"), "p.yaml")
    assert found[1].pipeline.lights[1].irradiance == 0.5
    assert found[1].pipeline.lights[0].irradiance == 0.25


def test_without_a_matrix_there_is_one_without_a_name():
    [only] = variants(load_pipeline("turntable"), "turntable")
    assert (only.name, only.pipeline) == ("", load_pipeline("turntable"))


@pytest.mark.parametrize(
    ("matrix", "words"),
    [
        ("{look: {a: {camera.wdith_px: 3}}}", ("wdith_px", "width_px", "matrix.look.a")),
        ("{look: {a: {camera: {width_px: no}}}}", ("camera.width_px", "matrix.look.a")),
        ("{look: {a: {lights.9.irradiance: 1}}}", ("9", "matrix.look.a")),
        ("{look: {a: {extends: skin/oilly}}}", ("skin/oily",)),
        ("{look: {}}", ("nothing to choose",)),
        ("{look: {'a/b': {}}}", ("folder", "a/b")),
        ("{look: {'..': {}}}", ("folder",)),
        ("{look: 3}", ("matrix.look",)),
        ("[a]", ("matrix",)),
        ("{a: {x: {}}, b: {y: {figure.panels.0.label: 3}}}", ("matrix.b.y",)),
    ],
)
def test_slips_are_told_when_the_file_is_read(tmp_path: Path, matrix: str, words: tuple[str, ...]):
    with pytest.raises(ConfigError) as caught:
        load(tmp_path, f"version: 1\nmatrix: {matrix}\n")
    for word in words:
        assert word in str(caught.value)


@pytest.mark.parametrize(
    "matrix",
    [
        "{a: {asset: {}}}",
        "{a: {frames: {}}}",
        "{a: {x-y: {}, x: {}}, b: {z: {}, y-z: {}}}",
        "{a: {x: {}, X: {}}}",
    ],
)
def test_names_that_would_share_a_folder_are_refused(tmp_path: Path, matrix: str):
    pipeline = load(tmp_path, f"version: 1\nmatrix: {matrix}\n")
    with pytest.raises(ConfigError, match=r"called"):
        variants(pipeline, "p.yaml")


def test_too_many_combinations_are_told(tmp_path: Path):
    axis = "{" + ", ".join(f"v{i}: {{}}" for i in range(30)) + "}"
    with pytest.raises(ConfigError, match="27,000"):
        load(tmp_path, f"version: 1\nmatrix: {{a: {axis}, b: {axis}, c: {axis}}}\n")


def test_pictures_of_a_choice_count_from_the_file(tmp_path: Path):
    (tmp_path / "sky.exr").write_bytes(b"x")
    light = "[{type: environment, map: sky.exr}]"
    pipeline = load(tmp_path, f"version: 1\nmatrix: {{sky: {{mine: {{lights: {light}}}}}}}\n")
    [found] = variants(pipeline, "p.yaml")
    assert found.pipeline.lights[0].map == str(tmp_path / "sky.exr")
    outside = "[{type: environment, map: ../sky.exr}]"
    with pytest.raises(ConfigError, match="outside"):
        load(tmp_path, f"version: 1\nmatrix: {{sky: {{mine: {{lights: {outside}}}}}}}\n")
