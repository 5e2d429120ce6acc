"""Texels that are no numbers, or more than a map can hold, never reach a frame."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from render.synthetic import AMBIENT, pipeline, render, sphere_mesh

from scanrender.asset import Asset
from scanrender.render.device import Device
from scanrender.render.frame import Renderer
from scanrender.render.maps import NEUTRAL_MAPS, sound_texels, unsound_texels

pytestmark = pytest.mark.gl

LAMP = {"type": "directional", "azimuth_deg": 140, "shadow_px": 64}
SHOT = {
    "camera": {"width_px": 40, "height_px": 40},
    "lights": [LAMP, AMBIENT],
    "quality": {"supersampling": 1, "check": True},
    "skin": {"transmission": {"method": "baked"}},
    "curvature": {"source": "baked", "modulation": "increase"},
}
CHANNELS = {"albedo": 3, "normal_ts": 3, "ao": 1, "skin": 1, "curvature": 1, "thickness_mm": 1}


def maps_with(value: float, share: float) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(3)
    found = {}
    for name, channels in CHANNELS.items():
        pixels = np.full((16, 16, channels), 0.5, np.float32)
        pixels[rng.random((16, 16)) < share] = value
        found[name] = pixels
    return found


@given(
    value=st.sampled_from([np.nan, np.inf, -np.inf, 1e30, -1e30, 7e4, -1.0, 1e-30]),
    share=st.sampled_from([0.01, 0.5, 1.0]),
)
def test_any_texels_give_a_sound_picture(gl: Device, value: float, share: float):
    asset = Asset(sphere_mesh(30.0, 12), maps_with(value, share))
    renderer = Renderer(gl, asset, pipeline(SHOT))
    renderer.render(renderer.view(1), renderer.buffer_names)
    told = [d for d in renderer.decisions if "texels" in d.what]
    assert len(told) == (0 if np.isfinite(value) else len(CHANNELS))


def test_a_wild_texel_does_not_spread(gl: Device):
    """It took its neighbours with it, through filtering and mip levels: all of the ball."""
    maps = maps_with(np.nan, 0.0)
    sound = render(gl, Asset(sphere_mesh(30.0, 12), maps), pipeline(SHOT))["beauty"]
    maps["albedo"][8, 8] = np.nan
    wild = render(gl, Asset(sphere_mesh(30.0, 12), maps), pipeline(SHOT))["beauty"]
    np.testing.assert_allclose(wild, sound, rtol=1e-3)
    maps["albedo"][8, 8] = 1e6  # an albedo is never more than 1
    wild = render(gl, Asset(sphere_mesh(30.0, 12), maps), pipeline(SHOT))["beauty"]
    assert wild.max() < 2.2 * sound.max()


def test_sound_maps_are_left_alone():
    pixels = np.random.default_rng(0).random((5, 4, 3)).astype(np.float32)
    assert sound_texels("albedo", pixels) is pixels
    assert unsound_texels(pixels) == 0


def test_an_unsound_texel_takes_the_mean_of_the_others_or_the_neutral_value():
    pixels = np.array([[[0.2], [np.nan], [0.6]]], np.float32)
    assert unsound_texels(pixels) == 1
    np.testing.assert_allclose(sound_texels("ao", pixels)[0, :, 0], [0.2, 0.4, 0.6])
    nothing = np.full((2, 2, 1), np.inf, np.float32)
    assert (sound_texels("ao", nothing) == NEUTRAL_MAPS["ao"][0]).all()
    assert (sound_texels("thickness_mm", nothing) == 0.0).all()
