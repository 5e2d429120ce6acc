"""Colours on their way from pages to texels: averaged in place, each page by itself."""

from __future__ import annotations

import numpy as np
import pytest

from scanrender.scan.bake_albedo import ColorSource, averaging, supersampling
from scanrender.scan.pages import Page
from scanrender.scan.rays import Hits
from scanrender.scan.skinmask import SkinMask
from scanrender.scan.surface import Surface

PALETTE = np.array([[[255, 0, 0], [0, 255, 0]], [[0, 0, 255], [255, 255, 255]]], np.uint8)


def ramp(width, height=8):
    """A page whose linear value at uv is u."""
    values = (np.arange(width, dtype=np.float32) + 0.5) / width
    return Page("ramp", np.tile(values[None, :, None], (height, 1, 3)), "linear")


def squares(*uv):
    """Squares of 100 mm side by side, one to a page, with the given coordinates (4, 2) each."""
    corner = np.array([[0.0, 0.0, 0.0], [100.0, 0.0, 0.0], [100.0, 100.0, 0.0], [0.0, 100.0, 0.0]])
    two = np.array([[0, 1, 2], [0, 2, 3]])
    count = len(uv)
    positions = np.concatenate([corner + np.array([100.0 * k, 0.0, 0.0]) for k in range(count)])
    faces = np.concatenate([two + 4 * k for k in range(count)])
    corner_uv = np.concatenate([np.asarray(x, np.float32)[two] for x in uv])
    page = np.repeat(np.arange(count), 2).astype(np.int16)
    return Surface(positions, faces, corner_uv, page, None)


WHOLE = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
RED_PIXEL = np.full((4, 2), 0.25)
MIDDLES = Hits(np.arange(4, dtype=np.int32), np.full((4, 3), 1 / 3, np.float32), np.zeros(4))


@pytest.mark.parametrize("factor", [2, 7, 13, 50])
def test_an_averaged_page_lies_where_it_lay(factor):
    """960 pixels are 73 blocks of 13 and a part of one: the image ends where it ended."""
    page = ramp(960, 960)
    uv = np.array([[u, v] for u in (0.1, 0.5, 0.9) for v in (0.1, 0.5, 0.9)])
    at_border = 0.5 * factor / 960
    small = page.shrunk(factor)
    assert small.size[0] < 960 / factor + 1
    np.testing.assert_allclose(small.sample(uv)[:, 0], uv[:, 0], atol=1e-5)
    assert small.sample(np.array([[1.0, 0.5]]))[0, 0] == pytest.approx(1.0, abs=1.01 * at_border)
    upright = Page("ramp", page.pixels.transpose(1, 0, 2), "linear").shrunk(factor)
    np.testing.assert_allclose(upright.sample(uv)[:, 0], uv[:, 1], atol=1e-5)


def test_averaging_leaves_no_pixel_out():
    pixels = np.zeros((5, 5, 3), np.uint8)
    pixels[4, 4] = 255
    small = Page("corner", pixels).shrunk(4)
    assert small.pixels[:, :, 0].tolist() == [[0.0, 0.0], [0.0, 1.0]]


def test_a_palette_beside_a_large_page_keeps_its_colours():
    """A texel holds thousands of the large page's pixels, and a part of one of the palette's."""
    large = Page("large", np.full((960, 960, 3), 128, np.uint8))
    palette = Page("palette", PALETTE)
    source = ColorSource(squares(WHOLE, RED_PIXEL), (large, palette), (0.5, 0.5, 0.5))
    every_mm, page_mm = source.pixels_mm()
    assert every_mm == page_mm[0] == pytest.approx(100.0 / 960)
    factors = averaging(page_mm, 100.0 / 10)
    assert factors == [96, 1]
    small = source.shrunk(factors)
    assert small.pages[0].size == (10, 10)
    assert small.pages[1] is palette
    np.testing.assert_allclose(small.at(MIDDLES)[2:], [[1.0, 0.0, 0.0]] * 2, atol=1e-6)


def test_each_page_is_averaged_by_its_own_fineness():
    pages = (ramp(800, 800), ramp(200, 200), ramp(1, 1))
    source = ColorSource(squares(WHOLE, WHOLE, WHOLE), pages, (0.5, 0.5, 0.5))
    _, page_mm = source.pixels_mm()
    assert page_mm == pytest.approx([0.125, 0.5, np.inf])
    assert averaging(page_mm, 1.0) == [8, 2, 1]
    assert averaging(page_mm, 0.1) == [1, 1, 1]
    assert source.shrunk([1, 1, 1]) is source


def test_images_finer_than_the_map_take_four_samples():
    assert supersampling(1.0, 1.1) == supersampling(float("inf"), 1.0) == 1
    assert supersampling(1.0, 1.3) == 2


def test_a_skin_mask_averages_each_image_by_itself():
    """Black and white in pixels of the second image, which the first is fifty times as fine as."""
    fine, coarse = np.full((960, 960, 3), 255, np.uint8), np.zeros((2, 2, 3), np.uint8)
    coarse[0, 0] = 255
    mask = SkinMask((Page("fine", fine, "linear"), Page("coarse", coarse, "linear")))
    skin = mask.at(squares(WHOLE, RED_PIXEL), MIDDLES, 10.0)
    np.testing.assert_allclose(skin, 1.0)
