"""A kernel that shrinks tends to no diffusion, continuously; one that grows to the visible mean."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from render.synthetic import MATT, pipeline, plane, render, sphere

from scanrender.measure.extremes import case_of
from scanrender.measure.invariants import Finding, finer_of, mirrored_of
from scanrender.render.device import Device
from scanrender.render.frame import Renderer

pytestmark = pytest.mark.gl

METHODS = ["gaussian_sum", "separable_preintegrated", "separable_artistic", "disk"]
HALOS = ["none", "depth", "measure"]
SIZE = 48
# A surface past the picture's edges: the guard band is full of it, and ends in it.
PATCHES = np.random.default_rng(1).random((12, 12, 3)).astype(np.float32)


def shot(method: str, halo: str, scale: float, samples: int = 17, **more: Any) -> Any:
    return pipeline(
        MATT,
        {"camera": {"width_px": SIZE, "height_px": SIZE, "height_mm": 30.0},
         "skin": {"scale": scale, "texturing": "pre"}, "quality": {"check": True},
         "diffusion": {"method": method, "halo": halo, "samples": samples, **more}},
    )  # fmt: skip


def patches(half_mm: float = 40.0) -> Any:
    board = plane(half_mm)
    # Sharp borders between the patches, whatever the footprint.
    return type(board)(board.mesh, {"albedo": np.kron(PATCHES, np.ones((8, 8, 1), np.float32))})


@given(
    method=st.sampled_from(METHODS),
    halo=st.sampled_from(HALOS),
    scale=st.sampled_from([100.0, 300.0, 1000.0]),
    samples=st.sampled_from([17, 64]),
)
def test_a_kernel_wider_than_the_picture_gives_the_visible_mean(
    gl: Device, method: str, halo: str, scale: float, samples: int
):
    """Its taps met the picture's last pixel again and again: streaks of it, instead of the mean."""
    made = render(gl, patches(), shot(method, halo, scale, samples), "scattered", "diffusion_input")
    red, mean = made["scattered"][:, :, 0], made["diffusion_input"][:, :, 0].mean()
    assert red.mean() == pytest.approx(mean, rel=0.1)
    # A sum of Gaussians blurs what is blurred; the others meet the patches with each tap.
    noise = {"gaussian_sum": 0.03, "disk": 0.12}.get(method, {17: 0.12, 64: 0.06}[samples])
    assert red.std() < noise * mean
    for axis in (0, 1):
        assert red.mean(axis=axis).std() < noise * mean  # no bands


@given(
    method=st.sampled_from(METHODS),
    halo=st.sampled_from(HALOS),
    exponent=st.floats(-4.0, -2.0),
)
def test_a_kernel_far_below_a_pixel_is_no_diffusion(
    gl: Device, method: str, halo: str, exponent: float
):
    settings = shot(method, halo, 10.0**exponent)
    made = render(gl, sphere(12.0, (0.7, 0.5, 0.4), rings=16), settings, "scattered", "irradiance")
    board = render(gl, patches(), settings, "scattered", "diffusion_input")
    np.testing.assert_allclose(board["scattered"], board["diffusion_input"], atol=0.02)
    assert np.isfinite(made["scattered"]).all()


@pytest.mark.parametrize("method", METHODS)
def test_the_kernel_grows_without_a_step(gl: Device, method: str):
    """From 0.01 to 30 px, in steps of a third: nothing pops where taps change their kind."""
    previous, steps = None, []
    for scale in np.geomspace(2e-3, 4.0, 28):
        settings = shot(method, "measure", float(scale), 64, disk_taps=255)
        made = render(gl, patches(), settings, "scattered")["scattered"]
        if previous is not None:
            steps.append(float(np.sqrt(np.mean((made - previous) ** 2))))
        previous = made
    assert max(steps) < 0.035


# Red reaches past the whole subject: the rest of the axes is as they walk.
WIDE = [{"scale": 100.0}, {"scale": 1000.0}, {"profile": 1e4}, {"size_mm": 0.05}]


@pytest.mark.parametrize("axes", WIDE)
@pytest.mark.parametrize("samples", [9, 64])
def test_a_kernel_wider_than_the_subject_does_not_hang_on_its_silhouette(
    gl: Device, axes: dict[str, float], samples: int
):
    """Where samples fell decided how much a silhouette weighed, from 2 to 20 times a facing pixel;
    mirrored, dE2000 0.6 to 1.2. Of nine taps it showed copies of the outline, 0.8 to 1.3."""
    case = case_of({**axes, "samples": samples})
    for invariant in (mirrored_of, finer_of):
        found = invariant(gl, case, 4)
        assert isinstance(found, Finding)
        assert found.holds, found


@pytest.mark.parametrize("method", ["separable_preintegrated", "separable_artistic", "disk"])
@pytest.mark.parametrize("axes", [{"scale": 1000.0}, {"size_mm": 0.05}])
def test_what_blurs_once_hands_over_to_gaussians_where_its_taps_would_show(
    gl: Device, axes: dict[str, float], method: str
):
    """Mirrored, dE2000 1.2 to 9: each tap met a pixel of the subject or of nothing."""
    case = case_of({**axes, "method": method})
    renderer = Renderer(gl, case.asset(), case.pipeline())
    told = [d for d in renderer.decisions if d.what == f"diffusion.method: {method}"]
    assert len(told) == 1
    assert "single taps would show" in told[0].reason
    for invariant in (mirrored_of, finer_of):
        found = invariant(gl, case, 4)
        assert isinstance(found, Finding)
        assert found.holds, found


def test_an_artistic_kernel_hands_over_its_own_gaussians(gl: Device):
    """Not the skin's: with its far radius as wide as a head, narrow skin would scatter next to
    nothing."""
    artistic = {"near_mm": [0.2] * 3, "far_mm": [150.0] * 3, "strength": [0.1] * 3}
    made = []
    for method in ("separable_artistic", "gaussian_sum"):
        settings = pipeline(
            MATT,
            camera={"width_px": SIZE, "height_px": SIZE, "height_mm": 30.0},
            lights=[{"type": "directional", "azimuth_deg": 70, "shadow_px": 64}],
            diffusion={"method": method, "halo": "none", "artistic": artistic},
        )
        ball = sphere(12.0, (0.7, 0.5, 0.4), rings=16)
        made.append(render(gl, ball, settings, "scattered")["scattered"])
    inside = made[0][:, :, 2] > 0.0
    spread = [np.std(picture[inside][:, 2]) for picture in made]
    assert spread[0] < 0.5 * spread[1]


def test_kernels_as_wide_as_a_face_keep_their_method(gl: Device):
    for method in ("separable_preintegrated", "disk"):
        case = case_of({"method": method, "scale": 10.0})
        renderer = Renderer(gl, case.asset(), case.pipeline())
        assert renderer.pipeline.diffusion.method == method
