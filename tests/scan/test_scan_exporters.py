"""What exporters really write, beyond the letter of the formats: read right, or said."""

from __future__ import annotations

import struct

import numpy as np
import pytest
from PIL import Image
from scan_shapes import cube

from scanrender import images
from scanrender.errors import ScanError
from scanrender.scan.ingest import read_scan
from scanrender.scan.raw import NO_PAGE
from scanrender.scan.words import floats, integers

NOISE = np.random.default_rng(0).integers(0, 256, (4, 4, 3)).astype(np.uint8)
OTHER = 255 - NOISE
CORNERS = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\n"
SQUARE = f"mtllib m.mtl\n{CORNERS}usemtl skin\nf 1/1 2/2 3/3\nf 1/1 3/3 4/4\n"
PLAIN = "newmtl skin\nmap_Kd skin.png\n"


@pytest.fixture
def obj(tmp_path):
    """obj(text, mtl, **images): the OBJ read, beside a decoy, so that no image is the lone one."""

    def write(text=SQUARE, mtl=PLAIN, name="a.obj", **files):
        for key, content in (("m.mtl", mtl), (name, text)):
            data = content if isinstance(content, bytes) else content.encode()
            (tmp_path / key).write_bytes(data)
        for file, pixels in {"decoy.png": OTHER, **(files or {"skin.png": NOISE})}.items():
            (tmp_path / file).parent.mkdir(exist_ok=True)
            images.write_image(tmp_path / file, pixels)
        return read_scan(tmp_path / name)

    return write


def assert_skin(raw, pixels=NOISE):
    assert (raw.page == 0).all()
    np.testing.assert_array_equal(raw.pages[0].pixels, pixels)
    np.testing.assert_allclose(raw.corner_uv[1], [[0, 1], [1, 0], [0, 0]])
    assert raw.faces.tolist() == [[0, 1, 2], [0, 2, 3]]


BOM = b"\xef\xbb\xbf"
TEXTS = {
    "windows line ends": (SQUARE.replace("\n", "\r\n"), PLAIN.replace("\n", "\r\n")),
    "old mac line ends": (SQUARE.replace("\n", "\r"), PLAIN.replace("\n", "\r")),
    "byte order mark": (BOM + SQUARE.encode(), BOM + PLAIN.encode()),
    "utf-16": (SQUARE.encode("utf-16"), PLAIN.encode("utf-16")),
    "tabs": (SQUARE.replace(" ", "\t"), PLAIN.replace(" ", "\t")),
    "continued lines": (SQUARE.replace(" 2/2", " 2/2 \\\n"), PLAIN),
    "continued windows lines": (SQUARE.replace(" 2/2", " 2/2 \\\n").replace("\n", "\r\n"), PLAIN),
    "comments at line ends": (SQUARE.replace("0 0\n", "0 0 # here\n"), PLAIN + "# end\n"),
    "upper case words": (SQUARE.replace("mtllib", "MTLLIB").replace("usemtl", "USEMTL"),
                         PLAIN.replace("map_Kd", "MAP_KD")),
    "upper case suffix": (SQUARE.replace("m.mtl", "M.MTL"), PLAIN.replace("png", "PNG")),
    "dot and backslash": (SQUARE.replace("m.mtl", r".\m.mtl"),
                          PLAIN.replace("skin.p", r".\skin.p")),
    "options": (SQUARE, "newmtl skin\nmap_Kd -blendu on -o 0 0 0 -clamp off -mm 0 1 skin.png\n"),
    "options with words": (SQUARE, "newmtl skin\nmap_Kd -imfchan r -type sphere skin.png\n"),
    "options between tabs": (SQUARE, "newmtl skin\nmap_Kd\t-s\t1 1 1\tskin.png\n"),
    "a comment after the image": (SQUARE, "newmtl skin\nmap_Kd skin.png # the skin\n"),
    "quotes": (SQUARE, 'newmtl skin\nmap_Kd "skin.png"\n'),
}  # fmt: skip


@pytest.mark.parametrize("kind", TEXTS)
def test_obj_and_mtl_as_text(obj, kind):
    assert_skin(obj(*TEXTS[kind]))


def test_a_byte_order_mark_does_not_eat_the_first_vertex(obj):
    assert len(obj(BOM + SQUARE.replace("mtllib m.mtl\n", "").encode()).positions) == 4


@pytest.mark.parametrize(
    ("named", "file"),
    [
        ("my skin 2.png", "my skin 2.png"),
        ("-s 1 1 1 2 skin.png", "2 skin.png"),  # an option's numbers, then a name with one
        ("-skin.png", "-skin.png"),
        ("skin#1.png", "skin#1.png"),
        (r"Textures\Skin.PNG", "textures/skin.png"),
        ("skin%20a.png", "skin a.png"),
        ("haut.tif", "haut.png"),  # the image was converted, the material file was not
    ],
)
def test_names_of_images(obj, named, file):
    assert_skin(obj(mtl=f"newmtl skin\nmap_Kd {named}\n", **{file: NOISE}))


def test_names_that_windows_wrote_in_its_own_encoding(obj):
    assert_skin(obj(mtl="newmtl skin\nmap_Kd hüt.png\n".encode("cp1252"), **{"hüt.png": NOISE}))


@pytest.mark.parametrize("named", ["skin.<UDIM>.png", "skin.1001.png"])
def test_udim_tiles_each_take_their_own_image(obj, named):
    tiles = CORNERS + "vt 1.25 0.25\nvt 1.75 0.25\nvt 1.75 0.75\nvt 2.5 0.5\nvt 0.5 1.5\n"
    faces = "f 1/1 2/2 3/3\nf 1/5 2/6 3/7\nf 1/8 2/8 3/8\nf 1/9 2/9 3/9\n"
    raw = obj(
        f"mtllib m.mtl\n{tiles}usemtl skin\n{faces}",
        f"newmtl skin\nmap_Kd {named}\n",
        **{"skin.1001.png": NOISE, "skin.1002.png": OTHER, "skin.1011.png": NOISE[::-1]},
    )
    assert [page.name for page in raw.pages] == ["skin.1001.png", "skin.1002.png", "skin.1011.png"]
    # Tile 1003 is missing, which is said; the first one is repeated there as any image would be.
    assert raw.page.tolist() == [0, 1, 0, 2]
    np.testing.assert_allclose(raw.corner_uv[1], [[0.25, 0.75], [0.75, 0.75], [0.75, 0.25]])
    np.testing.assert_allclose(raw.corner_uv[3], [[0.5, 0.5]] * 3)
    assert any("1003.png is missing" in note for note in raw.notes)


def test_one_of_two_textures_missing_costs_only_its_own_faces(obj):
    two = SQUARE.replace("f 1/1 3/3", "usemtl hair\nf 1/1 3/3")
    raw = obj(two, PLAIN + "newmtl hair\nmap_Kd hair.jpg\n")
    assert raw.page.tolist() == [0, NO_PAGE]
    assert any("hair.jpg, which is missing" in note for note in raw.notes)


def test_texture_coordinates_without_an_image_are_said(obj):
    raw = obj(mtl="newmtl skin\nmap_Kd gone.png\n")
    assert raw.color_source == "none"
    assert any("copy it beside the scan" in note for note in raw.notes)


def test_a_spectral_colour_costs_nothing_else(obj):
    assert_skin(obj(mtl=PLAIN + "Kd spectral file.rfl\nKd xyz 0.5 0.5 0.5\n"))


def vertex_lines(colors):
    rows = "".join(f"v {i % 2} {i // 2} 0 {c}\n" for i, c in enumerate(colors))
    return rows + "f 1 2 4\nf 1 4 3\n"


LEVELS = np.array([[10, 20, 30], [100, 120, 130], [200, 210, 220], [0, 0, 0]])


@pytest.mark.parametrize(
    "text",
    [
        vertex_lines(" ".join(map(str, level)) for level in LEVELS),
        vertex_lines(" ".join(f"{x / 255:.6f}" for x in level) for level in LEVELS),
        vertex_lines(" ".join(f"{x / 255:.6f}" for x in level) + " 1.0" for level in LEVELS),
        vertex_lines([""] * 4)
        + "#MRGB "
        + "".join("ff{:02x}{:02x}{:02x}".format(*level) for level in LEVELS.tolist()),
    ],
    ids=["0-255", "0-1", "with alpha", "ZBrush polypaint"],
)
def test_obj_vertex_colours(obj, text):
    expected = images.linear_from_srgb(LEVELS / 255.0)
    np.testing.assert_allclose(obj(text).colors, expected, atol=1e-5)


def test_vertices_without_a_colour_do_not_cost_the_others_theirs(obj):
    raw = obj(vertex_lines(["", *(" ".join(map(str, level)) for level in LEVELS[1:])]))
    expected = images.linear_from_srgb(LEVELS / 255.0)
    np.testing.assert_allclose(raw.colors[1:], expected[1:], atol=1e-5)
    assert any("1 vertices have no colour" in note for note in raw.notes)


@pytest.mark.parametrize(("shade", "kept"), [((0.2, 0.5, 0.8), True), ((0.5, 0.5, 0.5), False)])
def test_one_colour_for_all_is_kept_and_one_grey_is_said_to_be_dropped(obj, shade, kept):
    raw = obj(vertex_lines([" ".join(map(str, shade))] * 4))
    assert (raw.color_source == "vertex") == kept
    assert any("same grey" in note for note in raw.notes) != kept


def test_decimal_commas_are_quoted(obj):
    with pytest.raises(ScanError, match="'v' line is not made of numbers: '0,5 1,0 0,0'") as caught:
        obj("v 0 0 0\nv 0,5 1,0 0,0\nv 1 1 0\nf 1 2 3\n")
    assert "decimal" in caught.value.fix


def test_more_materials_than_there_are_numbers(obj):
    many = range(33_000)
    text = CORNERS + "".join(f"usemtl k{i}\nf 1 2 3\n" for i in many)
    with pytest.raises(ScanError, match="more than 32767 materials"):
        obj(
            "mtllib m.mtl\n" + text,
            "".join(f"newmtl k{i}\nKd 1 0 {i / 33_000:.5f}\n" for i in many),
        )


def test_words_of_any_length():
    long = b"0.1000000000000000055511151231257827021181583404541015625"
    assert floats([b"1", long, b"-2e3"]).tolist() == [1.0, 0.1, -2000.0]
    assert integers([b"7", b"-3"]).tolist() == [7, -3]
    assert len(floats([])) == 0
    for bad in ([b"x"], [b"9" * 2000], [b"1,5"]):
        with pytest.raises(ValueError, match=r"."):
            floats(bad)
    with pytest.raises(ValueError, match=r"."):
        integers([b"9" * 40])


PLACES = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)]
CODES = {"float": "f", "double": "d", "uchar": "B", "ushort": "H", "int": "i", "uint": "I"}


def write_ply(path, properties, rows, kind, faces=((3, 0, 1, 2), (3, 0, 2, 3)), **words):
    """rows: values per vertex as `properties` ("type name") say."""
    names = [p.split() for p in properties]
    eol = words.get("eol", "\n")
    face = words.get("face", "property list uchar int vertex_indices")
    head = ["ply", f"format {kind} 1.0", f"comment TextureFile {words.get('texture', 'none.png')}"]
    head += [f"element vertex {len(rows)}", *(f"property {p}" for p in properties)]
    head += [f"element face {len(faces)}", face, "end_header"]
    if kind == "ascii":
        lines = [" ".join(map(str, row)) for row in (*rows, *faces)]
        body = (eol.join(lines) + eol).encode()
    else:
        order = "<" if "little" in kind else ">"
        layout = order + "".join(CODES[t] for t, _ in names)
        body = b"".join(struct.pack(layout, *row) for row in rows)
        body += b"".join(struct.pack(f"{order}B{len(row) - 1}i", *row) for row in faces)
    path.write_bytes((eol.join(head) + eol).encode() + body)
    return read_scan(path)


XYZ = ["float x", "float y", "float z"]


def colored(kind, factor=1):
    names = [f"{kind} {name}" for name in ("red", "green", "blue")]
    return names, [tuple((level * factor).tolist()) for level in LEVELS]


COLORS = {
    "doubles and foreign properties": (
        ["double x", "double y", "double z", "float nx", "uchar flags", "float quality"],
        (1.5, 9, 0.25), *colored("uchar"), ()),
    "alpha": (XYZ, (), *colored("uchar"), (255,)),
    "16 bits": (XYZ, (), *colored("ushort", 257), ()),
    "bytes in 16 bits": (XYZ, (), *colored("ushort"), ()),
    "fractions": (XYZ, (), *colored("float", 1 / 255), ()),
    "capitals": (["float X", "float Y", "float Z"], (),
                 ["uchar Red", "uchar Green", "uchar Blue"], colored("uchar")[1], ()),
}  # fmt: skip


@pytest.mark.parametrize("kind", ["ascii", "binary_little_endian", "binary_big_endian"])
@pytest.mark.parametrize("case", COLORS)
def test_ply_vertex_colours(tmp_path, case, kind):
    first, extra, names, colors, tail = COLORS[case]
    properties = [*first, *names, *(["uchar alpha"] if tail else [])]
    rows = [(*p, *extra, *c, *tail) for p, c in zip(PLACES, colors, strict=True)]
    raw = write_ply(tmp_path / "a.ply", properties, rows, kind)
    expected = images.linear_from_srgb(LEVELS / 255.0)
    np.testing.assert_allclose(raw.colors, expected, atol=1e-5)
    np.testing.assert_array_equal(raw.positions, PLACES)


def test_ply_nearly_black_bytes_are_not_taken_for_fractions(tmp_path):
    rows = [(*p, i % 2, 1, 0) for i, p in enumerate(PLACES)]
    raw = write_ply(tmp_path / "a.ply", XYZ + colored("uchar")[0], rows, "ascii")
    assert raw.colors is None or raw.colors.max() < 0.01


@pytest.mark.parametrize("kind", ["ascii", "binary_little_endian"])
@pytest.mark.parametrize("names", ["s t", "u v", "texture_u texture_v", "s0 t0"])
def test_ply_texture_coordinates_by_any_name_and_line_end(tmp_path, kind, names):
    images.write_image(tmp_path / "skin.png", NOISE)
    images.write_image(tmp_path / "decoy.png", OTHER)
    properties = XYZ + [f"float {name}" for name in names.split()]
    rows = [(*p, p[0], p[1]) for p in PLACES]
    raw = write_ply(tmp_path / "a.ply", properties, rows, kind, texture="skin.png", eol="\r\n")
    assert_skin(raw)


def test_ply_index_lists_by_another_name_and_none(tmp_path):
    raw = write_ply(
        tmp_path / "a.ply", XYZ, PLACES, "ascii", face="property list uchar uint vertex_indexes"
    )
    assert len(raw.faces) == 2
    with pytest.raises(ScanError, match="without a list of vertex indices, only a, b"):
        write_ply(
            tmp_path / "a.ply", XYZ, PLACES, "ascii", [(1, 2)],
            face="property int a\nproperty int b",
        )  # fmt: skip


def test_ply_of_an_unknown_type(tmp_path):
    with pytest.raises(ScanError, match="type 'float128'"):
        write_ply(tmp_path / "a.ply", ["float128 x", "float y", "float z"], PLACES, "ascii")


@pytest.mark.parametrize("header", ["COLOR=", "VisCAM"])
def test_stl_facet_colours(tmp_path, header):
    """15 bits in the attribute: Magics has red lowest, VisCAM blue lowest and bit 15 set."""
    positions, faces = cube()
    shade = np.random.default_rng(0).integers(0, 32, (12, 3))
    record = np.zeros(12, [("n", "<f4", 3), ("c", "<f4", (3, 3)), ("a", "<u2")])
    record["c"] = positions[faces]
    order = shade if header == "COLOR=" else shade[:, ::-1]
    record["a"] = order[:, 0] | order[:, 1] << 5 | order[:, 2] << 10
    text = b"COLOR=\x80\x40\x20\xff" if header == "COLOR=" else b"made by a tool"
    expected = images.linear_from_srgb(shade / 31.0)
    if header == "COLOR=":
        record["a"][3] |= 1 << 15
        expected[3] = images.linear_from_srgb(np.array([128, 64, 32]) / 255.0)
    else:
        record["a"] |= 1 << 15
    path = tmp_path / "a.stl"
    path.write_bytes(text.ljust(80) + struct.pack("<I", 12) + record.tobytes())
    raw = read_scan(path)
    np.testing.assert_allclose(raw.colors[::3], expected, atol=1e-5)
    record["a"] = 0x2020  # blanks, which Blender left there for years
    path.write_bytes(b"Binary STL".ljust(80) + struct.pack("<I", 12) + record.tobytes())
    assert read_scan(path).colors is None


HALVES = np.zeros((16, 32, 3), np.uint8)
HALVES[:, :16], HALVES[:, 16:] = [240, 20, 20], [20, 20, 240]


@pytest.mark.parametrize(
    ("name", "mode", "options"),
    [
        ("skin.jpg", "CMYK", {"quality": 95}),
        ("skin.jpg", "RGB", {"quality": 95, "progressive": True}),
        ("skin.jpg", "RGB", {"quality": 95, "exif": True}),
        ("skin.png", "P", {}),
        ("skin.png", "RGBA", {}),
        ("skin.png", "RGB", {"format": "JPEG", "quality": 95}),  # a name that lies
        ("skin.tif", "CMYK", {}),
        ("skin.tif", "RGB", {"compression": "tiff_lzw"}),
        ("skin.bmp", "RGB", {}),
        ("skin.tga", "RGB", {}),
        ("skin.webp", "RGB", {"quality": 95}),
    ],
)
def test_images_of_other_kinds_keep_their_colours_and_place(obj, tmp_path, name, mode, options):
    """EXIF says that the picture is turned; texture coordinates are of the stored pixels."""
    image = Image.fromarray(HALVES).convert(mode)
    if options.pop("exif", False):
        tags = Image.Exif()
        tags[0x112] = 6
        options["exif"] = tags
    image.save(tmp_path / name, **options)
    raw = obj(mtl=f"newmtl skin\nmap_Kd {name}\n", **{"other.png": OTHER})
    [page] = raw.pages
    assert page.size == (32, 16)
    for column, color in ((6, [240, 20, 20]), (26, [20, 20, 240])):
        np.testing.assert_allclose(page.pixels[8, column], color, atol=40)


def test_images_that_cannot_be_colours_are_refused_with_what_to_do(obj, tmp_path):
    Image.fromarray(HALVES, mode="LAB").save(tmp_path / "skin.tif")
    (tmp_path / "skin.png").write_bytes(b"")
    for name, word in (("skin.tif", "CIE Lab"), ("skin.png", "Not a PNG")):
        with pytest.raises(ScanError, match=word) as caught:
            obj(mtl=f"newmtl skin\nmap_Kd {name}\n", **{"other.png": OTHER})
        assert caught.value.fix
        assert str(tmp_path) not in caught.value.what
