"""Diffusion profiles R(r): how far light travels below the skin before it comes out.

Every profile is radially symmetric, per RGB channel, and *white-normalised*: in each channel
the integral of 2 pi r R(r) is 1, because the colour of skin comes from its albedo texture
(d'Eon & Luebke, GPU Gems 3, ch. 14). One file per profile, one citation per file.
"""

from __future__ import annotations

from typing import Protocol, runtime_checkable

import numpy.typing as npt

from scanrender.optics._math import Array
from scanrender.optics.profiles.burley import Burley
from scanrender.optics.profiles.gaussians import D_EON_SKIN, GaussianSum

__all__ = ["D_EON_SKIN", "Burley", "DiffusionProfile", "GaussianSum"]


@runtime_checkable
class DiffusionProfile(Protocol):
    """What every profile answers. Inputs have any shape ``(...)``; answers are ``(..., 3)``."""

    @property
    def mean_radius_mm(self) -> Array:
        """Mean distance travelled per channel, shape ``(3,)``, mm."""

    @property
    def rms_radius_mm(self) -> Array:
        """Root mean square distance travelled per channel, shape ``(3,)``, mm."""

    def R(self, r_mm: npt.ArrayLike) -> Array:  # noqa: N802 (the literature's symbol)
        """Diffusion profile at distance ``r_mm``, 1/mm^2; may be inf at 0."""

    def radial_pdf(self, r_mm: npt.ArrayLike) -> Array:
        """2 pi r R(r), the density of the distance travelled, 1/mm; finite everywhere."""

    def cdf(self, r_mm: npt.ArrayLike) -> Array:
        """Energy that leaves within ``r_mm``, from 0 to 1."""

    def radius_for(self, fraction: npt.ArrayLike) -> Array:
        """Radius that encloses ``fraction`` in [0, 1) of the energy, mm: the inverse of cdf."""

    def line_marginal(self, x_mm: npt.ArrayLike) -> Array:
        """Integral of R over the line at signed distance ``x_mm``, 1/mm; may be inf at 0."""

    def line_cdf(self, x_mm: npt.ArrayLike) -> Array:
        """Integral of the line marginal from -inf to ``x_mm``, from 0 to 1."""

    def transmittance(self, d_mm: npt.ArrayLike) -> Array:
        """T(d): light through a slab of thickness ``d_mm`` lit evenly from behind, 0 to 1."""
