"""Kernel taps: exact sums, exact variance, exact cells, and good disks."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.stats import norm

from scanrender.errors import ConfigError
from scanrender.optics.kernels import (
    disk_samples,
    gaussian_taps,
    separable_artistic,
    separable_preintegrated,
    tap_positions,
)
from scanrender.optics.profiles import D_EON_SKIN, Burley

BURLEY = Burley((0.757, 0.322, 0.2))
EPS = np.finfo(float).eps


@given(st.integers(2, 1023), st.floats(0.5, 8.0))
@example(1023, 8.0)
@example(2, 0.5)
@settings(max_examples=80, deadline=None)
def test_gaussian_taps_are_a_unit_gaussian(samples, extent):
    taps = gaussian_taps(samples, extent)
    x, w = taps.offsets_sigma, taps.weights
    assert x.shape == w.shape == (samples,)
    assert abs(math.fsum(w) - 1.0) <= 4 * EPS
    assert abs(math.fsum(w * x * x) - 1.0) <= 8 * EPS
    np.testing.assert_array_equal(x, -x[::-1])
    np.testing.assert_array_equal(w, w[::-1])
    assert np.all(np.diff(x) > 0.0)
    assert np.all(w > 0.0)


@pytest.mark.parametrize("samples", [2, 3, 6, 7, 25])
def test_gaussian_weights_are_cell_integrals(samples):
    edges = np.linspace(-3.0, 3.0, samples + 1)
    edges[0], edges[-1] = -np.inf, np.inf
    np.testing.assert_allclose(
        gaussian_taps(samples).weights, np.diff(norm.cdf(edges)), rtol=1e-13, atol=1e-16
    )


def test_one_and_two_taps():
    one, two = gaussian_taps(1), gaussian_taps(2)
    assert (one.offsets_sigma.tolist(), one.weights.tolist()) == ([0.0], [1.0])
    np.testing.assert_allclose(two.offsets_sigma, [-1.0, 1.0], atol=1e-15)
    np.testing.assert_array_equal(two.weights, [0.5, 0.5])


def test_a_blur_of_blurs_has_the_summed_variance():
    # the reason for the rescaling: six passes of increments reach the table's last variance
    increments = D_EON_SKIN.increments_mm2()
    taps = gaussian_taps(7)
    variance = sum(v * float(taps.weights @ taps.offsets_sigma**2) for v in increments)
    assert variance == pytest.approx(7.41, rel=1e-13)


def test_taps_cannot_be_edited_by_accident():
    with pytest.raises(ValueError, match="read-only"):
        gaussian_taps(5).weights[0] = 1.0


PROFILES = pytest.mark.parametrize("profile", [D_EON_SKIN, BURLEY], ids=["gaussians", "burley"])


@PROFILES
@pytest.mark.parametrize("samples", [1, 2, 7, 8, 25, 1023])
@pytest.mark.parametrize("extent", [0.01, 3.0, 200.0])
@pytest.mark.parametrize("spacing", ["quadratic", "uniform"])
def test_preintegrated_sums_to_one(profile, samples, extent, spacing):
    taps = separable_preintegrated(profile, samples, extent, spacing)
    assert taps.offsets_mm.shape == (samples,)
    assert taps.weights.shape == (samples, 3)
    np.testing.assert_allclose(taps.weights.sum(axis=0), 1.0, atol=1e-13)
    np.testing.assert_array_equal(taps.weights, taps.weights[::-1])
    np.testing.assert_array_equal(taps.offsets_mm, -taps.offsets_mm[::-1])
    assert np.all(taps.weights >= 0.0)
    if samples > 1:
        assert taps.offsets_mm[-1] == extent
    if samples % 2:
        assert taps.offsets_mm[samples // 2] == 0.0


@PROFILES
def test_preintegrated_weights_are_integrals_of_the_marginal(profile):
    taps = separable_preintegrated(profile, 9, 4.0)
    _, edges = tap_positions(9, 4.0, "quadratic")
    # between the second and third edge the marginal is smooth: integrate it directly
    node, weight = np.polynomial.legendre.leggauss(60)
    low, high = edges[5], edges[6]
    x = 0.5 * (low + high) + 0.5 * (high - low) * node
    expected = 0.5 * (high - low) * weight @ profile.line_marginal(x)
    np.testing.assert_allclose(taps.weights[6], expected, rtol=1e-9)


def test_sampling_the_marginal_would_be_far_off():
    # the finding that made us integrate: 1.69 / 2.22 / 2.60 before normalising, at 7 taps
    offsets, edges = tap_positions(7, 6.0, "quadratic")
    cells = np.diff(np.concatenate(([offsets[0]], edges, [offsets[-1]])))
    sampled = cells @ D_EON_SKIN.line_marginal(offsets)
    np.testing.assert_allclose(sampled, [1.69, 2.22, 2.60], atol=0.02)
    exact = separable_preintegrated(D_EON_SKIN, 7, 6.0).weights.sum(axis=0)
    np.testing.assert_allclose(exact, 1.0, atol=1e-14)


def test_the_rim_receives_what_a_cut_would_lose():
    rim = 2.0 * separable_preintegrated(D_EON_SKIN, 25, 3.0).weights[-1]
    cut = 2.0 * (1.0 - D_EON_SKIN.line_cdf(3.0))
    assert np.all(rim >= cut)
    assert rim[0] > 0.03


def test_quadratic_spacing_is_dense_in_the_middle():
    np.testing.assert_allclose(tap_positions(5, 4.0, "quadratic")[0], [-4, -1, 0, 1, 4])
    np.testing.assert_allclose(tap_positions(5, 4.0, "uniform")[0], [-4, -2, 0, 2, 4])


@given(
    st.tuples(*[st.floats(0.01, 5.0)] * 3),
    st.tuples(*[st.floats(0.01, 5.0)] * 3),
    st.tuples(*[st.floats(0.0, 1.0)] * 3),
    st.integers(2, 101),
)
@settings(max_examples=50, deadline=None)
def test_artistic_is_a_mixture_of_gaussian_cells(near, far, strength, samples):
    taps = separable_artistic(near, far, strength, samples, 6.0)
    edges = np.concatenate(([-np.inf], tap_positions(samples, 6.0, "quadratic")[1], [np.inf]))
    for channel in range(3):
        cells = [np.diff(norm.cdf(edges / sigma[channel])) for sigma in (near, far)]
        expected = strength[channel] * cells[0] + (1.0 - strength[channel]) * cells[1]
        np.testing.assert_allclose(taps.weights[:, channel], expected, atol=1e-14)


@PROFILES
@pytest.mark.parametrize("inner_mm", [0.0, 0.3])
def test_disk_estimates_integrals_of_the_profile(profile, inner_mm):
    disk = disk_samples(profile, 4096, inner_mm)
    assert disk.channel == 0
    assert np.all(np.diff(disk.radius_mm) > 0.0)
    assert disk.radius_mm[0] > inner_mm
    # weights of every channel, not just the one drawn, sum to what lies outside
    weights = profile.radial_pdf(disk.radius_mm) / disk.pdf_per_mm[:, None]
    np.testing.assert_allclose(weights.mean(axis=0), 1.0 - profile.cdf(inner_mm), atol=2e-3)
    x = disk.radius_mm * np.cos(disk.angle_rad)
    y = disk.radius_mm * np.sin(disk.angle_rad)
    spread = float(np.mean(weights[:, 1] * (x * x + y * y)))
    for odd_moment in (x, y, x * y, x * x - y * y):
        assert abs(float(np.mean(weights[:, 1] * odd_moment))) < 0.05 * spread + 0.01


def test_disk_radii_are_quantiles():
    disk = disk_samples(BURLEY, 4)
    expected = BURLEY.radius_for([0.125, 0.375, 0.625, 0.875])[:, 0]
    np.testing.assert_allclose(disk.radius_mm, expected, rtol=1e-12)
    step = np.diff(disk.angle_rad) % (2 * math.pi)
    np.testing.assert_allclose(step, math.pi * (3 - math.sqrt(5)), atol=1e-12)


def test_the_widest_channel_is_drawn():
    assert disk_samples(Burley((0.2, 0.3, 0.7)), 2).channel == 2


@pytest.mark.parametrize(
    "call",
    [
        lambda: gaussian_taps(0),
        lambda: gaussian_taps(1024),
        lambda: gaussian_taps(5, 0.0),
        lambda: gaussian_taps(5, math.nan),
        lambda: separable_preintegrated(D_EON_SKIN, 0, 3.0),
        lambda: separable_preintegrated(D_EON_SKIN, 5, -1.0),
        lambda: separable_preintegrated(D_EON_SKIN, 5, math.inf),
        lambda: separable_preintegrated(D_EON_SKIN, 5, 1.0, "cubic"),
        lambda: separable_artistic((0, 1, 1), (1, 1, 1), (0.5,) * 3, 5, 3.0),
        lambda: separable_artistic((1, 1, 1), (1, 1, 1), (0.5, 0.5, 1.5), 5, 3.0),
        lambda: disk_samples(D_EON_SKIN, 0),
        lambda: disk_samples(D_EON_SKIN, 8, 1e3),
    ],
)
def test_bad_requests_are_refused(call):
    with pytest.raises(ConfigError):
        call()
