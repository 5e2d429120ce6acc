"""`scanrender compare`: what two pictures differ by, with every layer or none."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from scanrender.buffers import Frame
from scanrender.errors import UsageError
from scanrender.images import write_png8
from scanrender.measure.compare import compare_pictures, read_picture
from scanrender.outputs.exr import write_exr

SIZE = 48
PPD = 67.0


def frame(gain: float = 1.0, step_gain: float = 1.0) -> Frame:
    """A grey ramp with an outline, a step of depth down the middle and skin on the upper half."""
    y, x = np.mgrid[0:SIZE, 0:SIZE] / SIZE
    light = np.repeat((0.2 + 0.5 * x)[:, :, None], 3, axis=2).astype(np.float32) * gain
    light[:, SIZE // 2 - 2 : SIZE // 2 + 2] *= step_gain
    alpha = np.zeros((SIZE, SIZE), np.float32)
    alpha[4:-4, 4:-4] = 1.0
    depth = np.where(x < 0.5, 500.0, 520.0).astype(np.float32)[:, :, None]
    skin = (y < 0.5).astype(np.float32)[:, :, None]
    buffers = {"beauty": light * alpha[:, :, None], "depth_mm": depth, "skin": skin}
    return Frame(buffers, alpha, {})


def exr(path: Path, **changes: Any) -> Path:
    write_exr(path, frame(**changes))
    return path


def figures(a: Path, b: Path, kind: Any = "auto") -> dict[str, Any]:
    return compare_pictures(read_picture(a), read_picture(b), kind, PPD)[0]


def test_a_picture_is_no_distance_from_itself(tmp_path: Path):
    path = exr(tmp_path / "a.exr")
    found = figures(path, path)
    assert found["dE2000"]["maximum"] == 0.0
    assert found["FLIP"]["maximum"] == pytest.approx(0.0, abs=1e-9)
    assert found["rmse"] == found["silhouette_leak"] == found["border_leak"] == 0.0
    assert found["energy_ratio"] == pytest.approx([1.0, 1.0, 1.0])
    assert found["mask"] == "skin"


def test_known_gains_are_found_again(tmp_path: Path):
    reference = exr(tmp_path / "b.exr")
    found = figures(exr(tmp_path / "a.exr", gain=1.1), reference)
    assert found["energy_ratio"] == pytest.approx([1.1] * 3, rel=1e-5)
    assert found["rmse"] == pytest.approx(0.1 * 0.47, rel=0.05)
    assert 0.5 < found["dE2000"]["mean"] < 5.0


def test_an_error_at_the_step_is_told_apart(tmp_path: Path):
    reference = exr(tmp_path / "b.exr")
    found = figures(exr(tmp_path / "a.exr", step_gain=0.5), reference)
    assert found["silhouette_leak"] > 2.0 * found["border_leak"] > 0.0


@pytest.mark.parametrize("kind", ["all", "subject", "skin"])
def test_masks_count_what_they_say(tmp_path: Path, kind: str):
    path = exr(tmp_path / "a.exr")
    inner = SIZE - 8
    expected = {"all": SIZE * SIZE, "subject": inner * inner, "skin": inner * (SIZE // 2 - 4)}
    assert figures(path, path, kind)["pixels"] == expected[kind]


def test_png_is_what_a_display_shows(tmp_path: Path):
    shown = np.full((SIZE, SIZE, 3), 0.5)
    paths = write_png8(tmp_path / "a.png", shown), write_png8(tmp_path / "b.png", shown + 0.02)
    found = figures(*paths)
    assert found["mask"] == "the subject"
    assert found["silhouette_leak"] is None
    assert 0.5 < found["dE2000"]["mean"] < 3.0


def test_sizes_that_differ_are_refused(tmp_path: Path):
    small = write_png8(tmp_path / "a.png", np.zeros((8, 8, 3)))
    with pytest.raises(UsageError, match="8 x 8 and 48 x 48"):
        figures(small, exr(tmp_path / "b.exr"))


def test_the_command_prints_and_writes_heat_maps(tmp_path: Path, cli: Any):
    exr(tmp_path / "a.exr", gain=1.1)
    exr(tmp_path / "b.exr")
    told = cli("compare", "a.exr", "b.exr", "--out", "heat")
    assert told.returncode == 0, told.stderr
    assert "dE2000" in told.stdout
    assert (tmp_path / "heat" / "dE2000.png").stat().st_size > 1000
    assert (tmp_path / "heat" / "FLIP.png").exists()
    data = cli("compare", "a.exr", "b.exr", "--json")
    assert json.loads(data.stdout)["energy_ratio"] == pytest.approx([1.1] * 3, rel=1e-5)


def test_the_command_says_what_is_wrong(tmp_path: Path, cli: Any):
    exr(tmp_path / "b.exr")
    told = cli("compare", "none.exr", "b.exr")
    assert told.returncode == 2
    assert "none.exr is not there" in told.stderr
    write_png8(tmp_path / "a.png", np.zeros((SIZE, SIZE, 3)))
    told = cli("compare", "a.png", "a.png", "--mask", "skin")
    assert told.returncode == 2
    assert "--buffers skin" in told.stderr
