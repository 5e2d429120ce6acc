"""Each format gives the same mesh, and each kind of broken file one clear sentence."""

from __future__ import annotations

import json
import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scan_shapes import SCANS, cube, sphere, write_obj, write_ply

from scanrender import images
from scanrender.errors import ScanError, ScanrenderError, UsageError
from scanrender.scan.header import FORMATS
from scanrender.scan.ingest import read_scan
from scanrender.scan.raw import NO_PAGE
from scanrender.scan.triangulate import fan_corners, polygon_corners, strip_faces


def volume(raw):
    a, b, c = (raw.positions[raw.faces[:, i]] for i in range(3))
    return float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6.0)


def test_obj_with_texture_normal_map_and_uv_origin(tmp_path):
    positions, faces, uv = sphere(rows=6, columns=8)
    images.write_png8(tmp_path / "Skin Color.png", np.full((4, 4, 3), 0.5))
    images.write_png8(tmp_path / "bumps.png", np.full((4, 4, 3), [0.5, 0.5, 1.0]))
    (tmp_path / "m.mtl").write_text(
        "newmtl skin\nKd 0.2 0.9 0.1\nmap_Kd -s 1 1 1 skin color.png\nnorm bumps.png\n"
    )
    raw = read_scan(write_obj(tmp_path / "a.obj", positions, faces, uv, "m.mtl"))
    assert raw.faces.tolist() == faces.tolist()
    np.testing.assert_allclose(raw.corner_uv, uv, atol=1e-6)
    assert raw.color_source == "texture"
    assert raw.normal_pages[0] is not None
    level = np.float32(images.linear_from_srgb(np.array(128 / 255)))
    np.testing.assert_allclose(raw.pages[0].sample(np.array([[0.3, 0.7]])), [[level] * 3], 1e-4)


def test_obj_polygons_negative_indices_and_two_materials(tmp_path):
    (tmp_path / "m.mtl").write_text("newmtl red\nKd 1 0 0\nnewmtl blue\nKd 0 0 1\n")
    (tmp_path / "a.obj").write_text(
        "mtllib m.mtl\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nusemtl red\nf -4 -3 -2 -1\n"
        "v 0 0 1\nusemtl blue\nf 1//1 2//1 -1//1\n"
    )
    raw = read_scan(tmp_path / "a.obj")
    assert raw.faces.tolist() == [[0, 1, 2], [0, 2, 3], [0, 1, 4]]
    assert raw.page.tolist() == [0, 0, 1]
    np.testing.assert_allclose(raw.pages[1].sample(np.zeros((1, 2))), [[0, 0, 1]])


def test_obj_vertex_colours_are_srgb(tmp_path):
    positions, faces = cube()
    colors = np.tile([[0.5, 0.2, 0.1]], (8, 1))
    colors[0] = 0.9
    raw = read_scan(write_obj(tmp_path / "a.obj", positions, faces, colors=colors))
    np.testing.assert_allclose(raw.colors[1], images.linear_from_srgb(colors[1]), rtol=1e-4)


def test_lost_mtl_takes_the_image_beside_it(tmp_path):
    positions, faces, uv = sphere(rows=6, columns=8)
    images.write_png8(tmp_path / "atlas.png", np.full((4, 4, 3), 0.5))
    raw = read_scan(write_obj(tmp_path / "a.obj", positions, faces, uv, "gone.mtl"))
    assert raw.color_source == "texture"
    assert any("gone.mtl is missing" in note for note in raw.notes)
    assert any("atlas.png" in note for note in raw.notes)


@pytest.mark.parametrize("order", ["<", ">"])
def test_ply_binary_with_colours(tmp_path, order):
    positions, faces = cube()
    colors = np.arange(24, dtype=np.uint8).reshape(8, 3) * 10
    raw = read_scan(write_ply(tmp_path / "a.ply", positions, faces, colors, order))
    assert raw.faces.tolist() == faces.tolist()
    np.testing.assert_allclose(raw.colors, images.linear_from_srgb(colors / 255.0), atol=1e-6)


def test_ply_ascii_with_mixed_polygons(tmp_path):
    (tmp_path / "a.ply").write_text(
        "ply\nformat ascii 1.0\nelement vertex 5\nproperty float x\nproperty float y\n"
        "property float z\nelement face 2\nproperty list uchar int vertex_index\nend_header\n"
        "0 0 0\n1 0 0\n1 1 0\n0 1 0\n0 0 1\n4 0 1 2 3\n3 0 1 4\n"
    )
    assert read_scan(tmp_path / "a.ply").faces.tolist() == [[0, 1, 2], [0, 2, 3], [0, 1, 4]]


def test_stl_binary_and_ascii_agree(tmp_path):
    positions, faces = cube()
    record = np.zeros(len(faces), [("n", "<f4", 3), ("c", "<f4", (3, 3)), ("a", "<u2")])
    record["c"] = positions[faces]
    # "solid" in a binary header is the classic trap.
    head = b"solid exported by a tool".ljust(80, b" ") + struct.pack("<I", len(faces))
    (tmp_path / "b.stl").write_bytes(head + record.tobytes())
    text = "".join(
        "facet normal 0 0 0\nouter loop\n"
        + "".join(f"vertex {x} {y} {z}\n" for x, y, z in positions[f])
        + "endloop\nendfacet\n"
        for f in faces
    )
    (tmp_path / "a.stl").write_text("solid cube\n" + text + "endsolid\n")
    for name in ("a.stl", "b.stl"):
        assert volume(read_scan(tmp_path / name)) == pytest.approx(1.0)


def test_off_with_comments(tmp_path):
    positions, faces = cube()
    rows = [" ".join(map(str, p)) for p in positions] + [
        "3 " + " ".join(map(str, f)) for f in faces
    ]
    (tmp_path / "a.off").write_text("OFF # a cube\n8 12 0\n\n" + "\n".join(rows) + "\n")
    assert volume(read_scan(tmp_path / "a.off")) == pytest.approx(1.0)


def gltf_of_cube(node, **material):
    positions, faces = cube()
    blob = positions.astype("<f4").tobytes() + faces.astype("<u2").tobytes()
    document = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"children": [1], "translation": [5, 0, 0]}, {"mesh": 0, **node}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1, **material}]}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 8, "type": "VEC3"},
            {"bufferView": 1, "componentType": 5123, "count": 36, "type": "SCALAR"},
        ],
        "bufferViews": [
            {"buffer": 0, "byteOffset": 0, "byteLength": 96},
            {"buffer": 0, "byteOffset": 96, "byteLength": 72},
        ],
        "buffers": [{"byteLength": len(blob)}],
    }
    return document, blob


def write_glb(path, document, blob):
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    blob += b"\0" * (-len(blob) % 4)
    size = 12 + 8 + len(text) + 8 + len(blob)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text
    chunks += struct.pack("<I4s", len(blob), b"BIN\0") + blob
    path.write_bytes(b"glTF" + struct.pack("<II", 2, size) + chunks)
    return path


def test_glb_applies_node_transforms_and_turns_mirrored_ones(tmp_path):
    plain, blob = gltf_of_cube({"scale": [2, 2, 2]})
    raw = read_scan(write_glb(tmp_path / "a.glb", plain, blob))
    assert volume(raw) == pytest.approx(8.0)
    assert raw.positions.min(axis=0).tolist() == [5.0, 0.0, 0.0]
    mirrored, blob = gltf_of_cube({"scale": [-1, 1, 1]})
    assert volume(read_scan(write_glb(tmp_path / "b.glb", mirrored, blob))) == pytest.approx(1.0)


def test_gltf_refuses_what_it_does_not_understand(tmp_path):
    document, blob = gltf_of_cube({})
    document["extensionsRequired"] = ["EXT_meshopt_compression"]
    with pytest.raises(ScanError, match="EXT_meshopt_compression"):
        read_scan(write_glb(tmp_path / "a.glb", document, blob))


@pytest.mark.parametrize(
    "name",
    ["../secret.png", "/etc/hostname.png", "http://x.org/a.png", "C:\\a.png", "a/../../b.png"],
)
def test_mtl_may_not_name_files_outside(tmp_path, name):
    folder = tmp_path / "scan"
    folder.mkdir()
    images.write_png8(tmp_path / "secret.png", np.zeros((2, 2, 3)))
    positions, faces, uv = sphere(rows=4, columns=4)
    (folder / "m.mtl").write_text(f"newmtl skin\nmap_Kd {name}\n")
    with pytest.raises(ScanError, match="outside the scan's folder"):
        read_scan(write_obj(folder / "a.obj", positions, faces, uv, "m.mtl"))


def test_links_may_not_lead_outside(tmp_path):
    folder = tmp_path / "scan"
    folder.mkdir()
    images.write_png8(tmp_path / "secret.png", np.zeros((2, 2, 3)))
    (folder / "a.png").symlink_to(tmp_path / "secret.png")
    positions, faces, uv = sphere(rows=4, columns=4)
    (folder / "m.mtl").write_text("newmtl skin\nmap_Kd a.png\n")
    with pytest.raises(ScanError, match="leaves the scan's folder"):
        read_scan(write_obj(folder / "a.obj", positions, faces, uv, "m.mtl"))


@pytest.mark.parametrize("uri", ["../b.bin", "file:///etc/passwd", "https://x.org/b.bin"])
def test_gltf_may_not_name_files_outside(tmp_path, uri):
    document, blob = gltf_of_cube({})
    document["buffers"][0]["uri"] = uri
    (tmp_path / "b.bin").write_bytes(blob)
    folder = tmp_path / "scan"
    folder.mkdir()
    (folder / "a.gltf").write_text(json.dumps(document))
    with pytest.raises(ScanError, match="outside the scan's folder"):
        read_scan(folder / "a.gltf")


def test_out_of_range_and_non_finite_faces_are_dropped_with_a_note(tmp_path):
    (tmp_path / "a.obj").write_text(
        "v 0 0 0\nv 1 0 0\nv 0 1 0\nv nan 0 0\nf 1 2 3\nf 1 2 9\nf 1 2 4\n"
    )
    raw = read_scan(tmp_path / "a.obj")
    assert raw.faces.tolist() == [[0, 1, 2]]
    assert len(raw.notes) == 2


BROKEN = {
    "empty.obj": b"",
    "points.obj": b"v 0 0 0\nv 1 0 0\n",
    "nan.obj": b"v nan nan nan\nv nan 0 0\nv 0 nan 0\nf 1 2 3\n",
    "words.obj": b"v a b c\nv 0 0 0\nf 1 2 1\n",
    "index.obj": b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 7 8 9\n",
    "dot.obj": b"v 1 1 1\nv 1 1 1\nv 1 1 1\nf 1 2 3\n",
    "cloud.ply": b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\n"
    b"property float z\nend_header\n0 0 0\n",
    "notply.ply": b"hello",
    "cut.ply": b"ply\nformat binary_little_endian 1.0\nelement vertex 9\nproperty float x\n"
    b"property float y\nproperty float z\nelement face 3\n"
    b"property list uchar int vertex_indices\nend_header\n\0\0",
    "cut.stl": b"\0" * 80 + struct.pack("<I", 1000) + b"\0" * 60,
    "words.stl": b"solid nothing\nendsolid\n",
    "cut.glb": b"glTF" + struct.pack("<II", 2, 500) + b"\0" * 20,
    "notjson.gltf": b"{]",
    "list.gltf": b"[1, 2]",
    "nothing.gltf": b'{"asset": {"version": "2.0"}}',
    "cut.off": b"OFF\n8 12 0\n0 0 0\n",
    "scan.fbx": b"Kaydara",
}


@pytest.mark.parametrize("name", sorted(BROKEN))
def test_broken_files_end_in_one_sentence(tmp_path, name):
    path = tmp_path / name
    path.write_bytes(BROKEN[name])
    with pytest.raises(ScanError) as caught:
        read_scan(path)
    assert caught.value.what
    assert "\n" not in caught.value.what


def test_a_missing_path_is_a_usage_error(tmp_path):
    with pytest.raises(UsageError, match="no such scan"):
        read_scan(tmp_path / "none.obj")


@settings(max_examples=150, deadline=None)
@given(st.sampled_from([f for f in FORMATS if f != ".glb"]), st.binary(max_size=200))
def test_random_bytes_never_escape_as_another_error(tmp_path_factory, suffix, content):
    magic = {".ply": b"ply\nformat ascii 1.0\n", ".off": b"OFF\n"}.get(suffix, b"")
    path = tmp_path_factory.mktemp("fuzz") / f"a{suffix}"
    path.write_bytes(magic + content)
    try:
        read_scan(path)
    except ScanrenderError:
        pass


def test_fans_and_strips():
    assert fan_corners(np.array([3, 2, 4])).tolist() == [[0, 1, 2], [5, 6, 7], [5, 7, 8]]
    strips = np.array([0, 1, 2, 3, -1, 4, 5, 6])
    assert strip_faces(strips).tolist() == [[0, 1, 2], [2, 1, 3], [4, 5, 6]]


OUTLINES = {
    "dart": [(0, 0), (4, 0), (1, 1), (0, 4)],  # its first corner sees all others
    "turned dart": [(4, 0), (1, 1), (0, 4), (0, 0)],  # here it does not
    "arrow": [(0, 0), (2, 0), (2, 2), (1, 0.5), (0, 2)],
    "comb": [(0, 0), (7, 0), (7, 3), (6, 3), (5, 1), (4, 3), (3, 1), (2, 3), (1, 1), (0, 3)],
}


@pytest.mark.parametrize("axes", [(0, 1, 2), (1, 2, 0), (2, 0, 1), (1, 0, 2), (0, 2, 1)])
@pytest.mark.parametrize("name", OUTLINES)
def test_concave_polygons_are_neither_folded_nor_left_open(name, axes):
    outline = np.array(OUTLINES[name], float)
    area = 0.5 * np.sum(
        outline[:, 0] * np.roll(outline[:, 1], -1) - outline[:, 1] * np.roll(outline[:, 0], -1)
    )
    # A triangle before and a point that does not exist behind, so that offsets matter.
    flat = np.concatenate([[(9.0, 9.0), (9.0, 8.0), (8.0, 9.0)], outline])
    places = np.concatenate([flat, np.zeros((len(flat), 1))], axis=1)[:, axes]
    sizes = np.array([3, len(outline), 4])
    vertex = np.concatenate([np.arange(len(flat)), [0, 1, 2, 99]])
    triangles = polygon_corners(sizes, vertex, places)
    assert len(triangles) == 1 + len(outline) - 2 + 2
    mine = triangles[1 : len(outline) - 1]
    a, b, c = (places[vertex[mine[:, i]]] for i in range(3))
    normal = np.cross(b - a, c - a)
    np.testing.assert_allclose(0.5 * np.linalg.norm(normal, axis=1).sum(), area)
    assert (normal @ normal.sum(axis=0) >= 0.0).all()


def test_a_polygon_of_many_corners_that_crosses_itself_still_ends(tmp_path):
    rng = np.random.default_rng(0)
    for count in (40, 5000):
        rows = "".join(f"v {x} {y} 0\n" for x, y in rng.random((count, 2)))
        (tmp_path / "a.obj").write_text(rows + "f " + " ".join(map(str, range(1, count + 1))))
        assert len(read_scan(tmp_path / "a.obj").faces) == count - 2


def real(name):
    path = SCANS / name
    if not path.exists():
        pytest.skip(f"the real scan {name} is not on this machine")
    return path


@pytest.mark.parametrize(
    ("name", "triangles", "color"),
    [
        ("lee_perry_smith/LeePerrySmith.obj", 17_672, "texture"),
        ("james_3dmd/james.obj", 12_228, "texture"),
        ("fran_cyberware/fran_cut.obj", 4_224, "texture"),
        ("venus_bust/bust.glb", 172_316, "texture"),
        ("roman_bust/bust.glb", 3_444, "texture"),
        ("igea/igea.ply", 268_686, "none"),
        ("lucy/lucy.ply", 99_970, "none"),
    ],
)
def test_real_scans(name, triangles, color):
    raw = read_scan(real(name))
    assert len(raw.faces) == triangles
    assert raw.color_source == color
    assert abs(volume(raw)) > 0
    if raw.pages:
        assert (raw.page != NO_PAGE).all()


def test_every_file_of_the_corpus_gives_a_mesh_or_one_sentence():
    folder = real("corpus_trimesh")
    files = [f for f in sorted(folder.iterdir()) if f.suffix.lower() in FORMATS]
    failed = {}
    for file in files:
        try:
            assert len(read_scan(file).faces)
        except ScanError as error:
            failed[file.name] = error.what
    assert len(files) > 80
    allowed = ("empty", "points", "whitespace", "face_in_group_name.obj")
    assert all(name.startswith(allowed) for name in failed), failed
