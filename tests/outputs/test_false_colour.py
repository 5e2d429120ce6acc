"""False-colour pictures: the colours mean what the legend says."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from scanrender.buffers import CATALOGUE, buffer_spec
from scanrender.images import read_image
from scanrender.outputs import colourmaps, falsecolour
from scanrender.outputs.colourmaps import diverging_table, sequential_table, tick_labels
from scanrender.outputs.falsecolour import false_colour, false_colour_png, with_common_range

MAGENTA = np.array(colourmaps.MAGENTA)


def legend_words(monkeypatch, *arguments):
    """What a picture's legend says, as a list of strings."""
    words = []
    draw = falsecolour.write
    monkeypatch.setattr(falsecolour, "write", lambda *a: (words.append(a[2]), draw(*a)))
    false_colour(*arguments)
    return words


@pytest.mark.parametrize("name", CATALOGUE)
def test_every_buffer_of_the_catalogue_can_be_shown(name):
    spec = buffer_spec(name)
    values = np.random.default_rng(1).normal(0.5, 2.0, (9, 16, len(spec.channels)))
    picture = false_colour(spec, values.astype(np.float32), np.ones((9, 16)))
    assert picture.dtype == np.uint8
    assert picture.shape[1] == 480
    assert picture.shape[0] > 9 * 30
    # Colours and vectors may be magenta by right; the tables of scalars never are.
    assert spec.kind != "scalar" or not (picture == MAGENTA).all(axis=2).any()


def test_a_symmetric_span_is_white_at_zero_blue_below_red_above():
    values = np.array([[-0.1, 0.0, 0.1]], np.float32)[:, :, None]
    picture = false_colour(buffer_spec("curvature"), values)
    low, zero, high = picture[80, [80, 240, 400]].astype(int)
    assert low[2] > low[0] + 50
    assert high[0] > high[2] + 50
    assert zero.min() > 240


def test_other_scalars_grow_brighter_from_low_to_high():
    luma = sequential_table() @ np.array([0.2126, 0.7152, 0.0722])
    assert np.all(np.diff(luma) > -1.0)
    assert sequential_table()[[0, -1]].tolist() == [[68, 1, 84], [253, 231, 37]]
    assert diverging_table()[[0, -1]].tolist() == [[5, 48, 97], [103, 0, 31]]


def test_what_is_not_finite_is_magenta_and_counted(frame, monkeypatch):
    curvature = frame.buffers["curvature"]
    words = legend_words(monkeypatch, buffer_spec("curvature"), curvature, frame.alpha)
    assert "3 px not finite (NaN or Inf)" in words
    picture = false_colour(buffer_spec("curvature"), curvature, frame.alpha)
    grow = picture.shape[1] // curvature.shape[1]
    assert np.all(picture[3 * grow, 4 * grow + grow // 2] == MAGENTA)
    assert np.count_nonzero((picture[: 34 * grow] == MAGENTA).all(axis=2)) == 3 * grow * grow


def test_unit_vectors_are_half_v_plus_half():
    values = np.array([[[0, 0, 1], [-1, 0, 0]]], np.float32)
    picture = false_colour(buffer_spec("normal_shading"), values)
    assert picture[100, 100].tolist() == [128, 128, 255]
    assert picture[100, 400].tolist() == [0, 128, 128]


def test_positions_state_the_range_of_each_axis(frame, monkeypatch):
    position = frame.buffers["position"]
    words = legend_words(monkeypatch, buffer_spec("position"), position, frame.alpha)
    z = position[frame.alpha > 0][:, 2]
    low, high = np.percentile(z, (0.5, 99.5))
    assert set(tick_labels(float(low), float(high), 2)) <= set(words)


def test_colours_are_srgb_and_say_when_they_were_darkened(monkeypatch):
    spec = buffer_spec("irradiance")
    mid = np.full((4, 4, 3), 0.2158605, np.float32)  # sRGB 128
    assert false_colour(spec, mid)[100, 100].tolist() == [128, 128, 128]
    said = " ".join(legend_words(monkeypatch, spec, mid * 20))
    assert "exposure x0.232, auto-scaled" in said
    assert "4.32" in said


def test_background_does_not_move_the_range(monkeypatch):
    depth = np.full((8, 8, 1), 600.0, np.float32)
    depth[:4] = 0.0
    alpha = (depth[:, :, 0] > 0).astype(np.float32)
    depth[4, 0] = 500.0
    said = " ".join(legend_words(monkeypatch, buffer_spec("depth_mm"), depth, alpha))
    assert "data 500 to 600" in said


def test_empty_constant_and_huge_pictures_are_shown_too(monkeypatch):
    spec = buffer_spec("depth_mm")
    nothing = np.zeros((5, 5, 1), np.float32)
    assert "no surface in this picture" in legend_words(monkeypatch, spec, nothing, nothing[..., 0])
    assert "constant 7" in legend_words(monkeypatch, spec, nothing + 7)
    false_colour(spec, np.full((5, 5, 1), np.nan, np.float32))
    false_colour(spec, np.float32(3e38) * np.linspace(-1, 1, 25, dtype="f").reshape(5, 5, 1))


def test_a_fixed_span_counts_what_it_hides(monkeypatch):
    spec = replace(buffer_spec("depth_mm"), span=(0.0, 1.0))
    values = np.linspace(0, 2, 100, dtype=np.float32).reshape(10, 10, 1)
    assert "50 % outside the range" in " ".join(legend_words(monkeypatch, spec, values))


def test_shapes_that_do_not_fit_are_refused():
    with pytest.raises(ValueError, match="alpha"):
        false_colour(buffer_spec("ao"), np.zeros((4, 4, 1)), np.zeros((3, 4)))
    with pytest.raises(ValueError, match="not a scalar"):
        false_colour(buffer_spec("ao"), np.zeros((4, 4, 3)))


def test_the_file_holds_the_picture_and_is_reproducible(tmp_path, frame):
    spec = buffer_spec("normal_geometry")
    pixels = frame.buffers["normal_geometry"]
    one = false_colour_png(tmp_path / "1.png", spec, pixels, frame.alpha)
    two = false_colour_png(tmp_path / "2.png", spec, pixels, frame.alpha)
    assert one.read_bytes() == two.read_bytes()
    held = np.rint(read_image(one) * 255).astype(np.uint8)
    assert np.array_equal(held, false_colour(spec, pixels, frame.alpha))


@pytest.mark.parametrize(
    ("low", "high", "labels"),
    [
        (-0.1, 0.1, ["-0.1", "0", "0.1"]),
        (0.0, 1.0, ["0", "0.5", "1"]),
        (598.2, 601.9, ["598.2", "600.05", "601.9"]),
        (0.0, 4000.0, ["0", "2000", "4000"]),
        (-1e-7, 1e-7, ["-1e-07", "0", "1e-07"]),
    ],
)
def test_ticks_have_the_decimals_they_need(low, high, labels):
    assert tick_labels(low, high, 3) == labels


def test_one_range_for_several_pictures_of_a_buffer():
    near, far = (np.full((8, 8, 1), level, np.float32) for level in (0.2, 0.8))
    alpha = np.ones((8, 8), np.float32)
    spec = with_common_range(buffer_spec("edge_guide"), [(near, alpha), (far, alpha)])
    assert spec.span == pytest.approx((0.2, 0.8))
    first, second = (false_colour(spec, pixels, alpha)[4, 4] for pixels in (near, far))
    assert np.abs(first.astype(int) - second).max() > 50
    fixed = buffer_spec("curvature")
    assert with_common_range(fixed, [(near, alpha)]) == fixed


def test_dark_light_is_exposed_up_when_pictures_share_a_range():
    glow = np.full((8, 8, 3), 0.1, np.float32)
    alpha = np.ones((8, 8), np.float32)
    spec = buffer_spec("transmission")
    shared = with_common_range(spec, [(glow, alpha), (0.5 * glow, alpha)])
    assert false_colour(shared, glow, alpha)[4, 4].min() > 250
    assert false_colour(spec, glow, alpha)[4, 4].max() < 100
