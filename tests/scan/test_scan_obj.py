"""OBJ and MTL in less usual spellings: each is read as meant, or its loss is said."""

from __future__ import annotations

import numpy as np
import pytest

from scanrender import images
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
