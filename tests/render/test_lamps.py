"""Lights in the world: directions, cones, and shadow cameras that see the whole subject."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from scanrender.render.lamps import Lamp, resolve_lights
from scanrender.settings.light import AmbientLight, DirectionalLight, SpotLight


def lamp(light: DirectionalLight | SpotLight, radius_mm: float = 100.0) -> Lamp:
    return resolve_lights([light], radius_mm)[0][0]


@pytest.mark.parametrize(
    ("azimuth", "elevation", "direction"),
    [(0, 0, (0, 0, 1)), (90, 0, (1, 0, 0)), (-90, 0, (-1, 0, 0)), (180, 0, (0, 0, -1)),
     (0, 90, (0, 1, 0)), (77, -90, (0, -1, 0))],
)  # fmt: skip
@pytest.mark.parametrize("kind", [DirectionalLight, SpotLight])
def test_angles_are_seen_from_the_subject(kind, azimuth, elevation, direction):
    found = lamp(kind(azimuth_deg=azimuth, elevation_deg=elevation))
    np.testing.assert_allclose(found.to_light, direction, atol=1e-12)
    along = found.position_mm / np.linalg.norm(found.position_mm)
    np.testing.assert_allclose(along, direction, atol=1e-12)


def test_a_spot_stands_where_it_says():
    found = lamp(SpotLight(azimuth_deg=20, elevation_deg=50, distance_mm=777))
    assert np.linalg.norm(found.position_mm) == pytest.approx(777)


@given(
    st.floats(0.1, 1e4),
    st.one_of(
        st.builds(DirectionalLight, azimuth_deg=st.floats(-360, 360),
                  elevation_deg=st.floats(-90, 90)),
        st.builds(SpotLight, azimuth_deg=st.floats(-360, 360), elevation_deg=st.floats(-90, 90),
                  distance_mm=st.floats(1, 1e6), cone_deg=st.floats(1, 170)),
    ),
)  # fmt: skip
def test_the_shadow_map_sees_what_the_light_lights(radius_mm: float, light):
    found = lamp(light, radius_mm)
    rng = np.random.default_rng(0)
    points = rng.normal(size=(300, 3))
    points *= (
        radius_mm * rng.random((300, 1)) ** (1 / 3) / np.linalg.norm(points, axis=1, keepdims=True)
    )
    in_light = np.column_stack([points, np.ones(300)]) @ found.light_from_rig.T
    clip = in_light @ found.clip_from_light.T
    with np.errstate(divide="ignore", invalid="ignore"):
        ndc = clip[:, :3] / clip[:, 3:]
    if found.is_near:
        in_light[:, 2] -= found.distance_mm
        cosine = -in_light[:, 2] / np.linalg.norm(in_light[:, :3], axis=1)
        # A lamp inside the subject cannot see what lies behind its own near plane.
        lit = (1.0 - cosine < found.cone[1]) & (-in_light[:, 2] >= found.near_mm)
    else:
        lit = np.ones(300, bool)
    assert (np.abs(ndc[lit]) <= 1 + 1e-6).all()
    assert 0 < found.near_mm < found.far_mm
    assert found.width_mm > 0


def test_a_cone_is_ordered_even_for_a_hard_rim():
    for edge in (0.0, 0.3, 1.0):
        full, rim = lamp(SpotLight(cone_deg=50, edge=edge)).cone
        assert full < rim
        assert rim == pytest.approx(1.0 - np.cos(np.deg2rad(25)))


def test_ambient_lights_add_up_and_lamps_are_numbered():
    lights = [AmbientLight(irradiance=0.5, colour=(1, 0, 2)), DirectionalLight(), AmbientLight(),
              SpotLight(irradiance=3.0, colour=(1, 0.5, 0))]  # fmt: skip
    lamps, ambient = resolve_lights(lights, 10.0)
    np.testing.assert_allclose(ambient, [0.6, 0.1, 1.1])
    assert [found.index for found in lamps] == [0, 1]
    np.testing.assert_allclose(lamps[1].irradiance, [3.0, 1.5, 0.0])
