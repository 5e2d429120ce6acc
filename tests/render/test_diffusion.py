"""Diffusion on screen against what diffusion is: constants stay, edges are error functions."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from render.edges import CLOSE, HALF_MM, Floats, lit_edge, width_mm
from render.synthetic import (
    AMBIENT,
    MATT,
    pipeline,
    plane,
    render,
    sphere,
    stepped_terrace,
    turned,
    two_tone_plane,
)

from scanrender.optics.kernels import gaussian_taps
from scanrender.optics.profiles.gaussians import D_EON_SKIN
from scanrender.render.device import Device
from scanrender.render.frame import Renderer
from scanrender.render.passes.gaussian_sum import taps_for

pytestmark = pytest.mark.gl

RED, GREEN = 0, 1
METHODS = ("gaussian_sum", "separable_preintegrated", "separable_artistic")
HALOS = ("none", "depth", "cbf", "cbf_normalized")


def on_skin(x: Floats, half_mm: float = HALF_MM, margin_mm: float = 3.0):
    """Pixels of the plane that are not near its outer rim."""
    return (np.abs(x) < half_mm - margin_mm) & (x != 0)


# --- a constant stays a constant -----------------------------------------------------------------


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(
    ("halo", "samples"),
    [*(("measure", n) for n in (3, 4, 17, 255)), *((halo, 17) for halo in HALOS), ("depth", 4)],
)
def test_constant_light_stays_constant(gl: Device, samples: int, halo: str, method: str):
    settings = pipeline(MATT, diffusion={"samples": samples, "halo": halo, "method": method})
    for asset in (plane(20.0), turned(plane(20.0), 55.0, "y"), sphere(15.0)):
        made = render(gl, asset, settings, "diffuse", "irradiance")
        inside = made["alpha"][:, :, 0] == 1
        assert inside.sum() > 500
        np.testing.assert_allclose(made["irradiance"][inside], 1.0, atol=1e-6)
        np.testing.assert_allclose(made["diffuse"][inside], 1.0, atol=1e-3)
        assert (made["diffuse"][~inside] == 0).all()


@pytest.mark.parametrize(
    "camera",
    [{"width_px": 17, "height_px": 61}, {"fill": 12.0}, {"fill": 0.05}, {"focal_mm": 2000},
     {"focal_mm": 10}, {"width_px": 1, "height_px": 1}],
    ids=str,
)  # fmt: skip
def test_constant_light_stays_constant_at_any_size_on_screen(gl: Device, camera: dict[str, Any]):
    made = render(gl, plane(20.0), pipeline(MATT, camera=camera), "diffuse")
    inside = made["alpha"][:, :, 0] == 1
    if camera.get("width_px") != 1 and camera.get("fill") != 0.05:
        assert inside.any()
    np.testing.assert_allclose(made["diffuse"][inside], 1.0, atol=1e-3)


@pytest.mark.parametrize("texturing", ["pre", "mixed", "post"])
def test_flat_colour_comes_out_as_it_is(gl: Device, texturing: str):
    albedo = (0.6, 0.25, 0.04)
    settings = pipeline(MATT, skin={"texturing": texturing})
    made = render(gl, plane(20.0, albedo), settings, "diffuse")
    inside = made["alpha"][:, :, 0] == 1
    expected = np.broadcast_to(albedo, made["diffuse"][inside].shape)
    np.testing.assert_allclose(made["diffuse"][inside], expected, rtol=2e-3)


def test_energy_ratio_is_one_on_constant_light(gl: Device):
    made = render(gl, plane(20.0), pipeline(MATT), "energy_ratio")
    inside = made["alpha"][:, :, 0] == 1
    np.testing.assert_allclose(made["energy_ratio"][inside], 1.0, atol=1e-3)


@pytest.mark.parametrize("samples", [3, 4, 9, 17, 254, 255])
@pytest.mark.parametrize("sigma_px", [0.01, 0.5, 0.71, 3.0, 40.0, 1000.0])
def test_taps_of_each_gaussian_sum_to_one_and_fit_the_shader(samples: int, sigma_px: float):
    count = taps_for(samples, sigma_px)
    assert 1 <= count <= samples
    taps = gaussian_taps(count)
    assert taps.weights.sum() == pytest.approx(1.0, abs=1e-12)
    assert float(np.float32(taps.weights).sum()) == pytest.approx(1.0, abs=1e-6)


BASE_WIDTH = {
    "as it is": {},
    "twice the pixels": {"camera": {"width_px": 300, "height_px": 300}},
    "wide": {"camera": {"width_px": 320}},
    "tall": {"camera": {"height_px": 320}},
    "short lens": {"camera": {"focal_mm": 50}},
    "long lens": {"camera": {"focal_mm": 800}},
    "nearer": {"camera": {"fill": 1.4}},
    "from the side": {"camera": {"azimuth_deg": 30}},
}


@pytest.mark.parametrize("kind", [name for name in BASE_WIDTH if name != "as it is"])
def test_the_blur_is_a_width_in_millimetres(gl: Device, kind: str):
    """Not in pixels: whatever the distance, lens, aspect and resolution."""

    def widths(changes: dict[str, Any]) -> list[float]:
        settings = pipeline(MATT, CLOSE, {"diffusion": {"samples": 35}}, changes)
        renderer = Renderer(gl, two_tone_plane(HALF_MM), settings)
        frame = renderer.render(renderer.view(0), ["diffuse", "position"])
        row = frame.alpha.shape[0] // 2
        turn = np.cos(np.deg2rad(settings.camera.azimuth_deg))
        x = frame.buffers["position"][row][:, 0].astype(np.float64) / turn
        here = on_skin(x) & (frame.alpha[row] == 1)
        return [width_mm(x[here], frame.buffers["diffuse"][row][here, c]) for c in range(3)]

    base, changed = widths({}), widths(BASE_WIDTH[kind])
    assert changed[RED] == pytest.approx(base[RED], rel=0.04)
    assert changed[GREEN] == pytest.approx(base[GREEN], rel=0.12)  # half a millimetre: few pixels


def test_skin_scale_scales_the_width(gl: Device):
    narrow, wide = lit_edge(gl, skin={"scale": 0.5}), lit_edge(gl)
    found = [width_mm(edge.x_mm, edge.found[:, RED]) for edge in (narrow, wide)]
    assert found[1] == pytest.approx(2 * found[0], rel=0.05)


# --- edges of the skin ---------------------------------------------------------------------------


@pytest.mark.parametrize(("halo", "leaks"), [("none", True), ("depth", False), ("measure", False)])
def test_light_does_not_cross_a_depth_step(gl: Device, halo: str, leaks: bool):
    settings = pipeline(MATT, CLOSE, diffusion={"halo": halo})
    made = render(gl, stepped_terrace(HALF_MM, 60.0), settings, "diffuse", "albedo")
    far = (made["albedo"][:, :, 0] == 0) & (made["alpha"][:, :, 0] == 1)
    leak = float(made["diffuse"][far].max())
    # What is left crosses in the one texel that a filtered tap shares with the other side.
    assert leak > 0.2 if leaks else leak < 0.03


def test_what_is_no_skin_neither_gives_nor_takes(gl: Device):
    """A bright, non-skin half stays as it is and does not tint the dark skin beside it."""
    asset = two_tone_plane(HALF_MM)
    asset.maps["skin"] = np.array([[[1.0], [0.0]]], np.float32)
    settings = pipeline(MATT, CLOSE)
    made = render(gl, asset, settings, "diffuse", "albedo")
    inside = made["alpha"][:, :, 0] == 1
    lit = inside & (made["albedo"][:, :, 0] > 0.5)
    np.testing.assert_allclose(made["diffuse"][lit], 1.0, atol=1e-3)
    assert made["diffuse"][inside & ~lit].max() < 1e-3
    everywhere = render(gl, asset, pipeline(settings.model_dump(mode="json"),
                                            diffusion={"mask": "none"}), "diffuse")  # fmt: skip
    assert everywhere["diffuse"][inside & ~lit].max() > 0.2


def test_a_crop_is_the_middle_of_a_bigger_picture(gl: Device):
    """The guard band brings in the light from outside the picture."""
    asset = two_tone_plane(40.0)
    small = {"width_px": 48, "height_px": 48, "focal_mm": 200, "fill": 3.0}
    # The same pixels per millimetre, twice the field of view: half the focal length, half the fill.
    large = {"width_px": 144, "height_px": 144, "focal_mm": 200 / 3, "fill": 1.0}
    settings = {"skin": {"scale": 0.3}}
    a = Renderer(gl, asset, pipeline(MATT, settings, camera=small))
    b = Renderer(gl, asset, pipeline(MATT, settings, camera=large))
    # fill frames by distance: put both cameras at the same place.
    object.__setattr__(b.camera, "distance_mm", a.camera.distance_mm)
    object.__setattr__(b.camera, "near_mm", a.camera.near_mm)
    object.__setattr__(b.camera, "far_mm", a.camera.far_mm)
    cropped = a.render(a.view(0), ["diffuse"]).buffers["diffuse"]
    whole = b.render(b.view(0), ["diffuse"]).buffers["diffuse"][48:96, 48:96]
    assert a.guard_px < 24, "otherwise the cap would be what is tested"
    np.testing.assert_allclose(cropped, whole, atol=2e-3)
    assert cropped.std() > 0.2


def test_a_guard_band_that_is_cut_short_is_said(gl: Device):
    renderer = Renderer(gl, plane(20.0), pipeline(MATT, camera={"fill": 8.0}))
    assert renderer.guard_px == 48
    assert any(d.what == "guard band" for d in renderer.decisions)


def test_kernel_px_is_the_radius_on_screen(gl: Device):
    settings = pipeline(MATT)
    renderer = Renderer(gl, plane(20.0), settings)
    frame = renderer.render(renderer.view(0), ["kernel_px", "depth_mm"])
    inside = frame.alpha == 1
    expected = D_EON_SKIN.radius_for(0.999) * renderer.camera.px_per_mm(
        float(frame.buffers["depth_mm"][inside].mean())
    )
    np.testing.assert_allclose(frame.buffers["kernel_px"][inside].mean(axis=0), expected, rtol=1e-4)
    np.testing.assert_allclose(expected, np.array([8.0, 2.4, 1.5]) * expected[0] / 8.0, rtol=0.05)


def test_the_jacobian_adds_up_to_the_area_that_is_seen(gl: Device):
    """Pixels weigh by the skin they show: 60 deg of tilt or a hemisphere, the sum is the area."""
    radius = 12.0
    flat, round_ = plane(10.0), sphere(radius, rings=96)
    for asset, area, tolerance in (
        (flat, 400.0, 0.02),
        (turned(flat, 60.0, "y"), 400.0, 0.03),
        (turned(flat, 60.0, "x"), 400.0, 0.03),
        (round_, 2 * np.pi * radius**2, 0.05),  # the rim is clamped at cos 0.05
    ):
        settings = pipeline(MATT, camera={"focal_mm": 400})
        renderer = Renderer(gl, asset, settings)
        frame = renderer.render(renderer.view(0), ["jacobian"])
        pixel_mm = 1.0 / renderer.camera.px_per_mm(renderer.camera.distance_mm)
        seen = float(frame.buffers["jacobian"].sum()) * pixel_mm**2
        assert seen == pytest.approx(area, rel=tolerance)


def test_no_diffusion_is_the_input(gl: Device):
    settings = pipeline(MATT, CLOSE, diffusion={"method": "none"})
    made = render(gl, two_tone_plane(HALF_MM), settings, "diffuse", "albedo")
    np.testing.assert_array_equal(made["diffuse"], made["albedo"])


def test_lights_of_any_strength_give_finite_pictures(gl: Device):
    for strength in (1e-9, 1e9):
        settings = pipeline(MATT, lights=[{**AMBIENT, "irradiance": strength}])
        made = render(gl, sphere(20.0, rings=16), settings, "diffuse")
        inside = made["alpha"][:, :, 0] == 1
        np.testing.assert_allclose(made["diffuse"][inside] / strength, 1.0, atol=2e-3)
