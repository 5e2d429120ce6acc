"""The catalogue: names that are API in Python, GLSL, EXR and docs alike."""

from __future__ import annotations

import re

import pytest

from scanrender.buffers import CATALOGUE, buffer_spec
from scanrender.errors import UsageError


@pytest.mark.parametrize("spec", CATALOGUE.values(), ids=lambda spec: spec.name)
def test_each_buffer_is_described_whole(spec):
    assert re.fullmatch(r"[a-z][a-z0-9_]*", spec.name), "a GLSL and EXR name, a letter first"
    assert all((spec.space, spec.unit, spec.meaning, spec.healthy))
    assert spec.meaning.endswith((".", ";"))
    assert spec.span is None or spec.span[0] < spec.span[1]
    for channel in spec.channels:
        assert channel.count(".") == 1, "Nuke and tev group layers by one dot"
        assert channel.startswith(f"{spec.name}.")


def test_channel_names_by_kind():
    assert buffer_spec("albedo").channels == ("albedo.R", "albedo.G", "albedo.B")
    assert buffer_spec("position").channels == ("position.X", "position.Y", "position.Z")
    assert buffer_spec("depth_mm").channels == ("depth_mm.Y",)


@pytest.mark.parametrize("name", ["shadow_3", "visibility_12", "gaussian_5"])
def test_numbered_buffers_take_their_family_s_description(name: str):
    spec = buffer_spec(name)
    family = buffer_spec(f"{name.rsplit('_', 1)[0]}_0")
    assert spec.name == name
    assert (spec.kind, spec.unit, spec.span) == (family.kind, family.unit, family.span)


@pytest.mark.parametrize("name", ["", "shadow", "shadow_x", "position_1", "Albedo", "shadow_0 "])
def test_unknown_names_are_usage_errors(name: str):
    with pytest.raises(UsageError) as caught:
        buffer_spec(name)
    assert repr(name) in caught.value.what
