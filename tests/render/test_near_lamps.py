"""Point and spot lights, where lamps stand, and what they are fixed to in a turntable."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError
from render.synthetic import AMBIENT, MATT, pipeline, plane, render, slab, sphere

from scanrender.render.device import Device
from scanrender.render.frame import Renderer
from scanrender.settings.light import PointLight, SpotLight

pytestmark = pytest.mark.gl

POINT: dict[str, Any] = {"type": "point", "azimuth_deg": 0, "elevation_deg": 0, "irradiance": 1.0,
                         "distance_mm": 25.0, "shadow_px": 256, "shadow_blur_mm": 0.3}  # fmt: skip
THROUGH = {"skin": {"transmission": {"method": "shadow_map", "blur_mm": 0.0, "bias_mm": 0.1}}}


def test_a_point_falls_off_with_the_square_of_its_distance(gl: Device):
    made = render(gl, plane(20.0), pipeline(MATT, lights=[POINT]), "irradiance", "position")
    inside = made["alpha"][:, :, 0] == 1
    radius = np.hypot(made["position"][:, :, 0], made["position"][:, :, 1])[inside]
    expected = (25.0 / np.hypot(25.0, radius)) ** 3  # (d0 / d)^2 cos, cos = d0 / d
    np.testing.assert_allclose(made["irradiance"][inside][:, 1], expected, rtol=2e-3)


@pytest.mark.parametrize("distance", [30.0, 300.0, 1e6])
def test_irradiance_is_stated_at_the_centre_whatever_the_distance(gl: Device, distance: float):
    for kind in ("point", "spot"):
        lamp = {**POINT, "type": kind, "distance_mm": distance, "irradiance": 0.7}
        made = render(gl, plane(10.0), pipeline(MATT, lights=[lamp]), "irradiance")
        np.testing.assert_allclose(made["irradiance"][48, 48], 0.7, rtol=3e-3)


def test_a_position_in_millimetres_is_the_same_as_angles_and_a_distance(gl: Device):
    angles = {**POINT, "azimuth_deg": 30.0, "elevation_deg": -20.0, "distance_mm": 50.0}
    a, e = np.deg2rad([30.0, -20.0])
    position = 50.0 * np.array([np.sin(a) * np.cos(e), np.sin(e), np.cos(a) * np.cos(e)])
    given_mm = {**POINT, "azimuth_deg": 77, "position_mm": position.tolist()}
    names = "irradiance", "visibility_0"
    one = render(gl, sphere(10.0), pipeline(MATT, lights=[angles]), *names)
    two = render(gl, sphere(10.0), pipeline(MATT, lights=[given_mm]), *names)
    np.testing.assert_allclose(one["irradiance"], two["irradiance"], atol=1e-5)
    np.testing.assert_allclose(one["visibility_0"], two["visibility_0"], atol=0.07)


@pytest.mark.parametrize("kind", [PointLight, SpotLight])
def test_a_lamp_in_the_centre_is_refused(kind):
    with pytest.raises(ValidationError, match="nothing tells which way"):
        kind(position_mm=(0.0, 0.1, 0.0))


def test_light_inside_the_subjects_bounds_says_what_it_cannot_shadow(gl: Device):
    """A ball, 100 mm off, spreads the bounds; the lamp stands before the other ball."""
    lamp = {**POINT, "position_mm": [0, 0, 15.0]}
    outside = Renderer(gl, sphere(10.0), pipeline(MATT, lights=[lamp]))
    assert not outside.decisions
    inside = Renderer(gl, sphere(20.0), pipeline(MATT, lights=[lamp]))
    assert [d.what for d in inside.decisions] == ["part of the shadows of lamp 0"]
    assert "15 mm from the centre" in inside.decisions[0].reason
    frame = inside.render(inside.view(0), inside.buffer_names)
    for name, pixels in frame.buffers.items():
        assert np.isfinite(pixels).all(), name
    # It lights the ball from inside, so no outer face that its map sees is lit.
    assert frame.buffers["irradiance"].max() == 0.0


def test_what_a_map_does_not_see_is_lit_and_not_its_mirror_image(gl: Device):
    """A plane whose corners lie behind and beside a lamp close before it."""
    lamp = {**POINT, "position_mm": [0, 0, 2.0], "irradiance": 1e3}
    made = render(gl, plane(20.0), pipeline(MATT, lights=[lamp]), "visibility_0", "irradiance")
    inside = made["alpha"][:, :, 0] == 1
    assert made["visibility_0"][inside].min() == 1.0
    assert made["irradiance"][inside].min() > 0


@pytest.mark.parametrize("kind", ["point", "spot"])
def test_oblique_rays_of_a_near_lamp_cross_more_skin(gl: Device, kind: str):
    """Along the ray, not along the lamp's axis: thickness / cos at every point of the slab."""
    lamp = {**POINT, "type": kind, "azimuth_deg": 180, "distance_mm": 30.0, "shadow_px": 512}
    lamp |= {"cone_deg": 120} if kind == "spot" else {}
    made = render(gl, slab(20.0, 3.0), pipeline(MATT, THROUGH, lights=[lamp]), "thickness_mm",
                  "position")  # fmt: skip
    inside = made["alpha"][:, :, 0] == 1
    position = made["position"][inside]
    radius = np.hypot(position[:, 0], position[:, 1])
    middle = radius < 14.0
    way = 3.0 * np.hypot(31.5, radius) / 31.5
    np.testing.assert_allclose(made["thickness_mm"][inside][middle, 0], way[middle], rtol=0.03)


# --- what a light is fixed to --------------------------------------------------------------------


def lit(gl: Device, mode: str, follows: str, index: int, kind: str = "directional"):
    lamp = {**POINT, "type": kind, "azimuth_deg": 70, "elevation_deg": 20, "follows": follows}
    if kind == "directional":
        del lamp["distance_mm"]
    made = render(gl, sphere(10.0), pipeline(MATT, lights=[lamp], turntable={
        "mode": mode, "frames": 8}), "irradiance", index=index)  # fmt: skip
    return made["irradiance"]


@pytest.mark.parametrize("kind", ["directional", "point", "spot"])
def test_a_light_stays_where_it_is_fixed(gl: Device, kind: str):
    """The picture of a ball shows the light's place from the camera, and nothing else."""
    start = lit(gl, "subject", "world", 0, kind)
    same = {"atol": 2e-3}
    for index in (1, 3):
        np.testing.assert_allclose(lit(gl, "subject", "world", index, kind), start, **same)
        turned = lit(gl, "camera", "world", index, kind)
        assert np.abs(turned - start).max() > 0.3
        np.testing.assert_allclose(lit(gl, "subject", "subject", index, kind), turned, **same)
        np.testing.assert_allclose(lit(gl, "camera", "subject", index, kind), turned, **same)
    head = lit(gl, "subject", "camera", 0, kind)
    for mode in ("subject", "camera"):
        np.testing.assert_allclose(lit(gl, mode, "camera", 3, kind), head, **same)


def test_a_light_at_the_camera_comes_from_the_camera(gl: Device):
    lamp = {"type": "directional", "azimuth_deg": 0, "elevation_deg": 0, "follows": "camera"}
    made = render(gl, sphere(10.0), pipeline(MATT, lights=[lamp], camera={
        "elevation_deg": 50, "azimuth_deg": 20}), "irradiance", "normal_geometry")  # fmt: skip
    inside = made["alpha"][:, :, 0] == 1
    np.testing.assert_allclose(
        made["irradiance"][inside][:, 0], made["normal_geometry"][inside][:, 2], atol=2e-3
    )


# --- never a NaN ---------------------------------------------------------------------------------


@settings(max_examples=20)
@given(
    kind=st.sampled_from(["point", "spot"]),
    direction=st.tuples(*[st.sampled_from([-1.0, 0.0, 1e-3, 1.0])] * 3),
    distance=st.sampled_from([1.0, 11.999, 12.0, 12.001, 13.0, 1e3, 9e6]),
    radius=st.sampled_from([0.0, 1.0, 50.0, 1e5]),
    blur=st.sampled_from([0.0, 100.0]),
    irradiance=st.sampled_from([1e-8, 1.0, 1e8]),
)
def test_lamps_anywhere_give_finite_light(gl, kind, direction, distance, radius, blur, irradiance):
    """Behind, inside, on the surface, at the pole, as good as at infinity."""
    length = float(np.linalg.norm(direction)) or 1.0
    position = [max(distance, 1.0) * x / length * 1.0001 for x in direction]
    lamp = {"type": kind, "distance_mm": distance, "radius_mm": radius, "shadow_px": 32,
            "shadow_blur_mm": blur, "irradiance": irradiance}  # fmt: skip
    if any(direction):
        lamp["position_mm"] = position
    gloss = {"skin": {"specular": {"strength": 1.0}}}
    small = {"width_px": 24, "height_px": 24}
    chosen = pipeline(MATT, gloss, THROUGH, lights=[lamp, AMBIENT], camera=small)
    renderer = Renderer(gl, sphere(12.0, rings=8), chosen)
    names = [n for n in renderer.buffer_names if not n.startswith("gaussian")]
    for name, pixels in renderer.render(renderer.view(0), names).buffers.items():
        assert np.isfinite(pixels).all(), name
        if name in ("irradiance", "specular", "transmission", "beauty"):
            assert (pixels >= 0).all(), name


@pytest.mark.parametrize("kind", ["point", "spot"])
def test_a_lamp_at_infinity_is_parallel_light(gl: Device, kind: str):
    """Depths stay exact however far it is: float32 holds a millimetre at 10 km."""
    far = {**POINT, "type": kind, "azimuth_deg": 160, "distance_mm": 1e7, "shadow_px": 512}
    parallel = {k: v for k, v in far.items() if k != "distance_mm"} | {"type": "directional"}
    names = "thickness_mm", "irradiance", "transmission", "visibility_0"
    one = render(gl, slab(20.0, 3.0), pipeline(MATT, THROUGH, lights=[far]), *names)
    two = render(gl, slab(20.0, 3.0), pipeline(MATT, THROUGH, lights=[parallel]), *names)
    middle = np.s_[20:76, 20:76]
    for name in names:
        np.testing.assert_allclose(one[name][middle], two[name][middle], rtol=5e-3, atol=1e-3)
