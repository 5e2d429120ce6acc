"""Diffusion profile as a sum of Gaussians, R(r) = sum_k w_k G(v_k, r).

Source: d'Eon & Luebke, "Advanced Techniques for Realistic Real-Time Skin Rendering",
GPU Gems 3 (2007), ch. 14, with the six-Gaussian skin table. A Gaussian of variance v
is G(v, r) = exp(-r^2 / 2v) / (2 pi v), so that the integral of 2 pi r G is 1 and
G(v1) * G(v2) = G(v1 + v2).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from scanrender.errors import ConfigError
from scanrender.optics._math import Array, Rgb, as_array, erf
from scanrender.optics.profiles._checks import (
    MAX_LENGTH_MM,
    MIN_LENGTH_MM,
    checked_fraction,
    checked_rgb,
    invert_increasing,
)

_SUM_TOLERANCE = 1e-6


@dataclass(frozen=True)
class GaussianSum:
    """A white-normalised sum of Gaussians with shared variances and RGB weights.

    ``variances_mm2`` has K strictly increasing entries in mm^2, ``weights`` is (K, 3), linear
    Rec.709, each column summing to 1 within 1e-6 (see ``normalized`` otherwise). Raises
    ConfigError for anything else: negative weights would make the CDF fall.
    """

    variances_mm2: tuple[float, ...]
    weights: tuple[Rgb, ...]

    def __post_init__(self) -> None:
        object.__setattr__(self, "variances_mm2", _checked_variances(self.variances_mm2))
        object.__setattr__(self, "weights", _checked_weights(self.weights))
        if len(self.weights) != len(self.variances_mm2):
            raise ConfigError(
                f"{len(self.variances_mm2)} variances but {len(self.weights)} rows of weights",
                "weights",
                "give one RGB row of weights per variance",
            )
        sums = self._w.sum(axis=0)
        if bool(np.any(np.abs(sums - 1.0) > _SUM_TOLERANCE)):
            raise ConfigError(
                f"the weights sum to {np.round(sums, 6).tolist()} instead of 1 in R, G, B",
                "weights",
                "correct the table, or build it with GaussianSum.normalized",
            )

    @classmethod
    def normalized(
        cls, variances_mm2: Sequence[float], weights: Sequence[Sequence[float]]
    ) -> GaussianSum:
        """Return the profile with each column of ``weights`` (K, 3) divided by its sum."""
        rows = np.array(_checked_weights(weights), dtype=np.float64)
        sums = rows.sum(axis=0)
        if not bool(np.all(sums > 0.0)):
            raise ConfigError(
                "a channel has no weight at all",
                "weights",
                "give each of R, G and B at least one positive weight",
            )
        return cls(tuple(variances_mm2), tuple(_rgb(row) for row in rows / sums))

    @cached_property
    def _v(self) -> Array:
        return np.array(self.variances_mm2, dtype=np.float64)

    @cached_property
    def _w(self) -> Array:
        return np.array(self.weights, dtype=np.float64).reshape(-1, 3)

    @property
    def mean_radius_mm(self) -> Array:
        """Mean distance travelled, sum_k w_k sqrt(pi v_k / 2), shape (3,), mm."""
        return np.sqrt(0.5 * np.pi * self._v) @ self._w

    @property
    def rms_radius_mm(self) -> Array:
        """Root mean square distance travelled, sqrt(2 sum_k w_k v_k), shape (3,), mm."""
        return np.sqrt(2.0 * self._v @ self._w)

    def R(self, r_mm: npt.ArrayLike) -> Array:  # noqa: N802 (the literature's symbol)
        """Diffusion profile at ``r_mm`` (...), as (..., 3), 1/mm^2."""
        return _gauss(as_array(r_mm), self._v) @ (self._w / (2.0 * np.pi * self._v[:, None]))

    def radial_pdf(self, r_mm: npt.ArrayLike) -> Array:
        """2 pi r R(r) for ``r_mm`` (...) >= 0, as (..., 3), 1/mm; it integrates to 1."""
        r = as_array(r_mm)
        return r[..., None] * (_gauss(r, self._v) @ (self._w / self._v[:, None]))

    def cdf(self, r_mm: npt.ArrayLike) -> Array:
        """Energy within ``r_mm`` (...), sum_k w_k (1 - exp(-r^2 / 2 v_k)), as (..., 3)."""
        r = np.maximum(as_array(r_mm), 0.0)
        # expm1 keeps the relative precision at tiny radii, where sub-pixel kernels look
        return -np.expm1(-_half_square(r, self._v)) @ self._w

    def radius_for(self, fraction: npt.ArrayLike) -> Array:
        """Radius enclosing ``fraction`` (...) in [0, 1) of the energy, as (..., 3), mm.

        Raises ConfigError outside [0, 1). No closed form exists; found by bracketing.
        """
        target = checked_fraction(fraction)[..., None] * np.ones(3)
        return invert_increasing(self._cdf_by_channel, target, self.rms_radius_mm)

    def line_marginal(self, x_mm: npt.ArrayLike) -> Array:
        """Integral of R along the line at ``x_mm`` (...), as (..., 3), 1/mm: 1-D Gaussians."""
        scale = self._w / np.sqrt(2.0 * np.pi * self._v)[:, None]
        return _gauss(as_array(x_mm), self._v) @ scale

    def line_cdf(self, x_mm: npt.ArrayLike) -> Array:
        """Integral of the line marginal up to ``x_mm`` (...), as (..., 3), 0 to 1.

        sum_k w_k / 2 [1 + erf(x / sqrt(2 v_k))]: also the light at a half-lit plane's edge.
        """
        x = as_array(x_mm)
        return 0.5 * (1.0 + erf(x[..., None] / np.sqrt(2.0 * self._v))) @ self._w

    def transmittance(self, d_mm: npt.ArrayLike) -> Array:
        """T(d) = sum_k w_k exp(-d^2 / 2 v_k) for ``d_mm`` (...), as (..., 3), 0 to 1.

        The exact integral of R over a plane at distance d. Jimenez et al. 2010 use
        exp(-d^2 / v), which makes skin look sqrt(2) times thicker. Negative d counts as 0.
        """
        return _gauss(np.maximum(as_array(d_mm), 0.0), self._v) @ self._w

    def increments_mm2(self) -> Array:
        """Variances v_k - v_{k-1} (K,), mm^2: blurring by each in turn reaches each v_k."""
        return np.diff(self._v, prepend=0.0)

    def lerp_weights(self) -> Array:
        """Weights w_k / sum_{i<=k} w_i, (K, 3), for successive result = lerp(result, blur_k).

        Not additive weights: summed as such they create energy (T(0) = 2.2 in red). A channel
        that has no weight yet lerps by 1, so that it starts from the first blur, not from
        whatever the accumulator held.
        """
        so_far = np.cumsum(self._w, axis=0)
        return np.divide(self._w, so_far, out=np.ones_like(self._w), where=so_far > 0.0)

    def scaled(self, length_factor: float) -> GaussianSum:
        """Return the profile with every length multiplied by ``length_factor`` > 0."""
        if not (np.isfinite(length_factor) and length_factor > 0.0):
            raise ConfigError("a length factor must be a positive number", "length_factor")
        return GaussianSum(
            tuple(float(v) * length_factor**2 for v in self.variances_mm2), self.weights
        )

    def merged(self, count: int) -> GaussianSum:
        """Return the profile with at most ``count`` >= 1 Gaussians: the narrowest become one.

        Its variance is their mean by weight (all channels together), which keeps the second
        moment of the sum. Where all of them are narrower than a pixel, nothing else is seen.
        """
        if count < 1:
            raise ConfigError("at least one Gaussian must be left", "count")
        first = max(len(self.variances_mm2) - count + 1, 1)
        weights = self._w[:first].sum(axis=0)
        shares = self._w[:first].sum(axis=1)
        # Gaussians that no channel uses still have a variance: any mean of them will do.
        shares = shares if bool(shares.any()) else np.ones_like(shares)
        variance = float(np.average(self._v[:first], weights=shares))
        return GaussianSum.normalized(
            (variance, *self.variances_mm2[first:]), (_rgb(weights), *self.weights[first:])
        )

    def _cdf_by_channel(self, r_mm: Array) -> Array:
        """Return cdf where the last axis of ``r_mm`` (..., 3) already is the channel."""
        falloff = -np.expm1(-_half_square(r_mm, self._v))
        return np.asarray(np.sum(falloff * self._w.T, axis=-1))


def _half_square(length_mm: Array, variances_mm2: Array) -> Array:
    # divide first: squaring would overflow at 1e155 mm while the ratio is still a number
    return 0.5 * np.square(length_mm[..., None] / np.sqrt(variances_mm2))


def _gauss(length_mm: Array, variances_mm2: Array) -> Array:
    return np.exp(-_half_square(length_mm, variances_mm2))


def _rgb(row: Array) -> Rgb:
    return float(row[0]), float(row[1]), float(row[2])


def _checked_variances(variances_mm2: Sequence[float]) -> tuple[float, ...]:
    try:
        v = as_array(variances_mm2)
    except (TypeError, ValueError) as error:
        raise ConfigError("the variances are not numbers", "variances_mm2") from error
    low, high = MIN_LENGTH_MM**2, MAX_LENGTH_MM**2
    if v.ndim != 1 or v.size == 0 or not bool(np.all((v >= low) & (v <= high))):
        raise ConfigError(
            f"variances must be a non-empty list of numbers from {low:g} to {high:g} mm^2",
            "variances_mm2",
            "a variance is the square of a Gaussian's width in mm",
        )
    if bool(np.any(np.diff(v) <= 0.0)):
        raise ConfigError(
            "variances must increase strictly",
            "variances_mm2",
            "sort them, and merge Gaussians of equal variance",
        )
    return tuple(float(value) for value in v)


def _checked_weights(weights: Sequence[Sequence[float]]) -> tuple[Rgb, ...]:
    return tuple(
        checked_rgb(row, f"weights[{index}]", 0.0, 1e6) for index, row in enumerate(weights)
    )


#: d'Eon & Luebke's skin, GPU Gems 3 ch. 14: R mean radius 1.12 mm, G 0.26, B 0.17.
#: Blue's first weight is 0.649; the WSCG 2016 paper misprints 0.69, which creates 4 % energy.
D_EON_SKIN = GaussianSum(
    variances_mm2=(0.0064, 0.0484, 0.187, 0.567, 1.99, 7.41),
    weights=(
        (0.233, 0.455, 0.649),
        (0.100, 0.336, 0.344),
        (0.118, 0.198, 0.000),
        (0.113, 0.007, 0.007),
        (0.358, 0.004, 0.000),
        (0.078, 0.000, 0.000),
    ),
)
