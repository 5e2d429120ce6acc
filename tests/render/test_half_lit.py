"""The half-lit plane: the one case whose answer is known at any tilt, distance, lens and aspect."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from render.edges import CLOSE, lit_edge, width_mm
from render.synthetic import merged

from scanrender.render.device import Device

pytestmark = pytest.mark.gl

RED, GREEN, BLUE = 0, 1, 2
HALOS = ("none", "depth", "cbf", "cbf_normalized", "measure")
WITHIN = 0.01
# Camera settings that look at the same plane from elsewhere; fill is by distance, so that 0.9 / k
# puts the camera k times as far.
FILL = 0.9
CAMERAS: dict[str, Any] = {
    **{f"distance x{k:g}": {"fill": FILL / k} for k in (0.25, 0.5, 2, 4, 8)},
    "fov 10": {"focal_mm": 137.0},
    "fov 33": {"focal_mm": 40.0},
    "fov 90": {"focal_mm": 12.0},
    "orthographic": {"projection": "orthographic"},
    "aspect 1:2": {"height_px": 320},
    "aspect 21:9": {"width_px": 322, "height_px": 138},
}


def test_what_a_pixel_shows_is_not_the_value_at_its_centre(gl: Device):
    """Why truth is averaged over the footprint: blue is a pixel wide here."""
    edge = lit_edge(gl)
    beside = np.argsort(np.abs(edge.x_mm))[:2]
    assert edge.px_per_mm == pytest.approx(6.9, abs=0.2)
    assert edge.error < 1e-3
    for at in beside:
        assert 0.2 < edge.found[at, BLUE] < 0.8


@pytest.mark.parametrize("vertical", [True, False], ids=["across rows", "across columns"])
@pytest.mark.parametrize("halo", HALOS)
def test_it_is_a_sum_of_error_functions_in_every_halo_mode(gl: Device, vertical: bool, halo: str):
    assert lit_edge(gl, vertical=vertical, diffusion={"halo": halo}).error < WITHIN


@pytest.mark.parametrize("camera", CAMERAS)
@pytest.mark.parametrize("halo", ["none", "cbf", "cbf_normalized"])  # `measure` is below
def test_it_is_so_whatever_the_camera(gl: Device, camera: str, halo: str):
    edge = lit_edge(gl, camera=CAMERAS[camera], diffusion={"halo": halo})
    assert len(edge.x_mm) >= 12
    assert edge.error < WITHIN


@pytest.mark.parametrize("degrees", [30, 60])
@pytest.mark.parametrize(("axis", "vertical"), [("y", True), ("x", False), ("x", True)])
def test_measure_knows_no_tilt(gl: Device, axis: str, vertical: bool, degrees: float):
    assert lit_edge(gl, axis=axis, vertical=vertical, tilt_deg=degrees).error < WITHIN


@pytest.mark.parametrize("camera", CAMERAS)
@pytest.mark.parametrize("degrees", [0, 30, 60])
def test_measure_knows_no_tilt_whatever_the_camera(gl: Device, camera: str, degrees: float):
    edge = lit_edge(gl, tilt_deg=degrees, camera=CAMERAS[camera])
    assert len(edge.x_mm) >= 6
    assert edge.error < WITHIN


@pytest.mark.parametrize(("axis", "vertical"), [("y", True), ("x", False), ("diagonal", True)])
def test_without_the_measure_a_tilted_plane_is_wrong(
    gl: Device, axis: str, vertical: bool, capsys: pytest.CaptureFixture[str]
):
    """What the measure is for, and that the tests above could fail. All are printed."""
    rows = []
    for halo in HALOS:
        errors = [
            lit_edge(gl, axis=axis, vertical=vertical, tilt_deg=degrees, diffusion={"halo": halo})
            for degrees in (30, 60)
        ]
        rows.append((halo, *(edge.error for edge in errors)))
    with capsys.disabled():
        print(f"\nedge on a plane tilted about {axis}, error at 30 and 60 deg:")
        for halo, *errors in rows:
            print(f"  {halo:15}" + "".join(f"{error:8.4f}" for error in errors))
    at_60 = {halo: error for halo, _, error in rows}
    assert all(at_60[halo] > 0.04 for halo in ("none", "cbf"))
    # The depth correction narrows the kernel where skin is turned, by less than is right.
    for halo in ("depth", "cbf_normalized"):
        assert at_60["measure"] < at_60[halo] < at_60["none"]
        assert at_60[halo] > WITHIN


@pytest.mark.parametrize("supersampling", [2, 4])
@pytest.mark.parametrize("edge_mm", [0.0, 0.043, 0.11])
def test_supersampled_it_is_so_below_a_pixel_and_between_pixels(
    gl: Device, supersampling: int, edge_mm: float
):
    """A pixel and a half a millimetre: blue's first Gaussian is an eighth of a pixel wide.

    An edge between pixels is known to one sub-sample, which is what may be wrong with it.
    """
    edge = lit_edge(
        gl, camera={"fill": 0.2}, edge_mm=edge_mm, quality={"supersampling": supersampling}
    )
    assert edge.px_per_mm < 1.7
    one_sample = 0.0 if edge_mm == 0.0 else 0.5 / supersampling**2
    assert edge.error < WITHIN + one_sample


@pytest.mark.parametrize("fill", [0.9, 0.45, 0.2, 0.05])
def test_a_single_sample_is_right_at_every_width_in_pixels(gl: Device, fill: float):
    """From half a pixel to a hundredth: the kernel tends to the identity as the truth does."""
    assert lit_edge(gl, camera={"fill": fill}).error < WITHIN


@pytest.mark.parametrize("scale", [1e-5, 1e-3, 1e-2, 0.1, 0.3, 1.0, 2.0])
def test_at_every_scale_of_the_profile(gl: Device, scale: float):
    assert lit_edge(gl, skin={"scale": scale}).error < WITHIN


def test_the_profile_of_the_settings_is_the_one_that_blurs(gl: Device):
    terms = [{"variance_mm2": 0.09, "weight": [0.2, 0.5, 1.0]},
             {"variance_mm2": 1.0, "weight": [0.8, 0.5, 0.0]}]  # fmt: skip
    edge = lit_edge(gl, skin={"profile": terms})
    assert edge.error < WITHIN
    assert width_mm(edge.x_mm, edge.found[:, BLUE]) < 0.5 * width_mm(edge.x_mm, edge.found[:, RED])


def test_samples_refine_the_edge(gl: Device):
    errors = [lit_edge(gl, diffusion={"samples": samples}).error for samples in (3, 7, 13, 25)]
    assert errors[0] > 0.02
    assert errors[1] < 0.02
    assert errors[2] < WITHIN
    assert errors[3] < 2e-3


def test_the_kernel_grows_without_a_jump(gl: Device):
    """Over whole-pixel taps to bilinear ones: the first shadow pixel only ever gets brighter."""
    profile = [{"variance_mm2": 1.0, "weight": [1.0, 1.0, 1.0]}]
    found = []
    for scale in np.geomspace(0.001, 1.0, 16):
        edge = lit_edge(gl, skin={"profile": profile, "scale": float(scale)})
        # One Gaussian straight from a hard edge shows single taps once they are a pixel apart.
        assert edge.error < (WITHIN if scale < 0.5 else 0.02)
        dark = np.flatnonzero(edge.x_mm < 0)[np.argmax(edge.x_mm[edge.x_mm < 0])]
        found.append(float(edge.found[dark, RED]))
    steps = np.diff(found)
    assert found[0] < 3e-3
    assert found[-1] > 0.4
    assert (steps > -1e-3).all()
    assert steps.max() < 0.12


def test_red_bleeds_further_than_green_and_green_than_blue(gl: Device):
    edge = lit_edge(gl)
    in_shadow = np.argmin(np.abs(edge.x_mm + 1.0))
    red, green, blue = edge.found[in_shadow]
    assert red > 3 * green > 3 * blue
    assert red > 0.08
    lit = np.argmin(np.abs(edge.x_mm - 1.0))
    assert edge.found[lit, RED] < edge.found[lit, GREEN] < edge.found[lit, BLUE]


def test_jitter_leaves_the_edge_where_it_is(gl: Device):
    """Tap for tap inside its cell, the same on each run."""
    settings = merged(CLOSE, {"diffusion": {"samples": 11, "jitter": True}})
    edge, again = lit_edge(gl, settings), lit_edge(gl, settings)
    np.testing.assert_array_equal(edge.found, again.found)
    still = lit_edge(gl, CLOSE, diffusion={"samples": 11})
    assert np.abs(edge.found - still.found).max() > 1e-4
    assert edge.error < 0.03
