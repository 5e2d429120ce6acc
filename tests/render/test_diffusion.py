"""Diffusion on screen against what diffusion is: constants stay, edges are error functions."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
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
from scanrender.optics.profiles.gaussians import D_EON_SKIN, GaussianSum
from scanrender.reference.analytic import half_lit_plane
from scanrender.render.device import Device
from scanrender.render.frame import Renderer
from scanrender.render.passes.gaussian_sum import taps_for

pytestmark = pytest.mark.gl

RED, GREEN, BLUE = 0, 1, 2
# Seven pixels a millimetre: the narrowest Gaussian of skin (0.08 mm) is over half a pixel wide.
HALF_MM = 10.0
CLOSE = {"camera": {"width_px": 160, "height_px": 160, "focal_mm": 200}}


def lit_edge(
    gl: Device, half_mm: float = HALF_MM, vertical: bool = True, **changes: Any
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float32]]:
    """(x in mm from the edge, diffuse along the perpendicular) of a plane lit where x > 0.

    The edge lies between two pixels. A row of pixels at x sees the mean light of its footprint, so
    the analytic answer at its centre is what it should show.
    """
    settings = pipeline(MATT, CLOSE, {"diffusion": {"samples": 25}}, changes)
    renderer = Renderer(gl, two_tone_plane(half_mm, vertical=vertical), settings)
    frame = renderer.render(renderer.view(0), ["diffuse", "position"])
    height, width = frame.alpha.shape
    axis, lines = (0, np.s_[height // 2]) if vertical else (1, np.s_[:, width // 2])
    x = frame.buffers["position"][lines][:, axis].astype(np.float64)
    return x, frame.buffers["diffuse"][lines]


def on_skin(x: npt.NDArray[np.float64], half_mm: float = HALF_MM, margin_mm: float = 3.0):
    """Pixels of the plane that are not near its outer rim."""
    return (np.abs(x) < half_mm - margin_mm) & (x != 0)


def edge_errors(x: npt.NDArray[np.float64], found: npt.NDArray[np.float32]) -> tuple[float, float]:
    """Largest distance from the truth: of the two pixels that touch the edge, of all others."""
    error = np.abs(found - half_lit_plane(x, D_EON_SKIN)).max(axis=1)
    at_edge = np.argsort(np.abs(x))[:2]
    return float(error[at_edge].max()), float(np.delete(error, at_edge).max())


def width_mm(x: npt.NDArray[np.float64], edge: npt.NDArray[np.floating]) -> float:
    """Distance between the places where the edge has 10 % and 90 % of the light."""
    order = np.argsort(x)
    a, b = np.interp([0.1, 0.9], edge[order], x[order])
    return float(b - a)


# --- a constant stays a constant -----------------------------------------------------------------


@pytest.mark.parametrize(
    ("halo", "samples"),
    [*(("measure", n) for n in (3, 4, 9, 17, 255)), *(("depth", n) for n in (4, 17)), ("none", 9)],
)
def test_constant_light_stays_constant(gl: Device, samples: int, halo: str):
    settings = pipeline(MATT, diffusion={"samples": samples, "halo": halo})
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


# --- the half-lit plane --------------------------------------------------------------------------


@pytest.mark.parametrize("vertical", [True, False], ids=["across rows", "across columns"])
@pytest.mark.parametrize("halo", ["none", "depth", "measure"])
def test_a_half_lit_plane_is_a_sum_of_error_functions(gl: Device, vertical: bool, halo: str):
    x, found = lit_edge(gl, vertical=vertical, diffusion={"halo": halo})
    here = on_skin(x)
    assert here.sum() > 80
    near, far = edge_errors(x[here], found[here])
    # The two pixels at the edge see their footprint, not a point: blue is a pixel wide.
    assert near < 0.025
    assert far < 0.006


def test_samples_refine_the_edge(gl: Device):
    errors = []
    for samples in (5, 11, 25):
        x, found = lit_edge(gl, diffusion={"samples": samples})
        here = on_skin(x)
        errors.append(np.abs(found[here] - half_lit_plane(x[here], D_EON_SKIN)).max())
    assert errors[0] > errors[2]
    assert errors[1] < 0.03


def test_the_profile_of_the_settings_is_the_one_that_blurs(gl: Device):
    terms = [{"variance_mm2": 0.09, "weight": [0.2, 0.5, 1.0]},
             {"variance_mm2": 1.0, "weight": [0.8, 0.5, 0.0]}]  # fmt: skip
    x, found = lit_edge(gl, skin={"profile": terms})
    truth = half_lit_plane(x, GaussianSum((0.09, 1.0), ((0.2, 0.5, 1.0), (0.8, 0.5, 0.0))))
    assert np.abs(found - truth)[on_skin(x)].max() < 0.02


def tilted_edge(gl: Device, axis: str, degrees: float, halo: str) -> tuple[float, float]:
    settings = pipeline(MATT, CLOSE, diffusion={"samples": 25, "halo": halo})
    renderer = Renderer(gl, turned(two_tone_plane(HALF_MM), degrees, axis), settings)
    frame = renderer.render(renderer.view(0), ["diffuse", "position"])
    row = frame.alpha.shape[0] // 2
    position = frame.buffers["position"][row].astype(np.float64)
    # Distance along the plane from the edge, which passes through the middle of the picture.
    x = position[:, 0] / (np.cos(np.deg2rad(degrees)) if axis == "y" else 1.0)
    here = on_skin(x) & (frame.alpha[row] == 1)
    assert here.sum() > 20
    return edge_errors(x[here], frame.buffers["diffuse"][row][here])


@pytest.mark.parametrize("axis", ["x", "y"])
@pytest.mark.parametrize("degrees", [30, 50, 70])
def test_a_tilted_plane_blurs_the_same_in_millimetres(gl: Device, axis: str, degrees: float):
    """Truth does not know the camera; neither does `halo: measure`."""
    near, far = tilted_edge(gl, axis, degrees, "measure")
    assert near < 0.05
    assert far < 0.015


def test_without_the_measure_a_tilted_plane_blurs_too_far(gl: Device):
    """What the measure is for, and that the test above could fail."""
    assert tilted_edge(gl, "y", 50, "none")[1] > 0.04
    assert tilted_edge(gl, "y", 70, "depth")[1] > 0.04


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
    narrow = width_mm(*_red(lit_edge(gl, skin={"scale": 0.5})))
    wide = width_mm(*_red(lit_edge(gl)))
    assert wide == pytest.approx(2 * narrow, rel=0.05)


def _red(edge: Any) -> Any:
    x, found = edge
    here = on_skin(x)
    return x[here], found[here, RED]


def test_red_bleeds_further_than_green_and_green_than_blue(gl: Device):
    x, found = lit_edge(gl)
    in_shadow = np.argmin(np.abs(x + 1.0))
    red, green, blue = found[in_shadow]
    assert red > 3 * green > 3 * blue
    assert red > 0.08
    lit = np.argmin(np.abs(x - 1.0))
    assert found[lit, RED] < found[lit, GREEN] < found[lit, BLUE], "what left is missing here"


@pytest.mark.parametrize("scale", [1e-5, 1e-3, 1e-2])
def test_a_kernel_far_below_a_pixel_changes_nothing(gl: Device, scale: float):
    x, found = lit_edge(gl, skin={"scale": scale})
    here = on_skin(x)
    expected = np.repeat((x[here] > 0).astype(float)[:, None], 3, axis=1)
    np.testing.assert_allclose(found[here], expected, atol=5e-3 if scale == 1e-2 else 1e-4)


def test_the_kernel_grows_without_a_jump(gl: Device):
    """From the identity over the three-tap kernel to the filter: the first shadow pixel only
    ever gets brighter, by no more than its neighbours in scale do."""
    profile = [{"variance_mm2": 1.0, "weight": [1.0, 1.0, 1.0]}]
    found = []
    scales = np.geomspace(0.01, 0.4, 24)
    for scale in scales:
        x, edge = lit_edge(gl, skin={"profile": profile, "scale": float(scale)})
        dark = np.flatnonzero(x < 0)[np.argmax(x[x < 0])]
        found.append(float(edge[dark, RED]))
    steps = np.diff(found)
    assert found[0] < 3e-3
    assert found[-1] > 0.3
    assert (steps > -1e-3).all()
    assert steps.max() < 0.08


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
