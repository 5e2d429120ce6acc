"""Mean curvature against closed forms, on irregular triangulations, at all scales, with noise."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import ConvexHull, Delaunay

from scanrender.scan.curvature import curvature_scale, mean_curvature, noise_level
from scanrender.scan.topology import vertex_normals


def irregular_sphere(radius, edge, rng):
    """Points spread by the golden angle and then shaken, triangulated by their hull."""
    count = int(4.0 * np.pi * radius**2 / (edge**2 * 0.866))
    step = np.arange(count) + 0.5
    polar, around = np.arccos(1.0 - 2.0 * step / count), np.pi * (1.0 + 5.0**0.5) * step
    way = np.stack(
        [np.cos(around) * np.sin(polar), np.sin(around) * np.sin(polar), np.cos(polar)], axis=1
    )
    way += rng.normal(0.0, 0.2 * edge / radius, way.shape)
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    faces = ConvexHull(way).simplices.astype(np.int64)
    a, b, c = (way[faces[:, i]] for i in range(3))
    inward = np.einsum("ij,ij->i", np.cross(b - a, c - a), a) < 0.0
    faces[inward] = faces[inward][:, ::-1]
    return radius * way, faces


def irregular_sheet(half_x, half_y, edge, rng):
    """Parameters (n, 2) and counter-clockwise faces of a shaken grid."""
    columns, rows = int(2.0 * half_x / edge) + 1, int(2.0 * half_y / (0.866 * edge)) + 1
    x, y = np.meshgrid(np.linspace(-half_x, half_x, columns), np.linspace(-half_y, half_y, rows))
    x = x + 0.5 * edge * (np.arange(rows) % 2)[:, None]
    points = np.stack([x, y], axis=-1).reshape(-1, 2)
    points += rng.uniform(-0.3, 0.3, points.shape) * edge
    faces = Delaunay(points).simplices.astype(np.int64)
    u, v = points[faces[:, 1]] - points[faces[:, 0]], points[faces[:, 2]] - points[faces[:, 0]]
    clockwise = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0] < 0.0
    faces[clockwise] = faces[clockwise][:, ::-1]
    return points, faces


def cylinder(radius, edge, rng):
    q, faces = irregular_sheet(1.2 * radius, 2.0 * radius, edge, rng)
    angle = q[:, 0] / radius
    positions = np.stack([radius * np.sin(angle), q[:, 1], radius * np.cos(angle)], axis=1)
    inner = (np.abs(q[:, 0]) < 0.6 * radius) & (np.abs(q[:, 1]) < radius)
    return positions, faces, np.full(len(q), 0.5 / radius), inner


def saddle(radius, edge, rng):
    """z = (x^2 - y^2) / 2R, whose principal curvatures at the middle are +-1/R."""
    q, faces = irregular_sheet(radius, radius, edge, rng)
    x, y = q.T
    positions = np.stack([x, y, (x * x - y * y) / (2.0 * radius)], axis=1)
    p, r = x / radius, -y / radius
    mean = ((1.0 + r * r) - (1.0 + p * p)) / (2.0 * radius * (1.0 + p * p + r * r) ** 1.5)
    return positions, faces, -mean, np.abs(q).max(axis=1) < 0.5 * radius


def torus(radius, edge, rng):
    """Tube of `radius` about a circle of 2.5 times that."""
    big = 2.5 * radius
    q, faces = irregular_sheet(0.8 * np.pi * big, 0.95 * np.pi * radius, edge, rng)
    a, b = q[:, 0] / big, q[:, 1] / radius
    reach = big + radius * np.cos(b)
    positions = np.stack([reach * np.cos(a), reach * np.sin(a), radius * np.sin(b)], axis=1)
    mean = 0.5 * (1.0 / radius + np.cos(b) / reach)
    return positions, faces, mean, (np.abs(a) < 2.0) & (np.abs(b) < 2.0)


def rms_share(positions, faces, expected, inner, largest):
    """RMS error over `inner`, as a share of the largest principal curvature."""
    scale = curvature_scale(positions, faces, 0.0)
    error = (mean_curvature(positions, faces, scale) - expected)[inner]
    assert inner.sum() > 50
    return float(np.sqrt(np.mean(error**2))) / largest


@pytest.mark.parametrize("fineness", [10, 25])
@pytest.mark.parametrize("radius", [5.0, 20.0, 100.0])
def test_spheres(radius, fineness):
    positions, faces = irregular_sphere(radius, radius / fineness, np.random.default_rng(0))
    everywhere = np.ones(len(positions), bool)
    assert rms_share(positions, faces, 1.0 / radius, everywhere, 1.0 / radius) < 0.02


@pytest.mark.parametrize("fineness", [10, 25])
@pytest.mark.parametrize("radius", [5.0, 100.0])
@pytest.mark.parametrize("shape", [cylinder, saddle, torus])
def test_cylinder_saddle_and_torus(shape, radius, fineness):
    made = shape(radius, radius / fineness, np.random.default_rng(1))
    assert rms_share(*made, 1.0 / radius) < 0.02


@pytest.mark.parametrize("factor", [0.1, 0.001], ids=["cm", "m"])
def test_other_units_give_the_same_curvature_in_their_own(factor):
    positions, faces, expected, inner = torus(20.0, 2.0, np.random.default_rng(2))
    scale = curvature_scale(positions, faces, 0.0)
    in_mm = mean_curvature(positions, faces, scale)
    other = mean_curvature(factor * positions, faces, factor * scale)
    np.testing.assert_allclose(other * factor, in_mm, rtol=1e-3, atol=1e-5)
    assert np.abs(in_mm - expected)[inner].max() < 0.1 / 20.0


@pytest.mark.parametrize("radius", [20.0, 100.0])
def test_scanner_noise_of_a_tenth_of_a_millimetre(radius):
    rng = np.random.default_rng(3)
    positions, faces = irregular_sphere(radius, 1.0, rng) if radius < 50 else cap(radius, 1.0, rng)
    noisy = positions + rng.normal(0.0, 0.1, (len(positions), 1)) * vertex_normals(positions, faces)
    assert noise_level(noisy, faces) == pytest.approx(0.1, rel=0.3)
    inner = np.abs(positions[:, :2]).max(axis=1) < 0.3 * radius
    assert rms_share(noisy, faces, 1.0 / radius, inner, 1.0 / radius) < 0.1
    untreated = mean_curvature(noisy, faces, 1.0)
    assert np.std(untreated[inner]) * radius > 0.1, "otherwise the noise was no test"


def cap(radius, edge, rng):
    """The top of a sphere: the whole one has 145 000 vertices."""
    q, faces = irregular_sheet(0.45 * radius, 0.45 * radius, edge, rng)
    height = np.sqrt(radius**2 - (q**2).sum(axis=1))
    return np.concatenate([q, height[:, None]], axis=1), faces


def test_the_scale_grows_with_noise_and_coarseness_only():
    rng = np.random.default_rng(4)
    fine, fine_faces = irregular_sphere(20.0, 0.8, rng)
    coarse, coarse_faces = irregular_sphere(20.0, 3.0, rng)
    assert curvature_scale(fine, fine_faces, 2.5) == 2.5
    assert curvature_scale(coarse, coarse_faces, 2.5) == pytest.approx(6.0, rel=0.1)
    noisy = fine * (1.0 + rng.normal(0.0, 0.1 / 20.0, (len(fine), 1)))
    assert curvature_scale(noisy, fine_faces, 2.5) > 3.0
