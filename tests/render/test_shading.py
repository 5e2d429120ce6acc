"""Light on the surface: Lambert, shadows, highlights, what crosses thin skin, and curvature."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest
from render.synthetic import (
    AMBIENT,
    MATT,
    flat_map,
    joined,
    merged,
    pipeline,
    plane,
    quad,
    render,
    slab,
    sphere,
    sphere_mesh,
    turned,
)
from scipy import ndimage

from scanrender.asset import Asset
from scanrender.optics.profiles.gaussians import D_EON_SKIN
from scanrender.optics.surface import SpecularLobes
from scanrender.reference.analytic import slab_transmittance
from scanrender.render.device import Device
from scanrender.render.frame import Renderer

pytestmark = pytest.mark.gl

FRONT = {"type": "directional", "azimuth_deg": 0, "elevation_deg": 0, "irradiance": 1.0,
         "shadow_px": 256, "shadow_blur_mm": 0.5}  # fmt: skip
BEHIND = {**FRONT, "azimuth_deg": 180}
GLOSSY = {"skin": {"specular": {"strength": 1.0}}}
THROUGH = {"skin": {"transmission": {"method": "shadow_map", "blur_mm": 0.0, "bias_mm": 0.1}}}


def inside(made: dict[str, npt.NDArray[np.float32]]) -> npt.NDArray[np.bool_]:
    return made["alpha"][:, :, 0] == 1


# --- irradiance and shadow -----------------------------------------------------------------------


@pytest.mark.parametrize("azimuth", [0, 35, -60, 90])
def test_irradiance_is_the_cosine(gl: Device, azimuth: float):
    lamp = {**FRONT, "azimuth_deg": azimuth, "irradiance": 2.0, "shadow": False}
    made = render(gl, sphere(10.0), pipeline(MATT, lights=[lamp]), "irradiance", "normal_geometry")
    angle = np.deg2rad(azimuth)
    cosine = made["normal_geometry"] @ [np.sin(angle), 0, np.cos(angle)]
    expected = 2.0 * np.maximum(cosine, 0)[inside(made)]
    np.testing.assert_allclose(made["irradiance"][inside(made)][:, 1], expected, atol=2e-3)


def test_a_unit_light_gives_a_white_diffuser_the_radiance_one(gl: Device):
    made = render(gl, plane(10.0), pipeline(MATT, lights=[{**FRONT, "shadow": False}]))
    np.testing.assert_allclose(made["beauty"][48, 48], 1.0, atol=1e-3)


def test_lights_add_up(gl: Device):
    lamps = [{**FRONT, "azimuth_deg": 40}, {**FRONT, "azimuth_deg": -70, "colour": [0.2, 0.5, 1]},
             {**FRONT, "type": "spot", "distance_mm": 300}, AMBIENT]  # fmt: skip
    asset, base = sphere(10.0), merged(MATT, GLOSSY)
    parts = [render(gl, asset, pipeline(base, lights=[lamp]), "diffuse", "specular")
             for lamp in lamps]  # fmt: skip
    whole = render(gl, asset, pipeline(base, lights=lamps), "diffuse", "specular")
    for name in ("diffuse", "specular"):
        total = np.sum([part[name] for part in parts], axis=0)
        np.testing.assert_allclose(whole[name], total, atol=1e-4)


def test_ambient_occlusion_dims_ambient_light_only(gl: Device):
    asset = plane(10.0, ao=flat_map(0.25))
    ambient = render(gl, asset, pipeline(MATT), "irradiance")["irradiance"][48, 48]
    direct = render(gl, asset, pipeline(MATT, lights=[{**FRONT, "shadow": False}]), "irradiance")
    np.testing.assert_allclose(ambient, 0.25, atol=1e-3)
    np.testing.assert_allclose(direct["irradiance"][48, 48], 1.0, atol=1e-3)


def test_a_spot_falls_off_with_the_square_and_ends_at_its_cone(gl: Device):
    spot = {"type": "spot", "distance_mm": 20.0, "cone_deg": 60.0, "edge": 0.0, "azimuth_deg": 0,
            "elevation_deg": 0, "shadow": False, "irradiance": 1.0}  # fmt: skip
    made = render(gl, plane(20.0), pipeline(MATT, lights=[spot]), "irradiance", "position")
    position = made["position"]
    radius = np.hypot(position[:, :, 0], position[:, :, 1])
    cosine = 20.0 / np.hypot(20.0, radius)
    expected = np.where(radius < 20 * np.tan(np.deg2rad(30)), cosine**3, 0.0)
    away = inside(made) & (np.abs(radius - 20 * np.tan(np.deg2rad(30))) > 0.5)
    np.testing.assert_allclose(made["irradiance"][away][:, 0], expected[away], atol=5e-3)


@pytest.mark.parametrize("kind", ["directional", "spot"])
def test_a_shadow_falls_where_geometry_says(gl: Device, kind: str):
    """A ball 15 mm before a wall, lit from straight ahead and 45 deg up: its shadow is 15 below."""
    wall, ball = quad((-40, -40), (40, 40), z=-5), sphere_mesh(4.0, 24, (0, 10, 10))
    asset = Asset(joined([wall, ball]), {"albedo": flat_map(1, 1, 1)})
    lamp = {"type": kind, "azimuth_deg": 0, "elevation_deg": 45, "shadow_px": 512,
            "shadow_blur_mm": 0.3}  # fmt: skip
    if kind == "spot":
        lamp["distance_mm"] = 1e5
        lamp["cone_deg"] = 1.0
    made = render(gl, asset, pipeline(MATT, lights=[lamp]), "visibility_0", "position", "depth_mm")
    on_wall = inside(made) & (made["depth_mm"][:, :, 0] > made["depth_mm"].max() - 0.5)
    dark = on_wall & (made["visibility_0"][:, :, 0] < 0.5)
    assert dark.sum() > 30
    x, y = made["position"][dark][:, 0].mean(), made["position"][dark][:, 1].mean()
    assert x == pytest.approx(0.0, abs=0.7)
    assert y == pytest.approx(10.0 - 15.0, abs=1.0)
    lit = on_wall & ~dark
    assert (made["visibility_0"][lit] == 1).mean() > 0.9


@pytest.mark.parametrize("tilt", [0, 30, 60, 75])
@pytest.mark.parametrize("shadow_px", [64, 1024])
def test_a_lit_plane_does_not_shadow_itself(gl: Device, tilt: float, shadow_px: int):
    lamp = {**FRONT, "azimuth_deg": tilt, "shadow_px": shadow_px, "shadow_blur_mm": 3.0}
    made = render(gl, plane(20.0), pipeline(MATT, lights=[lamp]), "visibility_0")
    assert made["visibility_0"][inside(made)].min() == 1.0, "acne"


def test_a_sphere_has_no_acne_where_it_is_lit(gl: Device):
    lamp = {**FRONT, "azimuth_deg": 50, "shadow_px": 512, "shadow_blur_mm": 1.0}
    made = render(gl, sphere(20.0), pipeline(MATT, lights=[lamp]), "visibility_0",
                  "normal_geometry", "irradiance")  # fmt: skip
    angle = np.deg2rad(50)
    cosine = made["normal_geometry"] @ [np.sin(angle), 0, np.cos(angle)]
    lit = inside(made) & (cosine > 0.3)
    assert made["visibility_0"][lit].mean() > 0.999
    assert made["visibility_0"][inside(made) & (cosine < -0.5)].max() == 0.0
    assert made["irradiance"][inside(made) & (cosine < -0.01)].max() == 0.0


def test_a_light_without_shadow_reaches_everything(gl: Device):
    settings = pipeline(MATT, lights=[{**BEHIND, "shadow": False}])
    renderer = Renderer(gl, slab(10.0, 4.0), settings)
    assert not [n for n in renderer.buffer_names if n.startswith("visibility")]


# --- specular ------------------------------------------------------------------------------------


def test_specular_is_never_blurred(gl: Device):
    """The same with and without diffusion, to the last bit where the guard band is the same."""
    asset = sphere(10.0, (0.6, 0.3, 0.2))
    lights = [{**FRONT, "azimuth_deg": 30}, AMBIENT]
    settings = [
        pipeline(MATT, GLOSSY, lights=lights, diffusion=diffusion)
        for diffusion in ({"method": "none"}, {"halo": "none"}, {"halo": "measure", "samples": 5})
    ]
    plain, *diffused = [render(gl, asset, s, "specular")["specular"] for s in settings]
    assert plain.max() > 0.1
    np.testing.assert_array_equal(*diffused)
    np.testing.assert_allclose(plain, diffused[0], rtol=1e-3, atol=1e-5)


def test_the_highlight_lies_at_the_mirror_direction(gl: Device):
    lamp = {**FRONT, "azimuth_deg": 60, "shadow": False}
    sharp = {"skin": {"specular": {"strength": 1.0, "roughness": [0.1, 0.1]}}}
    made = render(gl, sphere(10.0), pipeline(MATT, sharp, lights=[lamp], camera={
        "focal_mm": 2000}), "specular", "normal_geometry")  # fmt: skip
    brightest = np.argmax(made["specular"][:, :, 1])
    normal = made["normal_geometry"].reshape(-1, 3)[brightest]
    half = np.array([np.sin(np.deg2rad(30)), 0, np.cos(np.deg2rad(30))])
    assert np.rad2deg(np.arccos(normal @ half)) < 4.0


def test_no_highlight_in_shadow_or_without_strength(gl: Device):
    made = render(gl, sphere(10.0), pipeline(MATT, GLOSSY, lights=[BEHIND]), "specular",
                  "normal_geometry")  # fmt: skip
    facing = inside(made) & (made["normal_geometry"][:, :, 2] > 0.2)
    assert made["specular"][facing].max() == 0.0
    renderer = Renderer(gl, sphere(10.0), pipeline(MATT))
    order = [step.name for step in renderer.graph.order({"radiance"})]
    assert "specular" not in order


@pytest.mark.parametrize("azimuth", [10, 60, 110])
def test_specular_is_the_lobes_of_optics_at_each_pixel(gl: Device, azimuth: float):
    """The shader against the float64 lobes, with the normals and positions that it saw."""
    specular = {"strength": 1.0, "roughness": [0.5, 0.2], "second_lobe": 0.3, "f0": 0.04}
    lamp = {**FRONT, "azimuth_deg": azimuth, "irradiance": 2.0, "shadow": False}
    made = render(gl, sphere(10.0), pipeline(MATT, skin={"specular": specular}, lights=[lamp]),
                  "specular", "irradiance", "normal_shading", "position")  # fmt: skip
    seen = inside(made)
    normal = made["normal_shading"][seen].astype(np.float64)
    to_view = -made["position"][seen].astype(np.float64)
    to_view /= np.linalg.norm(to_view, axis=1, keepdims=True)
    angle = np.deg2rad(azimuth)
    to_light = np.broadcast_to([np.sin(angle), 0, np.cos(angle)], normal.shape)
    cosine = np.maximum(np.sum(normal * to_light, axis=1), 0)
    lobes = SpecularLobes(0.5, 0.2, 0.7, 0.04)
    # A light of 1 has the irradiance pi.
    expected = np.pi * 2.0 * lobes.brdf(normal, to_light, to_view) * cosine
    facing = np.sum(normal * to_view, axis=1) > 0.05
    found = made["specular"][seen][facing, 1]
    np.testing.assert_allclose(found, expected[facing], rtol=0.01, atol=1e-4)
    entering = 2.0 * cosine * (1 - lobes.directional_albedo(cosine))
    np.testing.assert_allclose(made["irradiance"][seen][:, 1], entering, atol=0.01)


def test_ambient_light_loses_what_the_lobes_reflect(gl: Device):
    specular = {"strength": 1.0, "roughness": [0.4, 0.4], "f0": 0.2}
    made = render(gl, sphere(10.0), pipeline(MATT, skin={"specular": specular}), "irradiance")
    cosines = (np.arange(400) + 0.5) / 400
    reflected = SpecularLobes(0.4, 0.4, 1.0, 0.2).directional_albedo(cosines)
    mean = float(np.average(reflected, weights=cosines))
    assert mean > 0.1
    np.testing.assert_allclose(made["irradiance"][inside(made)], 1 - mean, atol=3e-3)


@pytest.mark.parametrize("roughness", [0.1, 0.38, 1.0])
def test_what_is_reflected_does_not_enter(gl: Device, roughness: float):
    """Never more light leaves than arrives: ambient 1, albedo 1, with any lobe."""
    lobes = {"strength": 1.0, "roughness": [roughness, roughness], "f0": 0.04}
    made = render(gl, sphere(10.0), pipeline(MATT, skin={"specular": lobes}), "diffuse",
                  "specular")  # fmt: skip
    total = (made["diffuse"] + made["specular"])[inside(made)]
    assert total.max() <= 1.0 + 1e-3
    assert total.min() > 0.7


def test_the_sum_of_the_parts_is_the_picture(gl: Device):
    settings = pipeline(MATT, GLOSSY, THROUGH, lights=[{**BEHIND, "azimuth_deg": 150}, AMBIENT])
    made = render(gl, slab(10.0, 2.0), settings, "diffuse", "specular", "transmission", "radiance")
    total = made["diffuse"] + made["specular"] + made["transmission"]
    np.testing.assert_allclose(made["radiance"], total, rtol=1e-6)
    np.testing.assert_array_equal(made["radiance"], made["beauty"])
    assert made["transmission"].max() > 0.01


# --- transmission --------------------------------------------------------------------------------


@pytest.mark.parametrize("thickness", [1.5, 2.0, 4.0, 8.0])
@pytest.mark.parametrize("bias", [0.0, 0.1, 0.6])
@pytest.mark.parametrize("kind", ["directional", "spot"])
def test_light_through_a_slab_is_the_closed_form(
    gl: Device, thickness: float, bias: float, kind: str
):
    lamp = {**BEHIND, "type": kind, "shadow_px": 256}
    if kind == "spot":
        lamp["distance_mm"] = 5000.0
    transmission = {"transmission": {"bias_mm": bias, "blur_mm": 0.0, "method": "shadow_map"}}
    made = render(gl, slab(20.0, thickness), pipeline(MATT, skin=transmission, lights=[lamp]),
                  "transmission", "thickness_mm", "transmittance")  # fmt: skip
    middle = np.s_[44:52, 44:52]
    np.testing.assert_allclose(made["thickness_mm"][middle], thickness, atol=0.02)
    truth = slab_transmittance(thickness, D_EON_SKIN)
    found = made["transmittance"][middle].mean(axis=(0, 1))
    np.testing.assert_allclose(found, truth, rtol=0.03, atol=1e-4)
    np.testing.assert_allclose(
        made["transmission"][middle], made["transmittance"][middle], rtol=5e-3
    )


@pytest.mark.parametrize("azimuth", [180, 150])
def test_oblique_light_crosses_more_skin(gl: Device, azimuth: float):
    """Through a slab the way is 1 / cos longer; the bias shortens it by little."""
    settings = pipeline(MATT, skin={"transmission": {"method": "shadow_map", "blur_mm": 0.0}},
                        lights=[{**BEHIND, "azimuth_deg": azimuth}])  # fmt: skip
    made = render(gl, slab(20.0, 3.0), settings, "thickness_mm")
    way = 3.0 / -np.cos(np.deg2rad(azimuth))
    np.testing.assert_allclose(made["thickness_mm"][44:52, 44:52], way, rtol=0.06)


def test_a_rim_is_as_thick_as_it_is_and_not_as_what_lies_beside_it(gl: Device):
    """Half of the taps at a slab's edge miss it: they tell of no way through skin."""
    transmission = {"method": "shadow_map", "blur_mm": 3.0}
    made = render(gl, slab(20.0, 3.0), pipeline(MATT, skin={"transmission": transmission},
                  lights=[BEHIND]), "thickness_mm")  # fmt: skip
    seen = ndimage.binary_erosion(made["alpha"][:, :, 0] == 1, iterations=2)
    np.testing.assert_allclose(made["thickness_mm"][seen], 3.0, atol=0.05)


def test_the_thinnest_skin_is_the_lit_face_and_fades_in(gl: Device):
    """Below `bias_mm` irradiance already holds the light; from twice that it is all there."""
    found = []
    for thickness in (0.3, 0.55, 0.9, 1.3):
        transmission = {"method": "shadow_map", "blur_mm": 0.0, "bias_mm": 0.6}
        settings = pipeline(MATT, skin={"transmission": transmission}, lights=[BEHIND])
        made = render(gl, slab(20.0, thickness), settings, "transmittance")
        truth = slab_transmittance(thickness, D_EON_SKIN)[0]
        found.append(float(made["transmittance"][48, 48, 0] / truth))
    assert found[:2] == pytest.approx([0.0, 0.0], abs=1e-3)
    assert found[2] == pytest.approx(0.5, abs=0.1)
    assert found[3] == pytest.approx(1.0, abs=0.03)


def test_transmission_is_red_and_takes_the_albedo(gl: Device):
    asset = slab(20.0, 2.0)
    tinted = Asset(asset.mesh, {"albedo": flat_map(0.5, 0.5, 0.25)})
    settings = pipeline(MATT, THROUGH, lights=[BEHIND])
    white = render(gl, asset, settings, "transmission")["transmission"][48, 48]
    colour = render(gl, tinted, settings, "transmission")["transmission"][48, 48]
    assert white[0] > 10 * white[1] > 0
    np.testing.assert_allclose(colour, white * [0.5, 0.5, 0.25], rtol=2e-3)


def test_nothing_crosses_on_the_lit_side_or_through_what_is_thick(gl: Device):
    lit = render(gl, slab(20.0, 1.0), pipeline(MATT, THROUGH, lights=[FRONT]), "transmission")
    assert lit["transmission"].max() == 0.0
    thick = render(gl, slab(20.0, 40.0), pipeline(MATT, THROUGH, lights=[BEHIND]), "transmission")
    assert thick["transmission"].max() < 1e-6


def test_what_is_no_skin_lets_nothing_through(gl: Device):
    asset = slab(20.0, 1.0)
    stone = Asset(asset.mesh, {**asset.maps, "skin": flat_map(0.0)})
    made = render(gl, stone, pipeline(MATT, THROUGH, lights=[BEHIND]), "transmission")
    assert made["transmission"].max() == 0.0


def test_each_light_shines_through_and_the_first_one_tells_the_thickness(gl: Device):
    """A light that hides a thick slab must not change what the first one measured."""
    asset = slab(20.0, 2.0)
    oblique = {**BEHIND, "azimuth_deg": 130}
    one = render(gl, asset, pipeline(MATT, THROUGH, lights=[BEHIND]), "transmission",
                 "thickness_mm")  # fmt: skip
    two = render(gl, asset, pipeline(MATT, THROUGH, lights=[BEHIND, oblique]), "transmission",
                 "thickness_mm")  # fmt: skip
    np.testing.assert_array_equal(one["thickness_mm"], two["thickness_mm"])
    assert two["transmission"][48, 48, 0] > 1.2 * one["transmission"][48, 48, 0]


# --- skin with and without scattering ------------------------------------------------------------


SHADOW_BUFFERS = ("diffuse", "specular", "irradiance", "visibility_0", "position")


def cast_shadow(gl: Device, method: str) -> dict[str, npt.NDArray[np.float32]]:
    """A wall with the shadow of a bar across it, as skin or as plaster."""
    parts = [quad((-16, -16), (16, 6)), quad((-60, 8), (60, 20), z=12)]
    lamp = {**FRONT, "elevation_deg": 50, "shadow_px": 1024, "shadow_blur_mm": 0.2}
    settings = pipeline(
        MATT, GLOSSY, lights=[lamp], diffusion={"method": method},
        camera={"width_px": 128, "height_px": 128, "fill": 2.4},
    )  # fmt: skip
    asset = Asset(joined(parts), {"albedo": flat_map(0.6, 0.4, 0.3)})
    return render(gl, asset, settings, *SHADOW_BUFFERS)


def test_scattering_reddens_and_softens_shadow_edges_and_leaves_highlights(gl: Device):
    off, on = cast_shadow(gl, "none"), cast_shadow(gl, "gaussian_sum")
    for name in ("irradiance", "specular"):
        np.testing.assert_allclose(off[name], on[name], rtol=1e-3, atol=1e-5)
    wall = inside(off) & (off["position"][:, :, 1] < 6)
    shadowed = wall & (off["visibility_0"][:, :, 0] == 0)
    near_edge = shadowed & _grown(wall & (off["visibility_0"][:, :, 0] == 1), 8)
    assert near_edge.sum() > 50
    assert off["diffuse"][near_edge].max() == 0.0
    red, green, blue = on["diffuse"][near_edge].mean(axis=0) / [0.6, 0.4, 0.3]
    assert red > 2 * green > 2 * blue > 0
    lit = wall & (off["visibility_0"][:, :, 0] == 1) & _grown(shadowed, 6)
    kept = on["diffuse"][lit].mean(axis=0) / off["diffuse"][lit].mean(axis=0)
    assert kept[0] < kept[1] < kept[2] < 1.0, "red left for the shadow"
    rows = np.flatnonzero(wall[:, 64] & (off["position"][:, 64, 1] < 4))
    rough = [np.abs(np.diff(made["diffuse"][rows, 64, 0])).max() for made in (off, on)]
    assert rough[1] < 0.6 * rough[0]


def _grown(mask: npt.NDArray[np.bool_], steps: int) -> npt.NDArray[np.bool_]:
    for _ in range(steps):
        wide = mask.copy()
        wide[1:] |= mask[:-1]
        wide[:-1] |= mask[1:]
        mask = wide
    return mask


# --- curvature -----------------------------------------------------------------------------------


@pytest.mark.parametrize("radius", [8.0, 20.0, 80.0])
def test_the_curvature_of_a_sphere_is_one_over_its_radius(gl: Device, radius: float):
    made = render(gl, sphere(radius, rings=128), pipeline(MATT), "curvature", "curvature_raw",
                  "normal_geometry")  # fmt: skip
    facing = inside(made) & (made["normal_geometry"][:, :, 2] > 0.5)
    assert np.median(made["curvature_raw"][facing]) == pytest.approx(1 / radius, rel=0.03)
    np.testing.assert_allclose(made["curvature"][facing], 1 / radius, rtol=0.15)


def test_the_curvature_of_a_plane_is_zero_up_to_its_edge(gl: Device):
    for asset in (plane(10.0), turned(plane(10.0), 60.0, "y")):
        made = render(gl, asset, pipeline(MATT), "curvature", "curvature_raw")
        np.testing.assert_allclose(made["curvature_raw"][inside(made)], 0.0, atol=1e-4)


def test_the_curvature_is_of_the_shape_and_not_of_the_normal_map(gl: Device):
    rng = np.random.default_rng(0)
    noise = rng.normal(size=(32, 32, 3)) * 0.3 + [0, 0, 1]
    noise /= np.linalg.norm(noise, axis=2, keepdims=True)
    made = render(gl, plane(10.0, normal_ts=noise), pipeline(MATT), "curvature_raw")
    np.testing.assert_allclose(made["curvature_raw"][inside(made)], 0.0, atol=1e-4)
