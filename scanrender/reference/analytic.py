"""Cases of subsurface scattering whose answer is known: planes, slabs and spheres.

Truth here is ``truth_sum``, M(p) = integral over S of R(|x_p - x|) E(x) dA, the radiant exitance
of white skin, for profile R (1/mm^2) and irradiance E. Results are (..., 3), linear Rec.709,
in units of the irradiance. On a sphere the area within chord length r is pi r^2 (Archimedes),
so dA = 2 pi r dr as on a plane, up to r = 2 rho, and surface integrals become one-dimensional.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from scanrender.errors import ConfigError
from scanrender.optics._math import Array, as_array, gauss_legendre
from scanrender.optics.profiles import DiffusionProfile

# Radii enclosing these fractions bound the quadrature panels, so that each Gaussian of a
# profile, 0.08 to 2.7 mm, gets panels of its own size on a sphere of any radius.
_PANEL_FRACTIONS = (0.01, 0.1, 0.3, 0.5, 0.7, 0.85, 0.95, 0.99, 0.999, 0.99999, 1.0 - 1e-9)
_PANEL_NODES = 24
# Enough for a profile a hundredth as wide as the pixel that shows it.
_FOOTPRINT_PANELS = 64
# A Gaussian profile's scales are not its quantiles where weights are small; halving the radius
# repeatedly reaches all of them.
_OCTAVES = 14


def half_lit_plane(x_mm: npt.ArrayLike, profile: DiffusionProfile) -> Array:
    """M at ``x_mm`` (...) from the edge of a plane lit with E = 1 where x > 0, (..., 3).

    sum_k w_k / 2 [1 + erf(x / sqrt(2 v_k))] for Gaussians: the integral of the line marginal,
    at any tilt, distance, field of view and aspect.
    """
    return profile.line_cdf(x_mm)


def half_lit_plane_seen(
    x_mm: npt.ArrayLike, footprint_mm: float, profile: DiffusionProfile
) -> Array:
    """Mean of ``half_lit_plane`` over pixels ``footprint_mm`` > 0 wide around ``x_mm`` (...).

    What a picture of that plane shows; beside the edge it differs from the value at the pixel's
    centre by as much as the profile is narrower than a pixel.
    """
    if not footprint_mm > 0.0:
        raise ConfigError("a footprint must be positive", "footprint_mm")
    x = as_array(x_mm)
    node, weight = gauss_legendre(_PANEL_NODES)
    panels = np.linspace(-0.5, 0.5, _FOOTPRINT_PANELS + 1)
    middle, half = 0.5 * (panels[1:] + panels[:-1]), 0.5 / _FOOTPRINT_PANELS
    offsets = (middle[:, None] + half * node).ravel() * footprint_mm
    values = profile.line_cdf(x[..., None] + offsets)
    return np.asarray(np.einsum("...kc,k->...c", values, half * np.tile(weight, len(middle))))


def slab_transmittance(d_mm: npt.ArrayLike, profile: DiffusionProfile) -> Array:
    """M behind a slab of thickness ``d_mm`` (...) >= 0 lit from behind with E = 1, (..., 3).

    Integrates R over the lit plane: with s the distance along it and r^2 = s^2 + d^2,
    2 pi s ds = 2 pi r dr, so M = integral from d of 2 pi r R dr. By quadrature over the
    density, so that it also judges a profile's own closed form. Negative d counts as 0.
    """
    d = np.maximum(as_array(d_mm), 0.0)
    far = float(np.max(profile.radius_for(1.0 - 1e-13)))
    flat = [_integrate_density(profile, min(value, far), far) for value in d.ravel().tolist()]
    return np.array(flat).reshape(*d.shape, 3)


def sphere_furnace(radius_mm: npt.ArrayLike, profile: DiffusionProfile) -> Array:
    """M on a sphere of ``radius_mm`` (...) > 0 lit everywhere with E = 1, (..., 3).

    The energy within the longest chord: 1 - sum_k w_k exp(-2 rho^2 / v_k) for Gaussians.
    Below 1 since a sphere smaller than the profile offers too little surface.
    """
    rho = as_array(radius_mm)
    if not bool(np.all(rho > 0.0)):
        raise ConfigError("a sphere's radius must be positive", "radius_mm")
    return profile.cdf(2.0 * rho)


def sphere_terminator(
    theta_rad: npt.ArrayLike,
    radius_mm: float,
    profile: DiffusionProfile,
    *,
    normalized: bool = False,
) -> Array:
    """M on a sphere under a distant light, at angle ``theta_rad`` (...) from it, (..., 3).

    E = max(0, cos theta), theta in 0 to pi, ``radius_mm`` 0.01 to 1e5. Then
    M(theta) = integral from 0 to 2 rho of 2 pi r R(r) mean_E(theta, r) dr, with mean_E the mean
    irradiance on the circle of chord r around the point. ``normalized`` divides by
    ``sphere_furnace``, which gives ``truth_mean``. Accurate to 1e-6; raises ConfigError.
    """
    if not 0.01 <= radius_mm <= 1e5:
        raise ConfigError(f"{radius_mm:g} is outside 0.01 to 1e5 mm", "radius_mm")
    theta = as_array(theta_rad)
    if not bool(np.all((theta >= 0.0) & (theta <= math.pi))):
        raise ConfigError("angles must lie in 0 to pi", "theta_rad")
    scales = _panel_edges(profile, 2.0 * radius_mm)
    flat = [_terminator_at(value, radius_mm, profile, scales) for value in theta.ravel().tolist()]
    result = np.array(flat).reshape(*theta.shape, 3)
    return result / sphere_furnace(radius_mm, profile) if normalized else result


def mean_irradiance_on_circle(theta_rad: float, alpha_rad: Array) -> Array:
    """Mean of max(0, N.L) over the circle ``alpha_rad`` (...) away from a point of a sphere.

    ``theta_rad`` is the point's angle to the light. N.L = a + b cos(phi) with a = cos(theta)
    cos(alpha), b = sin(theta) sin(alpha); the lit arc is |phi| < arccos(-a/b), clamped to
    none or all of the circle.
    """
    a = math.cos(theta_rad) * np.cos(alpha_rad)
    b = np.abs(math.sin(theta_rad) * np.sin(alpha_rad))
    lit_arc = np.arccos(np.clip(-a / np.maximum(b, 1e-300), -1.0, 1.0))
    return np.asarray((a * lit_arc + b * np.sin(lit_arc)) / math.pi)


def _terminator_at(
    theta_rad: float, radius_mm: float, profile: DiffusionProfile, scales_mm: Array
) -> Array:
    # circles that just touch the terminator, where mean_E has a 3/2-power kink
    touch = abs(0.5 * math.pi - theta_rad)
    kinks = 2.0 * radius_mm * np.sin(0.5 * np.array([touch, math.pi - touch]))
    r, weight = _gauss_panels(np.union1d(scales_mm, kinks))
    alpha = 2.0 * np.arcsin(np.clip(r / (2.0 * radius_mm), 0.0, 1.0))
    return (weight * mean_irradiance_on_circle(theta_rad, alpha)) @ profile.radial_pdf(r)


def _integrate_density(profile: DiffusionProfile, start_mm: float, end_mm: float) -> Array:
    edges = _panel_edges(profile, end_mm)
    edges = np.union1d(edges[edges > start_mm], [start_mm, end_mm])
    r, weight = _gauss_panels(edges)
    return weight @ profile.radial_pdf(r)


def _panel_edges(profile: DiffusionProfile, end_mm: float) -> Array:
    """Return ascending radii from 0 to ``end_mm`` between which the density is smooth, mm."""
    quantiles = profile.radius_for(np.array(_PANEL_FRACTIONS)).ravel()
    far = float(quantiles.max())
    octaves = 2.0 * far * np.exp2(-np.arange(_OCTAVES))
    inside = np.concatenate((quantiles, octaves))
    return np.unique(np.concatenate(([0.0], inside[inside < end_mm], [end_mm])))


def _gauss_panels(edges_mm: Array) -> tuple[Array, Array]:
    """Return Gauss-Legendre nodes and weights (n,) for all panels between ``edges_mm``."""
    node, weight = gauss_legendre(_PANEL_NODES)
    half = 0.5 * np.diff(edges_mm)
    middle = 0.5 * (edges_mm[1:] + edges_mm[:-1])
    r = middle[:, None] + half[:, None] * node
    return r.ravel(), (half[:, None] * weight).ravel()
