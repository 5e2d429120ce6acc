"""The sum of Gaussians: published skin figures, quadrature, and what is refused."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad

from scanrender.errors import ConfigError
from scanrender.optics.profiles import D_EON_SKIN, DiffusionProfile, GaussianSum


@st.composite
def profiles(draw: st.DrawFn) -> GaussianSum:
    count = draw(st.integers(1, 6))
    steps = draw(st.lists(st.floats(0.01, 10.0), min_size=count, max_size=count))
    row = st.tuples(*[st.floats(0.01, 1.0)] * 3)
    weights = draw(st.lists(row, min_size=count, max_size=count))
    return GaussianSum.normalized(np.cumsum(steps).tolist(), weights)


def test_is_a_diffusion_profile():
    assert isinstance(D_EON_SKIN, DiffusionProfile)


def test_blue_is_the_source_value_not_the_misprint():
    assert D_EON_SKIN.weights[0][2] == 0.649
    np.testing.assert_allclose(np.sum(D_EON_SKIN.weights, axis=0), 1.0, atol=1e-12)


def test_mean_and_rms_radius():
    np.testing.assert_allclose(D_EON_SKIN.mean_radius_mm, [1.1206, 0.2593, 0.1665], atol=1e-4)
    np.testing.assert_allclose(D_EON_SKIN.rms_radius_mm, [1.663, 0.369, 0.222], atol=1e-3)


@pytest.mark.parametrize("channel", [0, 1, 2])
def test_radii_are_moments_of_the_density(channel):
    def moment(power: int) -> float:
        def density(r):
            return float(D_EON_SKIN.radial_pdf(r)[channel]) * r**power

        return quad(density, 0, 30, points=[0.1, 0.5, 1.0, 5.0], limit=200)[0]

    assert moment(0) == pytest.approx(1.0, abs=1e-9)
    assert moment(1) == pytest.approx(D_EON_SKIN.mean_radius_mm[channel], abs=1e-9)
    assert math.sqrt(moment(2)) == pytest.approx(D_EON_SKIN.rms_radius_mm[channel], abs=1e-8)


def test_enclosed_energy():
    red = D_EON_SKIN.cdf([1, 2, 3, 4, 6, 8])[:, 0]
    np.testing.assert_allclose(red, [0.594, 0.806, 0.920, 0.967, 0.993, 0.999], atol=6e-4)
    np.testing.assert_allclose(D_EON_SKIN.cdf([0.5, 1.0])[:, 1], [0.864, 0.980], atol=6e-4)
    np.testing.assert_allclose(D_EON_SKIN.cdf([0.25, 0.5])[:, 2], [0.808, 0.968], atol=6e-4)


def test_radius_for_999_permille():
    np.testing.assert_allclose(D_EON_SKIN.radius_for(0.999), [8.0, 2.4, 1.5], atol=0.05)


@pytest.mark.parametrize(
    ("d_mm", "expected"),
    [
        (0.0, (1.0, 1.0, 1.0)),
        (0.1, (0.859, 0.715, 0.614)),
        (0.25, (0.691, 0.358, 0.192)),
        (0.5, (0.572, 0.136, 0.032)),
        (1.0, (0.406, 0.0197, 0.0029)),
        (2.0, (0.194, 0.0017, 0.0002)),
        (3.0, (0.080, 0.0004, 0.0)),
        (5.0, (0.015, 0.0, 0.0)),
        (8.0, (0.001, 0.0, 0.0)),
    ],
)
def test_transmittance_table(d_mm, expected):
    np.testing.assert_allclose(D_EON_SKIN.transmittance(d_mm), expected, atol=5.1e-4)
    if 0.0 < d_mm <= 3.0:  # Jimenez' exp(-d^2 / v) is not what is computed
        jimenez = D_EON_SKIN.transmittance(d_mm * math.sqrt(2.0))
        assert np.all(np.abs(jimenez[:1] - expected[0]) > 0.03)


def test_a_negative_thickness_is_the_lit_face():
    np.testing.assert_array_equal(D_EON_SKIN.transmittance(-3.0), D_EON_SKIN.transmittance(0.0))


def test_increments_and_lerp_weights():
    np.testing.assert_allclose(
        D_EON_SKIN.increments_mm2(), [0.0064, 0.042, 0.1386, 0.38, 1.423, 5.42], atol=1e-12
    )
    expected = [
        [1, 1, 1],
        [0.3003, 0.4248, 0.3464],
        [0.2616, 0.2002, 0],
        [0.2004, 0.0070, 0.0070],
        [0.3883, 0.0040, 0],
        [0.0780, 0, 0],
    ]
    np.testing.assert_allclose(D_EON_SKIN.lerp_weights(), expected, atol=5.1e-5)


@given(profiles())
@settings(max_examples=50, deadline=None)
def test_successive_lerps_rebuild_the_weights(profile):
    share = np.zeros((len(profile.variances_mm2), 3))
    for k, weight in enumerate(profile.lerp_weights()):
        share *= 1.0 - weight
        share[k] = weight
    np.testing.assert_allclose(share, profile.weights, atol=1e-12)


def test_a_channel_that_starts_late_ignores_the_accumulator():
    late = GaussianSum((1.0, 2.0), ((1.0, 0.0, 0.5), (0.0, 1.0, 0.5)))
    np.testing.assert_array_equal(late.lerp_weights(), [[1, 1, 1], [0, 1, 0.5]])


@given(profiles(), st.floats(0.0, 0.9999))
@settings(max_examples=60, deadline=None)
def test_radius_for_inverts_cdf(profile, fraction):
    radius = profile.radius_for(fraction)
    for channel in range(3):
        assert profile.cdf(radius[channel])[channel] == pytest.approx(fraction, abs=1e-14)


@given(profiles(), st.floats(0.0, 40.0))
@settings(max_examples=60, deadline=None)
def test_what_is_not_enclosed_passes_a_slab(profile, d_mm):
    # the plane at distance d holds the radii from d up: T(d) = 1 - CDF(d) for any profile
    np.testing.assert_allclose(profile.transmittance(d_mm), 1.0 - profile.cdf(d_mm), atol=1e-14)


@given(profiles(), st.floats(-20.0, 20.0))
@settings(max_examples=30, deadline=None)
def test_line_marginal_is_the_integral_of_r_and_the_slope_of_line_cdf(profile, x_mm):
    reach = 8.0 * math.sqrt(profile.variances_mm2[-1])

    def across(y, c):
        return float(profile.R(math.hypot(x_mm, y))[c])

    expected = [2.0 * quad(across, 0.0, reach, args=(c,), limit=200)[0] for c in range(3)]
    np.testing.assert_allclose(profile.line_marginal(x_mm), expected, rtol=1e-6, atol=1e-12)
    step = 1e-4 * math.sqrt(profile.variances_mm2[0])
    slope = (profile.line_cdf(x_mm + step) - profile.line_cdf(x_mm - step)) / (2 * step)
    np.testing.assert_allclose(slope, expected, rtol=1e-4, atol=1e-9)


@given(profiles(), st.floats(0.1, 10.0), st.floats(0.0, 5.0))
@settings(max_examples=30, deadline=None)
def test_scaled_stretches_radii(profile, factor, r_mm):
    np.testing.assert_allclose(
        profile.scaled(factor).cdf(factor * r_mm), profile.cdf(r_mm), rtol=1e-9, atol=1e-12
    )


def test_tiny_radii_keep_relative_precision_and_huge_ones_do_not_overflow():
    variances = np.array(D_EON_SKIN.variances_mm2)[:, None]
    curvature = np.sum(np.array(D_EON_SKIN.weights) / variances, axis=0)
    np.testing.assert_allclose(D_EON_SKIN.cdf(1e-9), 0.5e-18 * curvature, rtol=1e-9)
    for function in (D_EON_SKIN.R, D_EON_SKIN.radial_pdf, D_EON_SKIN.transmittance):
        np.testing.assert_array_equal(function(1e150), 0.0)


def test_shapes_follow_the_input():
    grid = np.ones((4, 5))
    for name in ("R", "radial_pdf", "cdf", "line_marginal", "line_cdf", "transmittance"):
        assert getattr(D_EON_SKIN, name)(grid).shape == (4, 5, 3)
        assert getattr(D_EON_SKIN, name)(1.0).shape == (3,)
    assert D_EON_SKIN.radius_for(np.full((2, 2), 0.5)).shape == (2, 2, 3)


@pytest.mark.parametrize(
    ("variances", "weights", "word"),
    [
        ((), (), "non-empty"),
        ((0.0,), ((1, 1, 1),), "variances"),
        ((-1.0,), ((1, 1, 1),), "variances"),
        ((math.nan,), ((1, 1, 1),), "variances"),
        ((math.inf,), ((1, 1, 1),), "variances"),
        (("wide",), ((1, 1, 1),), "not numbers"),
        ((1.0, 1.0), ((0.5,) * 3,) * 2, "increase"),
        ((2.0, 1.0), ((0.5,) * 3,) * 2, "increase"),
        ((1.0, 2.0), ((1, 1, 1),), "rows"),
        ((1.0,), ((1, 1),), "three numbers"),
        ((1.0,), ((1, 1, "x"),), "three numbers"),
        ((1.0,), ((1, 1, math.nan),), "outside"),
        ((1.0, 2.0), ((1.5, 1, 1), (-0.5, 0, 0)), "outside"),
        ((0.0064, 0.0484), ((0.6, 0.6, 0.69), (0.4, 0.4, 0.344)), "sum to"),
    ],
)
def test_bad_tables_are_refused(variances, weights, word):
    with pytest.raises(ConfigError, match=word):
        GaussianSum(variances, weights)


def test_an_empty_channel_cannot_be_normalized():
    with pytest.raises(ConfigError, match="no weight"):
        GaussianSum.normalized([1.0], [[1.0, 0.0, 1.0]])


@pytest.mark.parametrize("fraction", [-0.1, 1.0, math.nan])
def test_no_radius_for_impossible_fractions(fraction):
    with pytest.raises(ConfigError, match="fraction"):
        D_EON_SKIN.radius_for(fraction)


@pytest.mark.parametrize("factor", [0.0, -1.0, math.inf, math.nan])
def test_bad_length_factors_are_refused(factor):
    with pytest.raises(ConfigError, match="positive"):
        D_EON_SKIN.scaled(factor)
