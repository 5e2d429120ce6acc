"""Video: right colours, right count, same bytes, and nothing left behind by a failure."""

from __future__ import annotations

from fractions import Fraction

import av
import numpy as np
import pytest

from scanrender.errors import OutputError
from scanrender.outputs.video import VideoWriter, probe_video, yuv420_from_display

COLOURS = {
    "red": (1, 0, 0), "green": (0, 1, 0), "blue": (0, 0, 1), "white": (1, 1, 1),
    "black": (0, 0, 0), "skin": (0.87, 0.66, 0.56), "grey": (0.5, 0.5, 0.5),
}  # fmt: skip


def write(path, frames, width=64, height=48, fps=24, **options):
    with VideoWriter(path, width, height, fps, **options) as video:
        for frame in frames:
            video.write(frame)
    return path


def flat(colour, height=48, width=64):
    return np.broadcast_to(np.array(colour, np.float32), (height, width, 3))


def turntable(count, height=48, width=64):
    """A soft blob that moves: something for motion search to work on."""
    y, x = np.mgrid[0:height, 0:width].astype(np.float32)
    for index in range(count):
        blob = np.exp(-((x - 10 - 3 * index) ** 2 + (y - 20) ** 2) / 80)
        yield blob[:, :, None] * np.array(COLOURS["skin"], np.float32)


def decoded(path):
    """First frame as float R'G'B' in [0, 1], by BT.709's equations and no library's opinion."""
    with av.open(str(path)) as container:
        picture = next(container.decode(video=0)).to_ndarray(format="yuv420p").astype(np.float64)
    height = picture.shape[0] * 2 // 3
    luma = (picture[:height] - 16) / 219
    blue, red = (picture[height:].reshape(2, height // 2, -1) - 128) / 224
    blue, red = (c.repeat(2, axis=0).repeat(2, axis=1) for c in (blue, red))
    r, b = luma + 1.5748 * red, luma + 1.8556 * blue
    return np.stack([r, (luma - 0.2126 * r - 0.0722 * b) / 0.7152, b], axis=2)


@pytest.mark.parametrize("name", COLOURS)
def test_flat_colours_decode_within_three_levels(tmp_path, name):
    path = write(tmp_path / "v.mp4", [flat(COLOURS[name])] * 3)
    assert np.abs(decoded(path) - COLOURS[name]).max() * 255 <= 3


def test_a_player_that_heeds_the_tags_shows_the_same_red(tmp_path):
    path = write(tmp_path / "v.mp4", [flat((1, 0, 0))] * 2)
    with av.open(str(path)) as container:
        codec = container.streams.video[0].codec_context
        tags = (codec.colorspace, codec.color_primaries, codec.color_trc, codec.color_range)
        shown = next(container.decode(video=0)).to_ndarray(format="rgb24")
    assert [int(tag) for tag in tags] == [1, 1, 1, 1]
    assert np.abs(shown.astype(int) - (255, 0, 0)).max() <= 3


def test_conversion_hits_the_codes_of_the_standard():
    """75 % colour bars have published codes (ITU-R BT.1729 family): white, yellow, red, blue."""
    bars = {(0.75, 0.75, 0.75): (180, 128, 128), (0.75, 0.75, 0): (168, 44, 136),
            (0.75, 0, 0): (51, 109, 212), (0, 0, 0.75): (28, 212, 120)}  # fmt: skip
    for colour, (luma, blue, red) in bars.items():
        planes = yuv420_from_display(flat(colour, 4, 6)).ravel()
        assert set(planes[:24]) == {luma}
        assert set(planes[24:30]) == {blue}
        assert set(planes[30:]) == {red}


def test_chroma_lies_on_the_left_column_between_two_rows():
    """A horizontal ramp of blueness keeps its value at even columns: no half-pixel shift."""
    frame = np.zeros((2, 12, 3))
    frame[:, :, 2] = np.linspace(0.1, 0.9, 12)
    blue = yuv420_from_display(frame).ravel()[24:30].astype(float)
    expected = 128 + 224 * (1 - 0.0722) * frame[0, ::2, 2] / 1.8556
    assert np.abs(blue - expected)[1:].max() <= 0.5


def test_bytes_and_floats_give_the_same_video():
    levels = np.random.default_rng(2).integers(0, 256, (6, 8, 3), dtype=np.uint8)
    assert np.array_equal(yuv420_from_display(levels), yuv420_from_display(levels / 255.0))


def test_nan_is_black_and_excess_is_clipped():
    frame = np.zeros((2, 2, 3), np.float32)
    frame[:] = np.nan
    assert set(yuv420_from_display(frame)[:2].ravel()) == {16}
    frame[:] = np.inf
    assert set(yuv420_from_display(frame)[:2].ravel()) == {235}


def test_same_frames_give_the_same_bytes(tmp_path):
    one = write(tmp_path / "1.mp4", turntable(30, 180, 320), 320, 180)
    two = write(tmp_path / "2.mp4", turntable(30, 180, 320), 320, 180)
    assert one.read_bytes() == two.read_bytes()


def test_odd_sizes_are_padded_and_every_frame_arrives(tmp_path):
    path = write(tmp_path / "v.mp4", turntable(7, 33, 51), 51, 33, fps=Fraction(30000, 1001))
    found = probe_video(path)
    assert found == {"frames": 7, "width": 52, "height": 34, "fps": pytest.approx(29.97, abs=1e-3),
                     "codec": "h264"}  # fmt: skip


def test_the_index_comes_first_and_no_date_is_held(tmp_path):
    path = write(tmp_path / "v.mp4", turntable(3))
    held = path.read_bytes()
    assert held.index(b"moov") < held.index(b"mdat")
    assert held[held.index(b"mvhd") + 8 :][:8] == bytes(8)  # creation and modification time


def test_a_failure_inside_leaves_nothing_and_keeps_its_own_error(tmp_path):
    def broken():
        yield from turntable(2)
        raise PermissionError("the renderer's own trouble")

    with pytest.raises(PermissionError, match="the renderer's own trouble"):
        write(tmp_path / "v.mp4", broken())
    assert list(tmp_path.iterdir()) == []


def test_an_existing_video_survives_a_failed_second_run(tmp_path):
    path = write(tmp_path / "v.mp4", turntable(2))
    before = path.read_bytes()
    with pytest.raises(ValueError, match="shape"):
        write(path, [np.zeros((3, 3, 3))])
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


def test_sentences_for_what_cannot_be_encoded(tmp_path):
    with pytest.raises(OutputError, match="no frame came"):
        write(tmp_path / "v.mp4", [])
    with pytest.raises(OutputError, match="cannot encode video"):
        write(tmp_path / "v.mp4", [], 40_000, 2)
    (tmp_path / "text.mp4").write_text("not a video")
    with pytest.raises(OutputError, match="cannot read video"):
        probe_video(tmp_path / "text.mp4")
    assert [p.name for p in tmp_path.iterdir()] == ["text.mp4"]
