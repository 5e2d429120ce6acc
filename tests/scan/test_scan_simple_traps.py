"""PLY, STL and OFF that are not quite what their kind says: read, or said in one sentence."""

from __future__ import annotations

import struct
import warnings

import numpy as np
import pytest
from scan_shapes import cube

from scanrender import images
from scanrender.errors import ScanError
from scanrender.scan.ingest import read_scan
from scanrender.scan.inspect import inspect_scan

XYZ = "property float x\nproperty float y\nproperty float z\n"
RGB = "property uchar red\nproperty uchar green\nproperty uchar blue\n"
INDICES = "property list uchar int vertex_indices\n"
SQUARE = ("0 0 0", "200 0 0", "200 200 50", "0 200 0")


def ply(vertex=XYZ, face=INDICES, rows=SQUARE, faces=("3 0 1 2", "3 0 2 3"), more="", tail=""):
    head = f"ply\nformat ascii 1.0\nelement vertex {len(rows)}\n{vertex}"
    head += f"element face {len(faces)}\n{face}" if faces else ""
    return "\n".join([f"{head}{more}end_header", *rows, *faces]) + f"\n{tail}"


@pytest.fixture
def read(tmp_path):
    """read(text, suffix): the scan as read; looking at its health may not fail, nor warn."""

    def reads(content, suffix="ply"):
        path = tmp_path / f"a.{suffix}"
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            inspect_scan(path)
            return read_scan(path)

    return reads


@pytest.mark.parametrize("names", [("red", "green", "blue"), ("s", "t"), ("red",)])
def test_ply_vertex_properties_that_are_lists_are_dropped_with_a_note(read, names):
    lists = "".join(f"property list uchar float {name}\n" for name in names)
    rest = "".join(f"property float {n}\n" for n in ("green", "blue") if names == ("red",))
    tail = " 1 .5" * len(names) + (" .5 .5" if rest else "")
    raw = read(ply(XYZ + lists + rest, rows=[row + tail for row in SQUARE]))
    assert raw.faces.tolist() == [[0, 1, 2], [0, 2, 3]]
    assert raw.colors is None
    assert raw.corner_uv is None
    assert [note for note in raw.notes if f"{', '.join(names)} of its vertices" in note]


def test_ply_places_that_are_lists_are_no_places(read):
    lists = "".join(f"property list uchar float {name}\n" for name in "xyz")
    with pytest.raises(ScanError, match="vertex positions"):
        read(ply(lists, rows=["1 0 1 0 1 0", "1 9 1 0 1 0", "1 0 1 9 1 0", "1 0 1 0 1 9"]))


def test_ply_face_colours_and_page_numbers_that_are_lists_are_dropped_with_a_note(read, tmp_path):
    for name in ("a.png", "b.png"):
        images.write_png8(tmp_path / name, np.random.default_rng(0).random((4, 4, 3)))
    names = ("red", "green", "blue", "texnumber")
    face = INDICES + "".join(f"property list uchar int {name}\n" for name in names)
    text = ply(face=face, faces=["3 0 1 2" + " 1 1" * 4, "3 0 2 3" + " 1 0" * 4])
    text = text.replace("element v", "comment TextureFile a.png\ncomment TextureFile b.png\n"
                        "element v", 1)  # fmt: skip
    raw = read(text)
    assert len(raw.faces) == 2
    assert raw.colors is None
    assert any("red, green, blue, texnumber of its faces are lists" in note for note in raw.notes)


def test_ply_of_indices_that_are_not_numbers(read):
    face = "property list uchar float vertex_indices\n"
    raw = read(ply(face=face, faces=["3 0 1 2", "3 0 1 nan", "3 0 1 1e300"]))
    assert raw.faces.tolist() == [[0, 1, 2]]
    assert any("2 faces named vertices that do not exist" in note for note in raw.notes)


def test_one_face_without_its_vertices_does_not_cost_the_others_their_colours(read):
    text = ply(face=INDICES + RGB, faces=["3 0 1 2 255 0 0", "3 0 2 9 0 255 0", "3 0 2 3 255 0 0"])
    for raw in (
        read(text),
        read("OFF\n4 3 0\n" + "\n".join(SQUARE)
             + "\n3 0 1 2 255 0 0\n3 0 2 9 0 255 0\n3 0 2 3 255 0 0\n", "off"),
    ):  # fmt: skip
        assert raw.faces.tolist() == [[0, 1, 2], [0, 2, 3]]
        np.testing.assert_allclose(raw.colors, [[1, 0, 0]] * 4, atol=1e-6)


def test_ply_strips_beside_faces_are_said(read):
    strips = "element tristrips 1\nproperty list int int vertex_indices\n"
    raw = read(ply(faces=["3 0 1 2"], more=strips, tail="3 0 2 3\n"))
    assert raw.faces.tolist() == [[0, 1, 2]]
    assert any("triangle strips" in note for note in raw.notes)
    alone = read(ply(faces=(), more=strips, tail="3 0 2 3\n"))
    assert alone.faces.tolist() == [[0, 2, 3]]
    assert not alone.notes
    with pytest.raises(ScanError):
        read(ply(faces=(), more="element tristrips 1\n", tail="3 0 2 3\n"))


@pytest.mark.parametrize("kind", ["ascii", "binary_big_endian"])
def test_ply_of_old_mac_line_ends(read, kind):
    positions, faces = cube(200.0)
    if kind == "ascii":
        rows = [" ".join(map(str, p)) for p in positions]
        content = ply(rows=rows, faces=[f"3 {a} {b} {c}" for a, b, c in faces])
        content = content.replace("\n", "\r").encode()
    else:
        head = f"ply\nformat {kind} 1.0\nelement vertex 8\n{XYZ}element face 12\n{INDICES}"
        content = (head + "end_header\n").replace("\n", "\r").encode()
        content += positions.astype(">f4").tobytes()
        content += b"".join(b"\3" + face.astype(">i4").tobytes() for face in faces)
    raw = read(content)
    assert raw.faces.tolist() == faces.tolist()
    np.testing.assert_array_equal(raw.positions, positions)


def test_off_colours_that_are_not_numbers(read):
    corners = "0 0 0\n200 0 0\n0 200 0\n0 0 200\n"
    faces = "3 0 2 1 nan 0 0\n3 0 1 3 1.0 0 0\n3 1 2 3 1.0 0 0\n3 2 0 3 1.0 0 0\n"
    raw = read(f"OFF\n4 4 0\n{corners}{faces}", "off")
    np.testing.assert_allclose(raw.colors, [[1, 0, 0]] * 4, atol=1e-6)
    assert any("1 faces have no colour" in note for note in raw.notes)
    rows = "0 0 0 nan 0 0\n200 0 0 1 0 0\n0 200 0 1 0 0\n0 0 200 1 0 0\n"
    raw = read(f"COFF\n4 1 0\n{rows}3 0 1 2\n", "off")
    np.testing.assert_allclose(raw.colors, [[1, 0, 0]] * 3, atol=1e-6)
    assert any("1 vertices have no colour" in note for note in raw.notes)


def facet(*corners):
    rows = "".join(f"vertex {corner}\n" for corner in corners)
    return f"facet normal 0 0 0\nouter loop\n{rows}endloop\nendfacet\n"


def solid(*facets):
    return "solid a\n" + "".join(facets) + "endsolid a\n"


def test_ascii_stl_of_polygons(read):
    raw = read(solid(facet(*SQUARE), facet(*SQUARE), facet(*SQUARE)), "stl")
    places = raw.positions[raw.faces]
    square = [[float(x) for x in row.split()] for row in SQUARE]
    np.testing.assert_array_equal(places[0], [square[i] for i in (0, 1, 2)])
    np.testing.assert_array_equal(places[1], [square[i] for i in (0, 2, 3)])
    assert len(raw.faces) == 6
    # Six corners in all, as two triangles have.
    with pytest.raises(ScanError, match="ends inside a triangle"):
        read(solid(facet(*SQUARE), facet(*SQUARE[:2])), "stl")


@pytest.mark.parametrize("word", ["-1.#IND", "1.#QNAN", "1.#INF", "nan", "inf"])
def test_ascii_stl_of_places_that_are_no_numbers(read, word):
    raw = read(solid(facet(*SQUARE[:3]), facet("0 0 0", f"0 1 {word}", "1 0 0")), "stl")
    assert len(raw.faces) == 1
    assert any("1 vertices are not finite" in note for note in raw.notes)


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16"])
def test_text_with_a_byte_order_mark(read, encoding):
    assert len(read(solid(facet(*SQUARE[:3])).encode(encoding), "stl").faces) == 1
    text = "OFF\n4 2 0\n" + "\n".join(SQUARE) + "\n3 0 1 2\n3 0 2 3\n"
    assert len(read(text.encode(encoding), "off").faces) == 2


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"\0" * 84 + b"\1" * 100, "says that it has no triangles, but goes on for 100 bytes"),
        (b"hello, this is a text of some sort, " * 9, "is neither a binary STL nor one in words"),
        (b"\0" * 80 + struct.pack("<I", 9) + b"\0" * 60, "ends before its 9 triangles do"),
        (b"\0" * 80 + struct.pack("<I", 10**9) + b"\0" * 60, "ends before its 1000000000 tri"),
        (b"\0" * 30, "ends before"),
    ],
)
def test_what_is_said_of_a_broken_stl(read, content, said):
    with pytest.raises(ScanError, match=said):
        read(content, "stl")
