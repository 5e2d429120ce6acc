"""Pictures of one pixel, one column, one row: rendered, checked, and written as everything else."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from render.synthetic import AMBIENT, pipeline, render, sphere

from scanrender.asset import save_asset
from scanrender.batch.turntable import _small
from scanrender.render.device import Device

BALL = sphere(30.0, (0.7, 0.5, 0.4), rings=12)
LAMP = {"type": "directional", "azimuth_deg": 130, "shadow_px": 64}


@pytest.mark.gl
@pytest.mark.parametrize("size", [(1, 1), (1, 4096), (8192, 1), (2, 3), (1, 7)])
@pytest.mark.parametrize("method", ["gaussian_sum", "separable_preintegrated", "disk"])
def test_any_shape_of_picture(gl: Device, size: tuple[int, int], method: str):
    width, height = size
    made = render(gl, BALL, pipeline(
        camera={"width_px": width, "height_px": height, "fill": 2.0}, lights=[LAMP, AMBIENT],
        diffusion={"method": method, "limit": "lab"}, curvature={"modulation": "increase"},
        quality={"supersampling": 2, "sampling": "contrast", "check": True},
    ), "curvature", "lab")  # fmt: skip
    assert made["display"].shape == (height, width, 3)
    assert made["alpha"].max() == 1.0
    assert made["beauty"].max() > 0.1


@given(height=st.integers(1, 6000), width=st.integers(1, 6))
def test_a_contact_sheet_s_picture_is_a_mean_and_never_nothing(height: int, width: int):
    """A picture of one column has no block of seven: dividing by its columns was an error."""
    pixels = np.linspace(0, 255, height * width * 3).astype(np.uint8)
    small = _small(pixels.reshape(height, width, 3))
    assert small.size > 0
    assert small.shape[0] <= 1080
    assert small.mean() == pytest.approx(0.5, abs=0.1)


@pytest.mark.gl
def test_a_turntable_of_one_pixel_is_written(cli, tmp_path: Path):
    save_asset(BALL, tmp_path / "asset")
    sets = [w for s in ("camera.width_px=1", "camera.height_px=900", "turntable.frames=2",
                        "quality.supersampling=1", "outputs.buffers=[position]")
            for w in ("--set", s)]  # fmt: skip
    done = cli("render", "asset", *sets, "--frames", "all", "--check", "--out", "out")
    assert done.returncode == 0, done.stderr
    for name in ("turntable.mp4", "contact_sheet.png", "buffers/frame_0000.exr", "manifest.json"):
        assert (tmp_path / "out" / name).stat().st_size > 0
