"""What report.html embeds: strips of turns, values of buffers, text that cannot leave its tag."""

from __future__ import annotations

import base64
import io
import itertools
import json
import zlib
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from PIL import Image

from scanrender.buffers import Frame
from scanrender.errors import OutputError
from scanrender.outputs.exr import layers_of, read_exr, write_exr
from scanrender.outputs.png import write_bytes_png
from scanrender.outputs.report.layers import VALUES_PX, layers_of_frame, packed
from scanrender.outputs.report.page import safe_json, write_page
from scanrender.outputs.report.turn import MOST_FRAMES, spread, turn_of
from scanrender.outputs.video import VideoWriter


def picture(uri: str) -> np.ndarray:
    head, data = uri.split(",")
    assert head == "data:image/webp;base64"
    return np.asarray(Image.open(io.BytesIO(base64.b64decode(data))).convert("RGB"))


def unpacked(values: dict, channels: int) -> np.ndarray:
    """The inverse of `packed`, as the page does it: NaN where there is nothing or no number."""
    plain = np.frombuffer(zlib.decompress(base64.b64decode(values["data"])), np.uint8)
    high, low = plain.reshape(2, channels, values["height"], values["width"]).astype(np.uint16)
    codes = np.cumsum((high << 8) + low, axis=2, dtype=np.uint16)
    least, most = np.array(values["ranges"]).T[:, :, None, None]
    found = least + (most - least) * (codes - 2.0) / 65533.0
    return np.moveaxis(np.where(codes < 2, np.nan, found), 0, 2)


# --- values ---------------------------------------------------------------------------------------


@given(
    hnp.arrays(
        np.float32,
        hnp.array_shapes(min_dims=3, max_dims=3, min_side=1, max_side=9).map(
            lambda shape: (shape[0], shape[1], 3)
        ),
        elements=st.floats(-1e6, 1e6, width=32),
    )
)
def test_values_come_back_to_a_65000th_of_their_range(pixels: np.ndarray):
    values = packed(pixels, None)
    assert values["step"] == 1
    span = np.ptp(pixels.astype(float), axis=(0, 1))
    off = np.abs(unpacked(values, 3) - pixels)
    assert (off <= span / 65533 * 0.51 + 1e-9).all()


def test_what_is_no_surface_and_what_is_no_number_stay_apart():
    pixels = np.array([[1.0, 2.0, np.nan, 4.0]], np.float32)[:, :, None]
    alpha = np.array([[0.0, 1.0, 1.0, 1.0]], np.float32)
    values = packed(pixels, alpha)
    plain = np.frombuffer(zlib.decompress(base64.b64decode(values["data"])), np.uint8)
    codes = np.cumsum(plain[:4].astype(np.uint16) * 256 + plain[4:], dtype=np.uint16)
    assert codes.tolist() == [0, round(2 + 65533 / 3), 1, 65535]


def test_kept_values_are_pixels_not_means():
    rng = np.random.default_rng(1)
    pixels = rng.random((3 * VALUES_PX - 5, 700, 1), np.float32)
    values = packed(pixels, None)
    assert (values["step"], values["height"]) == (3, VALUES_PX - 1)
    np.testing.assert_allclose(unpacked(values, 1), pixels[::3, ::3], atol=1e-5)


def frame() -> Frame:
    depth = np.linspace(400, 500, 20 * 24, dtype=np.float32).reshape(20, 24, 1)
    shadow = np.ones((8, 8, 1), np.float32)
    alpha = np.ones((20, 24), np.float32)
    alpha[:4] = 0.0
    beauty = np.repeat(depth / 500, 3, axis=2)
    buffers = {"beauty": beauty, "depth_mm": depth, "shadow_0": shadow, "display": beauty}
    return Frame(buffers, alpha)


@pytest.mark.parametrize("layout", ["single", "multipart", "per_buffer"])
def test_every_layout_gives_the_same_layers(tmp_path: Path, layout: str):
    made = frame()
    names = ["beauty", "depth_mm", "shadow_0", "display"]
    files = list(write_exr(tmp_path / "frame_0003.exr", made, layout=layout, names=names))
    layers = {layer["name"]: layer for layer in layers_of_frame(files, 3)}
    assert set(layers) == set(names)
    depth = layers["depth_mm"]
    assert (depth["unit"], depth["width"], depth["height"], depth["frame"]) == ("mm", 24, 20, 3)
    values = unpacked(depth["values"], 1)
    np.testing.assert_allclose(values[4:], made.buffers["depth_mm"][4:], atol=0.002)
    if layout != "per_buffer":  # where depth lies in a file of its own, there is no alpha
        assert np.isnan(values[:4]).all()
    assert picture(depth["picture"]).shape == (20, 24, 3)
    assert len(depth["bars"]) == 1
    assert not np.isnan(unpacked(layers["shadow_0"]["values"], 1)).any()


def test_layers_are_read_in_parts_as_they_are_read_at_once(tmp_path: Path):
    names = ["beauty", "depth_mm"]
    path = write_exr(tmp_path / "a.exr", frame(), names=names)[-1]
    whole, parts = read_exr(path), dict(layers_of(path, at_once=1))
    assert next(iter(parts)) == "alpha"
    assert set(parts) == set(whole)
    for name, pixels in whole.items():
        np.testing.assert_array_equal(parts[name], pixels)


# --- turns ----------------------------------------------------------------------------------------


@given(st.integers(0, 2000))
def test_frames_of_a_strip_are_spread_and_bounded(count: int):
    kept = spread(count)
    assert len(kept) == min(count, MOST_FRAMES)
    assert all(0 <= index < count for index in kept)
    assert len({b - a for a, b in itertools.pairwise(kept)}) <= 2


def colour(index: int) -> np.ndarray:
    return np.full((48, 32, 3), (20 * index, 120, 200 - 15 * index), np.uint8)


def check(turn: dict, count: int) -> None:
    assert turn["shown"] == list(range(count))
    strip = picture(turn["strip"]).astype(int)
    for index in range(count):
        row, column = divmod(index, turn["columns"])
        middle = strip[row * 48 + 24, column * 32 + 16]
        assert np.abs(middle - colour(index)[0, 0]).max() <= 8
    assert picture(turn["still"]).shape == (48, 32, 3)


def test_a_strip_is_made_of_frames(tmp_path: Path):
    files = [write_bytes_png(tmp_path / f"frame_{i}.png", colour(i)) for i in range(7)]
    check(turn_of(files, None), 7)


def test_frames_of_a_part_keep_their_numbers(tmp_path: Path):
    files = [write_bytes_png(tmp_path / f"frame_{i:04d}.png", colour(i)) for i in (8, 9)]
    assert turn_of(files, None)["shown"] == [8, 9]


def test_a_strip_is_made_of_a_video_in_its_colours(tmp_path: Path):
    path = tmp_path / "turn.mp4"
    with VideoWriter(path, 32, 48, fps=8) as video:
        for index in range(7):
            video.write(colour(index))
    check(turn_of([], path), 7)


def test_a_video_that_is_none_is_told(tmp_path: Path):
    (tmp_path / "turn.mp4").write_bytes(b"no video")
    with pytest.raises(OutputError, match="cannot read video"):
        turn_of([], tmp_path / "turn.mp4")


# --- text -----------------------------------------------------------------------------------------


@given(st.text())
def test_no_text_ends_its_script(text: str):
    made = safe_json({"name": text + "</script><!--\u2028"})
    assert not set("<>&\u2028\u2029") & set(made)
    assert json.loads(made)["name"].startswith(text)


def test_data_that_looks_like_the_template_is_left_alone(tmp_path: Path):
    page = write_page(tmp_path / "a.html", {"title": "%%script%% %%data%%"}, {})
    assert page.read_text(encoding="utf-8").count("%%script%% %%data%%") == 1
