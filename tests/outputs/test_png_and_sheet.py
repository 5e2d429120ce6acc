"""The finished picture, the contact sheet, and the words on them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from scanrender.errors import UsageError
from scanrender.images import read_image
from scanrender.outputs import contact_sheet as module
from scanrender.outputs.contact_sheet import Tile, contact_sheet, sheet_pixels
from scanrender.outputs.lettering import drawable, elided, measure, wrapped
from scanrender.outputs.png import bytes_from_unit, write_frame_png


def test_display_is_written_as_it_is(tmp_path, frame):
    display = frame.buffers["display"]
    back = read_image(write_frame_png(tmp_path / "f.png", frame))
    assert np.array_equal(np.rint(back * 255), bytes_from_unit(display))


def test_alpha_leaves_colours_alone(tmp_path, frame):
    half = replace(frame, alpha=frame.alpha * 0.5)
    back = read_image(write_frame_png(tmp_path / "f.png", half, alpha=True))
    assert np.array_equal(np.rint(back[:, :, 3] * 255), bytes_from_unit(half.alpha))
    stored = np.asarray(Image.open(tmp_path / "f.png"))  # OpenImageIO would premultiply
    assert np.array_equal(stored[:, :, :3], bytes_from_unit(frame.buffers["display"]))


def test_a_frame_without_display_is_refused(tmp_path, frame):
    with pytest.raises(UsageError, match="display"):
        write_frame_png(tmp_path / "f.png", replace(frame, buffers={}))


def test_bytes_round_and_survive_what_is_not_finite():
    values = np.array([0.5 / 255 - 1e-5, 0.5 / 255 + 1e-5, -3, 7, np.nan, np.inf, -np.inf])
    assert bytes_from_unit(values).tolist() == [0, 1, 0, 255, 0, 255, 0]


def tiles(count, height=90, width=120):
    return [Tile(f"tile {i}", np.full((height, width, 3), i / count)) for i in range(1, count + 1)]


def test_tiles_are_shown_pixel_for_pixel_when_they_fit(tmp_path):
    noise = np.random.default_rng(3).integers(0, 256, (300, 400, 3), dtype=np.uint8)
    sheet = sheet_pixels([Tile(str(i), noise) for i in range(6)], 3, "t", "s", "f")
    windows = np.argwhere((sheet[:, :, 0] == noise[0, 0, 0]) & (sheet[:, :, 1] == noise[0, 0, 1]))
    matches = [(y, x) for y, x in windows if np.array_equal(sheet[y : y + 300, x : x + 400], noise)]
    assert len(matches) == 6
    assert len({x for _, x in matches}) == 3


def test_a_wide_sheet_is_reduced_to_a_page():
    assert sheet_pixels(tiles(12, 540, 960), 6, "t", "", "").shape[1] <= module.MAX_SHEET


def test_mixed_sizes_long_labels_and_a_short_last_row(tmp_path):
    mixed = [*tiles(3), Tile("ä" * 300, np.ones((4, 3, 3))), Tile("", np.zeros((2000, 20, 3)))]
    one = contact_sheet(tmp_path / "1.png", mixed, columns=2, title="x" * 400)
    two = contact_sheet(tmp_path / "2.png", mixed, columns=2, title="x" * 400)
    assert one.read_bytes() == two.read_bytes()
    assert read_image(one).shape[1] == module.MIN_SHEET


def painted(height, width, level):
    return np.full((height, width, 3), (level, 0, 0), np.uint8)


def extent(sheet, level):
    """(top, bottom, left, right) of what has this red; letters are grey."""
    rows, columns = np.nonzero((np.abs(sheet.astype(int) - (level, 0, 0)) < 2).all(axis=2))
    return rows.min(), rows.max(), columns.min(), columns.max()


def test_pictures_of_a_row_start_at_one_top_and_fill_their_columns():
    """A cropped panel beside a square one and one with a legend under it."""
    parts = [painted(300, 400, 200), painted(200, 400, 160), painted(90, 120, 120)]
    sheet = sheet_pixels([Tile("a", part, "1.0") for part in parts], 3, "t", "s", "")
    tops, bottoms, lefts, rights = zip(*(extent(sheet, v) for v in (200, 160, 120)), strict=True)
    assert max(tops) - min(tops) <= 1
    widths = np.subtract(rights, lefts)
    np.testing.assert_allclose(widths, 399, atol=1)
    np.testing.assert_allclose(np.subtract(bottoms, tops), [299, 199, 299], atol=1)


def test_a_note_stands_under_the_label():
    plain = sheet_pixels([Tile("a", painted(90, 400, 200))], 1, "t", "", "")
    noted = sheet_pixels([Tile("a", painted(90, 400, 200), "dE2000 0.20")], 1, "t", "", "")
    assert noted.shape[0] > plain.shape[0]
    below = noted[extent(noted, 200)[1] + 25 :]
    assert (below.max(axis=(1, 2)) > 100).any()


def test_an_empty_sheet_is_refused(tmp_path):
    with pytest.raises(UsageError, match="at least one tile"):
        contact_sheet(tmp_path / "s.png", [], columns=3, title="t")


def test_words_that_the_typeface_lacks_are_spelled_otherwise():
    assert drawable("Jörg — 2×2 ±3°") == "Jorg - 2x2 ±3°"
    assert drawable("李 Łódź\tx") == "? Lodz x"


def test_lines_fit_their_width():
    text = "Length of skin between the surface and where the light of a lit rim enters."
    lines = wrapped(text, 14, 200)
    assert " ".join(lines) == text
    assert all(measure(line, 14) <= 200 for line in lines)
    assert measure(elided(text, 14, 100), 14) <= 100
    assert elided("short", 14, 100) == "short"
