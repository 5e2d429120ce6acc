"""OBJ and MTL in less usual spellings: each is read as meant, or its loss is said."""

from __future__ import annotations

from io import BytesIO

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


def jpeg(**options):
    stream = BytesIO()
    noise = np.random.default_rng(1).integers(0, 256, (64, 64, 3)).astype(np.uint8)
    Image.fromarray(noise).save(stream, "JPEG", **{"quality": 95, **options})
    return stream.getvalue()


KINDS = {"baseline": {}, "progressive": {"progressive": True}, "restarts":
         {"restart_marker_blocks": 2}, "thumbnail": {"exif": b"Exif\0\0" + jpeg(quality=5)}}  # fmt: skip
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
