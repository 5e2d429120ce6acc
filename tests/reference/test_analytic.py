"""Analytic truth against independent surface integrals and exact identities."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.special import erf

from scanrender.errors import ConfigError
from scanrender.optics.profiles import D_EON_SKIN, Burley, GaussianSum
from scanrender.reference.analytic import (
    half_lit_plane,
    half_lit_plane_seen,
    mean_irradiance_on_circle,
    slab_transmittance,
    sphere_furnace,
    sphere_terminator,
)

BURLEY = Burley((0.757, 0.322, 0.2))
PROFILES = pytest.mark.parametrize("profile", [D_EON_SKIN, BURLEY], ids=["gaussians", "burley"])
V = np.array(D_EON_SKIN.variances_mm2)[:, None]
W = np.array(D_EON_SKIN.weights)


def test_half_lit_plane_is_a_sum_of_erf():
    for x in (-5.0, -0.3, 0.0, 0.01, 1.0, 9.0):
        expected = np.sum(0.5 * W * (1.0 + erf(x / np.sqrt(2.0 * V))), axis=0)
        np.testing.assert_allclose(half_lit_plane(x, D_EON_SKIN), expected, atol=1e-15)


@PROFILES
def test_half_lit_plane_by_polar_integration(profile):
    # on the ring of radius r around a point x inside the lit half, 1 - arccos(x/r)/pi is lit
    x = 0.4
    r = np.linspace(0.0, 60.0, 2_000_001)
    r = 0.5 * (r[1:] + r[:-1])
    lit = 1.0 - np.arccos(np.clip(x / r, -1.0, 1.0)) / math.pi
    expected = 3e-5 * (lit @ profile.radial_pdf(r))
    np.testing.assert_allclose(half_lit_plane(x, profile), expected, atol=1e-7)


@PROFILES
def test_slab_quadrature_meets_the_closed_form(profile):
    d = np.array([[0.0, 0.1, 0.25], [1.0, 3.0, 8.0]])
    got = slab_transmittance(d, profile)
    assert got.shape == (2, 3, 3)
    np.testing.assert_allclose(got, profile.transmittance(d), atol=1e-11)
    np.testing.assert_array_equal(slab_transmittance(-1.0, profile), slab_transmittance(0, profile))


def test_slab_truth_in_red_at_1_mm():
    assert slab_transmittance(1.0, D_EON_SKIN)[0] == pytest.approx(0.406, abs=5e-4)


def test_sphere_furnace():
    radius = np.array([0.2, 2.0, 50.0])
    expected = 1.0 - np.exp(-2.0 * radius[:, None, None] ** 2 / V)
    expected = np.sum(W * expected, axis=1)
    np.testing.assert_allclose(sphere_furnace(radius, D_EON_SKIN), expected, atol=1e-13)
    # a 2 mm sphere keeps .97 of red
    assert sphere_furnace(2.0, D_EON_SKIN)[0] == pytest.approx(0.97, abs=5e-3)


def surface_integral_on_sphere(theta: float, rho: float, profile) -> np.ndarray:
    """Sum R(chord) max(0, N.L) over the sphere in polar angles around the point: 2-D, plain."""
    node, weight = np.polynomial.legendre.leggauss(600)
    # crowd the nodes at the point, where R is steep
    t, w_t = 0.5 * (node + 1.0), 0.5 * weight
    alpha, w_alpha = math.pi * t**3, 3.0 * math.pi * t**2 * w_t
    phi = (np.arange(2000) + 0.5) * (2.0 * math.pi / 2000)
    n_dot_l = math.sin(theta) * np.sin(alpha)[:, None] * np.cos(phi)
    n_dot_l += math.cos(theta) * np.cos(alpha)[:, None]
    around = np.maximum(n_dot_l, 0.0).sum(axis=1) * (2.0 * math.pi / 2000)
    area = rho**2 * np.sin(alpha) * w_alpha
    return (area * around) @ profile.R(2.0 * rho * np.sin(0.5 * alpha))


@PROFILES
@pytest.mark.parametrize("rho", [2.0, 10.0])
@pytest.mark.parametrize("theta_deg", [0.0, 60.0, 88.0, 93.0, 150.0])
def test_terminator_is_the_surface_integral(profile, rho, theta_deg):
    theta = math.radians(theta_deg)
    np.testing.assert_allclose(
        sphere_terminator(theta, rho, profile),
        surface_integral_on_sphere(theta, rho, profile),
        atol=3e-6,
    )


@pytest.mark.parametrize("rho", [0.05, 0.5, 2.0, 10.0, 100.0, 1e4])
def test_opposite_points_differ_by_the_cosine_transform(rho):
    # max(0, c) - max(0, -c) = c, a spherical harmonic: M(theta) - M(pi - theta) is
    # cos(theta) * integral of 2 pi r R (1 - r^2 / 2 rho^2), elementary for Gaussians
    theta = np.linspace(0.0, math.pi, 13)
    edge = np.exp(-2.0 * rho**2 / V)
    second_moment = 2.0 * V - (4.0 * rho**2 + 2.0 * V) * edge
    gain = np.sum(W * (1.0 - edge - second_moment / (2.0 * rho**2)), axis=0)
    got = sphere_terminator(theta, rho, D_EON_SKIN)
    got = got - sphere_terminator(math.pi - theta, rho, D_EON_SKIN)
    np.testing.assert_allclose(got, np.cos(theta)[:, None] * gain, atol=1e-6)


@PROFILES
def test_a_huge_sphere_is_locally_a_plane(profile):
    theta = np.array([0.0, 0.5, 1.2, 2.0, math.pi])
    expected = np.maximum(np.cos(theta), 0.0)[:, None] * np.ones(3)
    np.testing.assert_allclose(sphere_terminator(theta, 1e5, profile), expected, atol=1e-7)


def test_light_wraps_further_in_red_and_on_small_spheres():
    behind = math.radians(95.0)
    at_2, at_20 = (sphere_terminator(behind, rho, D_EON_SKIN) for rho in (2.0, 20.0))
    assert at_20[0] > at_20[1] > at_20[2]
    assert np.all(at_2 > at_20)


def test_normalized_divides_by_the_furnace():
    theta = np.array([0.2, 1.5])
    plain = sphere_terminator(theta, 1.0, D_EON_SKIN)
    mean = sphere_terminator(theta, 1.0, D_EON_SKIN, normalized=True)
    np.testing.assert_allclose(mean * sphere_furnace(1.0, D_EON_SKIN), plain, rtol=1e-14)
    assert np.all(mean > plain)


@pytest.mark.parametrize("theta", [0.0, 0.7, math.pi / 2, 2.5, math.pi])
def test_circle_mean_in_closed_form(theta):
    alpha = np.array([0.0, 0.3, math.pi / 2, 2.0, math.pi])
    phi = (np.arange(200_000) + 0.5) * (2.0 * math.pi / 200_000)
    cosine = math.sin(theta) * np.sin(alpha)[:, None] * np.cos(phi)
    cosine += math.cos(theta) * np.cos(alpha)[:, None]
    np.testing.assert_allclose(
        mean_irradiance_on_circle(theta, alpha), np.maximum(cosine, 0.0).mean(axis=1), atol=1e-9
    )


def test_a_profile_with_one_narrow_and_one_wide_lobe_is_still_resolved():
    profile = GaussianSum((1e-6, 25.0), ((0.002,) * 3, (0.998,) * 3))
    got = slab_transmittance(2e-3, profile)
    np.testing.assert_allclose(got, profile.transmittance(2e-3), atol=1e-9)


@pytest.mark.parametrize(
    "call",
    [
        lambda: sphere_furnace(0.0, D_EON_SKIN),
        lambda: sphere_furnace([1.0, math.nan], D_EON_SKIN),
        lambda: sphere_terminator(1.0, 0.0, D_EON_SKIN),
        lambda: sphere_terminator(1.0, math.inf, D_EON_SKIN),
        lambda: sphere_terminator(-0.1, 1.0, D_EON_SKIN),
        lambda: sphere_terminator([0.1, math.nan], 1.0, D_EON_SKIN),
    ],
)
def test_impossible_cases_are_refused(call):
    with pytest.raises(ConfigError):
        call()


@pytest.mark.parametrize("footprint_mm", [0.01, 0.3, 2.0, 8.0])
def test_what_a_pixel_sees_of_the_edge_is_the_mean_over_it(footprint_mm):
    x = np.array([-1.0, -0.1, 0.0, 0.4])
    offsets = (np.arange(20000) + 0.5) / 20000 - 0.5
    fine = half_lit_plane(x[:, None] + footprint_mm * offsets, D_EON_SKIN).mean(axis=1)
    found = half_lit_plane_seen(x, footprint_mm, D_EON_SKIN)
    np.testing.assert_allclose(found, fine, atol=1e-7)


def test_a_footprint_must_be_positive():
    with pytest.raises(ConfigError):
        half_lit_plane_seen(0.0, 0.0, D_EON_SKIN)
