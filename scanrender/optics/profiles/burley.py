"""Normalized diffusion: R(r) = (e^{-r/d} + e^{-r/3d}) / (8 pi d r).

Source: Christensen & Burley, "Approximate Reflectance Profiles for Efficient Subsurface
Scattering", Pixar TM 15-04 (2015): R eq. 2, CDF eq. 11; d = l / s(A). The inverse CDF is
Golubev's, "Sampling Burley's Normalized Diffusion Profiles" (2019). Line marginal and T(d)
are integrated here in closed form and checked against quadrature in the tests.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
import numpy.typing as npt

from scanrender.errors import ConfigError
from scanrender.optics._math import Array, Rgb, as_array, bessel_k0, bessel_k0_integral
from scanrender.optics.profiles._checks import (
    MAX_LENGTH_MM,
    MIN_LENGTH_MM,
    checked_fraction,
    checked_rgb,
)

Fit = Literal["searchlight", "diffuse", "diffuse_mean_free_path"]


def scaling(albedo: npt.ArrayLike, fit: Fit = "searchlight") -> Array:
    """Return Burley's s(A) for surface albedo (...) in [0, 1], dimensionless; d = l / s.

    ``searchlight`` fits perpendicular entry (5.5 % mean error) and ``diffuse`` diffuse entry
    (3.9 %), both for a mean free path l; ``diffuse_mean_free_path`` (7.7 %, eq. 8) is for l
    the diffuse mean free path. Raises ConfigError for another fit or an albedo out of range.
    """
    a = as_array(albedo)
    if not bool(np.all((a >= 0.0) & (a <= 1.0))):
        raise ConfigError("surface albedo must lie in 0 to 1", "albedo")
    if fit == "searchlight":
        return 1.85 - a + 7.0 * np.abs(a - 0.8) ** 3
    if fit == "diffuse":
        return 1.9 - a + 3.5 * np.square(a - 0.8)
    if fit == "diffuse_mean_free_path":
        return 3.5 + 100.0 * np.square(np.square(a - 0.33))
    raise ConfigError(
        f"unknown fit {fit!r}", "fit", "use searchlight, diffuse or diffuse_mean_free_path"
    )


@dataclass(frozen=True)
class Burley:
    """White-normalised Burley diffusion with ``scale_mm`` d = 1/s for R, G, B, in mm.

    Raises ConfigError unless every d lies in 1e-6 to 1e6 mm (0 would make s infinite).
    """

    scale_mm: Rgb

    def __post_init__(self) -> None:
        checked = checked_rgb(self.scale_mm, "scale_mm", MIN_LENGTH_MM, MAX_LENGTH_MM, unit=" mm")
        object.__setattr__(self, "scale_mm", checked)

    @classmethod
    def from_mean_free_path(
        cls, mean_free_path_mm: npt.ArrayLike, albedo: npt.ArrayLike, fit: Fit = "searchlight"
    ) -> Burley:
        """Return the profile of a medium with RGB mean free path (mm) and surface albedo.

        ``fit`` says how light enters and which mean free path is meant, see ``scaling``.
        """
        mfp = checked_rgb(
            mean_free_path_mm, "mean_free_path_mm", MIN_LENGTH_MM, MAX_LENGTH_MM, unit=" mm"
        )
        a = checked_rgb(albedo, "albedo", 0.0, 1.0)
        red, green, blue = as_array(mfp) / scaling(a, fit)
        return cls((float(red), float(green), float(blue)))

    @cached_property
    def _d(self) -> Array:
        return np.array(self.scale_mm, dtype=np.float64)

    @property
    def mean_radius_mm(self) -> Array:
        """Mean distance travelled, 5 d / 2, shape (3,), mm."""
        return 2.5 * self._d

    @property
    def rms_radius_mm(self) -> Array:
        """Root mean square distance travelled, d sqrt(14), shape (3,), mm."""
        return math.sqrt(14.0) * self._d

    def R(self, r_mm: npt.ArrayLike) -> Array:  # noqa: N802 (the literature's symbol)
        """Diffusion profile at ``r_mm`` (...), as (..., 3), 1/mm^2 (eq. 2).

        Diverges as 1/r: inf at 0. Integrate with ``radial_pdf`` or ``cdf`` instead.
        """
        r = np.abs(as_array(r_mm))
        with np.errstate(divide="ignore"):
            return self.radial_pdf(r) / (2.0 * np.pi * r[..., None])

    def radial_pdf(self, r_mm: npt.ArrayLike) -> Array:
        """2 pi r R(r) for ``r_mm`` (...) >= 0, as (..., 3), 1/mm; it integrates to 1."""
        near, far = self._falloffs(r_mm)
        return (near + far) / (4.0 * self._d)

    def cdf(self, r_mm: npt.ArrayLike) -> Array:
        """Energy within ``r_mm`` (...), 1 - e^{-r/d}/4 - 3 e^{-r/3d}/4, as (..., 3) (eq. 11)."""
        x = np.maximum(as_array(r_mm), 0.0)[..., None] / self._d
        return -0.25 * (np.expm1(-x) + 3.0 * np.expm1(-x / 3.0))

    def radius_for(self, fraction: npt.ArrayLike) -> Array:
        """Radius enclosing ``fraction`` (...) in [0, 1) of the energy, as (..., 3), mm.

        Golubev 2019: with e^{-r/3d} = y the CDF is a cubic in y with one positive root.
        Raises ConfigError outside [0, 1).
        """
        rest = 1.0 - checked_fraction(fraction)
        g = 1.0 + 4.0 * rest * (2.0 * rest + np.sqrt(1.0 + 4.0 * np.square(rest)))
        cube_root = np.cbrt(g)
        ratio = 3.0 * np.log((1.0 + 1.0 / cube_root + cube_root) / (4.0 * rest))
        # rounding can make the logarithm -1e-16 at fraction 0
        return np.maximum(ratio, 0.0)[..., None] * self._d

    def line_marginal(self, x_mm: npt.ArrayLike) -> Array:
        """Integral of R along the line at ``x_mm`` (...), as (..., 3), 1/mm.

        [K0(|x|/d) + K0(|x|/3d)] / (4 pi d): log-singular, inf at 0. Use ``line_cdf``
        differences for filter weights, never samples.
        """
        x = np.abs(as_array(x_mm))[..., None] / self._d
        return (bessel_k0(x) + bessel_k0(x / 3.0)) / (4.0 * np.pi * self._d)

    def line_cdf(self, x_mm: npt.ArrayLike) -> Array:
        """Integral of the line marginal up to ``x_mm`` (...), as (..., 3), 0 to 1, finite."""
        x = as_array(x_mm)[..., None] / self._d
        distance = np.abs(x)
        half = bessel_k0_integral(distance) + 3.0 * bessel_k0_integral(distance / 3.0)
        return 0.5 + np.sign(x) * half / (4.0 * np.pi)

    def transmittance(self, d_mm: npt.ArrayLike) -> Array:
        """T(d) = (e^{-d/s'} + 3 e^{-d/3s'}) / 4, s' the scale, for ``d_mm`` (...), (..., 3).

        The exact integral of R over a plane at distance d, 0 to 1. Negative d counts as 0.
        """
        near, far = self._falloffs(np.maximum(as_array(d_mm), 0.0))
        return 0.25 * (near + 3.0 * far)

    def _falloffs(self, r_mm: npt.ArrayLike) -> tuple[Array, Array]:
        x = np.abs(as_array(r_mm))[..., None] / self._d
        return np.exp(-x), np.exp(-x / 3.0)
