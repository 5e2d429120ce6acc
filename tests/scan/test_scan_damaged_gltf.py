"""glTF that is damaged, or says what makes no sense: noted or refused, in printable words."""

from __future__ import annotations

import base64
import json

import DracoPy
import numpy as np
import pytest
from scan_gltf import NOISE, Gltf, volume
from scan_shapes import sphere

from scanrender.errors import ScanError
from scanrender.scan import read_gltf

SHADES = np.random.default_rng(0).uniform(0.1, 0.9, (8, 3)).astype("<f4")
NAN = float("nan")


def draco(blob):
    """A document whose only primitive is `blob`, compressed by Draco."""
    made = Gltf()
    extension = {"bufferView": made.view(blob), "attributes": {"POSITION": 0}}
    made.primitive["extensions"] = {"KHR_draco_mesh_compression": extension}
    return made


def test_draco_cut_or_overwritten(tmp_path):
    positions, faces, _ = sphere(0.1, 8, 16)
    whole = DracoPy.encode(positions.astype(np.float32), faces.astype(np.uint32))
    assert len(draco(whole).read(tmp_path / "a.glb").faces) == len(faces)
    for damaged in (whole[: len(whole) // 2], whole[:20] + b"\xff" * 20 + whole[40:]):
        with pytest.raises(ScanError, match=r"a\.glb: its Draco data is damaged") as caught:
            draco(damaged).read(tmp_path / "a.glb")
        assert caught.value.fix


@pytest.mark.parametrize(
    ("values", "kind"),
    [(SHADES[:5], "VEC3"), (np.tile(SHADES, (2, 1)), "VEC3"), (SHADES[:, 0], "SCALAR")],
)
def test_vertex_colours_that_do_not_fit(tmp_path, values, kind):
    made = Gltf()
    made.attributes["COLOR_0"] = made.add(values, 5126, kind)
    raw = made.read(tmp_path / "a.glb")
    assert raw.colors is None
    assert raw.notes == ("vertex colours that do not fit the vertices are ignored",)


def test_vertex_colours_too_many_do_not_shift_those_of_the_next_primitive(tmp_path):
    made = Gltf()
    many = np.tile(np.array([1, 0, 0], "<f4"), (12, 1))
    blue = np.tile(np.array([0, 0, 1], "<f4"), (8, 1))
    first = {**made.attributes, "COLOR_0": made.add(many, 5126, "VEC3")}
    second = {**made.attributes, "COLOR_0": made.add(blue, 5126, "VEC3")}
    made.document["meshes"][0]["primitives"] = [
        {**made.primitive, "attributes": first},
        {**made.primitive, "attributes": second},
    ]
    raw = made.read(tmp_path / "a.glb")
    assert (raw.colors[raw.faces[12:]] == [0, 0, 1]).all()
    assert (raw.colors[raw.faces[:12]] == [1, 1, 1]).all()


@pytest.mark.parametrize("columns", [[0], [0, 1, 2]])
def test_texture_coordinates_that_do_not_fit(tmp_path, columns):
    made = Gltf()
    made.textured(tmp_path)
    values = made.positions[:, columns].astype("<f4")
    kind = {1: "SCALAR", 3: "VEC3"}[len(columns)]
    made.attributes["TEXCOORD_0"] = made.add(values, 5126, kind)
    raw = made.read(tmp_path / "a.glb")
    assert raw.color_source == "none"
    assert "texture coordinates that do not fit the vertices are ignored" in raw.notes


@pytest.mark.parametrize("kind", ["VEC2", "VEC4"])
def test_positions_of_another_width(tmp_path, kind):
    made = Gltf()
    wide = np.tile(made.positions, (1, 2))[:, : int(kind[-1])]
    made.attributes["POSITION"] = made.add(wide.astype("<f4"), 5126, kind)
    with pytest.raises(ScanError, match="positions are not 3 numbers for each vertex"):
        made.read(tmp_path / "a.glb")


@pytest.mark.parametrize("first", [0.0, NAN, 1e30])
def test_indices_that_are_not_whole_numbers(tmp_path, first):
    made = Gltf()
    indices = made.faces.astype("<f4").reshape(-1)
    indices[0] = first
    made.primitive["indices"] = made.add(indices, 5126, "SCALAR")
    with pytest.raises(ScanError, match=r"indices.* whole numbers"):
        made.read(tmp_path / "a.glb")


@pytest.mark.parametrize("wrong", [NAN, float("inf"), -float("inf")])
def test_vertex_colours_that_are_not_finite_take_the_mean(tmp_path, wrong):
    made = Gltf()
    colors = SHADES.copy()
    colors[0, 1] = wrong
    made.attributes["COLOR_0"] = made.add(colors, 5126, "VEC3")
    raw = made.read(tmp_path / "a.glb")
    np.testing.assert_allclose(raw.colors[0], SHADES[1:].mean(axis=0), rtol=1e-6)
    np.testing.assert_array_equal(raw.colors[1:], SHADES[1:])
    assert raw.notes == ("1 vertices have no colour: they take the mean one",)
    made.attributes["COLOR_0"] = made.add(np.full_like(colors, wrong), 5126, "VEC3")
    raw = made.read(tmp_path / "b.glb")
    assert raw.colors is None
    assert raw.notes == ("the vertex colours are not numbers: they are ignored",)


def test_vertex_colours_are_clamped_and_those_beside_a_texture_not_repaired(tmp_path):
    made = Gltf()
    colors = SHADES.copy()
    colors[0], colors[1] = -5.0, 1.4
    made.attributes["COLOR_0"] = made.add(colors, 5126, "VEC3")
    raw = made.read(tmp_path / "a.glb")
    assert raw.colors[:2].tolist() == [[0.0] * 3, [1.0] * 3]
    made.textured(tmp_path)
    colors[0] = NAN
    made.attributes["COLOR_0"] = made.add(colors, 5126, "VEC3")
    raw = made.read(tmp_path / "b.glb")
    assert raw.notes == ("vertex colours beside a texture are ignored: the texture is used",)


@pytest.mark.parametrize("textured", [True, False])
@pytest.mark.parametrize(("wrong", "read"), [(NAN, 1.0), (float("inf"), 1.0), (-3.0, 0.0), (7, 1)])
def test_colour_factors_are_fractions(tmp_path, textured, wrong, read):
    made = Gltf()
    made.textured(tmp_path)
    pbr = made.document["materials"][0]["pbrMetallicRoughness"]
    pbr["baseColorFactor"] = [wrong, 0.5, 0.25, 1.0]
    if not textured:
        del pbr["baseColorTexture"]
    raw = made.read(tmp_path / "a.glb")
    assert raw.pages[0].factor == (read, 0.5, 0.25)
    assert raw.notes == ("a material has a colour that is not a fraction: it is made one",)


ODD = {"surrogate": "\ud800.png", "long": "x" * 5000, "lines": "a\nb\x1b[31m\u2028.png"}


def assert_printable(sentences):
    assert sentences
    assert all(text.isprintable() and len(text) < 250 for text in sentences)


@pytest.mark.parametrize("odd", ODD)
def test_names_of_images_and_materials_are_printable(tmp_path, odd):
    made = Gltf()
    made.textured(tmp_path)
    red = {"name": ODD[odd], "pbrMetallicRoughness": {"baseColorFactor": [1, 0, 0, 1]}}
    made.document["materials"].append(red)
    made.document["meshes"][0]["primitives"].append({**made.primitive, "material": 1})
    made.document["images"] = [{"uri": ODD[odd]}]
    raw = made.read(tmp_path / "a.glb")
    assert any(note.endswith("is missing") for note in raw.notes)
    assert_printable([*raw.notes, *(page.name for page in raw.pages)])
    made.document["images"] = [{"name": ODD[odd], "uri": "data:image/png;base64,AAAA"}]
    raw = made.read(tmp_path / "a.glb")
    assert any("neither PNG" in note for note in raw.notes)
    assert_printable(raw.notes)


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


def test_primitives_count_once_for_each_node_that_shows_them(tmp_path):
    """2^10 nodes that show 1,000 primitives, in some kilobytes: none of them is decoded."""
    made = Gltf()
    made.document["meshes"] = [{"primitives": [made.primitive] * 1000}]
    doubling = [{"children": [i + 1, i + 1]} for i in range(10)]
    made.document["nodes"] = [*doubling, {"mesh": 0}]
    with pytest.raises(ScanError, match="shows more than 100,000 meshes"):
        made.read(tmp_path / "a.glb")


def test_primitives_are_decoded_once_however_often_they_are_shown(tmp_path, monkeypatch):
    decoded = []
    once = read_gltf._primitive
    monkeypatch.setattr(read_gltf, "_primitive", lambda *a: decoded.append(1) or once(*a))
    made = Gltf()
    made.document["nodes"] = [{"mesh": 0, "translation": [3 * i, 0, 0]} for i in range(5)]
    made.document["scenes"] = [{"nodes": list(range(5))}]
    raw = made.read(tmp_path / "a.glb")
    assert volume(raw) == pytest.approx(5.0)
    assert raw.positions.max(axis=0).tolist() == [13.0, 1.0, 1.0]
    assert len(decoded) == 1


def test_an_image_of_several_materials_is_held_once(tmp_path):
    made = Gltf()
    made.textured(tmp_path)
    made.document["materials"] *= 2
    made.document["meshes"][0]["primitives"].append({**made.primitive, "material": 1})
    first, second = made.read(tmp_path / "a.glb").pages
    assert first.pixels is second.pixels


@pytest.mark.parametrize("where", ["mesh", "node"])
def test_morph_targets_are_applied_as_far_as_the_file_says(tmp_path, where):
    made = Gltf()
    moved = np.tile(np.array([4, 0, 0], "<f4"), (8, 1)) * made.positions.astype("<f4")
    target = {"POSITION": made.add(moved, 5126, "VEC3")}
    made.primitive["targets"] = [{}, target, target]
    made.document["meshes"][0]["weights"] = [1.0, 0.5, 0.0] if where == "mesh" else [0, 9, 9]
    if where == "node":
        made.document["nodes"][0]["weights"] = [1.0, 0.5, 0.0]
    assert volume(made.read(tmp_path / "a.glb")) == pytest.approx(3.0)
    made.accessors[target["POSITION"]]["count"] = 7
    with pytest.raises(ScanError, match=r"morph targets.* do not fit"):
        made.read(tmp_path / "a.glb")
    made.document["nodes"][0]["weights"] = [NAN]
    with pytest.raises(ScanError, match=r"morph targets.* not finite"):
        made.read(tmp_path / "b.glb")


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    "place",
    [{"scale": [1e400, 1, 1]}, {"translation": [NAN, 0, 0]}, {"rotation": [1e200, 0, 0, 1]}],
    ids=str,
)
def test_nodes_that_are_nowhere(tmp_path, place):
    made = Gltf()
    made.document["nodes"][0].update(place)
    with pytest.raises(ScanError, match="no usable face"):
        made.read(tmp_path / "a.glb")


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("transform", [{"rotation": 1e400}, {"offset": [1e300, 0]}], ids=str)
def test_texture_transforms_that_lead_nowhere(tmp_path, transform):
    made = Gltf()
    made.textured(tmp_path, extensions={"KHR_texture_transform": transform})
    raw = made.read(tmp_path / "a.glb")
    assert raw.notes == ("12 faces have an image but no texture coordinates",)


def test_instances_of_an_extension_are_said_to_be_ignored(tmp_path):
    made = Gltf()
    made.document["extensionsUsed"] = ["EXT_mesh_gpu_instancing"]
    (note,) = made.read(tmp_path / "a.glb").notes
    assert "EXT_mesh_gpu_instancing" in note


def test_json_padded_with_zeros(tmp_path):
    made = Gltf()
    made.read(tmp_path / "a.glb")
    data = (tmp_path / "a.glb").read_bytes()
    size = int.from_bytes(data[12:16], "little")
    text = json.dumps(made.document, separators=(",", ":")).encode().ljust(size, b"\0")
    assert text.endswith(b"\0")
    (tmp_path / "b.glb").write_bytes(data[:20] + text + data[20 + size :])
    assert volume(read_gltf.read_gltf(tmp_path / "b.glb")) == pytest.approx(1.0)


@pytest.mark.parametrize(
    "change", [{"nodes": [], "scenes": []}, {"scenes": [{}]}, {"nodes": [{}]}], ids=str
)
def test_meshes_that_no_node_shows(tmp_path, change):
    made = Gltf()
    made.document.update(change)
    with pytest.raises(ScanError, match="no node of its scene shows its meshes"):
        made.read(tmp_path / "a.glb")


@pytest.mark.parametrize("scene", [[0], [0, 1]])
def test_skin_whose_bind_matrix_is_all_zeros(tmp_path, scene):
    """A joint of the scene makes a point of the mesh; one outside leaves it where it is."""
    made = Gltf()
    made.attributes["JOINTS_0"] = made.add(np.zeros((8, 4), "u1"), 5121, "VEC4")
    weights = np.tile(np.array([1, 0, 0, 0], "<f4"), (8, 1))
    made.attributes["WEIGHTS_0"] = made.add(weights, 5126, "VEC4")
    zeros = made.add(np.zeros((1, 16), "<f4"), 5126, "MAT4")
    made.document["skins"] = [{"joints": [1], "inverseBindMatrices": zeros}]
    made.document["nodes"] = [{"mesh": 0, "skin": 0}, {}]
    made.document["scenes"] = [{"nodes": scene}]
    if scene == [0]:
        assert volume(made.read(tmp_path / "a.glb")) == pytest.approx(1.0)
        return
    with pytest.raises(ScanError, match="all its vertices coincide"):
        made.read(tmp_path / "a.glb")


def test_embedded_data_of_a_uri(tmp_path):
    made = Gltf()
    text = base64.b64encode(made.blob).decode().replace("=", "%3D").replace("/", "%2F")
    raw = made.read(tmp_path / "a.gltf", f"data:;base64,{text.replace('+', '%2B')}")
    assert volume(raw) == pytest.approx(1.0)
