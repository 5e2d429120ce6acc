"""Soft shadows against the closed form of a disk behind an edge; no leaks, no acne, no flicker."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from render.synthetic import MATT, flat_map, joined, pipeline, plane, quad, render, sphere, turned

from scanrender.asset import Asset
from scanrender.render.device import Device
from scanrender.render.frame import Renderer

pytestmark = pytest.mark.gl

FRONT = {"type": "directional", "azimuth_deg": 0, "elevation_deg": 0, "irradiance": 1.0,
         "shadow_px": 1024, "shadow_blur_mm": 0.0}  # fmt: skip
# From the right, past the screen, at the wall behind it.
SIDE = {"azimuth_deg": 60, "elevation_deg": 0, "look_up_mm": -6.0, "projection": "orthographic",
        "width_px": 160, "height_px": 80}  # fmt: skip
PLAIN: dict[str, Any] = {"diffusion": {"method": "none"}, "quality": {"supersampling": 4}}


def edge_over_wall(gap_mm: float) -> Asset:
    """A wall and, `gap_mm` before its left half (x < 0), a screen, seen from below the screen."""
    wall, screen = quad((-20, -20), (20, 0)), quad((-20, -20), (0, 0), z=gap_mm)
    return Asset(joined([wall, screen]), {"albedo": flat_map(1, 1, 1)})


def share_of_disk(x: npt.NDArray[Any], radius: float) -> npt.NDArray[Any]:
    """What a straight edge at 0 leaves of a disk's area, `x` from its shadow's middle."""
    t = np.clip(x / radius, -1, 1)
    return np.asarray(0.5 + (t * np.sqrt(1 - t * t) + np.arcsin(t)) / np.pi)


@pytest.mark.parametrize("gap", [4.0, 10.0])
@pytest.mark.parametrize("lamp", [
    {"size_deg": 20.0},
    {"type": "spot", "distance_mm": 200.0, "radius_mm": 30.0, "cone_deg": 60},
    {"type": "point", "distance_mm": 200.0, "radius_mm": 30.0},
], ids=["directional", "spot", "point"])  # fmt: skip
def test_a_penumbra_is_as_wide_as_geometry_says(gl: Device, gap: float, lamp: dict[str, Any]):
    """Lit from the front, seen from the right past the screen: the shadow's edge on the wall."""
    camera = {**SIDE, "height_mm": 12.0}
    settings = pipeline(MATT, PLAIN, lights=[{**FRONT, **lamp}], camera=camera)
    asset = edge_over_wall(gap)
    made = render(gl, asset, settings, "position")
    view_from_world = Renderer(gl, asset, settings).camera.view_from_world
    rows = np.s_[44:60]  # below the middle, where the wall is
    world = made["position"][rows] - view_from_world[:3, 3]
    world = world @ view_from_world[:3, :3]
    x, z = world[:, :, 0], world[:, :, 2]
    on_wall = (np.abs(z) < 0.01) & (made["alpha"][rows][:, :, 0] == 1)
    if "size_deg" in lamp:
        middle, radius, lit = 0.0, gap * np.tan(np.deg2rad(10.0)), 1.0
    else:
        # The edge at x = 0 throws its shadow straight; the lamp's disk is 200 - gap away from it.
        middle, radius = 0.0, 30.0 * gap / (200.0 - gap)
        lit = (200.0 / np.hypot(200.0, np.hypot(x, world[:, :, 1]))) ** 3
    expected = share_of_disk(x - middle, radius) * lit
    found = made["beauty"][rows][:, :, 0]
    near = on_wall & (np.abs(x) < 3 * radius)
    assert near.sum() > 60
    error = np.abs(found - expected)[near]
    assert error.max() < 0.1
    assert error.mean() < 0.02


def test_contact_is_sharp_and_distance_soft(gl: Device):
    """With a size of the light; with a fixed edge both are the same."""
    width = {}
    for kind, lamp in {"sized": {"size_deg": 20.0}, "fixed": {"shadow_blur_mm": 1.5}}.items():
        for gap in (1.0, 12.0):
            camera = {**SIDE, "height_mm": 12.0}
            settings = pipeline(MATT, PLAIN, lights=[{**FRONT, **lamp}], camera=camera)
            row = render(gl, edge_over_wall(gap), settings)["beauty"][50, :, 0]
            # Pixels between dark and lit, outside the silhouettes.
            width[kind, gap] = int(((row > 0.1) & (row < 0.9)).sum())
    assert width["sized", 12.0] > 3 * width["sized", 1.0]
    assert abs(width["fixed", 12.0] - width["fixed", 1.0]) <= 3


@pytest.mark.parametrize("lamp", [{"shadow_blur_mm": 0.0}, {"shadow_blur_mm": 6.0},
                                  {"size_deg": 15.0}], ids=str)  # fmt: skip
@pytest.mark.parametrize("tilt", [0, 60, 80])
def test_nothing_leaks_below_a_roof(gl: Device, lamp: dict[str, Any], tilt: float):
    """A floor under a large roof 8 mm above it, light at any slant: dark in the core."""
    floor, roof = quad((-10, -10), (10, 10)), quad((-90, -90), (90, 90), z=8.0)
    asset = Asset(joined([floor, roof]), {"albedo": flat_map(1, 1, 1)})
    lamps = [{**FRONT, **lamp, "azimuth_deg": tilt}]
    # Looked at from between the two, so that the floor is what is seen.
    camera = {"azimuth_deg": 0, "elevation_deg": 89, "projection": "orthographic", "height_mm": 30}
    below = Asset(floor, asset.maps)
    seen = render(gl, below, pipeline(MATT, PLAIN, lights=lamps, camera=camera))["beauty"]
    assert seen.max() > 0.05, "without the roof it is lit"
    settings = pipeline(MATT, PLAIN, lights=lamps, camera={**camera, "elevation_deg": 85})
    made = render(gl, asset, settings, "position", "visibility_0", "normal_geometry")
    view = Renderer(gl, asset, settings).camera.view_from_world
    z = ((made["position"] - view[:3, 3]) @ view[:3, :3])[:, :, 2]
    on_floor = (np.abs(z) < 0.05) & (made["alpha"][:, :, 0] == 1)
    assert on_floor.sum() > 20
    assert made["visibility_0"][on_floor].max() == 0.0


@pytest.mark.parametrize("lamp", [
    {"size_deg": 20.0}, {"type": "point", "distance_mm": 60.0},
    {"type": "spot", "distance_mm": 60.0, "radius_mm": 8.0}, {"shadow_blur_mm": 10.0},
], ids=str)  # fmt: skip
@pytest.mark.parametrize("tilt", [0, 45, 75])
@pytest.mark.parametrize("shadow_px", [64, 1024])
def test_a_lit_plane_does_not_shadow_itself(gl: Device, lamp, tilt: float, shadow_px: int):
    lamps = [{**FRONT, **lamp, "azimuth_deg": tilt, "shadow_px": shadow_px}]
    made = render(gl, plane(20.0), pipeline(MATT, lights=lamps), "visibility_0", "irradiance")
    inside = (made["alpha"][:, :, 0] == 1) & (made["irradiance"][:, :, 0] > 0)
    assert made["visibility_0"][inside].min() == 1.0, "acne"


def test_a_sphere_is_lit_to_its_terminator(gl: Device):
    """A wide light on a coarse map: the rim toward the terminator holds no stripes."""
    lamp = {**FRONT, "azimuth_deg": 50, "size_deg": 15.0, "shadow_px": 256}
    made = render(gl, sphere(20.0), pipeline(MATT, lights=[lamp]), "visibility_0",
                  "normal_geometry")  # fmt: skip
    angle = np.deg2rad(50)
    cosine = made["normal_geometry"] @ [np.sin(angle), 0, np.cos(angle)]
    inside = made["alpha"][:, :, 0] == 1
    assert made["visibility_0"][inside & (cosine > 0.25)].mean() > 0.998
    assert made["visibility_0"][inside & (cosine <= 0)].max() == 0.0


def test_where_the_surface_turns_from_the_light_a_normal_map_cannot_turn_it_back(gl: Device):
    tilt = np.float32([0.8, 0.0, 0.6])  # 53 degrees toward +X
    lamp = {**FRONT, "azimuth_deg": 80, "size_deg": 0.0}
    visible = {}
    for degrees in (0.0, -9.0, -20.0):  # the plane, turned away from the light
        asset = turned(plane(10.0, normal_ts=flat_map(*tilt)), degrees, "y")
        made = render(gl, asset, pipeline(MATT, lights=[lamp]), "visibility_0")
        visible[degrees] = float(made["visibility_0"][48, 48, 0])
    assert visible[-20.0] == 0.0, "a surface that turns away is dark"
    assert 0 < visible[-9.0] < visible[0.0] < 1, "and fades before it does"


def test_shadows_do_not_flicker(gl: Device):
    """A light that turns with the subject gives the same picture as one that stands, seen from a
    camera that goes round: the pattern depends on the pixel and the sample alone."""
    lamp = {**FRONT, "azimuth_deg": 65, "elevation_deg": 35, "size_deg": 15.0, "shadow_px": 128}
    pictures = []
    for mode, follows in (("subject", "subject"), ("camera", "world")):
        settings = pipeline(MATT, lights=[{**lamp, "follows": follows}],
                            turntable={"mode": mode, "frames": 7})  # fmt: skip
        pictures.append(render(gl, edge_over_wall(6.0), settings, "visibility_0", index=1))
    for name in ("visibility_0", "beauty"):
        difference = np.abs(pictures[0][name] - pictures[1][name])
        assert np.quantile(difference, 0.995) < 1e-3
