"""The view transform is pinned, exact where it can be, and never reaches linear values."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from render.synthetic import AMBIENT, MATT, pipeline, render, sphere
from render.test_picture import tonemapped

from scanrender.buffers import Frame
from scanrender.images import read_image, srgb_from_linear
from scanrender.outputs.exr import write_exr
from scanrender.render.device import Device
from scanrender.render.frame import Renderer
from scanrender.render.view import OCIO_CONFIG, VIEWS, apply_view, describe
from scanrender.settings.light import BUILT_IN_SKIES
from scanrender.settings.loading import load_pipeline
from scanrender.settings.shot import ViewSettings

pytestmark = pytest.mark.gl


def test_neutral_is_srgb(gl: Device):
    """Half a step of 8 bits, by table and shader; by OpenColorIO itself a thousandth of that."""
    grey = np.repeat(np.linspace(0, 1, 4096).reshape(64, 64, 1) ** 2.2, 3, axis=2)
    colours = np.random.default_rng(0).random((64, 64, 3)) ** 3
    for linear in (grey.astype(np.float32), colours.astype(np.float32)):
        exact = srgb_from_linear(linear)
        shown = tonemapped(gl, linear, {"transform": "neutral"})
        assert np.abs(shown - exact).max() <= 0.5 / 255
        assert np.abs(apply_view(linear, "neutral") - exact).max() < 1e-4


def test_the_config_is_a_named_built_in_of_one_version():
    assert re.fullmatch(r"ocio://[a-z-]+config-v[\d.]+_aces-v[\d.]+_ocio-v[\d.]+", OCIO_CONFIG)
    for name in VIEWS:
        said = describe(ViewSettings(transform=name))
        assert said == {"ocio_config": OCIO_CONFIG, "display": "sRGB - Display",
                        "view": VIEWS[name]}  # fmt: skip


def test_an_ocio_variable_from_the_start_changes_nothing(tmp_path: Path):
    """OpenImageIO reads $OCIO when it loads, so that setting it later proves little."""
    config = tmp_path / "studio.ocio"
    config.write_text(
        "ocio_profile_version: 2\nroles: {default: raw, scene_linear: raw}\n"
        "displays:\n  sRGB - Display:\n    - !<View> {name: Un-tone-mapped, colorspace: raw}\n"
        "colorspaces:\n  - !<ColorSpace> {name: raw, isdata: true}\n"
    )
    program = (
        "import numpy as np\nfrom scanrender.render.view import apply_view\n"
        "print(apply_view(np.full((1, 1, 3), 0.18, np.float32), 'neutral')[0, 0, 0])\n"
    )
    for value in (str(config), "/nowhere/config.ocio"):
        done = subprocess.run(
            [sys.executable, "-c", program], env={**os.environ, "OCIO": value},
            capture_output=True, text=True, timeout=120, check=True,
        )  # fmt: skip
        assert float(done.stdout) == pytest.approx(srgb_from_linear(np.array(0.18)), abs=1e-4)


def test_the_view_never_touches_linear_values(gl: Device, tmp_path: Path):
    asset = sphere(10.0, (0.6, 0.4, 0.3))
    lights = [AMBIENT, {"type": "directional", "irradiance": 7.0}]
    frames: list[Frame] = []
    for view in ({}, {"transform": "neutral", "exposure_ev": 5.0, "background": [1, 0, 0]}):
        renderer = Renderer(gl, asset, pipeline(MATT, lights=lights, view=view))
        frames.append(renderer.render(renderer.view(0), ["diffuse"]))
    one, two = frames
    assert np.abs(one.buffers["display"] - two.buffers["display"]).max() > 0.2
    for name in ("beauty", "diffuse"):
        np.testing.assert_array_equal(one.buffers[name], two.buffers[name])
    assert one.buffers["beauty"].max() > 1.0, "and nothing is clipped"
    for number, frame in enumerate(frames):
        write_exr(tmp_path / f"{number}.exr", frame, names=["beauty"])
        stored = read_image(tmp_path / f"{number}.exr")
        np.testing.assert_array_equal(stored[:, :, :3], one.buffers["beauty"])


def test_filmic_keeps_highlights_that_neutral_clips(gl: Device):
    ramp = np.repeat(np.linspace(0.5, 8, 64, dtype=np.float32).reshape(1, 64, 1), 3, axis=2)
    ramp = np.repeat(ramp, 4, axis=0)
    filmic, neutral = (tonemapped(gl, ramp, {"transform": name})[0, :, 1] for name in VIEWS)
    assert (neutral[6:] == 1.0).all()
    assert (np.diff(filmic[:40]) > 0).all()
    assert filmic[6] < 0.95


# --- the rigs ------------------------------------------------------------------------------------

RIGS = ("backlit", "dome", "flat", "key_only", "portrait", "rembrandt", "rim", "sky", "studio",
        "three_point")  # fmt: skip


@pytest.mark.parametrize("name", RIGS)
def test_each_rig_lights_a_head_well(gl: Device, name: str, tmp_path: Path):
    """Neither black nor burnt: what the camera sees of a grey ball lies in the middle stops."""
    (tmp_path / "p.yaml").write_text(f"version: 1\nextends: light/{name}\n")
    lights = load_pipeline(tmp_path / "p.yaml").lights
    small = [light.model_dump(mode="json") for light in lights]
    for light in small:
        light.update({"shadow_px": 128} if "shadow_px" in light else {})
    grey = pipeline(MATT, lights=small, camera={"width_px": 48, "height_px": 48})
    made = render(gl, sphere(110.0, (0.35, 0.35, 0.35), rings=24), grey)
    seen = made["beauty"][made["alpha"][:, :, 0] == 1]
    assert 0.01 < np.median(seen) < 0.9
    assert np.quantile(seen, 0.99) < 3.0
    assert any(getattr(light, "map", None) in BUILT_IN_SKIES for light in lights) == (
        name in ("dome", "sky", "studio")
    )
