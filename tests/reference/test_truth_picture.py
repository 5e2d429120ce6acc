"""The truth as a picture: the renderer's conventions of light, material, camera and sheets."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from shapes import both, mesh_of, plane_mesh, sheet_mesh, sphere_mesh, turned_over

from scanrender.asset import Asset, Mesh
from scanrender.errors import ConfigError
from scanrender.optics.profiles import D_EON_SKIN
from scanrender.optics.surface import SpecularLobes
from scanrender.reference.gather import gather, pixel_areas
from scanrender.reference.lighting import Lighting
from scanrender.reference.points import PictureCamera, points_of_positions
from scanrender.reference.skin import SkinField
from scanrender.reference.surface import Surface
from scanrender.reference.truth import TruthQuality, truth_picture
from scanrender.render.frame import Renderer
from scanrender.render.samples import sample_offsets_px
from scanrender.settings.light import DirectionalLight
from scanrender.settings.pipeline import Pipeline
from scanrender.settings.skin import SpecularSettings

QUICK = TruthQuality(spacing_mm=0.8)
MATT: dict[str, Any] = {"specular": {"strength": 0.0}, "transmission": {"method": "none"}}


def asset_of(mesh: Mesh, **values: Any) -> Asset:
    maps = {name: np.array(value, np.float32).reshape(1, 1, -1) for name, value in values.items()}
    return Asset(mesh, maps)


def pipeline_of(*lights: dict[str, Any], **skin: Any) -> Pipeline:
    return Pipeline.model_validate({"lights": list(lights), "skin": {**MATT, **skin}})


def ortho(size_px: int, half_mm: float, turn: np.ndarray | None = None) -> PictureCamera:
    """Looks along -Z from z = 100 mm; the subject turned by `turn` (4x4)."""
    view, clip = np.eye(4), np.eye(4)
    view[2, 3] = -100.0
    clip[0, 0] = clip[1, 1] = 1.0 / half_mm
    clip[2, 2], clip[2, 3] = -2.0 / 198.0, -200.0 / 198.0
    return PictureCamera(view, np.eye(4) if turn is None else turn, clip, (size_px, size_px))


def perspective(size_px: int, half_tan: float, depth_mm: float) -> PictureCamera:
    view, clip = np.eye(4), np.zeros((4, 4))
    view[2, 3] = -depth_mm
    clip[0, 0] = clip[1, 1] = 1.0 / half_tan
    near, far = 1.0, 2.0 * depth_mm
    clip[2, 2], clip[2, 3] = -(far + near) / (far - near), -2.0 * far * near / (far - near)
    clip[3, 2] = -1.0
    return PictureCamera(view, np.eye(4), clip, (size_px, size_px))


def squashed(mesh: Mesh) -> Mesh:
    shape = np.array([1.0, 0.7, 1.0])
    normals = mesh.normals / shape
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return mesh_of(mesh.positions_mm * shape, normals, mesh.faces)


@pytest.mark.parametrize("texturing", ["pre", "mixed", "post"])
def test_even_skin_under_parallel_light(texturing):
    """albedo cos(60 deg) (1 - rho_dt(60 deg)) (1 - rho_dt(0)), in units of pi."""
    asset = asset_of(plane_mesh(20.0, 8), albedo=(0.6, 0.3, 0.2))
    light = {"type": "directional", "azimuth_deg": 60, "elevation_deg": 0, "irradiance": 2.0}
    pipeline = pipeline_of(light, texturing=texturing, specular={"roughness": [0.4, 0.2]})
    made = truth_picture(asset, pipeline, D_EON_SKIN, ortho(3, 2.0), QUICK, convergence_spots=0)
    lobes = SpecularLobes(0.4, 0.2, 0.7)
    rho_in, rho_out = lobes.directional_albedo([0.5, 1.0])
    # The renderer's table of rho_dt ends at half a step from cos = 1.
    expected = 2.0 * 0.5 * np.array([0.6, 0.3, 0.2]) * (1 - rho_in) * (1 - rho_out)
    for picture in (made.truth_mean, made.truth_sum, made.unscattered):
        np.testing.assert_allclose(picture, np.tile(expected, (3, 3, 1)), rtol=2e-3)
    assert made.coverage.min() == 1.0


def test_light_falls_where_rays_say():
    """A small roof over half of a plane, lit from straight above: dark below it, lit beside it."""
    roof = plane_mesh(10.0, 4)
    roof.positions_mm[:, 0] += 10.0
    roof.positions_mm[:, 2] += 30.0
    surface = Surface(both(plane_mesh(20.0, 20), roof))
    light = {"type": "directional", "azimuth_deg": 0, "elevation_deg": 0, "shadow_blur_mm": 0}
    field = SkinField.of(surface, pipeline_of(light), ortho(2, 8.0), 1, True)
    below = np.arange(2 * 20 * 20)
    lit, _ = field.field(below, np.full((len(below), 3), 1 / 3))
    middle = surface.positions[surface.faces[below]].mean(axis=1)
    in_shade = (middle[:, 0] > 0.0) & (np.abs(middle[:, 1]) < 10.0)
    np.testing.assert_array_equal(lit[:, 0] == 0.0, in_shade)


def test_a_soft_edge_is_as_wide_as_the_lights_say():
    roof = plane_mesh(10.0, 4)
    roof.positions_mm[:, 0] += 10.0
    roof.positions_mm[:, 2] += 30.0
    surface = Surface(both(plane_mesh(20.0, 20), roof))
    lamp = DirectionalLight(azimuth_deg=0, elevation_deg=0, shadow_blur_mm=1.5)
    rigs = ortho(1, 1.0).object_from_rig()
    lighting = Lighting((lamp,), rigs, SpecularSettings(strength=0), 256)
    x = np.array([-2.0, -1.0, 0.0, 1.0, 2.0])
    origin = np.stack([x, np.full(5, 0.3), np.full(5, 1.0)], axis=1)
    face, bary = surface.caster.first_hit(origin, np.tile([0.0, 0, -1.0], (5, 1)))
    at = surface.geometry(face, bary)
    got = lighting.irradiance(at, np.ones(5), surface.caster)[:, 0]
    u = np.clip(x / 1.5, -1.0, 1.0)
    expected = 0.5 - (u * np.sqrt(1.0 - u * u) + np.arcsin(u)) / np.pi  # of a disk past a line
    np.testing.assert_allclose(got, expected, atol=0.02)


def test_hidden_skin_counts_in_the_sum_and_not_in_the_mean():
    """A thin slab lit from behind glows in truth_sum; its lit side is no part of the picture."""
    slab = both(plane_mesh(15.0, 10), turned_over(plane_mesh(15.0, 10, -2.0)))
    light = {"type": "directional", "azimuth_deg": 180, "elevation_deg": 0}
    made = truth_picture(
        asset_of(slab, albedo=(1.0, 1.0, 1.0)),
        pipeline_of(light),
        D_EON_SKIN,
        ortho(2, 1.0),
        TruthQuality(spacing_mm=0.4),
        convergence_spots=0,
    )
    expected = D_EON_SKIN.transmittance(2.0)[0]
    assert made.truth_sum[0, 0, 0] == pytest.approx(expected, abs=5e-3)
    assert float(made.truth_mean.max()) == 0.0


def test_what_is_no_skin_keeps_its_own_light():
    mesh = plane_mesh(15.0, 10)
    lit = {"type": "directional", "azimuth_deg": 0, "elevation_deg": 0}
    asset = asset_of(mesh, albedo=(1.0, 1.0, 1.0), skin=(0.0,))
    made = truth_picture(
        asset, pipeline_of(lit), D_EON_SKIN, ortho(2, 1.0), QUICK, convergence_spots=0
    )
    np.testing.assert_allclose(made.truth_sum, 1.0, atol=1e-6)
    assert float(made.skin.max()) == 0.0


def test_convergence_is_measured_and_even_light_has_converged():
    mesh = sheet_mesh(12.0, 24, lambda x, y: 0.4 * np.sin(x) * np.cos(y))
    ambient = {"type": "ambient", "irradiance": 0.5}
    made = truth_picture(
        asset_of(mesh, albedo=(0.5, 0.4, 0.3)),
        pipeline_of(ambient),
        D_EON_SKIN,
        ortho(16, 4.0),
        QUICK,
        convergence_spots=2,
    )
    assert made.convergence is not None
    assert 9 <= made.convergence.pixels <= 18
    assert made.convergence.truth_mean.maximum < 1e-6
    assert 0.0 < made.convergence.truth_sum.maximum < 1.0


def test_an_environment_is_refused_with_a_sentence():
    sky = {"type": "environment", "map": "dome"}
    with pytest.raises(ConfigError, match="no environment light"):
        truth_picture(
            asset_of(plane_mesh(5.0, 2)), pipeline_of(sky), D_EON_SKIN, ortho(2, 1.0), QUICK
        )


@pytest.mark.parametrize("tilt_deg", [0.0, 45.0, 70.0])
def test_gather_of_a_half_lit_tilted_plane(tilt_deg):
    """All pixels in reach, by the area that they show, are the surface integral at any tilt."""
    size, camera = 160, perspective(160, 0.06, 200.0)
    row, column = np.mgrid[:size, :size] + 0.5
    way = np.stack(
        [(2 * column / size - 1) * 0.06, (1 - 2 * row / size) * 0.06, -np.ones_like(row)], axis=-1
    )
    normal = np.array([0.0, np.sin(np.deg2rad(tilt_deg)), np.cos(np.deg2rad(tilt_deg))])
    distance = (normal @ [0.0, 0.0, -200.0]) / (way @ normal)
    position = way * distance[..., None]
    area = pixel_areas(position, np.broadcast_to(normal, position.shape), camera)
    x = position[..., 0]
    # What a pixel on the edge shows is half lit.
    width = 2 * 0.06 * -position[..., 2] / size
    light = np.clip(0.5 + x / width, 0.0, 1.0)[..., None] * np.ones(3)
    wide = type(D_EON_SKIN)((1.2,), ((1.0, 1.0, 1.0),))
    total, mean = gather(position, light, np.ones((size, size)), area, wide)
    inside = np.s_[60:100, 60:100]
    expected = wide.line_cdf(x)
    np.testing.assert_allclose(mean[inside], expected[inside], atol=4e-3)
    np.testing.assert_allclose(total[inside], expected[inside], atol=4e-3)


def test_gather_of_a_profile_below_a_pixel_is_the_pixel():
    camera = ortho(8, 4.0)
    x, y = np.meshgrid(np.arange(8) - 3.5, 3.5 - np.arange(8))
    position = np.stack([x, y, np.full_like(x, -100.0)], axis=-1)
    area = pixel_areas(position, np.broadcast_to([0.0, 0, 1.0], position.shape), camera)
    np.testing.assert_allclose(area, 1.0)
    light = np.random.default_rng(3).random((8, 8, 3))
    narrow = type(D_EON_SKIN)((1e-4,), ((1.0, 1.0, 1.0),))
    total, mean = gather(position, light, np.ones((8, 8)), area, narrow)
    np.testing.assert_allclose(total, light, atol=1e-9)
    np.testing.assert_allclose(mean, light, atol=1e-9)


@pytest.mark.parametrize("sigma_px", [0.05, 0.3, 0.5, 0.8, 2.0])
def test_gather_loses_nothing_however_narrow_the_profile(sigma_px):
    camera = ortho(32, 16.0)
    x, y = np.meshgrid(np.arange(32) - 15.5, 15.5 - np.arange(32))
    position = np.stack([x, y, np.full_like(x, -100.0)], axis=-1)
    area = pixel_areas(position, np.broadcast_to([0.0, 0, 1.0], position.shape), camera)
    profile = type(D_EON_SKIN)((sigma_px**2,), ((1.0, 1.0, 1.0),))
    ones = np.ones((32, 32))
    total, _ = gather(position, np.ones((32, 32, 3)), ones, area, profile, tail=1e-9)
    np.testing.assert_allclose(total[15:17, 15:17], 1.0, atol=1e-6)


@pytest.mark.gl
@pytest.mark.parametrize(
    "light",
    [
        {"type": "directional", "azimuth_deg": 40, "elevation_deg": 20, "follows": "camera"},
        {"type": "point", "azimuth_deg": -50, "elevation_deg": 10, "distance_mm": 90},
        {
            "type": "spot",
            "azimuth_deg": 30,
            "elevation_deg": 35,
            "distance_mm": 120,
            "cone_deg": 30,
            "follows": "subject",
        },
    ],
)
def test_unscattered_light_is_the_renderers(gl, light):
    """The same picture by rays and in float64 as the device draws without diffusion."""
    asset = asset_of(squashed(sphere_mesh(30.0, 5)), albedo=(0.5, 0.4, 0.3))
    pipeline = Pipeline.model_validate(
        {
            "lights": [light, {"type": "ambient", "irradiance": 0.1}],
            "skin": {"transmission": {"method": "none"}},
            "diffusion": {"method": "none"},
            "camera": {"width_px": 48, "height_px": 40, "azimuth_deg": 25, "elevation_deg": 15},
            "turntable": {"frames": 4},
            "quality": {"supersampling": 1},
        }
    )
    renderer = Renderer(gl, asset, pipeline)
    view = renderer.view(1)
    frame = renderer.render(view, ("diffuse", "position"))
    shot = renderer.scene.shot(renderer.camera.turned(view.camera_deg), view.subject_deg)
    camera = PictureCamera(
        shot.view_from_world,
        shot.world_from_object,
        shot.clip_from_view,
        shot.size,
        sample_offsets_px(1),
    )
    made = truth_picture(asset, pipeline, D_EON_SKIN, camera, QUICK, convergence_spots=0)
    assert float(np.abs(made.coverage - frame.alpha).mean()) < 0.005
    inside = (made.coverage == 1.0) & (frame.alpha == 1.0)
    # The same points again from the device's own G-buffer.
    position = frame.buffers["position"][inside].astype(float)
    again = points_of_positions(Surface(asset.mesh), camera, position)
    turn = camera.view_from_object
    found = Surface(asset.mesh).positions_at(again.face, again.bary) @ turn[:3, :3].T + turn[:3, 3]
    assert len(again) >= 0.99 * len(position)
    away = np.linalg.norm(found - position[again.pixel], axis=1)
    assert float(np.quantile(away, 0.99)) < 2e-3
    difference = np.abs(made.unscattered - frame.buffers["diffuse"])[inside]
    assert float(made.unscattered.max()) > 0.2
    assert float(difference.mean()) < 1e-3
    assert float(np.quantile(difference, 0.99)) < 0.02
