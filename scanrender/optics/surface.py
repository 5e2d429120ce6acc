"""Specular reflection of skin: Kelemen/Szirmay-Kalos with a Beckmann distribution.

Source: Kelemen & Szirmay-Kalos, "A Microfacet Based Coupled Specular-Matte BRDF Model with
Importance Sampling", Eurographics 2001 short papers; used for skin by d'Eon & Luebke, GPU
Gems 3 ch. 14. Their listing drops the 1/pi of the Beckmann distribution, to go with a diffuse
term that drops it too; here both keep it, so f is a BRDF in 1/sr.

Skin: F0 = 0.028 (index 1.4), m about 0.3. Specular light is white and is never blurred.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from scanrender.errors import ConfigError
from scanrender.optics._math import Array, as_array, gauss_legendre

F0_SKIN = 0.028

MIN_ROUGHNESS_M = 0.01
MAX_ROUGHNESS_M = 1.0

# tan(theta_h) / m where the Beckmann lobe has 5e-16 of its energy left
_LOBE_REACH = 6.0
_LOBE_NODES = 96
_AZIMUTH_NODES = 64


@dataclass(frozen=True)
class SpecularLobes:
    """Two Beckmann lobes: ``mix`` in 0 to 1 of ``m_first``, the rest of ``m_second``.

    Roughnesses m are rms microfacet slopes, 0.01 to 1; ``f0`` is the reflectance at normal
    incidence, 0 to 1. Raises ConfigError out of range. A mixture of BRDFs whose shares sum to
    1 reflects no more than its stronger lobe, so energy needs no further care.
    """

    m_first: float = 0.3
    m_second: float = 0.3
    mix: float = 1.0
    f0: float = F0_SKIN

    def __post_init__(self) -> None:
        _check_roughness(self.m_first)
        _check_roughness(self.m_second)
        _check_unit(self.mix, "mix")
        _check_unit(self.f0, "f0")

    def brdf(self, normal: npt.ArrayLike, to_light: npt.ArrayLike, to_view: npt.ArrayLike) -> Array:
        """Mixture of two ``kelemen_brdf``, unit vectors (..., 3) in, (...) out, 1/sr."""
        first = kelemen_brdf(normal, to_light, to_view, self.m_first, self.f0)
        second = kelemen_brdf(normal, to_light, to_view, self.m_second, self.f0)
        return self.mix * first + (1.0 - self.mix) * second

    def directional_albedo(self, cos_theta: npt.ArrayLike) -> Array:
        """Mixture of two ``rho_dt`` at ``cos_theta`` (...), dimensionless."""
        first = rho_dt(cos_theta, self.m_first, self.f0)
        second = rho_dt(cos_theta, self.m_second, self.f0)
        return self.mix * first + (1.0 - self.mix) * second


def beckmann_d(cos_h: npt.ArrayLike, m: float) -> Array:
    """Beckmann distribution D = exp(-tan^2 / m^2) / (pi m^2 cos^4) at N.H (...), 1/sr.

    The integral of D cos over the hemisphere is 1. 0 at and below the horizon, where the
    exponential wins over 1/cos^4. Raises ConfigError for m outside 0.01 to 1.
    """
    _check_roughness(m)
    cosine = as_array(cos_h)
    # below 1e-3 the exponent is under -1e6 for any m, so the clamp changes nothing
    cos_squared = np.square(np.clip(cosine, 1e-3, 1.0))
    tan_squared = (1.0 - cos_squared) / cos_squared
    value = np.exp(-tan_squared / m**2) / (math.pi * m**2 * np.square(cos_squared))
    return np.asarray(np.where(cosine > 0.0, value, 0.0))


def fresnel_schlick(cos_theta: npt.ArrayLike, f0: float = F0_SKIN) -> Array:
    """Fresnel reflectance F0 + (1 - F0)(1 - cos)^5 at L.H = V.H (...) (Schlick 1994)."""
    cosine = np.clip(as_array(cos_theta), 0.0, 1.0)
    return f0 + (1.0 - f0) * (1.0 - cosine) ** 5


def kelemen_brdf(
    normal: npt.ArrayLike,
    to_light: npt.ArrayLike,
    to_view: npt.ArrayLike,
    m: float,
    f0: float = F0_SKIN,
) -> Array:
    """BRDF f = D F / (h.h) with h = L + V not normalised; unit vectors (..., 3), (...) 1/sr.

    h.h = 4 (V.H)^2 stands for Torrance-Sparrow's 4 (N.L)(N.V) / G. 0 unless light and view are
    both above the surface. Multiply by N.L and the light's irradiance scale; no pi elsewhere.
    """
    n, light, view = as_array(normal), as_array(to_light), as_array(to_view)
    half = light + view
    squared = np.maximum(np.sum(half * half, axis=-1), 1e-12)  # L = -V: both at the horizon
    length = np.sqrt(squared)
    cos_h = np.sum(n * half, axis=-1) / length
    above = (np.sum(n * light, axis=-1) > 0.0) & (np.sum(n * view, axis=-1) > 0.0)
    value = beckmann_d(cos_h, m) * fresnel_schlick(0.5 * length, f0) / squared
    return np.asarray(np.where(above, value, 0.0))


def rho_dt(cos_theta: npt.ArrayLike, m: float, f0: float = F0_SKIN) -> Array:
    """Directional albedo: integral of f N.L over the hemisphere, at N.V = ``cos_theta`` (...).

    Light that enters the skin is what is left of it, E (1 - rho_dt(N.L)), and what leaves is
    scaled by 1 - rho_dt(N.V) (d'Eon & Luebke). Accurate to 1e-4. Raises ConfigError for m
    outside 0.01 to 1 or f0 outside 0 to 1.

    Integrated over half vectors, where dw_l = 4 (V.H) dw_h and D cos_h dw_h is a unit measure
    du dphi / 2 pi with u = 1 - exp(-t^2), t = tan(theta_h) / m:
    rho = mean of F(V.H) [2 - N.V / (V.H cos_h)] where that bracket (it is N.L / (V.H cos_h))
    is positive. The integrand is bounded, so narrow lobes cost no more than wide ones.
    """
    _check_roughness(m)
    _check_unit(f0, "f0")
    mu = np.clip(as_array(cos_theta), 0.0, 1.0)
    flat = np.array([_rho_dt_at(float(value), m, f0) for value in mu.ravel()])
    return flat.reshape(mu.shape)


def rho_dt_table(size_mu: int, size_m: int, f0: float = F0_SKIN) -> Array:
    """Return rho_dt at texel centres, (size_m, size_mu), for a clamped, linear lookup.

    Row j is m = (j + 0.5) / size_m and column i is cos = (i + 0.5) / size_mu, so a texture
    coordinate (u, v) *is* (cos, m). Raises ConfigError unless sizes are 1 to 50 for m (m stays
    at or above 0.01) and 1 to 4096 for the cosine.
    """
    if not (1 <= size_mu <= 4096 and 1 <= size_m <= 50):
        raise ConfigError(
            f"a table of {size_mu} x {size_m} is out of range",
            "size_mu, size_m",
            "use 1 to 4096 cosines and 1 to 50 roughnesses",
        )
    mu = (np.arange(size_mu) + 0.5) / size_mu
    return np.stack([rho_dt(mu, (j + 0.5) / size_m, f0) for j in range(size_m)])


def _rho_dt_at(mu: float, m: float, f0: float) -> float:
    """Return rho_dt for one cosine: Gauss-Legendre in t and, up to the horizon, in azimuth."""
    node, weight = gauss_legendre(_LOBE_NODES)
    t = 0.5 * _LOBE_REACH * (node + 1.0)
    measure = 0.5 * _LOBE_REACH * weight * 2.0 * t * np.exp(-np.square(t))  # du
    cos_h = 1.0 / np.sqrt(1.0 + np.square(m * t))
    sin_h = m * t * cos_h
    sin_v = math.sqrt(max(0.0, 1.0 - mu * mu))
    # N.L > 0 means V.H > mu / (2 cos_h), which bounds the azimuth of H around N
    with np.errstate(divide="ignore", invalid="ignore"):
        bound = (mu / (2.0 * cos_h) - mu * cos_h) / (sin_h * sin_v)
    everywhere = mu * cos_h >= mu / (2.0 * cos_h)
    bound = np.where(np.isfinite(bound), bound, np.where(everywhere, -1.0, 1.0))
    reach = np.arccos(np.clip(bound, -1.0, 1.0))

    node, weight = gauss_legendre(_AZIMUTH_NODES)
    azimuth = 0.5 * reach[:, None] * (node + 1.0)
    v_dot_h = mu * cos_h[:, None] + sin_v * sin_h[:, None] * np.cos(azimuth)
    v_dot_h = np.maximum(v_dot_h, 1e-12)
    bracket = np.maximum(2.0 - mu / (v_dot_h * cos_h[:, None]), 0.0)
    around = (fresnel_schlick(v_dot_h, f0) * bracket) @ (0.5 * weight) * reach / math.pi
    return float(measure @ around)


def _check_roughness(m: float) -> None:
    if not MIN_ROUGHNESS_M <= m <= MAX_ROUGHNESS_M:
        raise ConfigError(
            f"roughness {m:g} is outside {MIN_ROUGHNESS_M:g} to {MAX_ROUGHNESS_M:g}", "m"
        )


def _check_unit(value: float, where: str) -> None:
    if not 0.0 <= value <= 1.0:
        raise ConfigError(f"{value:g} is outside 0 to 1", where)
