"""glTF that is damaged, or says what makes no sense: noted or refused, in printable words."""

from __future__ import annotations

import base64
import json

import numpy as np
import pytest
from scan_gltf import NOISE, Gltf, volume

from scanrender.errors import ScanError
from scanrender.scan import read_gltf

ODD = {"surrogate": "\ud800.png", "long": "x" * 5000, "lines": "a\nb\x1b[31m\u2028.png"}


def assert_printable(sentences):
    assert sentences
    assert all(text.isprintable() and len(text) < 250 for text in sentences)


@pytest.mark.parametrize("odd", ODD)
@pytest.mark.parametrize(
    ("change", "word"),
    [
        (lambda name: {"extensionsRequired": [name]}, "requires"),
        (lambda name: {"more_buffers": [{"byteLength": 9, "uri": name}]}, "needs"),
        (lambda name: {"more_buffers": [{"byteLength": 999, "extensions": {name: {}}}]}, "is comp"),
        (lambda name: {"nodes": [{"mesh": name}]}, "names meshes"),
        (lambda name: {"asset": {"version": name}}, "is glTF"),
    ],
)
def test_names_in_refusals_are_printable(tmp_path, odd, change, word):
    made = Gltf()
    made.document.update(change(ODD[odd]))
    if "more_buffers" in made.document:
        made.views[0]["buffer"] = 1
    with pytest.raises(ScanError, match=word) as caught:
        made.read(tmp_path / "a.glb")
    assert_printable([caught.value.what])


def test_images_of_odd_names_are_found_all_the_same(tmp_path):
    made = Gltf()
    made.textured(tmp_path)
    for uri in ("my skin.png?v=2", "./my%20skin.png#x", "my skin.png?a#b"):
        made.document["images"] = [{"uri": uri}]
        raw = made.read(tmp_path / "a.glb")
        np.testing.assert_array_equal(raw.pages[0].pixels, NOISE)
    (tmp_path / "skin#1.png").write_bytes((tmp_path / "my skin.png").read_bytes())
    made.document["images"] = [{"uri": "skin#1.png"}]
    assert made.read(tmp_path / "a.glb").pages[0].name == "skin#1.png"


def test_an_image_of_several_materials_is_held_once(tmp_path):
    made = Gltf()
    made.textured(tmp_path)
    made.document["materials"] *= 2
    made.document["meshes"][0]["primitives"].append({**made.primitive, "material": 1})
    first, second = made.read(tmp_path / "a.glb").pages
    assert first.pixels is second.pixels


def test_json_padded_with_zeros(tmp_path):
    made = Gltf()
    made.read(tmp_path / "a.glb")
    data = (tmp_path / "a.glb").read_bytes()
    size = int.from_bytes(data[12:16], "little")
    text = json.dumps(made.document, separators=(",", ":")).encode().ljust(size, b"\0")
    assert text.endswith(b"\0")
    (tmp_path / "b.glb").write_bytes(data[:20] + text + data[20 + size :])
    assert volume(read_gltf.read_gltf(tmp_path / "b.glb")) == pytest.approx(1.0)


def test_embedded_data_of_a_uri(tmp_path):
    made = Gltf()
    text = base64.b64encode(made.blob).decode().replace("=", "%3D").replace("/", "%2F")
    raw = made.read(tmp_path / "a.gltf", f"data:;base64,{text.replace('+', '%2B')}")
    assert volume(raw) == pytest.approx(1.0)
