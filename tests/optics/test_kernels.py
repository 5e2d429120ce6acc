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
    discrete_gaussian_taps,
    disk_taps,
    falloff_per_mm2,
    footprint_taps,
    gaussian_taps,
    separable_artistic,
    separable_preintegrated,
    tap_positions,
)
from scanrender.optics.profiles import D_EON_SKIN, Burley, GaussianSum

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


@given(
    st.floats(0.0, 4.0), st.integers(1, 16), st.floats(-0.5, 0.5), st.sampled_from([1, 4, 16, 256])
)
def test_footprint_taps_are_a_partition_of_unity(sigma, radius, shift, samples):
    taps = footprint_taps([sigma], radius, shift, samples)
    assert taps.shape == (1, 2 * radius + 1)
    assert taps.sum() == pytest.approx(1.0, abs=1e-12)
    assert taps.min() >= 0.0, "a negative tap is negative light"


def test_footprint_taps_of_no_width_are_the_identity():
    np.testing.assert_allclose(footprint_taps([0.0], 3)[0], [0, 0, 0, 1, 0, 0, 0], atol=1e-15)


@pytest.mark.parametrize("sigma", [0.05, 0.3, 0.56, 1.0, 2.5])
@pytest.mark.parametrize("samples", [1, 4])
def test_footprint_taps_blur_steps_as_pixels_see_them(sigma, samples):
    """Exact for a step between cells: the mean over the pixel of the blurred step, any sample."""
    radius, centre = 14, 40
    pixels = np.arange(81)
    shifts = (np.arange(samples) + 0.5) / samples - 0.5
    for edge in centre + 0.5 + np.arange(samples) / samples:  # where the step lies, in pixels
        seen = np.zeros(81)
        for shift in shifts:
            image = (pixels + shift > edge).astype(float)
            taps = footprint_taps([sigma], radius, shift, samples)[0]
            seen += np.convolve(image, taps[::-1], mode="same") / samples
        node, weight = np.polynomial.legendre.leggauss(40)
        at = np.arange(centre - 5, centre + 7)
        expected = norm.cdf((at[:, None] + 0.5 * node - edge) / sigma) @ weight / 2
        np.testing.assert_allclose(seen[at], expected, atol=2e-3 if sigma < 0.1 else 1e-6)


@given(st.floats(0.0, 3.0))
def test_discrete_gaussian_taps_have_the_variance_asked_for(sigma):
    taps = discrete_gaussian_taps([sigma], 20)[0]
    j = np.arange(-20, 21)
    assert taps.sum() == pytest.approx(1.0, abs=1e-12)
    assert taps @ j**2 == pytest.approx(sigma**2, abs=1e-6)
    np.testing.assert_array_equal(taps, taps[::-1])


@pytest.mark.parametrize("radius", range(1, 33))
def test_no_tap_of_a_narrow_gaussian_is_negative(radius):
    """Whatever rounding does to what lies beyond the last tap."""
    sigma = np.linspace(0.0, 4.0, 129)
    assert discrete_gaussian_taps(sigma, radius).min() >= 0.0
    for shift, samples in ((0.0, 1), (0.25, 2), (-0.375, 4)):
        assert footprint_taps(sigma, radius, shift, samples).min() >= 0.0


def test_discrete_gaussians_add_up():
    a, b, both = (discrete_gaussian_taps([s], 30)[0] for s in (0.6, 0.8, 1.0))
    np.testing.assert_allclose(np.convolve(a, b)[30:91], both, atol=1e-12)


def test_falloff_is_how_the_marginal_falls_with_depth():
    one = GaussianSum((2.25,), ((1, 1, 1),))
    np.testing.assert_allclose(falloff_per_mm2(one, [-3, 0, 0.1, 5]), 0.5 / 2.25, rtol=1e-4)
    x = np.array([0.1, 0.5, 1.0, 2.0])
    q = falloff_per_mm2(D_EON_SKIN, x)
    z = 0.02
    ratio = D_EON_SKIN.line_marginal(np.hypot(x, z)) / D_EON_SKIN.line_marginal(x)
    np.testing.assert_allclose(np.exp(-q * z * z), ratio, rtol=2e-3)
    assert np.isfinite(falloff_per_mm2(D_EON_SKIN, [-20.0, 0.0, 20.0])).all()
    assert np.isfinite(falloff_per_mm2(BURLEY, [-20.0, 0.0, 20.0])).all()


@PROFILES
@pytest.mark.parametrize("count", [4, 64, 1023])
def test_disk_has_the_energy_and_the_variance_of_the_profile(profile, count):
    disk = disk_taps(profile, count)
    assert np.all(np.diff(disk.radius_mm) > 0.0)
    np.testing.assert_allclose(disk.weights.sum(axis=0), 1.0, atol=1e-12)
    np.testing.assert_allclose(disk.centre, 0.0, atol=1e-12)
    np.testing.assert_allclose(disk.weights.mean(axis=1), 1.0 / count, rtol=0.01)
    # of the channels' mean: one radius a ring cannot be right for each of them
    square = (disk.weights.mean(axis=1) * disk.radius_mm**2).sum()
    assert square == pytest.approx(np.mean(np.square(profile.rms_radius_mm)), rel=0.01)


def test_a_narrow_channel_has_taps_of_its_own():
    """Drawn from the widest, blue would meet 5 of 64 within its own reach."""
    disk = disk_taps(D_EON_SKIN, 64)
    assert (disk.radius_mm < D_EON_SKIN.radius_for(0.5)[2]).sum() >= 16


@PROFILES
@pytest.mark.parametrize("inner_mm", [1e-4, 0.3, 2.0, 1e4])
def test_what_lies_within_the_pixel_needs_no_tap(profile, inner_mm):
    disk = disk_taps(profile, 32, inner_mm)
    np.testing.assert_allclose(disk.centre, profile.cdf(inner_mm), atol=1e-5)
    np.testing.assert_allclose(disk.weights.sum(axis=0) + disk.centre, 1.0, atol=1e-12)
    assert np.isfinite(disk.radius_mm).all()
    assert (np.diff(disk.radius_mm) >= 0.0).all()


@PROFILES
def test_disk_leans_to_no_side(profile):
    disk = disk_taps(profile, 1023)
    x, y = (disk.radius_mm * f(disk.angle_rad) for f in (np.cos, np.sin))
    weights = disk.weights[:, 1]
    spread = float((weights * (x * x + y * y)).sum())
    for odd_moment in (x, y, x * y, x * x - y * y):
        assert abs(float((weights * odd_moment).sum())) < 0.05 * spread + 0.01
    step = np.diff(disk.angle_rad) % (2 * math.pi)
    np.testing.assert_allclose(step, math.pi * (3 - math.sqrt(5)), atol=1e-12)


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
        lambda: footprint_taps([-1.0], 3),
        lambda: footprint_taps([1.0], 0),
        lambda: footprint_taps([math.nan], 3),
        lambda: discrete_gaussian_taps([1.0], 65),
        lambda: disk_taps(D_EON_SKIN, 0),
        lambda: disk_taps(D_EON_SKIN, 1024),
    ],
)
def test_bad_requests_are_refused(call):
    with pytest.raises(ConfigError):
        call()
