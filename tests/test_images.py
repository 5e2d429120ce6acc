"""Colour encodings invert each other, and bad image files are errors, never black pictures."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from scanrender import images
from scanrender.errors import OutputError, ScanError

UNIT = st.floats(0.0, 1.0)


@given(UNIT)
def test_srgb_round_trip(value: float):
    assert images.linear_from_srgb(images.srgb_from_linear(value)) == pytest.approx(value, abs=1e-7)


@given(UNIT, UNIT)
def test_srgb_keeps_the_order(a: float, b: float):
    low, high = sorted((a, b))
    assert images.srgb_from_linear(low) <= images.srgb_from_linear(high)


def test_srgb_golden_numbers():
    # IEC 61966-2-1: 18 % grey is code value 118 of 255; the branches meet at 0.04045.
    assert 255 * float(images.srgb_from_linear(0.18)) == pytest.approx(117.6, abs=0.1)
    assert float(images.linear_from_srgb(0.5)) == pytest.approx(0.21404, abs=1e-5)
    assert float(images.linear_from_srgb(0.04045)) == pytest.approx(0.04045 / 12.92, abs=1e-6)


@pytest.mark.parametrize("value", [-5.0, 2.0, np.inf, -np.inf])
def test_srgb_clips_what_no_screen_shows(value: float):
    assert float(images.srgb_from_linear(value)) == pytest.approx(float(value > 0), abs=1e-12)


@pytest.mark.parametrize(
    ("suffix", "dtype"), [("png", "uint8"), ("png", "uint16"), ("exr", "float16"),
                          ("exr", "float32"), ("tif", "float32")],
)  # fmt: skip
@pytest.mark.parametrize("channels", [1, 3, 4])
def test_pixels_round_trip(tmp_path: Path, suffix: str, dtype: str, channels: int):
    rng = np.random.default_rng(0)
    values = rng.random((5, 7, channels))
    scale = np.iinfo(dtype).max if dtype.startswith("u") else 1
    # A reversed, non-contiguous view: rows must not come out in another order.
    pixels = (values * scale).astype(dtype)[::-1]
    # With alpha, colours must not be divided by it behind our back.
    attributes = {"oiio:UnassociatedAlpha": 1} if channels == 4 else {}
    path = images.write_image(tmp_path / f"a.{suffix}", pixels, attributes=attributes)
    back = images.read_image(path)
    assert back.shape == (5, 7, channels)
    if channels != 4 or suffix == "exr":
        np.testing.assert_allclose(back, pixels.astype(np.float64) / scale, atol=1e-6)
    assert [p.name for p in tmp_path.iterdir()] == [f"a.{suffix}"]


def test_a_two_dimensional_array_is_one_channel(tmp_path: Path):
    path = images.write_image(tmp_path / "a.exr", np.ones((3, 4), np.float32))
    assert images.read_image(path).shape == (3, 4, 1)


def test_albedo_png_holds_the_value_within_half_a_step(tmp_path: Path):
    linear = np.linspace(0, 1, 300, dtype=np.float32).reshape(10, 10, 3)
    stored = images.read_image(images.write_srgb_png(tmp_path / "a.png", linear))
    assert np.abs(stored - images.srgb_from_linear(linear)).max() <= 0.5001 / 255


@pytest.mark.parametrize("name", ["absent.png", "text.png", "cut.png", "empty.exr"])
def test_an_unreadable_file_is_a_scan_error_that_names_it(tmp_path: Path, name: str):
    good = images.write_png8(tmp_path / "good.png", np.random.default_rng(0).random((64, 64, 3)))
    (tmp_path / "text.png").write_text("this is no picture")
    (tmp_path / "cut.png").write_bytes(good.read_bytes()[:2000])
    (tmp_path / "empty.exr").write_bytes(b"")
    with pytest.raises(ScanError) as caught:
        images.read_image(tmp_path / name)
    assert name in str(caught.value)


def test_an_image_bomb_is_refused_before_it_is_decoded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    path = images.write_png8(tmp_path / "a.png", np.zeros((8, 9, 3)))
    monkeypatch.setattr(images, "MAX_PIXELS", 71)
    with pytest.raises(ScanError, match="9 x 8"):
        images.read_image(path)


def test_a_format_that_cannot_be_written_is_an_output_error(tmp_path: Path):
    with pytest.raises(OutputError):
        images.write_image(tmp_path / "a.nosuchformat", np.zeros((2, 2, 3), np.float32))
    assert list(tmp_path.iterdir()) == []
