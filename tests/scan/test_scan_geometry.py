"""Curvature, smoothing, tangents, rasteriser, unwrapping: against closed forms and invariants."""

from __future__ import annotations

import numpy as np
import pytest
from scan_shapes import cube, grid, sphere

from scanrender.asset import Mesh
from scanrender.scan.bake_shape import THICKNESS_FALL_MM, ambient_occlusion, thickness
from scanrender.scan.bakedlight import baked_light
from scanrender.scan.curvature import integrated_curvature, mean_curvature
from scanrender.scan.diffuse import diffuse
from scanrender.scan.flatten import flatten, is_flattenable, signed_areas, tutte
from scanrender.scan.gutters import Gutters
from scanrender.scan.map_sizes import fitted_sizes
from scanrender.scan.meshlab import count_self_intersections
from scanrender.scan.project import make_projector
from scanrender.scan.rasterize import overlap_share, rasterize
from scanrender.scan.rays import Target
from scanrender.scan.tangents import (
    corner_tangents,
    from_tangent_space,
    to_tangent_space,
    vertex_tangents,
)
from scanrender.scan.topology import components, face_areas, unit, vertex_areas, vertex_normals
from scanrender.scan.unwrap import unwrap
from scanrender.scan.unwrap_box import pack_shelves, project
from scanrender.settings.prep import BakeSettings, UnwrapSettings


def inner(positions, half=10.0):
    return np.abs(positions[:, :2]).max(axis=1) < half


@pytest.mark.parametrize("radius", [5.0, 50.0])
def test_curvature_of_a_sphere_is_one_over_r(radius):
    positions, faces, _ = sphere(radius, 32, 64)
    curvature = mean_curvature(positions, faces, 0.1 * radius)
    error = np.abs(curvature * radius - 1.0)
    assert error[np.abs(positions[:, 1]) < 0.9 * radius].max() < 0.03
    assert error.max() < 0.1  # at the poles 64 slivers meet


def test_curvature_of_cylinder_plane_and_saddle():
    radius = 30.0
    positions, faces = grid(lambda x, y: np.sqrt(radius**2 - x**2), side=81)
    cylinder = mean_curvature(positions, faces, 1.0)[inner(positions)]
    np.testing.assert_allclose(cylinder, 0.5 / radius, rtol=0.03)
    valley = mean_curvature(positions * [1, 1, -1], faces, 1.0)[inner(positions)]
    np.testing.assert_allclose(valley, -0.5 / radius, rtol=0.03)
    positions, faces = grid(lambda x, y: 0.0 * x)
    assert np.abs(mean_curvature(positions, faces, 1.0)).max() < 1e-9
    positions, faces = grid(lambda x, y: (x * x - y * y) / 200.0)
    saddle = mean_curvature(positions, faces, 1.0)[inner(positions, 4.0)]
    assert np.abs(saddle).max() < 4e-4  # principal curvatures are +-0.01


def test_curvature_of_a_cube_is_steiners():
    assert integrated_curvature(*cube(2.0)).sum() == pytest.approx(3.0 * np.pi * 2.0)


def test_curvature_survives_scanner_noise_and_uneven_triangles():
    rng = np.random.default_rng(0)
    positions, faces, _ = sphere(60.0, 96, 192)
    noisy = positions * (1.0 + rng.normal(0.0, 0.03, (len(positions), 1)) / 60.0)
    curvature = mean_curvature(noisy, faces, 4.0)
    away = np.abs(positions[:, 1]) < 54.0
    assert np.abs(curvature[away] * 60.0 - 1.0).mean() < 0.15
    assert abs(curvature[away].mean() * 60.0 - 1.0) < 0.02


def test_diffusion_conserves_and_has_the_stated_width():
    positions, faces = grid(lambda x, y: 0.0 * x, side=81, half=20.0)
    middle = len(positions) // 2
    start = np.zeros(len(positions))
    start[middle] = 1.0
    density = diffuse(positions, faces, start, 2.0)
    area = vertex_areas(positions, faces)
    assert (density * area).sum() == pytest.approx(1.0, abs=2e-3)
    variance = (density * area * (positions[:, :2] ** 2).sum(axis=1)).sum() / 2.0
    assert variance == pytest.approx(4.0, rel=0.05)


def test_tangents_are_orthonormal_and_point_along_u():
    positions, faces, uv = sphere(50.0)
    normals = vertex_normals(positions, faces)
    tangents = corner_tangents(positions, faces, normals, uv)
    t, n = tangents[..., :3], normals[faces]
    assert np.abs(np.linalg.norm(t, axis=2) - 1.0).max() < 1e-9
    assert np.abs(np.einsum("mcd,mcd->mc", t, n)).max() < 1e-9
    assert (tangents[..., 3] == 1.0).all()  # seen from outside the image is not mirrored
    away = np.abs(positions[faces][..., 1]) < 40.0
    east = unit(np.cross([0.0, 1.0, 0.0], positions[faces]))
    assert np.einsum("mcd,mcd->mc", t, east)[away].min() > 0.99
    # +Y of a normal map is up in the image, toward decreasing v: here toward the north pole.
    up = tangents[..., 3:] * np.cross(n, t)
    assert up[away][:, 1].min() > 0.5


def test_a_mirrored_image_has_the_other_handedness():
    positions, faces, uv = sphere(50.0)
    mirrored = uv * [-1.0, 1.0] + [1.0, 0.0]
    tangents = corner_tangents(positions, faces, vertex_normals(positions, faces), mirrored)
    assert (tangents[..., 3] == -1.0).all()


def test_tangent_space_round_trip():
    rng = np.random.default_rng(1)
    n = unit(rng.normal(size=(200, 3)))
    t = np.concatenate([unit(np.cross(n, rng.normal(size=(200, 3)))), np.ones((200, 1))], axis=1)
    t[::2, 3] = -1.0
    n = n * rng.uniform(0.7, 1.0, (200, 1))  # interpolation shortens and skews the frame
    t[:, :3] += 0.1 * rng.normal(size=(200, 3))
    vector = unit(n + 0.3 * rng.normal(size=(200, 3)))
    back = from_tangent_space(to_tangent_space(vector, n, t), n, t)
    np.testing.assert_allclose(back, vector, atol=1e-9)


def test_rasteriser_covers_each_centre_once_and_interpolates_exactly():
    uv = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0], [0.4, 0.55]])
    faces = np.array([[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]])
    texels = rasterize(uv, faces, 64)
    assert texels.mask.all()
    at = texels.interpolate(uv[faces])
    column, row = texels.index % 64, texels.index // 64
    np.testing.assert_allclose(at, (np.stack([column, row], 1) + 0.5) / 64, atol=1e-5)
    assert overlap_share(uv, faces, 64) == 0.0
    assert overlap_share(uv, np.concatenate([faces, [[0, 1, 2]]]), 64) > 0.4


def test_a_map_without_a_covered_texel_is_empty():
    texels = rasterize(np.zeros((3, 2)), np.array([[0, 1, 2]]), 4)
    assert len(texels.index) == 0
    assert texels.scatter(np.zeros(0)).shape == (4, 4, 1)
    assert texels.scatter(np.zeros((0, 3))).shape == (4, 4, 3)


def test_gutters_take_the_nearest_value():
    image = np.zeros((8, 8, 1), np.float32)
    covered = np.zeros((8, 8), bool)
    covered[2, 2], image[2, 2], covered[6, 6], image[6, 6] = True, 3.0, True, 5.0
    filled = Gutters(covered).fill(image)
    assert filled[0, 0] == 3.0
    assert filled[7, 7] == 5.0
    assert (filled > 0).all()


def test_tutte_never_flips_and_slim_keeps_area():
    positions, faces = grid(lambda x, y: 8.0 * np.cos(x / 6.0) * np.cos(y / 9.0), side=25)
    assert is_flattenable(faces)
    assert (signed_areas(tutte(positions, faces), faces) > 0).all()
    uv = flatten(positions, faces)
    assert (signed_areas(uv, faces) > 0).all()
    closed, closed_faces, _ = sphere()
    assert not is_flattenable(closed_faces)
    ring = np.delete(faces, [300, 300 + 24 * 24], axis=0)
    assert (signed_areas(tutte(positions, ring), ring) > 0).all()
    del closed


def test_unwrap_has_no_flips_and_covers_the_map():
    positions, faces, _ = sphere(100.0, 24, 48)
    result = unwrap(positions, faces, UnwrapSettings(), 512)
    assert result.report["rung"] == "charts", result.report
    assert result.report["packer"] == "bitmap"
    assert result.report["flipped"] == 0
    assert overlap_share(result.uv, result.faces, 512) < 0.001
    np.testing.assert_array_equal(result.source[result.faces], faces)
    assert rasterize(result.uv, result.faces, 512).mask.mean() > 0.4
    again = unwrap(positions, faces, UnwrapSettings(), 512)
    np.testing.assert_array_equal(result.uv, again.uv)


def test_charts_keep_their_padding():
    positions, faces, _ = sphere(100.0, 24, 48)
    result = unwrap(positions, faces, UnwrapSettings(padding_px=8), 512)
    assert "padding_px" not in result.report, "only said where it is less than asked for"
    texels = rasterize(result.uv, result.faces, 512)
    chart = texels.scatter(result.chart[texels.face] + 1.0)[:, :, 0]
    near = np.zeros(0)
    for shift in range(1, 5):
        for axis in (0, 1):
            a, b = chart, np.roll(chart, shift, axis=axis)
            near = np.append(near, ((a > 0) & (b > 0) & (a != b))[5:-5, 5:-5].sum())
    assert near.sum() == 0


@pytest.mark.parametrize(("padding_px", "size_px"), [(64, 64), (64, 512)])
def test_padding_that_leaves_no_room_is_less_and_said(padding_px, size_px):
    """Not a search of minutes for a scale at which gaps as wide as the map fit."""
    positions, faces, _ = sphere(100.0, 10, 20)
    report = unwrap(positions, faces, UnwrapSettings(padding_px=padding_px), size_px).report
    assert report["rung"] == "charts"
    assert report["packer"] == "bitmap"
    assert report["padding_px"] == pytest.approx(0.25 * size_px / np.sqrt(report["charts"]))
    assert report["padding_px_asked"] == padding_px


@pytest.mark.parametrize("side", [64, 256])
def test_maps_are_halved_by_what_gaps_leave_of_them(side):
    """At 64 px gaps of 4 px leave a third of the atlas to the charts, not two."""
    positions, faces, _ = sphere(100.0, 24, 48)
    area = float(face_areas(positions, faces).sum())
    atlas = unwrap(positions, faces, UnwrapSettings(), side)
    used = np.abs(signed_areas(atlas.uv, atlas.faces)).sum()
    texel_mm = np.sqrt(area / used) / side
    for asked, expected in ((0.99, 2 * side), (1.1, side)):
        bake = BakeSettings(albedo_px=2 * side, texel_mm=asked * texel_mm)
        assert fitted_sizes(bake, area, UnwrapSettings().padding_px).albedo_px == expected


def test_the_box_fallback_always_works():
    positions, faces, _ = sphere(100.0)
    chart, uv = project(positions, faces)
    packed = pack_shelves(chart, uv, 0.004)
    assert packed.min() >= 0.0
    assert packed.max() <= 1.0
    flat = packed.reshape(-1, 2)
    assert (signed_areas(flat, np.arange(len(flat)).reshape(-1, 3)) >= 0).all()


def test_unwrap_falls_back_and_says_so(monkeypatch):
    from scanrender.errors import StageError
    from scanrender.scan import unwrap as module

    def broken(*arguments):
        raise StageError("the child crashed")

    monkeypatch.setattr(module, "run_task", broken)
    positions, faces, _ = sphere(100.0)
    report = unwrap(positions, faces, UnwrapSettings(), 256).report
    assert report["rung"] == "box"
    assert [text.split(":")[0] for text in report["failed_rungs"]] == ["charts", "xatlas"]


def test_occlusion_and_thickness_against_closed_forms():
    positions, faces, _ = sphere(20.0, 48, 96)
    normals = unit(positions)
    target = Target(positions, faces)
    assert ambient_occlusion(target, positions, normals, 64, 100.0).min() > 0.98
    inside = ambient_occlusion(target, positions * 0.9, -normals, 64, 100.0)
    assert inside.max() == 0.0
    # A chord at angle a to the axis is 2 r cos a long; the cone is uniform in projected angle.
    deep = thickness(target, positions, normals, 256)
    cosine = np.sqrt(1.0 - np.linspace(0.0, 0.25, 2001))
    light = np.exp(-40.0 * cosine / THICKNESS_FALL_MM).mean()
    expected = -THICKNESS_FALL_MM * np.log(light)
    np.testing.assert_allclose(deep, expected, rtol=0.02)


def test_projection_finds_the_point_above_and_not_the_other_side():
    low, low_faces, uv = sphere(50.0, 24, 48)
    high, high_faces, _ = sphere(50.3, 48, 96)
    normals = vertex_normals(low, low_faces)
    flat = np.arange(3 * len(low_faces)).reshape(-1, 3)
    corner = low[low_faces].reshape(-1, 3).astype(np.float32)
    corner_normals = normals[low_faces].reshape(-1, 3).astype(np.float32)
    coordinates = uv.reshape(-1, 2).astype(np.float32)
    tangents = vertex_tangents(corner, flat, corner_normals, coordinates)
    mesh = Mesh(corner, corner_normals, tangents, coordinates, flat.astype(np.uint32))
    projector = make_projector(mesh, Target(high, high_faces))
    samples = projector.samples(128)
    assert samples.missed < 0.01
    point = samples.texels.interpolate(corner[flat])
    found = projector.target.interpolate(samples.hits, high)
    assert np.linalg.norm(found - point, axis=1).max() < 1.2


def test_baked_light_is_measured_with_its_direction():
    rng = np.random.default_rng(0)
    normal = unit(rng.normal(size=(20_000, 3)))
    flat = np.tile([0.5, 0.3, 0.25], (20_000, 1)) * rng.normal(1.0, 0.05, (20_000, 1))
    lit = flat * (1.0 + 0.6 * normal[:, 1:2])
    skin = np.ones(20_000)
    clean = baked_light(flat, normal, skin)
    dirty = baked_light(lit, normal, skin)
    assert clean["explained"] < 0.01
    assert dirty["explained"] > 0.8
    assert dirty["direction"][1] > 0.99
    assert baked_light(flat, normal, 0.0 * skin) is None


def test_meshlab_counts_self_intersections():
    one, faces = cube()
    two = np.concatenate([one, one * 0.5 + [0.7, 0.2, 0.2]])
    both = np.concatenate([faces, faces + 8])
    count = count_self_intersections(two, both, 60.0)
    if count is None:
        pytest.skip("pymeshlab cannot be loaded here")
    assert count > 0
    assert count_self_intersections(one, faces, 60.0) == 0


@pytest.mark.parametrize("kind", [np.int64, np.int32, np.uint32])
def test_pieces_are_counted_whatever_integers_name_the_vertices(kind):
    """Two vertices' numbers make one of 64 bits: 200,000 squared is more than 32 hold."""
    number = np.arange(200_000)
    strip = np.stack([number[:-2], number[1:-1], number[2:]], axis=1)
    assert components(strip.astype(kind), len(number))[0] == 1
