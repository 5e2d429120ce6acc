"""Colours that libraries lose in silence: each is read right, or its loss is said."""

from __future__ import annotations

import json
import struct

import numpy as np
import pytest
from scan_shapes import cube, sphere, write_obj

from scanrender import images
from scanrender.scan.ingest import read_scan
from scanrender.scan.raw import NO_PAGE

NOISE = np.random.default_rng(0).integers(0, 256, (4, 4, 3)).astype(np.uint8)


@pytest.fixture
def ball(tmp_path):
    """write(mtl): an OBJ of a sphere that names the material file `mtl` and the material skin."""
    positions, faces, uv = sphere(rows=4, columns=6)
    images.write_image(tmp_path / "skin.png", NOISE)
    return lambda mtl: write_obj(tmp_path / "a.obj", positions, faces, uv, mtl)


@pytest.mark.parametrize("present", ["a.mtl", "a.obj.mtl", "other.mtl"])
def test_a_misnamed_mtl_is_found_and_said(tmp_path, ball, present):
    images.write_image(tmp_path / "decoy.png", NOISE)  # so that there is no lone image
    (tmp_path / present).write_text("newmtl skin\nmap_Kd skin.png\n")
    raw = read_scan(ball("export_final.mtl"))
    assert [page.name for page in raw.pages] == ["skin.png"]
    assert any("export_final.mtl is missing" in note for note in raw.notes)
    assert any(f"{present}, beside the scan" in note for note in raw.notes)


def test_two_material_files_on_one_line(tmp_path, ball):
    (tmp_path / "x.mtl").write_text("newmtl unused\nKd 1 0 0\n")
    (tmp_path / "y.mtl").write_text("newmtl skin\nmap_Kd skin.png\n")
    assert [page.name for page in read_scan(ball("x.mtl y.mtl")).pages] == ["skin.png"]


def test_an_image_under_another_materials_name_or_map_is_still_used(tmp_path, ball):
    (tmp_path / "m.mtl").write_text("newmtl Skin_0\nmap_Ka skin.png\n")
    raw = read_scan(ball("m.mtl"))
    assert (raw.page == 0).all()
    assert any("Skin_0 is used for all" in note for note in raw.notes)
    assert any("does not describe skin" in note for note in raw.notes)


def test_alpha_never_darkens_a_texture(tmp_path, ball):
    """Image libraries multiply colours by alpha unasked; a texture's alpha is a cut-out."""
    alpha = np.full((4, 4, 1), 64, np.uint8)
    images.write_image(
        tmp_path / "skin.png",
        np.concatenate([NOISE, alpha], axis=2),
        attributes={"oiio:UnassociatedAlpha": 1},
    )
    (tmp_path / "m.mtl").write_text("newmtl skin\nmap_Kd skin.png\n")
    [page] = read_scan(ball("m.mtl")).pages
    np.testing.assert_array_equal(page.pixels, NOISE)


@pytest.mark.parametrize("dtype", ["uint8", "uint16", "float32"])
@pytest.mark.parametrize("channels", [1, 3])
def test_images_are_kept_as_stored(tmp_path, dtype, channels):
    top = np.iinfo(dtype).max if dtype != "float32" else 1.0
    stored = (np.random.default_rng(1).random((3, 5, channels)) * top).astype(dtype)
    path = images.write_image(tmp_path / f"a.{'tif' if dtype == 'float32' else 'png'}", stored)
    back = images.read_colors(path)
    assert back.dtype == dtype
    np.testing.assert_array_equal(back, np.broadcast_to(stored, (3, 5, 3)))


def test_a_placeholder_is_noticed(tmp_path, ball):
    images.write_image(tmp_path / "skin.png", np.full((64, 64, 3), 200, np.uint8))
    (tmp_path / "m.mtl").write_text("newmtl skin\nmap_Kd skin.png\n")
    assert any("placeholder" in note for note in read_scan(ball("m.mtl")).notes)


def ply_of_two_squares(tmp_path, textures, texcoords):
    """Two quads; texcoords: per quad the texture's number and its corners, or None."""
    for name in ("one.png", "two.png"):
        images.write_image(tmp_path / name, NOISE)
    lines = ["ply", "format ascii 1.0", *(f"comment TextureFile {name}" for name in textures)]
    lines += ["element vertex 6", *(f"property float {axis}" for axis in "xyz")]
    lines += ["element face 2", "property list uchar int vertex_indices"]
    lines += ["property list uchar float texcoord", "property int texnumber", "end_header"]
    lines += ["0 0 0", "1 0 0", "1 1 0", "0 1 0", "2 0 0", "2 1 0"]
    for corners, (number, uv) in zip(("0 1 2 3", "1 4 5 2"), texcoords, strict=True):
        flat = "" if uv is None else " ".join(str(x) for pair in uv for x in pair)
        lines.append(f"4 {corners} {0 if uv is None else 8} {flat} {number}")
    (tmp_path / "a.ply").write_text("\n".join(lines) + "\n")
    return read_scan(tmp_path / "a.ply")


UNIT = [(0, 0), (1, 0), (1, 1), (0, 1)]


def test_ply_texture_numbers_choose_their_page_also_when_one_is_missing(tmp_path):
    both = ply_of_two_squares(tmp_path, ["one.png", "two.png"], [(0, UNIT), (1, UNIT)])
    assert both.page.tolist() == [0, 0, 1, 1]
    np.testing.assert_allclose(both.corner_uv[0], [[0, 1], [1, 1], [1, 0]])
    rest = ply_of_two_squares(tmp_path, ["gone.png", "two.png"], [(0, UNIT), (1, UNIT)])
    assert rest.page.tolist() == [NO_PAGE, NO_PAGE, 0, 0]
    assert [page.name for page in rest.pages] == ["two.png"]
    assert any("gone.png is missing" in note for note in rest.notes)


def test_ply_faces_without_texture_coordinates_do_not_cost_the_others_theirs(tmp_path):
    raw = ply_of_two_squares(tmp_path, ["one.png"], [(0, UNIT), (-1, None)])
    assert raw.page.tolist() == [0, 0, NO_PAGE, NO_PAGE]
    assert np.isfinite(raw.corner_uv[:2]).all()


def test_ply_strips_in_several_rows_are_not_joined(tmp_path):
    (tmp_path / "a.ply").write_text(
        "ply\nformat ascii 1.0\nelement vertex 6\nproperty float x\nproperty float y\n"
        "property float z\nelement tristrips 2\nproperty list int int vertex_indices\nend_header\n"
        "0 0 0\n1 0 0\n0 1 0\n5 0 0\n6 0 0\n5 1 0\n3 0 1 2\n3 3 4 5\n"
    )
    assert read_scan(tmp_path / "a.ply").faces.tolist() == [[0, 1, 2], [3, 4, 5]]


def gltf_of_cubes(tmp_path, primitives, materials):
    """One GLB whose primitives are the same cube; each is (material or None, colours or None)."""
    positions, faces = cube()
    blob = positions.astype("<f4").tobytes() + faces.astype("<u2").tobytes()
    views = [{"byteOffset": 0, "byteLength": 96}, {"byteOffset": 96, "byteLength": 72}]
    accessors = [
        {"bufferView": 0, "componentType": 5126, "count": 8, "type": "VEC3"},
        {"bufferView": 1, "componentType": 5123, "count": 36, "type": "SCALAR"},
    ]
    entries = []
    for material, colors in primitives:
        attributes = {"POSITION": 0}
        if colors is not None:
            attributes["COLOR_0"] = len(accessors)
            data = np.asarray(colors, "<f4").tobytes()
            accessors.append(
                {"bufferView": len(views), "componentType": 5126, "count": 8, "type": "VEC3"}
            )
            views.append({"byteOffset": len(blob), "byteLength": len(data)})
            blob += data
        entry = {"attributes": attributes, "indices": 1}
        entries.append(entry if material is None else {**entry, "material": material})
    document = {
        "asset": {"version": "2.0"},
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": entries}],
        "materials": materials,
        "accessors": accessors,
        "bufferViews": [{"buffer": 0, **view} for view in views],
        "buffers": [{"byteLength": len(blob)}],
    }
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text
    chunks += struct.pack("<I4s", len(blob), b"BIN\0") + blob
    path = tmp_path / "a.glb"
    path.write_bytes(b"glTF" + struct.pack("<II", 2, 12 + len(chunks)) + chunks)
    return read_scan(path)


RED = {"pbrMetallicRoughness": {"baseColorFactor": [1.0, 0.2, 0.1, 1.0]}}


def test_gltf_vertex_colours_survive_a_material_and_take_its_factor(tmp_path):
    colors = np.random.default_rng(0).random((8, 3)).astype(np.float32)
    raw = gltf_of_cubes(tmp_path, [(0, colors)], [RED])
    assert raw.color_source == "vertex"
    np.testing.assert_allclose(raw.colors, colors * np.float32([1.0, 0.2, 0.1]), rtol=1e-6)


def test_gltf_plain_materials_beside_vertex_colours_become_vertex_colours(tmp_path):
    colors = np.random.default_rng(0).random((8, 3)).astype(np.float32)
    raw = gltf_of_cubes(tmp_path, [(None, colors), (0, None)], [RED])
    assert raw.color_source == "vertex"
    np.testing.assert_allclose(raw.colors[:8], colors, rtol=1e-6)
    np.testing.assert_allclose(raw.colors[8:], [[1.0, 0.2, 0.1]] * 8, rtol=1e-6)


def test_off_face_colours_in_both_notations(tmp_path):
    for name, red, blue in (("a", "255 0 0", "0 0 255"), ("b", "1.0 0.0 0.0", "0.0 0.0 1.0")):
        (tmp_path / f"{name}.off").write_text(
            f"OFF\n4 2 0\n0 0 0\n1 0 0\n0 1 0\n1 1 1\n3 0 1 2 {red}\n3 1 3 2 {blue}\n"
        )
        raw = read_scan(tmp_path / f"{name}.off")
        np.testing.assert_allclose(raw.colors[0], [1, 0, 0], atol=1e-6)
        np.testing.assert_allclose(raw.colors[3], [0, 0, 1], atol=1e-6)
        np.testing.assert_allclose(raw.colors[1], [0.5, 0, 0.5], atol=1e-6)
