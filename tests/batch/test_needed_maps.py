"""`prep.bake.need: shot` leaves out maps, never anything of the picture."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from render.synthetic import AMBIENT, pipeline, sphere

from scanrender.batch.needed import unread_maps, with_needed_maps
from scanrender.render.device import Device
from scanrender.render.frame import Renderer
from scanrender.render.plan import maps_read
from scanrender.scan.map_sizes import ATLAS_USE, fitted_sizes
from scanrender.settings.prep import BakeSettings

LAMP = {"type": "directional", "azimuth_deg": 140, "elevation_deg": 20, "shadow_px": 256}
NEED = {"prep": {"bake": {"need": "shot"}}}
SHOTS: list[dict[str, Any]] = [
    {"lights": [LAMP]},
    {"lights": [LAMP, AMBIENT]},
    {"lights": [LAMP], "skin": {"transmission": {"method": "baked"}}},
    {"lights": [LAMP], "curvature": {"modulation": "reduce", "source": "baked"}},
    {"lights": [LAMP], "diffusion": {"method": "none"}},
]


@pytest.mark.gl
@pytest.mark.parametrize("shot", SHOTS)
def test_a_map_that_is_not_read_does_not_change_the_picture(gl: Device, shot: dict[str, Any]):
    settings = pipeline({"camera": {"width_px": 64, "height_px": 64}}, **shot)
    bare = sphere(30.0, (0.7, 0.5, 0.4))
    rng = np.random.default_rng(3)
    one = {name: rng.random((8, 8, 1), np.float32) for name in ("ao", "skin", "curvature")}
    thin = {"thickness_mm": rng.random((8, 8, 1), np.float32) * 4}
    asset = replace(bare, maps={**bare.maps, **one, **thin})
    kept = {k: v for k, v in asset.maps.items() if k in maps_read(settings)}
    pictures = [
        Renderer(gl, head, settings).render(Renderer(gl, head, settings).view(0)).buffers["beauty"]
        for head in (asset, replace(asset, maps=kept))
    ]
    np.testing.assert_array_equal(*pictures)


@pytest.mark.parametrize(
    ("shot", "baked"),
    [
        (SHOTS[0], {"albedo", "normal_ts", "skin"}),
        (SHOTS[1], {"albedo", "normal_ts", "skin", "ao"}),
        (SHOTS[2], {"albedo", "normal_ts", "skin", "thickness_mm"}),
        (SHOTS[3], {"albedo", "normal_ts", "skin", "curvature"}),
    ],
)
def test_only_what_a_pass_reads_is_baked(shot: dict[str, Any], baked: set[str]):
    (made,) = with_needed_maps([pipeline(NEED, **shot)])
    assert set(made.prep.bake.maps) == baked


def test_variants_share_what_any_of_them_reads():
    made = with_needed_maps([pipeline(NEED, **SHOTS[1]), pipeline(NEED, **SHOTS[2])])
    assert {"ao", "thickness_mm"} <= set(made[0].prep.bake.maps)
    assert made[0].prep == made[1].prep


def test_without_being_asked_all_maps_are_baked_and_those_in_vain_are_named():
    settings = pipeline(lights=[LAMP])
    assert with_needed_maps([settings]) == [settings]
    named = {decision.what for decision in unread_maps(settings)}
    assert named == {"map normal_geometry", "map curvature", "map ao", "map thickness_mm"}


def test_maps_are_no_finer_than_the_nearest_camera_shows():
    near, far = ({"height_mm": mm, "height_px": 1000, "width_px": 1000} for mm in (250.0, 5000.0))
    made = with_needed_maps([pipeline(NEED, camera=camera) for camera in (near, far)])
    texel_mm = made[0].prep.bake.texel_mm
    assert texel_mm is not None
    assert 8.0 < 1.0 / texel_mm < 16.0, (
        "two texels a pixel at 4 px/mm, and more where the face is nearer"
    )
    whole = with_needed_maps([pipeline(NEED)])[0]
    assert whole.prep.bake.texel_mm is None, "the subject's size decides, and is not known"


@given(area=st.floats(1e-3, 1e9), wanted=st.floats(1e-3, 1e3), power=st.integers(4, 13))
def test_a_side_is_halved_while_it_stays_fine_enough(area: float, wanted: float, power: int):
    bake = BakeSettings(albedo_px=2**power, texel_mm=1.0 / wanted)
    side = fitted_sizes(bake, area).albedo_px
    density = (ATLAS_USE / area) ** 0.5
    assert side == 2**power or side * density >= wanted
    assert side <= 128 or 0.5 * side * density < wanted
