"""Burley's profile: published quantiles, quadrature, and what is refused."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.special import k0

from scanrender.errors import ConfigError
from scanrender.optics._math import bessel_k0_integral
from scanrender.optics.profiles import Burley, DiffusionProfile
from scanrender.optics.profiles.burley import scaling

UNIT = Burley((1.0, 1.0, 1.0))
SKIN = Burley((0.757, 0.322, 0.2))

scales = st.tuples(*[st.floats(0.01, 20.0)] * 3)


def test_is_a_diffusion_profile():
    assert isinstance(UNIT, DiffusionProfile)


@pytest.mark.parametrize(
    ("fraction", "expected"),
    [
        (0.5, 1.552),
        (0.9, 6.062),
        (0.95, 8.129),
        (0.99, 12.953),
        (0.997, 16.564),
        (0.999, 19.860),
        (0.9999, 26.768),
    ],
)
def test_quantiles(fraction, expected):
    np.testing.assert_allclose(UNIT.radius_for(fraction), expected, atol=5.1e-4)


def test_line_marginal_golden():
    expected = [0.364539, 0.135091, 0.036269]
    np.testing.assert_allclose(UNIT.line_marginal([0.2, 1.0, 3.0])[:, 0], expected, atol=6e-7)


@pytest.mark.parametrize("x_mm", [0.05, 1.0, 4.0])
def test_line_marginal_is_the_integral_of_r(x_mm):
    for channel in range(3):

        def across(y, c=channel):
            return float(SKIN.R(math.hypot(x_mm, y))[c])

        expected = 2.0 * (quad(across, 0, 1, limit=200)[0] + quad(across, 1, 80, limit=200)[0])
        assert SKIN.line_marginal(x_mm)[channel] == pytest.approx(expected, rel=1e-7)


def test_moments():
    def density(r, power):
        return float(UNIT.radial_pdf(r)[0]) * r**power

    moment = [quad(density, 0, 200, args=(power,), limit=300)[0] for power in range(3)]
    assert moment[0] == pytest.approx(1.0, abs=1e-9)
    np.testing.assert_allclose(UNIT.mean_radius_mm, 2.5)
    np.testing.assert_allclose(moment[1], 2.5, atol=1e-7)
    np.testing.assert_allclose(UNIT.rms_radius_mm, math.sqrt(14.0))
    np.testing.assert_allclose(moment[2], 14.0, atol=1e-6)


@given(scales, st.floats(0.0, 0.999999))
@settings(max_examples=100, deadline=None)
def test_radius_for_inverts_cdf(scale_mm, fraction):
    profile = Burley(scale_mm)
    radius = profile.radius_for(fraction)
    for channel in range(3):
        assert profile.cdf(radius[channel])[channel] == pytest.approx(fraction, abs=1e-13)


@given(scales, st.floats(0.0, 40.0))
@settings(max_examples=60, deadline=None)
def test_what_is_not_enclosed_passes_a_slab(scale_mm, d_mm):
    profile = Burley(scale_mm)
    np.testing.assert_allclose(profile.transmittance(d_mm), 1.0 - profile.cdf(d_mm), atol=1e-14)


@given(scales, st.floats(0.0, 60.0))
@settings(max_examples=60, deadline=None)
def test_line_cdf_is_a_symmetric_cdf(scale_mm, x_mm):
    profile = Burley(scale_mm)
    right, left = profile.line_cdf(x_mm), profile.line_cdf(-x_mm)
    np.testing.assert_allclose(right + left, 1.0, atol=1e-15)
    assert np.all(profile.line_cdf(1.1 * x_mm) >= right - 1e-12)
    assert np.all((right >= 0.5) & (right <= 1.0 + 2e-12))


@pytest.mark.parametrize("x", [1e-9, 1e-3, 0.3, 1.0, 3.0, 10.0, 30.0])
def test_k0_integral(x):
    expected = quad(k0, 0.0, x, epsabs=1e-14, epsrel=1e-12, limit=500)[0]
    assert float(bessel_k0_integral(np.array(x))) == pytest.approx(expected, rel=3e-12)


def test_k0_integral_at_its_ends():
    ends = bessel_k0_integral(np.array([0.0, 5e-324, 1e3, 1e300, np.inf]))
    np.testing.assert_allclose(ends, [0.0, 0.0, np.pi / 2, np.pi / 2, np.pi / 2], atol=1e-15)


def test_the_singularity_is_integrable():
    assert np.all(np.isinf(UNIT.R(0.0)))
    assert np.all(np.isinf(UNIT.line_marginal(0.0)))
    np.testing.assert_array_equal(UNIT.radial_pdf(0.0), 0.5)
    np.testing.assert_array_equal(UNIT.line_cdf(0.0), 0.5)
    np.testing.assert_allclose(UNIT.cdf(1e-12), 0.5e-12, rtol=1e-9)
    np.testing.assert_array_equal(UNIT.R(1e9), 0.0)


@pytest.mark.parametrize(
    ("fit", "albedo", "expected"),
    [
        ("searchlight", 0.8, 1.05),
        ("searchlight", 0.3, 1.85 - 0.3 + 7 * 0.125),
        ("searchlight", 1.0, 0.85 + 7 * 0.008),  # no cube of a negative number
        ("diffuse", 0.8, 1.1),
        ("diffuse", 0.0, 1.9 + 3.5 * 0.64),
        ("diffuse_mean_free_path", 0.33, 3.5),
        ("diffuse_mean_free_path", 0.83, 3.5 + 100 * 0.0625),
    ],
)
def test_scaling(fit, albedo, expected):
    assert float(scaling(albedo, fit)) == pytest.approx(expected, abs=1e-12)


def test_from_mean_free_path_divides_by_s():
    profile = Burley.from_mean_free_path((2.0, 1.0, 0.5), (0.8, 0.8, 0.8))
    np.testing.assert_allclose(profile.scale_mm, np.array([2.0, 1.0, 0.5]) / 1.05)


@pytest.mark.parametrize(
    "scale_mm", [(0, 1, 1), (-1, 1, 1), (math.nan, 1, 1), (1, 1), (1, 1, math.inf), "abc", 1.0]
)
def test_bad_scales_are_refused(scale_mm):
    with pytest.raises(ConfigError, match="scale_mm"):
        Burley(scale_mm)


def test_bad_albedo_fit_and_fraction_are_refused():
    with pytest.raises(ConfigError, match="albedo"):
        Burley.from_mean_free_path((1, 1, 1), (0.5, 0.5, 1.5))
    with pytest.raises(ConfigError, match="albedo"):
        scaling(-0.1)
    with pytest.raises(ConfigError, match="fit"):
        scaling(0.5, "dipole")
    with pytest.raises(ConfigError, match="fraction"):
        UNIT.radius_for(1.0)
