"""--set KEY=VALUE goes through the same models as a file."""

from __future__ import annotations

import pytest

from scanrender.errors import ConfigError, UsageError
from scanrender.settings.loading import load_pipeline


def test_values_are_yaml():
    found = load_pipeline(
        "turntable",
        ["camera.width_px=1080", "skin.scale=1e-3", "outputs.buffers=[albedo, skin]",
         "view.transform=neutral", "outputs.video=false", "scan.units=2.5",
         "lights=[{type: ambient}]"],
    )  # fmt: skip
    assert found.camera.width_px == 1080
    assert found.skin.scale == 1e-3
    assert found.outputs.buffers == ("albedo", "skin")
    assert (found.view.transform, found.outputs.video, found.scan.units) == ("neutral", False, 2.5)
    assert [light.type for light in found.lights] == ["ambient"]


def test_the_later_override_wins():
    found = load_pipeline("turntable", ["camera.fill=0.1", "camera.fill=0.2"])
    assert found.camera.fill == 0.2


def test_one_item_of_a_list_of_the_file():
    before = load_pipeline("turntable")
    after = load_pipeline("turntable", ["lights.0.irradiance=9"])
    assert after.lights[0].irradiance == 9.0
    assert after.lights[1:] == before.lights[1:]
    assert after.lights[0].colour == before.lights[0].colour


@pytest.mark.parametrize("key", ["lights.0.irradiance", "skin.specular.roughness.0"])
def test_one_item_of_a_list_that_only_the_defaults_have(key: str):
    found = load_pipeline("prep_only", [f"{key}=0.5"])
    assert found.lights[0].irradiance == (0.5 if key.startswith("lights") else 2.0)
    assert found.skin.specular.roughness == ((0.38, 0.22) if key.startswith("l") else (0.5, 0.22))


@pytest.mark.parametrize(
    ("text", "fault"),
    [("camera.witdh_px=3", "camera.witdh_px"), ("camera.width_px=-3", "camera.width_px"),
     ("lights.7.irradiance=2", "no item 7"), ("lights.first.irradiance=2", "no item 'first'"),
     ("lights.-1.irradiance=2", "no item '-1'"), ("camera=3", "camera"),
     ("camera..fill=1", "camera."), ("camera.fill.deep=1", "camera.fill"),
     ("skin.scale=[1", "not valid YAML"), ("skin.scale=!!python/name:os x", "YAML"),
     ("extends=light/flat", "extends"), ("outputs.buffers.9=albedo", "no item 9")],
)  # fmt: skip
def test_a_wrong_override_is_a_config_error_that_shows_it(text: str, fault: str):
    with pytest.raises(ConfigError) as caught:
        load_pipeline("turntable", [text])
    assert fault in caught.value.what
    assert caught.value.where == f"--set {text}"


def test_a_suggestion_for_a_mistyped_override():
    with pytest.raises(ConfigError) as caught:
        load_pipeline("turntable", ["camera.witdh_px=3"])
    assert caught.value.fix == "did you mean 'width_px'?"


@pytest.mark.parametrize("text", ["camera.fill", "=3", " =3", ""])
def test_an_override_without_key_or_value_is_a_usage_error(text: str):
    with pytest.raises(UsageError, match="KEY=VALUE"):
        load_pipeline("turntable", [text])
