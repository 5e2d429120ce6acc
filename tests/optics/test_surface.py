"""Specular lobes: normalisation, reciprocity, and the albedo against plain quadrature."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad

from scanrender.errors import ConfigError
from scanrender.optics.surface import (
    F0_SKIN,
    SpecularLobes,
    beckmann_d,
    fresnel_schlick,
    kelemen_brdf,
    rho_dt,
    rho_dt_table,
)

UP = np.array([0.0, 0.0, 1.0])


def direction(cos_theta, phi):
    sin_theta = np.sqrt(1.0 - np.square(cos_theta))
    z = np.broadcast_to(cos_theta, np.shape(sin_theta * np.cos(phi)))
    return np.stack((sin_theta * np.cos(phi), sin_theta * np.sin(phi), z), axis=-1)


def albedo_over_light_directions(mu: float, m: float, f0: float) -> float:
    """Integrate f cos over light directions: the definition, on another domain than rho_dt."""
    node, weight = np.polynomial.legendre.leggauss(400)
    cos_l, w_cos = 0.5 * (node + 1.0), 0.5 * weight
    phi, w_phi = np.pi * 0.5 * (node + 1.0), np.pi * 0.5 * weight
    light = direction(cos_l[:, None], phi[None, :])
    value = kelemen_brdf(UP, light, direction(np.float64(mu), 0.0), m, f0)
    return float(2.0 * (w_cos * cos_l) @ value @ w_phi)


@pytest.mark.parametrize("m", [0.01, 0.1, 0.3, 1.0])
def test_beckmann_projects_to_one(m):
    def integrand(tangent: float) -> float:
        cos_h = 1.0 / math.sqrt(1.0 + tangent**2)
        # dw = 2 pi sin dtheta = 2 pi t cos^3 dt
        return 2.0 * math.pi * tangent * cos_h**3 * cos_h * float(beckmann_d(cos_h, m))

    assert quad(integrand, 0.0, 8.0 * m, epsrel=1e-10)[0] == pytest.approx(1.0, abs=1e-8)


def test_beckmann_keeps_the_pi_and_is_dark_below_the_horizon():
    assert float(beckmann_d(1.0, 0.3)) == pytest.approx(1.0 / (math.pi * 0.09))
    np.testing.assert_array_equal(beckmann_d([0.0, -0.5, -1.0, 1e-200], 0.3), 0.0)


def test_fresnel_ends():
    np.testing.assert_allclose(fresnel_schlick([1.0, 0.0, -0.5, 2.0]), [0.028, 1.0, 1.0, 0.028])
    index = 1.4
    assert pytest.approx(F0_SKIN, abs=3e-4) == ((index - 1.0) / (index + 1.0)) ** 2


def test_kelemen_at_normal_incidence():
    # D(1) F0 / (h.h = 4)
    value = kelemen_brdf(UP, UP, UP, 0.3, 0.028)
    assert float(value) == pytest.approx(0.028 / (4.0 * math.pi * 0.09))


cosines = st.floats(0.01, 1.0)
angles = st.floats(0.0, 2.0 * math.pi)


@given(cosines, angles, cosines, angles, st.floats(0.05, 1.0))
@settings(max_examples=100, deadline=None)
def test_kelemen_is_reciprocal_and_finite(cos_l, phi_l, cos_v, phi_v, m):
    light, view = direction(np.float64(cos_l), phi_l), direction(np.float64(cos_v), phi_v)
    there, back = kelemen_brdf(UP, light, view, m), kelemen_brdf(UP, view, light, m)
    assert np.isfinite(there)
    assert there >= 0.0
    assert there == pytest.approx(float(back), rel=1e-12)


def test_nothing_shines_through_the_horizon():
    below, side = np.array([0.96, 0.0, -0.28]), np.array([1.0, 0.0, 0.0])
    for light, view in ((below, UP), (UP, below), (below, below), (side, -side), (UP, -UP)):
        assert float(kelemen_brdf(UP, light, view, 1.0)) == 0.0


@pytest.mark.parametrize("m", [0.2, 0.3, 0.6])
@pytest.mark.parametrize("mu", [0.05, 0.3, 0.8, 1.0])
@pytest.mark.parametrize("f0", [0.028, 1.0])
def test_rho_dt_is_the_integral_over_light(mu, m, f0):
    assert float(rho_dt(mu, m, f0)) == pytest.approx(
        albedo_over_light_directions(mu, m, f0), abs=1e-4
    )


def test_rho_dt_of_a_smooth_surface_is_fresnel():
    mu = np.array([0.3, 0.5, 0.8, 1.0])
    np.testing.assert_allclose(rho_dt(mu, 0.01), fresnel_schlick(mu), rtol=3e-3)


@given(st.floats(-0.1, 1.1), st.floats(0.01, 1.0))
@settings(max_examples=60, deadline=None)
def test_rho_dt_leaves_light_for_the_skin(mu, m):
    value = float(rho_dt(mu, m))
    assert 0.0 < value < 1.0


def test_rho_dt_rises_towards_grazing():
    assert np.all(np.diff(rho_dt(np.linspace(0.02, 0.9, 12), 0.3)) < 0.0)


def test_table_holds_texel_centres():
    table = rho_dt_table(8, 4)
    assert table.shape == (4, 8)
    assert table[2, 5] == pytest.approx(float(rho_dt(5.5 / 8, 2.5 / 4)), abs=1e-15)


def test_two_lobes_mix_linearly():
    light, view = direction(np.float64(0.8), 0.3), direction(np.float64(0.6), 2.0)
    lobes = SpecularLobes(m_first=0.2, m_second=0.5, mix=0.85)
    tight, wide = kelemen_brdf(UP, light, view, 0.2), kelemen_brdf(UP, light, view, 0.5)
    assert float(lobes.brdf(UP, light, view)) == pytest.approx(float(0.85 * tight + 0.15 * wide))
    expected = 0.85 * rho_dt(0.6, 0.2) + 0.15 * rho_dt(0.6, 0.5)
    assert float(lobes.directional_albedo(0.6)) == pytest.approx(float(expected))
    default = SpecularLobes()
    assert float(default.brdf(UP, light, view)) == float(kelemen_brdf(UP, light, view, 0.3))


@pytest.mark.parametrize(
    "call",
    [
        lambda: beckmann_d(1.0, 0.0),
        lambda: beckmann_d(1.0, math.nan),
        lambda: rho_dt(0.5, 2.0),
        lambda: rho_dt(0.5, 0.3, -0.1),
        lambda: rho_dt_table(0, 4),
        lambda: rho_dt_table(4, 64),
        lambda: SpecularLobes(m_first=0.0),
        lambda: SpecularLobes(mix=1.5),
        lambda: SpecularLobes(f0=math.nan),
    ],
)
def test_bad_parameters_are_refused(call):
    with pytest.raises(ConfigError):
        call()
