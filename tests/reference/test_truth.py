"""The surface integrals against planes, slabs and spheres whose answer is known."""

from __future__ import annotations

import math

import numpy as np
import pytest
from shapes import (
    both,
    plane_mesh,
    points_near,
    sheet_mesh,
    sphere_mesh,
    turned_over,
    white,
)

from scanrender.optics.profiles import D_EON_SKIN
from scanrender.reference.analytic import (
    half_lit_plane,
    slab_transmittance,
    sphere_furnace,
    sphere_terminator,
)
from scanrender.reference.surface import Surface
from scanrender.reference.truth import TruthQuality, integrals

FINE = TruthQuality(tail=1e-8, cells_per_sigma=8.0)


def bumps(x, y):
    return 1.5 * np.sin(1.1 * x) * np.cos(0.9 * y + 0.3)


def test_mean_of_even_light_is_that_light_on_any_surface():
    surface = Surface(sheet_mesh(15.0, 60, bumps))
    points = points_near(surface, [[0, 0, 0], [1.4, 0.2, 1.5], [-3.0, 2.0, 0]])
    found = integrals(surface, white, points, D_EON_SKIN, TruthQuality())
    np.testing.assert_allclose(found.mean, 1.0, atol=1e-6)
    assert float(np.abs(found.total - 1.0).max()) > 1e-2, "bumps hold more or less skin"


def test_sum_of_even_light_on_a_plane():
    surface = Surface(plane_mesh(22.0, 30))
    points = points_near(surface, [[0, 0, 0], [1.3, 0.4, 0], [-2.0, 3.1, 0]])
    found = integrals(surface, white, points, D_EON_SKIN, FINE)
    np.testing.assert_allclose(found.total, 1.0, atol=1e-6)


@pytest.mark.parametrize(
    ("radius_mm", "spacing_mm"), [(1.0, 0.05), (2.0, 0.1), (10.0, 0.25), (50.0, 0.25)]
)
def test_sum_of_even_light_on_spheres(radius_mm, spacing_mm):
    surface = Surface(sphere_mesh(radius_mm))
    points = points_near(surface, radius_mm * np.array([[0, 0, 1.0], [0.6, 0.8, 0], [-1.0, 0, 0]]))
    found = integrals(surface, white, points, D_EON_SKIN, TruthQuality(spacing_mm=spacing_mm))
    expected = sphere_furnace(radius_mm, D_EON_SKIN)
    np.testing.assert_allclose(found.total, np.tile(expected, (3, 1)), atol=1e-3)


def test_half_lit_plane():
    surface = Surface(plane_mesh(16.0, 32))

    def half(face, bary):
        lit = (surface.positions_at(face, bary)[:, :1] > 0.0) * np.ones((1, 3))
        return lit, np.ones(len(face))

    points = points_near(surface, [[x, 0.2, 0.0] for x in (-0.3, 0.3, 2.7)])
    # Shifted within their faces, closer to the edge than the narrowest Gaussian is wide.
    bary = np.array([[0.04, 0.48, 0.48], [0.9, 0.04, 0.06], [0.5, 0.3, 0.2]])
    points = type(points)(points.face, bary, points.is_inside, points.pixel)
    quality = TruthQuality(spacing_mm=0.014, cells_per_sigma=12.0, tail=1e-7)
    assert all(quality.is_sampled(v) for v in D_EON_SKIN.variances_mm2)
    found = integrals(surface, half, points, D_EON_SKIN, quality)
    x = surface.positions_at(points.face, points.bary)[:, 0]
    assert float(np.abs(x).min()) < 0.08
    np.testing.assert_allclose(found.total, half_lit_plane(x, D_EON_SKIN), atol=1e-4)
    np.testing.assert_allclose(found.mean, found.total, atol=1e-4)


@pytest.mark.parametrize("radius_mm", [2.0, 10.0, 50.0])
def test_terminator_on_spheres(radius_mm):
    surface = Surface(sphere_mesh(radius_mm))
    theta = np.deg2rad([60.0, 85.0, 90.0, 95.0, 110.0])
    wanted = radius_mm * np.stack([np.sin(theta), 0.02 * theta, np.cos(theta)], axis=1)
    points = points_near(surface, wanted)

    def lit(face, bary):
        position = surface.positions_at(face, bary)
        cosine = position[:, 2] / np.linalg.norm(position, axis=1)
        return np.maximum(cosine, 0.0)[:, None] * np.ones(3), np.ones(len(face))

    quality = TruthQuality(spacing_mm=0.1, disc_nodes=64)
    found = integrals(surface, lit, points, D_EON_SKIN, quality)
    position = surface.positions_at(points.face, points.bary)
    angle = np.arccos(position[:, 2] / np.linalg.norm(position, axis=1))
    expected = sphere_terminator(angle, radius_mm, D_EON_SKIN)
    np.testing.assert_allclose(found.total, expected, atol=1e-3)
    normalized = sphere_terminator(angle, radius_mm, D_EON_SKIN, normalized=True)
    np.testing.assert_allclose(found.mean, normalized, atol=1e-3)


@pytest.mark.parametrize("thickness_mm", [0.6, 1.0, 3.0])
def test_slab_lit_from_behind(thickness_mm):
    front = plane_mesh(14.0, 14)
    back = turned_over(plane_mesh(14.0, 14, -thickness_mm))
    surface = Surface(both(front, back))
    points = points_near(surface, [[0.1, 0.3, 0.0]])

    def behind(face, bary):
        lit = (face >= len(front.faces)).astype(float)
        return lit[:, None] * np.ones(3), np.ones(len(face))

    found = integrals(surface, behind, points, D_EON_SKIN, TruthQuality(spacing_mm=0.07))
    expected = slab_transmittance(thickness_mm, D_EON_SKIN)
    np.testing.assert_allclose(found.total[0], expected, atol=1e-3)
    assert float(found.mean.max()) == 0.0, "the lit side is no part of the sheet"


@pytest.mark.parametrize(("nodes", "tolerance"), [(16, 2e-3), (64, 4e-4)])
def test_narrow_gaussians_need_no_samples_of_their_own(nodes, tolerance):
    """Discs around points give what samples of the whole surface give, E bending within reach."""
    surface = Surface(sheet_mesh(4.0, 80, lambda x, y: 0.3 * np.sin(x) * np.cos(y)))
    points = points_near(surface, [[0, 0, 0], [0.7, 0.9, 0.1], [-1.0, 0.4, 0]])

    def wavy(face, bary):
        x, y, _ = surface.positions_at(face, bary).T
        return (1.0 + 0.5 * np.sin(3.0 * x + y))[:, None] * np.ones(3), np.ones(len(face))

    narrow = type(D_EON_SKIN)((0.0484,), ((1.0, 1.0, 1.0),))
    coarse = TruthQuality(spacing_mm=0.25, disc_nodes=nodes)
    fine = TruthQuality(spacing_mm=0.03, tail=1e-7)
    assert fine.is_sampled(0.0484)
    assert not coarse.is_sampled(0.0484)
    by_disc = integrals(surface, wavy, points, narrow, coarse)
    by_samples = integrals(surface, wavy, points, narrow, fine)
    np.testing.assert_allclose(by_disc.total, by_samples.total, atol=tolerance)
    assert math.isclose(float(by_disc.mass.mean()), float(by_samples.mass.mean()), abs_tol=1e-3)
