"""What goes into an EXR comes out bit for bit, and says what it is."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import OpenImageIO
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from scanrender.buffers import Frame
from scanrender.errors import OutputError, ScanError, UsageError
from scanrender.outputs.exr import read_exr, write_exr

LAYOUTS = ("single", "multipart", "per_buffer")


def same_bits(one: np.ndarray, other: np.ndarray) -> bool:
    return one.shape == other.shape and bool(np.all(one.view(np.uint32) == other.view(np.uint32)))


def headers(path: Path) -> list[OpenImageIO.ImageSpec]:
    source = OpenImageIO.ImageInput.open(str(path))
    found = []
    while source.seek_subimage(len(found), 0):
        found.append(source.spec())
    source.close()
    return found


@pytest.mark.parametrize("layout", LAYOUTS)
def test_every_bit_comes_back(tmp_path, frame, layout):
    files = write_exr(tmp_path / "f.exr", frame, layout=layout)
    back = {name: pixels for file in files for name, pixels in read_exr(file).items()}
    assert set(back) == {*frame.buffers, "alpha"} - {"display"}
    assert same_bits(back.pop("alpha")[:, :, 0], frame.alpha)
    for name, pixels in back.items():
        assert same_bits(pixels, frame.buffers[name]), name


@settings(max_examples=15, deadline=None)
@given(bits=st.lists(st.integers(0, 2**32 - 1), min_size=6, max_size=6))
def test_any_float32_comes_back(tmp_path_factory, bits):
    """NaN with any payload, denormals and infinities: a file for debugging must not tidy up."""
    folder = tmp_path_factory.mktemp("bits")
    curvature = np.array(bits, np.uint32).view(np.float32).reshape(2, 3, 1)
    frame = Frame({"curvature": curvature}, np.ones((2, 3), np.float32))
    (path,) = write_exr(folder / "f.exr", frame)
    assert same_bits(read_exr(path)["curvature"], curvature)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_two_writes_give_the_same_bytes(tmp_path, frame, layout):
    first = write_exr(tmp_path / "one" / "f.exr", frame, layout=layout)
    second = write_exr(tmp_path / "two" / "f.exr", frame, layout=layout)
    assert [a.read_bytes() for a in first] == [b.read_bytes() for b in second]


def test_beauty_is_unnamed_rgba_and_layers_have_one_dot(tmp_path, frame):
    *_, path = write_exr(tmp_path / "f.exr", frame)
    (header,) = headers(path)
    assert header.channelnames[:4] == ("R", "G", "B", "A")
    assert "normal_geometry.X" in header.channelnames
    assert all(c.count(".") == 1 and c[0].isalpha() for c in header.channelnames[4:])


def test_a_shadow_map_of_another_size_gets_its_own_file(tmp_path, frame):
    files = write_exr(tmp_path / "frame_0003.exr", frame)
    assert [f.name for f in files] == ["frame_0003.shadow_0.exr", "frame_0003.exr"]
    assert read_exr(files[0])["shadow_0"].shape == (64, 64, 1)


def test_display_is_not_mixed_with_linear_layers(tmp_path, frame):
    files = write_exr(tmp_path / "f.exr", frame, names=["display", "beauty"])
    assert [f.name for f in files] == ["f.display.exr", "f.exr"]
    (header,) = headers(files[0])
    assert header.getattribute("colorInteropID") == "srgb_rec709_display"


def test_each_part_has_its_name_full_channels_and_colour_id(tmp_path, frame):
    (path,) = write_exr(tmp_path / "f.exr", frame, layout="multipart")
    parts = {h.getattribute("oiio:subimagename"): h for h in headers(path)}
    assert next(iter(parts)) == "beauty"
    assert set(parts) == set(frame.buffers) - {"display"}
    assert parts["position"].channelnames == ("position.X", "position.Y", "position.Z")
    ids = {name: header.getattribute("colorInteropID") for name, header in parts.items()}
    assert ids["beauty"] == "lin_rec709_scene"
    assert ids["position"] == ids["shadow_0"] == ids["kernel_px"] == "data"


def test_the_header_explains_the_layers(tmp_path, frame):
    *_, path = write_exr(tmp_path / "f.exr", frame)
    (header,) = headers(path)
    assert header.format == OpenImageIO.FLOAT
    assert header.getattribute("compression") == "zip"
    assert header.getattribute("DateTime") == "1970:01:01 00:00:00"
    assert header.getattribute("Software").startswith("scanrender ")
    assert header.getattribute("chromaticities")[:2] == pytest.approx((0.64, 0.33))
    assert header.getattribute("scanrender/curvature/unit") == "1/mm"
    assert header.getattribute("scanrender/position/space") == "view"
    assert "smoothed" in header.getattribute("scanrender/curvature/meaning")


def test_a_file_of_data_alone_says_so(tmp_path, frame):
    (path,) = write_exr(tmp_path / "f.exr", frame, names=["position", "curvature"])
    assert headers(path)[0].getattribute("colorInteropID") == "data"


def test_sentences_for_what_cannot_be_done(tmp_path, frame):
    with pytest.raises(UsageError, match="no EXR layout is called 'stereo'"):
        write_exr(tmp_path / "f.exr", frame, layout="stereo")
    with pytest.raises(UsageError, match="no buffer 'albedo'"):
        write_exr(tmp_path / "f.exr", frame, names=["albedo"])
    with pytest.raises(ScanError, match="cannot read EXR"):
        read_exr(tmp_path / "absent.exr")
    wrong = replace(frame, buffers={"curvature": np.zeros((34, 47, 3), np.float32)})
    with pytest.raises(ValueError, match="curvature"):
        write_exr(tmp_path / "f.exr", wrong)


def test_a_failed_write_leaves_nothing(tmp_path, frame):
    (tmp_path / "f.exr").mkdir()  # the final rename cannot succeed
    with pytest.raises(OutputError, match="cannot write"):
        write_exr(tmp_path / "f.exr", frame, names=["beauty"])
    assert [p.name for p in tmp_path.iterdir()] == ["f.exr"]
