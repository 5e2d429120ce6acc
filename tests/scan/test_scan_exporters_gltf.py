"""glTF as exporters and compressors write it: read right, or refused in a sentence."""

from __future__ import annotations

import base64

import numpy as np
import pytest
from scan_gltf import NOISE, Gltf, volume

from scanrender.errors import ScanError


@pytest.mark.parametrize("index", ["u1", "<u2", "<u4"])
def test_gltf_indices_of_any_width(tmp_path, index):
    assert volume(Gltf(index).read(tmp_path / "a.glb")) == pytest.approx(1.0)


def test_gltf_interleaved_buffer(tmp_path):
    """Position, normal, UV and colour of one vertex side by side."""
    made = Gltf()
    fields = [("p", "<f4", 3), ("n", "<f4", 3), ("uv", "<f4", 2), ("c", "u1", 4)]
    vertex = np.zeros(8, fields)
    vertex["p"], vertex["uv"] = made.positions, made.positions[:, :2]
    vertex["c"] = np.arange(32).reshape(8, 4) * 8
    view = made.view(vertex.tobytes(), byteStride=36)
    places = {"POSITION": (0, 5126, "VEC3"), "TEXCOORD_0": (24, 5126, "VEC2")}
    for name, (offset, component, kind) in {**places, "COLOR_0": (32, 5121, "VEC4")}.items():
        made.accessors.append(
            {"bufferView": view, "byteOffset": offset, "componentType": component, "count": 8,
             "type": kind, "normalized": component == 5121})  # fmt: skip
        made.attributes[name] = len(made.accessors) - 1
    raw = made.read(tmp_path / "a.glb")
    assert volume(raw) == pytest.approx(1.0)
    np.testing.assert_allclose(raw.corner_uv, made.positions[made.faces][:, :, :2])
    np.testing.assert_allclose(raw.colors, vertex["c"][:, :3] / 255.0, atol=1e-6)


def test_gltf_sparse_accessor(tmp_path):
    made = Gltf()
    moved = made.positions.astype("<f4") * 2.0
    zeros = made.accessors[0]
    zeros["sparse"] = {
        "count": 8,
        "indices": {"bufferView": made.view(np.arange(8, dtype="<u2").tobytes()),
                    "componentType": 5123},
        "values": {"bufferView": made.view(moved.tobytes())},
    }  # fmt: skip
    assert volume(made.read(tmp_path / "a.glb")) == pytest.approx(8.0)
    del zeros["bufferView"]
    assert volume(made.read(tmp_path / "b.glb")) == pytest.approx(8.0)
    zeros["sparse"]["indices"]["bufferView"] = made.view(np.full(8, 9, "<u2").tobytes())
    with pytest.raises(ScanError, match="names elements that it does not have"):
        made.read(tmp_path / "c.glb")


@pytest.mark.parametrize("normalized", [True, False])
def test_gltf_quantized_positions(tmp_path, normalized):
    """KHR_mesh_quantization: 16-bit positions, padded to a stride of 8, scaled by their node."""
    made = Gltf()
    stored = np.zeros((8, 4), "<i2")
    stored[:, :3] = made.positions * (32767 if normalized else 1000)
    view = made.view(stored.tobytes(), byteStride=8)
    made.accessors[0].update(bufferView=view, componentType=5122, normalized=normalized)
    made.document["extensionsRequired"] = ["KHR_mesh_quantization"]
    made.document["nodes"] = [{"mesh": 0, "scale": [0.3 if normalized else 3e-4] * 3}]
    assert volume(made.read(tmp_path / "a.glb")) == pytest.approx(0.027, rel=1e-4)


@pytest.mark.parametrize(("component", "dtype"), [(5121, "u1"), (5123, "<u2")])
@pytest.mark.parametrize("normalized", [True, False])
def test_gltf_integer_colours_marked_as_fractions_or_not(tmp_path, component, dtype, normalized):
    made = Gltf()
    stored = np.random.default_rng(0).integers(0, np.iinfo(dtype).max, (8, 3)).astype(dtype)
    made.attributes["COLOR_0"] = made.add(stored, component, "VEC3", normalized=normalized)
    raw = made.read(tmp_path / "a.glb")
    np.testing.assert_allclose(raw.colors, stored / np.iinfo(dtype).max, atol=1e-6)


def test_gltf_texture_transform(tmp_path):
    """Scaled, then turned counter-clockwise as the image is seen (v down), then moved."""
    made = Gltf()
    transform = {"offset": [0.5, 0.25], "rotation": np.pi / 2, "scale": [2, 1]}
    made.textured(tmp_path, extensions={"KHR_texture_transform": transform})
    raw = made.read(tmp_path / "a.glb")
    u, v = (made.positions[made.faces][:, :, axis] for axis in (0, 1))
    expected = np.stack([0.5 + v, 0.25 - 2.0 * u], axis=-1)
    np.testing.assert_allclose(raw.corner_uv, expected, atol=1e-6)
    np.testing.assert_array_equal(raw.pages[0].pixels, NOISE)


def test_gltf_in_pieces_and_in_one(tmp_path):
    """An external buffer and image with blanks in their names, and all of it as data URIs."""
    made = Gltf()
    made.textured(tmp_path)
    (tmp_path / "my scan.bin").write_bytes(made.blob)
    raw = made.read(tmp_path / "a.gltf", "my%20scan.bin")
    assert volume(raw) == pytest.approx(1.0)
    assert raw.color_source == "texture"
    image = base64.b64encode((tmp_path / "my skin.png").read_bytes()).decode()
    made.document["images"] = [{"uri": f"data:image/png;base64,{image}"}]
    whole = base64.b64encode(made.blob).decode()
    raw = made.read(tmp_path / "b.gltf", f"data:application/octet-stream;base64,{whole}")
    np.testing.assert_array_equal(raw.pages[0].pixels, NOISE)
    with pytest.raises(ScanError, match=r"needs gone\.bin, which is missing"):
        made.read(tmp_path / "c.gltf", "gone.bin")


def test_gltf_mirrored_inside_mirrored_is_not_mirrored(tmp_path):
    made = Gltf()
    made.document["nodes"] = [
        {"children": [1], "scale": [-1, 1, 1]},
        {"mesh": 0, "scale": [-1, 1, 1]},
    ]
    assert volume(made.read(tmp_path / "a.glb")) == pytest.approx(1.0)


def test_gltf_an_image_that_glows_is_the_colour(tmp_path):
    made = Gltf()
    made.textured(tmp_path)
    texture = made.document["materials"][0]["pbrMetallicRoughness"].pop("baseColorTexture")
    made.document["materials"][0].update(emissiveTexture=texture, emissiveFactor=[1, 1, 1])
    raw = made.read(tmp_path / "a.glb")
    assert raw.color_source == "texture"
    assert any("light of its own" in note for note in raw.notes)


def skinned_cube():
    """A cube whose joint turns it by 90 degrees and whose bind matrix scales it by 100."""
    made = Gltf()
    made.attributes["JOINTS_0"] = made.add(np.zeros((8, 4), "u1"), 5121, "VEC4")
    weights = np.tile(np.array([255, 0, 0, 0], "u1"), (8, 1))
    made.attributes["WEIGHTS_0"] = made.add(weights, 5121, "VEC4", normalized=True)
    bind = np.diag([100.0, 100.0, 100.0, 1.0]).astype("<f4").reshape(1, 16)
    inverse = made.add(bind, 5126, "MAT4")
    half = float(np.sqrt(0.5))
    made.document["nodes"] = [
        {"mesh": 0, "skin": 0, "translation": [9, 9, 9]},
        {"rotation": [half, 0, 0, half], "translation": [0, 0, 5]},
    ]
    made.document["scenes"] = [{"nodes": [0, 1]}]
    made.document["skins"] = [{"joints": [1], "inverseBindMatrices": inverse}]
    return made


def test_gltf_skins_place_their_mesh_and_its_node_does_not(tmp_path):
    made = skinned_cube()
    raw = made.read(tmp_path / "a.glb")
    x, y, z = 100.0 * made.positions.T
    np.testing.assert_allclose(raw.positions, np.stack([x, -z, y + 5.0], axis=1), atol=1e-3)
    made.document["skins"][0]["joints"] = []
    with pytest.raises(ScanError, match="joints that it does not have"):
        made.read(tmp_path / "b.glb")


def test_gltf_two_meshes_are_both_read(tmp_path):
    made = Gltf()
    made.document["meshes"] *= 2
    made.document["nodes"] = [{"mesh": 0}, {"mesh": 1, "translation": [5, 0, 0]}, {}]
    made.document["scenes"] = [{"nodes": [0, 1, 2]}]
    raw = made.read(tmp_path / "a.glb")
    assert volume(raw) == pytest.approx(2.0)
    assert raw.positions[:, 0].max() == 6.0


REFUSED_GLTF = {
    "meshopt": ({"extensionsRequired": ["EXT_meshopt_compression"]}, "EXT_meshopt_compression"),
    "ktx2": ({"extensionsRequired": ["KHR_texture_basisu"]}, "KHR_texture_basisu"),
    "version 1": ({"asset": {"version": "1.0"}}, "glTF 1.0"),
    "negative index": ({"scenes": [{"nodes": [-1]}]}, "names nodes -1"),
    "index beyond": ({"nodes": [{"mesh": 7}]}, "names meshes 7, of which it has 1"),
    "word for a number": ({"nodes": [{"mesh": 0, "scale": "big"}]}, "damaged"),
    "nothing for a list": ({"nodes": None}, "damaged"),
}


@pytest.mark.parametrize("case", REFUSED_GLTF)
def test_gltf_refused_in_a_sentence(tmp_path, case):
    change, word = REFUSED_GLTF[case]
    made = Gltf()
    made.document.update(change)
    with pytest.raises(ScanError) as caught:
        made.read(tmp_path / "a.glb")
    assert word in caught.value.what
    assert caught.value.fix


def test_gltf_whose_data_is_only_there_compressed(tmp_path):
    """What gltfpack -cc writes: a buffer without data stands in for the compressed one."""
    made = Gltf()
    extension = {"EXT_meshopt_compression": {"buffer": 0, "byteLength": 9, "count": 8}}
    made.document["more_buffers"] = [
        {"byteLength": 500, "extensions": {"EXT_meshopt_compression": {"fallback": True}}}
    ]
    made.views[0].update(buffer=1, extensions=extension)
    with pytest.raises(ScanError, match="compressed by EXT_meshopt_compression"):
        made.read(tmp_path / "a.glb")
