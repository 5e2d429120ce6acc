"""OBJ and MTL in less usual spellings: each is read as meant, or its loss is said."""

from __future__ import annotations

from contextlib import suppress
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from scanrender import images
from scanrender.errors import ScanError
from scanrender.scan import triangulate
from scanrender.scan.ingest import read_scan

NOISE = np.random.default_rng(0).integers(0, 256, (4, 4, 3)).astype(np.uint8)
OTHER = 255 - NOISE
CORNERS = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\n"
SQUARE = f"mtllib m.mtl\n{CORNERS}usemtl skin\nf 1/1 2/2 3/3\nf 1/1 3/3 4/4\n"


@pytest.fixture
def obj(tmp_path):
    """obj(text, mtl, **images): the OBJ read, beside two decoys: no image is the lone one."""

    def write(text=SQUARE, mtl="", **files):
        (tmp_path / "m.mtl").write_text(mtl)
        (tmp_path / "a.obj").write_text(text)
        for file, pixels in {"decoy.png": OTHER, "decoy2.png": OTHER, **files}.items():
            (tmp_path / file).parent.mkdir(exist_ok=True)
            images.write_image(tmp_path / file, pixels)
        return read_scan(tmp_path / "a.obj")

    return write


@pytest.mark.parametrize("color", ["nan 0 0", "0.5 inf 0.2", "0 0 -1e400", "1e39 0 0"])
def test_a_colour_that_is_no_number_is_none(obj, color):
    raw = obj(mtl=f"newmtl skin\nKd {color}\n")
    assert raw.pages == ()
    assert any("Kd of material skin is no colour" in note for note in raw.notes)


def test_negative_indices_between_tabs(obj):
    text = "v\t0\t0\t0\nv\t1\t0\t0\nv\t0\t1\t0\nv\t1\t1\t0\nf\t-4\t-3\t-2\nf\t-3\t-1\t-2\n"
    assert obj(text).faces.tolist() == [[0, 1, 2], [1, 3, 2]]


def test_corner_styles_may_change_where_the_numbers_of_slashes_cancel(obj):
    """One slash fewer in three corners, then one more in three, behind many of one slash."""
    few = "v 0 0 0\nv 1 0 0\nv 1 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nvn 0 0 1\n"
    raw = obj(few * 3 + "f 1/1 2/2 3/3\n" * 30 + "f 5 6 7\nf 5/1/1 6/2/2 7/3/3\nf 1/1 2/2 3/3\n")
    assert raw.faces[-4:].tolist() == [[0, 1, 2], [4, 5, 6], [4, 5, 6], [0, 1, 2]]
    assert np.isnan(raw.corner_uv[-3]).all()
    np.testing.assert_array_equal(raw.corner_uv[-2], [[0, 1], [1, 1], [1, 0]])


@pytest.mark.parametrize("word", ["-1.#IND", "1.#INF00", "1.#QNAN", "-1.#J"])
def test_numbers_that_microsoft_could_not_write_are_not_finite(obj, word):
    rows = f"v 0 0 0 # 1\nv 1 0 0\nv 0 1 0\nv 0 1 {word}\nv 0 1 2#3\n"
    raw = obj(rows + "f 1 2 3\nf 2 3 4\nf 2 3 5\n")
    assert raw.faces.tolist()[0] == [0, 1, 2]
    assert len(raw.faces) == 2
    assert raw.positions[raw.faces[1, 2]].tolist() == [0, 1, 2]
    assert any("1 vertices are not finite" in note for note in raw.notes)


LEVELS = np.array([[1.0, 0.2, 0.3], [1.0, 0.5, 0.6], [1.0, 0.8, 0.1]])


@pytest.mark.parametrize("numbers", ["{}", "{} 1.0", "1.0 {}"], ids=["rgb", "rgba", "wrgb"])
def test_a_weight_is_not_taken_for_red_nor_red_for_a_weight(obj, numbers):
    colors = [numbers.format(" ".join(map(str, level))) for level in LEVELS]
    places = zip(("0 0 0", "1 0 0", "0 1 0"), colors, strict=True)
    raw = obj("".join(f"v {place} {color}\n" for place, color in places) + "f 1 2 3\n")
    np.testing.assert_allclose(raw.colors, images.linear_from_srgb(LEVELS), atol=1e-6)


def test_polygons_beyond_what_a_file_may_cost_are_fans_which_is_said(obj, monkeypatch):
    darts = "v 4 0 0\nv 1 1 0\nv 0 4 0\nv 0 0 0\n" * 3 + "f 1 2 3 4\nf 5 6 7 8\nf 9 10 11 12\n"
    ears, fan = [[3, 0, 1], [1, 2, 3]], [[0, 1, 2], [0, 2, 3]]
    raw = obj(darts)
    assert (raw.faces.reshape(3, 2, 3) - 4 * np.arange(3)[:, None, None]).tolist() == [ears] * 3
    assert raw.notes == ()
    monkeypatch.setattr(triangulate, "_MOST_WORK", 50)
    raw = obj(darts)
    assert (raw.faces.reshape(3, 2, 3) - 4 * np.arange(3)[:, None, None]).tolist() == [
        ears, ears, fan
    ]  # fmt: skip
    assert any(note.startswith("1 concave polygons too many") for note in raw.notes)


def squares(count):
    """An OBJ of `count` squares, the material of each by its number."""
    faces = (f"usemtl m{i}\nf 1/1 2/2 3/3\nf 1/1 3/3 4/4\n" for i in range(count))
    return f"mtllib m.mtl\n{CORNERS}{''.join(faces)}"


def test_materials_that_name_the_same_images_are_one_page(obj):
    mtl = "".join(f"newmtl m{i}\nmap_Kd skin.png\n" for i in range(3))
    mtl += "newmtl m3\nmap_Kd skin.png\nnorm bumps.png\nnewmtl m4\nmap_Kd ./other.png\n"
    raw = obj(squares(5), mtl, **{"skin.png": NOISE, "bumps.png": NOISE, "other.png": OTHER})
    assert raw.page.tolist() == [0, 0, 0, 0, 0, 0, 1, 1, 2, 2]
    assert [page.name for page in raw.pages] == ["skin.png", "skin.png", "other.png"]
    assert raw.pages[0] is raw.pages[1]
    assert [normal and normal.name for normal in raw.normal_pages] == [None, "bumps.png", None]


def test_a_folder_is_listed_once_whatever_is_missing(obj, monkeypatch):
    listed, list_folder = [], Path.iterdir
    monkeypatch.setattr(Path, "iterdir", lambda path: listed.append(path) or list_folder(path))
    raw = obj(squares(9), "".join(f"newmtl m{i}\nmap_Kd no{i}.png\n" for i in range(9)))
    assert sum("which is missing" in note for note in raw.notes) == 9
    assert len(listed) <= 2


def test_a_material_without_a_name_does_not_paint_the_one_before(obj):
    mtl = "newmtl skin\nmap_Kd skin.png\nnewmtl\nmap_Kd other.png\n"
    raw = obj(mtl=mtl, **{"skin.png": NOISE, "other.png": OTHER})
    np.testing.assert_array_equal(raw.pages[0].pixels, NOISE)


@pytest.mark.parametrize(
    ("options", "said"), [("-s 2 2 1 -o 0.5 0 0", True), ("-s 1 1 1 -o 0 0 0 -mm 0 2", False)]
)
def test_a_scale_or_offset_of_an_image_is_said_to_be_lost(obj, options, said):
    raw = obj(mtl=f"newmtl skin\nmap_Kd {options} skin.png\n", **{"skin.png": NOISE})
    assert raw.pages[0].name == "skin.png"
    assert any("scale or offset of the image of skin" in note for note in raw.notes) == said


@pytest.mark.parametrize(
    ("named", "file"),
    [
        ("skin.png", "mats/skin.png"),
        ("Skin.PNG", "mats/skin.png"),
        ("../tex/skin.png", "tex/skin.png"),
        ("mats/skin.png", "mats/skin.png"),
        ("skin.png", "skin.png"),
        ("skin.tif", "mats/skin.png"),
        ("head:skin.png", "head:skin.png"),
        ("head:skin.png", "mats/head:skin.png"),
    ],
)
def test_images_are_looked_for_beside_the_material_file(obj, tmp_path, named, file):
    (tmp_path / "mats").mkdir()
    (tmp_path / "mats/m.mtl").write_text(f"newmtl skin\nmap_Kd {named}\n")
    raw = obj(SQUARE.replace("m.mtl", "mats/m.mtl"), **{file: NOISE})
    assert raw.page.tolist() == [0, 0]
    np.testing.assert_array_equal(raw.pages[0].pixels, NOISE)


def test_of_two_images_the_one_beside_the_material_file_is_meant(obj, tmp_path):
    (tmp_path / "mats").mkdir()
    (tmp_path / "mats/m.mtl").write_text("newmtl skin\nmap_Kd skin.png\n")
    both = {"skin.png": OTHER, "mats/skin.png": NOISE}
    raw = obj(SQUARE.replace("m.mtl", "mats/m.mtl"), **both)
    np.testing.assert_array_equal(raw.pages[0].pixels, NOISE)


def test_tiles_beside_the_material_file(obj, tmp_path):
    (tmp_path / "mats").mkdir()
    (tmp_path / "mats/m.mtl").write_text("newmtl skin\nmap_Kd skin.<UDIM>.png\n")
    text = f"mtllib mats/m.mtl\n{CORNERS}vt 1.5 0.5\nusemtl skin\nf 1/1 2/2 3/3\nf 1/5 2/5 3/5\n"
    raw = obj(text, **{"mats/skin.1001.png": NOISE, "mats/skin.1002.png": OTHER})
    assert raw.page.tolist() == [0, 1]
    np.testing.assert_array_equal(raw.pages[1].pixels, OTHER)


@pytest.mark.parametrize("named", ["../../skin.png", "..:/skin.png", "a:/../../skin.png",
                                   "a:/../../../skin.png", "%2e%2e/%2e%2e/skin.png"])  # fmt: skip
def test_nothing_outside_is_read_from_a_folder_within(obj, tmp_path, named):
    scan = tmp_path / "scan"
    (scan / "mats").mkdir(parents=True)
    images.write_image(tmp_path / "skin.png", NOISE)
    (scan / "mats/m.mtl").write_text(f"newmtl skin\nmap_Kd {named}\n")
    (scan / "a.obj").write_text(SQUARE.replace("m.mtl", "mats/m.mtl"))
    with suppress(ScanError):
        assert read_scan(scan / "a.obj").pages == ()


def test_a_material_file_nobody_named_that_links_outside_is_skipped(tmp_path):
    scan = tmp_path / "scan"
    scan.mkdir()
    (tmp_path / "secret.mtl").write_text("newmtl skin\nKd 1 0 0\n")
    (scan / "a.mtl").symlink_to(tmp_path / "secret.mtl")
    (scan / "a.obj").write_text(SQUARE.replace("mtllib m.mtl\n", ""))
    raw = read_scan(scan / "a.obj")
    assert raw.pages == ()
    assert any(note.startswith("a.mtl, beside the scan, is a link") for note in raw.notes)


def jpeg(**options):
    stream = BytesIO()
    noise = np.random.default_rng(1).integers(0, 256, (64, 64, 3)).astype(np.uint8)
    Image.fromarray(noise).save(stream, "JPEG", **{"quality": 95, **options})
    return stream.getvalue()


KINDS = {
    "baseline": {},
    "progressive": {"progressive": True},
    "restarts": {"restart_marker_blocks": 2},
    "thumbnail": {"exif": b"Exif\0\0" + jpeg(quality=5)},
}
CUTS = {
    "half": lambda data: data[: len(data) // 2],
    "the last bytes": lambda data: data[:-20],
    "half, then zeros": lambda data: data[: len(data) // 2].ljust(len(data), b"\0"),
    "half, then an end": lambda data: data[: len(data) // 2] + b"\xff\xd9",
}


@pytest.mark.parametrize("kind", KINDS)
def test_a_jpeg_that_is_cut_short_is_refused_and_one_with_more_behind_it_is_not(tmp_path, kind):
    whole, path = jpeg(**KINDS[kind]), tmp_path / "skin.jpg"
    path.write_bytes(whole)
    pixels = images.read_colors(path)
    for more in (b"\0" * 5000, b"SEFT" * 40, whole):
        path.write_bytes(whole + more)
        np.testing.assert_array_equal(images.read_colors(path), pixels)
    for cut in CUTS.values():
        path.write_bytes(cut(whole))
        with pytest.raises(ScanError, match=r"skin\.jpg is cut short"):
            images.read_colors(path)


@pytest.mark.parametrize(("name", "what"), [("x.null", "x.null"), ("ha\udcff.png", "not UTF-8")])
def test_images_that_nobody_reads(tmp_path, name, what):
    try:
        (tmp_path / name).write_bytes(b"nothing")
    except OSError:
        pytest.skip("this file system has no such names")
    with pytest.raises(ScanError, match=what) as caught:
        images.read_colors(tmp_path / name)
    assert caught.value.fix


def test_a_lone_image_whose_name_is_not_utf_8_is_skipped_and_said(tmp_path):
    image = images.write_image(tmp_path / "skin.png", NOISE)
    try:
        image.rename(tmp_path / "ha\udcff.png")
    except OSError:
        pytest.skip("this file system has no such names")
    (tmp_path / "a.obj").write_text(SQUARE)
    raw = read_scan(tmp_path / "a.obj")
    assert raw.pages == ()
    assert r"the image 'ha\udcff.png' is ignored: its name is not UTF-8" in raw.notes
