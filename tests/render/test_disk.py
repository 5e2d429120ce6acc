"""The surface-measure disk: what a plane, a ball, a slope and a step make of it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from render.edges import lit_edge, width_mm
from render.synthetic import (
    AMBIENT,
    MATT,
    joined,
    merged,
    pipeline,
    plane,
    quad,
    render,
    sphere,
    turned,
)
from render.test_halo import METHODS, crumpled, leaked, terrace

from scanrender.asset import Asset
from scanrender.render.device import Device
from scanrender.render.frame import Renderer

pytestmark = pytest.mark.gl

DISK: dict[str, Any] = {"method": "disk"}
FINE = {**DISK, "disk_taps": 1023}
TILTS = (0, 30, 60, 75)
WIDER = {"camera": {"fill": 0.9}}


@pytest.mark.parametrize("axis", ["x", "y"])
@pytest.mark.parametrize("degrees", TILTS)
def test_the_mean_weight_on_a_tilted_plane_is_1(gl: Device, axis: str, degrees: float):
    """Whatever is not the plane's rim, at 64 taps; normalization has no part in it."""
    settings = pipeline(MATT, diffusion={**DISK, "normalize": "none"})
    made = render(gl, turned(plane(40.0), degrees, axis), settings, "weight_sum", "scattered",
                  "diffusion_input")  # fmt: skip
    middle = np.s_[44:52, 44:52]
    np.testing.assert_allclose(made["weight_sum"][middle], 1.0, atol=0.01)
    np.testing.assert_allclose(
        made["scattered"][middle], made["diffusion_input"][middle], rtol=0.01
    )


@pytest.mark.parametrize("degrees", TILTS)
def test_it_is_as_wide_along_a_slope_as_across(gl: Device, degrees: float):
    """Engines that leave the pixel's area out are 1.38 times as wide one way at 75 degrees."""
    shot = {"camera": {"width_px": 480, "height_px": 480}}
    widths = []
    for vertical in (True, False):
        edge = lit_edge(gl, shot, vertical=vertical, tilt_deg=degrees, axis="y", diffusion=FINE)
        order = np.argsort(edge.x_mm)
        spilt = np.abs(edge.found[:, 0] - (edge.x_mm > 0.0))[order]
        widths.append(np.trapezoid(spilt, edge.x_mm[order]))  # mean |x| of red's line kernel
    assert widths[0] / widths[1] == pytest.approx(1.0, abs=0.02)


@pytest.mark.parametrize("projection", ["perspective", "orthographic"])
@pytest.mark.parametrize(("axis", "vertical"), [("y", True), ("x", False), ("x", True)])
@pytest.mark.parametrize("degrees", TILTS)
def test_the_half_lit_plane_at_any_tilt(
    gl: Device, axis: str, vertical: bool, degrees: float, projection: str
):
    edge = lit_edge(gl, axis=axis, vertical=vertical, tilt_deg=degrees, diffusion=FINE,
                    camera={"projection": projection})  # fmt: skip
    assert edge.error < 0.015


def test_supersamples_bring_taps_of_their_own(gl: Device):
    """64 taps leave a few ghosts of a hard edge; 16 samples of them, each turned, do not."""
    one, many = (lit_edge(gl, diffusion=DISK, quality={"supersampling": n}).error for n in (1, 4))
    assert many < 0.5 * one
    assert many < 0.03


@pytest.mark.parametrize("normalize", ["visible", "none"])
def test_a_plane_in_even_light_stays_even(gl: Device, normalize: str):
    settings = pipeline(MATT, lights=[AMBIENT], diffusion={**DISK, "normalize": normalize})
    made = render(gl, plane(40.0), settings, "diffuse")
    np.testing.assert_allclose(made["diffuse"][40:56, 40:56], 1.0, atol=2e-3)


def test_a_ball_keeps_constant_light_and_misses_its_hidden_side(gl: Device):
    settings = {mode: pipeline(MATT, WIDER, diffusion={**DISK, "normalize": mode})
                for mode in ("visible", "none")}  # fmt: skip
    seen, plain = (render(gl, sphere(4.0), settings[mode], "diffuse") for mode in settings)
    inside = seen["alpha"][:, :, 0] == 1
    np.testing.assert_allclose(seen["diffuse"][inside], 1.0, atol=1e-3)
    middle, rim = plain["diffuse"][48, 48], plain["diffuse"][inside].min(axis=0)
    # A ball of 4 mm has less surface within reach than a plane: red's sum is below 1 in the middle.
    assert 0.93 < middle[0] < 1.0
    assert (rim < middle).all()


def test_what_lies_behind_a_step_does_not_leak(gl: Device):
    """Nothing crosses 15 mm; 2 mm let through what their distance does, a third of the plane's."""
    none = leaked(gl, terrace(2.0, 0.5, 0.5), method="gaussian_sum", halo="none")
    assert 0.02 * none < leaked(gl, terrace(2.0, 0.5, 0.5), **DISK) < 0.3 * none
    assert leaked(gl, terrace(15.0, 0.5, 0.5), **DISK) < 1e-3 * none


def test_no_pixel_is_black_or_not_a_number(gl: Device):
    assert "disk" not in METHODS, "the halo modes do not apply to it: this test is its own"
    settings = pipeline(MATT, {"camera": {"fill": 1.2}}, diffusion={**DISK, "limit": "lab"})
    made = render(gl, crumpled(), settings, "diffuse", "nan_map", "weight_sum", "rejected")
    seen = made["alpha"][:, :, 0] == 1
    assert made["nan_map"].max() == 0
    assert all(np.isfinite(made[name]).all() for name in made)
    np.testing.assert_allclose(made["diffuse"][seen] / [0.7, 0.5, 0.4], 1.0, atol=1e-3)


def test_curvature_and_scale_change_its_width(gl: Device):
    halves = {}
    for scale in (0.5, 1.0):
        edge = lit_edge(gl, {"skin": {"scale": scale}}, diffusion=FINE)
        halves[scale] = width_mm(edge.x_mm, edge.found[:, 0])
    assert halves[0.5] / halves[1.0] == pytest.approx(0.5, abs=0.1)


def test_jitter_and_repeats_are_the_same_bits(gl: Device):
    asset = Asset(joined([quad((-10, -10), (10, 10))]), {})
    settings = pipeline(merged(MATT, {"diffusion": {**DISK, "jitter": True}}))
    first, second = (render(gl, asset, settings, "diffuse")["diffuse"] for _ in range(2))
    np.testing.assert_array_equal(first, second)


@pytest.mark.parametrize("radius_mm", [0.02, 0.25])
@pytest.mark.parametrize("degrees", [0, 45])
def test_a_plain_sum_over_a_ball_smaller_than_its_profile(
    gl: Device, radius_mm: float, degrees: float
):
    """Under light that is the same everywhere: the profile's integral over the hemisphere that is
    seen. Taps in the tangent plane met a ball of 0.02 mm by chance: 9 times too much light."""
    shot = {"camera": {"projection": "orthographic", "width_px": 120, "height_px": 120}}
    settings = pipeline(MATT, shot, lights=[AMBIENT], diffusion={**DISK, "normalize": "none"})
    renderer = Renderer(gl, sphere(radius_mm), settings)
    names = ("scattered", "diffusion_input", "normal_geometry")
    frame = renderer.render(renderer.view(0), names)
    where = np.array([np.sin(np.radians(degrees)), 0.0, np.cos(np.radians(degrees))])
    facing = frame.buffers["normal_geometry"][:, :, :3] @ where
    near = np.argsort(-facing, axis=None)[:12]
    scattered, came_in = (frame.buffers[n][:, :, :3].reshape(-1, 3)[near] for n in names[:2])
    height, turn = np.meshgrid((np.arange(400) + 0.5) / 400, np.linspace(0, 2 * np.pi, 800)[:-1])
    around = np.sqrt(1.0 - height**2)
    points = np.stack([around * np.cos(turn), around * np.sin(turn), height], axis=-1)
    apart_mm = radius_mm * np.linalg.norm(points.reshape(-1, 3) - where, axis=1)
    area_mm2 = 2.0 * np.pi * radius_mm**2 / len(apart_mm)
    expected = renderer.scene.scattering.R(apart_mm).sum(axis=0) * area_mm2
    np.testing.assert_allclose((scattered / came_in).mean(axis=0), expected, rtol=0.03)
