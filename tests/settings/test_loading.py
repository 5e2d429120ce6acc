"""YAML in, Pipeline out: extends, YAML 1.2, and errors that name file, line and what was meant."""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from scanrender.errors import ConfigError, UsageError
from scanrender.resources import shipped_pipelines, shipped_presets
from scanrender.settings.loading import find_pipeline, load_pipeline, resolved_yaml
from scanrender.settings.pipeline import Pipeline


def write(folder: Path, name: str, text: str) -> Path:
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize("name", shipped_pipelines())
def test_each_shipped_pipeline_is_valid(name: str):
    assert load_pipeline(name).description


@pytest.mark.parametrize("name", shipped_presets())
def test_each_shipped_preset_is_valid_alone(name: str):
    path = shipped_presets()[name]
    assert load_pipeline(path).version == 1
    assert "version: 1" in path.read_text(encoding="utf-8"), "each file says its format"


def test_presets_and_pipelines_are_found():
    assert {"turntable", "demo", "prep_only", "buffers"} <= set(shipped_pipelines())
    assert len(shipped_presets()) >= 10


def test_an_empty_file_is_all_defaults(tmp_path: Path):
    assert load_pipeline(write(tmp_path, "p.yaml", "")) == Pipeline()
    assert load_pipeline(write(tmp_path, "p.yaml", "# only words\n")) == Pipeline()


# --- extends -------------------------------------------------------------------------------------


def test_extends_a_file_beside_and_a_preset(tmp_path: Path):
    write(tmp_path, "base.yaml", "camera: {width_px: 100, fill: 0.5}\nturntable: {frames: 3}\n")
    for base in ("base.yaml", "base"):
        path = write(tmp_path, "p.yaml", f"extends: {base}\ncamera: {{width_px: 200}}\n")
        found = load_pipeline(path)
        assert (found.camera.width_px, found.camera.fill, found.turntable.frames) == (200, 0.5, 3)
    found = load_pipeline(write(tmp_path, "p.yaml", "extends: light/flat\n"))
    assert [light.type for light in found.lights] == ["ambient"]


def test_of_several_the_later_lies_over_the_earlier(tmp_path: Path):
    write(tmp_path, "a.yaml", "camera: {width_px: 100, height_px: 10}\n")
    write(tmp_path, "b.yaml", "camera: {width_px: 200}\n")
    ab = load_pipeline(write(tmp_path, "p.yaml", "extends: [a, b]\n")).camera
    ba = load_pipeline(write(tmp_path, "p.yaml", "extends: [b, a]\n")).camera
    assert (ab.width_px, ab.height_px) == (200, 10)
    assert (ba.width_px, ba.height_px) == (100, 10)


def test_lists_are_replaced_whole(tmp_path: Path):
    text = "extends: light/portrait\nlights: [{type: ambient, irradiance: 3}]\n"
    lights = load_pipeline(write(tmp_path, "p.yaml", text)).lights
    assert [(light.type, light.irradiance) for light in lights] == [("ambient", 3.0)]


def test_a_preset_may_extend_the_one_beside_it():
    oily, natural = load_pipeline(find_preset("skin/oily")), load_pipeline("turntable").skin
    assert oily.skin.texturing == natural.texturing
    assert oily.skin.specular.roughness != natural.specular.roughness


def find_preset(name: str) -> Path:
    return shipped_presets()[name]


@pytest.mark.parametrize("count", [1, 2, 3, 12])
def test_a_circle_is_refused_and_shown(tmp_path: Path, count: int):
    for i in range(count):
        write(tmp_path, f"f{i}.yaml", f"extends: f{(i + 1) % count}.yaml\n")
    with pytest.raises(ConfigError, match="circle") as caught:
        load_pipeline(tmp_path / "f0.yaml")
    assert "f0.yaml" in caught.value.what


def test_a_base_that_is_not_there_says_where_and_what_was_meant(tmp_path: Path):
    path = write(tmp_path, "p.yaml", "version: 1\nextends: [light/flat, light/portait]\n")
    with pytest.raises(ConfigError, match="light/portait") as caught:
        load_pipeline(path)
    assert caught.value.where == f"{path}:2"
    assert caught.value.fix == "did you mean 'light/portrait'?"


@pytest.mark.parametrize("value", ["3", "{a: b}", "[[a]]", "true", "null", "[3]"])
def test_extends_names_files_and_nothing_else(tmp_path: Path, value: str):
    with pytest.raises(ConfigError):
        load_pipeline(write(tmp_path, "p.yaml", f"extends: {value}\n"))


def test_a_fault_in_a_base_is_reported_where_it_stands(tmp_path: Path):
    base = write(tmp_path, "base.yaml", "version: 1\ncamera:\n  width_px: -3\n")
    with pytest.raises(ConfigError, match=r"camera\.width_px") as caught:
        load_pipeline(write(tmp_path, "p.yaml", "extends: base\nturntable: {frames: 2}\n"))
    assert caught.value.where == f"{base}:3"


# --- YAML 1.2 ------------------------------------------------------------------------------------


def test_numbers_as_people_write_them(tmp_path: Path):
    text = "skin: {scale: 1e-3}\nturntable: {fps: 3E1}\ncamera: {fill: .5}\n"
    found = load_pipeline(write(tmp_path, "p.yaml", text))
    assert (found.skin.scale, found.turntable.fps, found.camera.fill) == (1e-3, 30.0, 0.5)


@pytest.mark.parametrize("word", ["off", "on", "yes", "no", "y", "Off"])
def test_words_stay_words(tmp_path: Path, word: str):
    assert load_pipeline(write(tmp_path, "p.yaml", f"description: {word}\n")).description == word


def test_a_switch_may_be_said_in_words(tmp_path: Path):
    text = "outputs: {video: off, frames: yes}\n"
    outputs = load_pipeline(write(tmp_path, "p.yaml", text)).outputs
    assert (outputs.video, outputs.frames) == (False, True)


def test_leading_zeros_are_decimal(tmp_path: Path):
    # YAML 1.1 reads 010 as eight.
    assert load_pipeline(write(tmp_path, "p.yaml", "turntable: {frames: 010}\n")).turntable.frames \
        == 10  # fmt: skip


@pytest.mark.parametrize(
    "text",
    ["camera: {width_px: 1, width_px: 2}", "version: 1\ncamera: {}\nversion: 1", "a: [1", "\t- x",
     "camera: }", "? [a]\n: b", "- a list", "just words", "&a [*b]"],
)  # fmt: skip
def test_broken_yaml_names_the_file_and_the_line(tmp_path: Path, text: str):
    path = write(tmp_path, "p.yaml", f"# a comment\n{text}\n")
    with pytest.raises(ConfigError) as caught:
        load_pipeline(path)
    assert caught.value.where is not None
    assert caught.value.where.startswith(f"{path}:")


def test_a_duplicate_key_names_the_second_one(tmp_path: Path):
    path = write(tmp_path, "p.yaml", "version: 1\ncamera:\n  fill: 1\n  width_px: 9\n  fill: 2\n")
    with pytest.raises(ConfigError, match=r"(?i)duplicate key.*fill") as caught:
        load_pipeline(path)
    assert caught.value.where == f"{path}:5"


@pytest.mark.parametrize(
    "value",
    ["!!python/object/apply:os.system ['touch pwned']", "!include /etc/passwd", "!!python/name:os",
     "!env HOME", "!!python/tuple [1]", "!!binary aGk="],
)  # fmt: skip
def test_tags_execute_nothing_and_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, value: str
):
    monkeypatch.chdir(tmp_path)
    path = write(tmp_path, "p.yaml", f"description: {value}\n")
    with pytest.raises(ConfigError):
        load_pipeline(path)
    assert [p.name for p in tmp_path.iterdir()] == ["p.yaml"]


def test_merge_keys_and_anchors_work_or_are_refused_with_a_line(tmp_path: Path):
    text = "camera: {width_px: 77}\nlights:\n  - &l {type: ambient}\n  - *l\n"
    found = load_pipeline(write(tmp_path, "p.yaml", text))
    assert len(found.lights) == 2
    assert found.lights[0] == found.lights[1]
    merging = "quality: &q {supersampling: 3}\nturntable:\n  <<: *q\n  frames: 4\n"
    with pytest.raises(ConfigError, match=r"supersampling") as caught:
        load_pipeline(write(tmp_path, "p.yaml", merging))
    assert caught.value.where is not None
    assert ":" in caught.value.where.removeprefix(str(tmp_path))


def test_an_alias_bomb_is_refused(tmp_path: Path):
    lines = ["a0: &a0 [x, x, x, x, x, x, x, x, x]"]
    lines += [f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]" for i in range(1, 10)]
    with pytest.raises(ConfigError, match="too"):
        load_pipeline(write(tmp_path, "p.yaml", "\n".join(lines)))


@pytest.mark.parametrize("text", ["a: &a [*a]", "a: &a {b: *a}", "x: " + "[" * 300 + "]" * 300])
def test_endless_nesting_is_refused(tmp_path: Path, text: str):
    with pytest.raises(ConfigError):
        load_pipeline(write(tmp_path, "p.yaml", text))


def test_what_is_no_text_is_refused(tmp_path: Path):
    path = tmp_path / "p.yaml"
    for data in (b"\xff\xfe\x00\x01", b"a: \x00", bytes(range(256))):
        path.write_bytes(data)
        with pytest.raises(ConfigError):
            load_pipeline(path)


@given(st.text(max_size=60))
def test_no_text_is_a_bug_of_ours(tmp_path_factory: pytest.TempPathFactory, text: str):
    path = tmp_path_factory.mktemp("fuzz") / "p.yaml"
    path.write_bytes(text.encode("utf-8", "replace"))
    with contextlib.suppress(ConfigError):
        load_pipeline(path)


# --- unknown keys and bad values -----------------------------------------------------------------

MISTYPED = [
    ("camra: {}", "camra", "camera", 1),
    ("camera:\n  witdh_px: 3", "camera.witdh_px", "width_px", 2),
    ("skin:\n  specular:\n    rougness: [1, 1]", "skin.specular.rougness", "roughness", 3),
    ("skin:\n  transmission: {bias: 1}", "skin.transmission.bias", "bias_mm", 2),
    ("prep:\n  bake: {\n    albedo: 3}", "prep.bake.albedo", "albedo_px", 3),
    ("lights:\n  - type: ambient\n    iradiance: 2", "lights.0.iradiance", "irradiance", 3),
    ("lights:\n- {type: ambient}\n- {type: spot, cone: 2}", "lights.1.cone", "cone_deg", 3),
    ("skin:\n  profile:\n  - variance: 1\n    weight: [1,1,1]", "skin.profile.0.variance",
     "variance_mm2", 3),
    ("extend: light/flat", "extend", "extends", 1),
]  # fmt: skip


@pytest.mark.parametrize(("text", "key", "meant", "line"), MISTYPED, ids=[m[1] for m in MISTYPED])
def test_a_mistyped_key_gets_its_line_and_a_suggestion(
    tmp_path: Path, text: str, key: str, meant: str, line: int
):
    path = write(tmp_path, "p.yaml", text + "\n")
    with pytest.raises(ConfigError) as caught:
        load_pipeline(path)
    assert repr(key) in caught.value.what
    assert caught.value.where == f"{path}:{line}"
    assert caught.value.fix == f"did you mean {meant!r}?"


BAD_VALUES = [
    ("camera: {width_px: 0}", "camera.width_px"),
    ("camera: {width_px: 3.5}", "camera.width_px"),
    ("camera: {width_px: wide}", "camera.width_px"),
    ("camera: {fill: .nan}", "camera.fill"),
    ("camera: {fill: .inf}", "camera.fill"),
    ("camera: 3", "camera"),
    ("camera: [1]", "camera"),
    ("camera: null", "camera"),
    ("version: 2", "version"),
    ("stages: [prep, bake]", "stages.1"),
    ("diffusion: {method: guassian_sum}", "diffusion.method"),
    ("lights: [{type: laser}]", "lights.0"),
    ("lights: [{irradiance: 2}]", "lights.0"),
    ("lights: {type: ambient}", "lights"),
    ("lights: [{type: ambient, colour: [1, 2]}]", "lights.0.colour"),
    ("lights: [{type: ambient, colour: [1, 2, -3]}]", "lights.0.colour.2"),
    ("scan: {units: furlong}", "scan.units"),
    ("scan: {units: -3}", "scan.units"),
    ("scan: {units: mm, height_mm: 200}", "scan"),
    ("skin: {profile: [{variance_mm2: 1, weight: [.5, 1, 1]}]}", "skin"),
    (
        "skin: {profile: [{variance_mm2: 1, weight: [0.5, 0.5, 0.5]}, "
        "{variance_mm2: 1, weight: [0.5, 0.5, 0.5]}]}",
        "skin",
    ),
    ("skin: {specular: {roughness: [5, 0.2]}}", "skin.specular.roughness.0"),
    ("outputs: {buffers: [positon]}", "outputs.buffers"),
    ("description: 2020-01-01", "description"),
]


@pytest.mark.parametrize(("text", "key"), BAD_VALUES, ids=[text for text, _ in BAD_VALUES])
def test_a_bad_value_gets_its_key_and_line(tmp_path: Path, text: str, key: str):
    path = write(tmp_path, "p.yaml", f"version: 1\n{text}\n" if "version" not in text else text)
    with pytest.raises(ConfigError) as caught:
        load_pipeline(path)
    assert caught.value.what.startswith(f"{key}:")
    assert caught.value.where == f"{path}:{1 if 'version' in text else 2}"


def test_a_missing_key_is_named(tmp_path: Path):
    with pytest.raises(ConfigError, match=r"skin\.profile\.0\.weight: field required"):
        load_pipeline(write(tmp_path, "p.yaml", "skin: {profile: [{variance_mm2: 1}]}"))


# --- finding, and writing back -------------------------------------------------------------------


def test_a_pipeline_is_found_by_file_and_by_name():
    assert find_pipeline("turntable") == find_pipeline("turntable.yaml")
    assert find_pipeline("pipelines/turntable.yaml").name == "turntable.yaml"


def test_an_unknown_pipeline_is_a_usage_error_with_a_suggestion():
    with pytest.raises(UsageError) as caught:
        load_pipeline("turntabel")
    assert caught.value.fix == "did you mean 'turntable'?"


@pytest.mark.parametrize("name", [*shipped_pipelines(), *shipped_presets()])
def test_resolved_yaml_reads_back_as_the_same_pipeline(tmp_path: Path, name: str):
    original = load_pipeline({**shipped_pipelines(), **shipped_presets()}[name])
    assert load_pipeline(write(tmp_path, "p.yaml", resolved_yaml(original))) == original


@given(
    st.text(max_size=20),
    st.floats(1e-12, 1e9),
    st.sampled_from(["auto", "mm", 2.5]),
    st.lists(st.fixed_dictionaries({"type": st.just("spot"), "cone_deg": st.floats(1, 170)}),
             max_size=2),
)  # fmt: skip
def test_any_pipeline_survives_its_resolved_yaml(
    tmp_path_factory: pytest.TempPathFactory,
    description: str, irradiance: float, units: Any, lights: list[Any],
):  # fmt: skip
    lamp = {"type": "ambient", "irradiance": irradiance}
    original = Pipeline.model_validate(
        {"description": description, "lights": [lamp, *lights], "scan": {"units": units}}
    )
    path = tmp_path_factory.mktemp("yaml") / "p.yaml"
    assert load_pipeline(write(path.parent, "p.yaml", resolved_yaml(original))) == original
