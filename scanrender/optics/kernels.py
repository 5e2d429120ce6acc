"""Filter taps from a diffusion profile, by exact cell integrals.

A tap stands for a cell of the profile, so its weight is the profile's integral over that cell
(erf, or the integral of K0), never the profile sampled at the tap. Sampling goes wrong wherever
a Gaussian is narrower than a cell: the six-Gaussian skin table sampled at 7 quadratic taps over
+-6 mm gives weight sums of 1.7 to 2.6 and misplaces 4-14 % of the energy once normalised, and
more taps do not help monotonically. Exact integrals sum to 1 at any count.

The outermost cells reach to infinity: what a cut kernel would lose arrives at its rim instead,
so that a constant irradiance stays constant.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from scanrender.errors import ConfigError
from scanrender.optics._math import Array, as_array, erf, erfc, erfcx, scaled_bessel_i
from scanrender.optics.profiles import DiffusionProfile
from scanrender.optics.profiles._checks import MAX_LENGTH_MM, MIN_LENGTH_MM, checked_rgb

MAX_SAMPLES = 1023
# Of the numerical integrals over rings of a disk.
_RING_STEPS = 1 << 16

#: Angle between successive samples of a sunflower, pi (3 - sqrt 5): no two arms line up.
GOLDEN_ANGLE_RAD = math.pi * (3.0 - math.sqrt(5.0))

Spacing = Literal["quadratic", "uniform"]


@dataclass(frozen=True, eq=False)
class Taps1D:
    """A symmetric 1-D Gaussian filter: ``offsets_sigma`` (n,) ascending, ``weights`` (n,).

    Offsets are in standard deviations; weights sum to 1, and the discrete variance is 1
    (for n = 1, the identity, it is 0).
    """

    offsets_sigma: Array
    weights: Array


@dataclass(frozen=True, eq=False)
class SeparableTaps:
    """One pass of a separable kernel: ``offsets_mm`` (n,) ascending, ``weights`` (n, 3).

    Weights are linear Rec.709, and each column sums to 1. Run once along x, once along y.
    ``cell_mm`` (n,) is how far a tap may be moved within its cell, to either side alike.
    """

    offsets_mm: Array
    weights: Array
    cell_mm: Array


@dataclass(frozen=True, eq=False)
class DiskTaps:
    """Points on a disk, inside out, each for a ring of the profile.

    ``radius_mm`` (n,) ascends, ``angle_rad`` (n,) is in [0, 2 pi), ``weights`` (n, 3) are each
    channel's energy in the ring, ``centre`` (3,) that inside the innermost: together 1.
    """

    radius_mm: Array
    angle_rad: Array
    weights: Array
    centre: Array


def gaussian_taps(samples: int, extent_sigma: float = 3.0) -> Taps1D:
    """Return ``samples`` taps (1 to 1023, odd or even) of the unit-variance Gaussian.

    Cells are uniform over +-``extent_sigma`` (0.5 to 8), the two end cells reach to infinity;
    a tap sits at its cell's centroid. Raises ConfigError for counts or extents out of range.

    Centroids keep the mean of each cell but drop the spread inside it, so the discrete
    variance falls short of 1 (law of total variance). Offsets are therefore scaled until it is
    1 to the last bit: blurs in sequence then add up to the variances v_k that the sum of
    Gaussians was fitted with, whatever the tap count.
    """
    _check_samples(samples, MAX_SAMPLES)
    _check_length(extent_sigma, "extent_sigma", 0.5, 8.0, "standard deviations")
    if samples == 1:
        return Taps1D(_frozen(np.zeros(1)), _frozen(np.ones(1)))
    # the right half only, mirrored below: symmetric to the last bit
    edges = extent_sigma * np.arange(samples % 2, samples + 1, 2) / samples
    edges[-1] = np.inf
    # erfc, not 1 - erf: the difference between two tail values must not cancel
    weights = 0.5 * -np.diff(erfc(edges / math.sqrt(2.0)))
    density = np.exp(-0.5 * np.square(edges)) / math.sqrt(2.0 * math.pi)
    centroids = -np.diff(density) / weights
    if samples % 2 == 1:
        centre = float(erf(edges[:1] / math.sqrt(2.0))[0])
        weights = np.concatenate((weights[::-1], [centre], weights))
        offsets = np.concatenate((-centroids[::-1], [0.0], centroids))
    else:
        weights = np.concatenate((weights[::-1], weights))
        offsets = np.concatenate((-centroids[::-1], centroids))
    weights /= math.fsum(weights)
    offsets /= math.sqrt(math.fsum(weights * np.square(offsets)))
    return Taps1D(_frozen(offsets), _frozen(weights))


def footprint_taps(
    sigma_px: npt.ArrayLike, radius_px: int, shift_px: float = 0.0, samples: int = 1
) -> Array:
    """Return integer taps (m, 2 radius + 1) of Gaussians ``sigma_px`` (m,) >= 0, seen by pixels.

    A pixel shows the mean over its footprint, and each of its ``samples`` along a direction stands
    for a cell of 1 / samples px. The tap at j is therefore (box_1 * box_{1/samples} * G) at
    j + ``shift_px``, the sample's place in the pixel, -0.5 to 0.5: over all samples the sum is the
    pixel's mean of the blurred light exactly, at any width, for steps between cells. Wide Gaussians
    tend to G, and at sigma 0 this is the identity. What lies beyond ``radius_px`` (1 to 64) counts
    at the ends, so that each row sums to 1. Raises ConfigError out of these ranges.
    """
    sigma = as_array(sigma_px).reshape(-1, 1)
    if not (bool(np.all(sigma >= 0.0)) and 1 <= radius_px <= 64 and samples >= 1):
        raise ConfigError("needs sigma_px >= 0, radius_px 1 to 64, samples >= 1", "sigma_px")
    cell = 1.0 / samples
    x = np.arange(-radius_px, radius_px, dtype=np.float64) + 0.5 + shift_px

    # The CDF between taps: the box of a pixel sums to a step, so what is left is box_cell * G. From
    # the nearer end, 1 - CDF on the right: differences of numbers near 1 leave weights of -1e-16,
    # which are negative light beside bright light.
    def integral(at: Array) -> Array:
        """Twice integrated Gaussian, x Phi(x / sigma) + sigma phi(x / sigma); max(x, 0) at 0.

        What it is above max(x, 0), by erfcx: exp and erfc cancel each other far out.
        """
        u = np.abs(at) / np.maximum(sigma, 1e-12)
        density = np.exp(-0.5 * np.square(u)) / math.sqrt(2.0 * math.pi)
        mills = math.sqrt(0.5 * math.pi) * erfcx(u / math.sqrt(2.0))
        return np.asarray(sigma * density * (1.0 - u * mills) + np.maximum(at, 0.0))

    outside = -np.abs(x)
    return _folded((integral(outside + 0.5 * cell) - integral(outside - 0.5 * cell)) / cell, x)


def discrete_gaussian_taps(sigma_px: npt.ArrayLike, radius_px: int) -> Array:
    """Return integer taps (m, 2 radius + 1) that blur by the variances ``sigma_px`` (m,)^2 exactly.

    T(j, v) = e^{-v} I_j(v), the discrete analogue of the Gaussian (Lindeberg 1990, "Scale-space
    for discrete signals"): variance v at any width, T(v1) * T(v2) = T(v1 + v2), the identity at 0.
    A sampled Gaussian has neither below a pixel. Ends as in ``footprint_taps``.
    """
    sigma = as_array(sigma_px).reshape(-1, 1)
    if not (bool(np.all(sigma >= 0.0)) and 1 <= radius_px <= 64):
        raise ConfigError("needs sigma_px >= 0 and radius_px 1 to 64", "sigma_px")
    order = np.arange(-radius_px, radius_px + 1, dtype=np.float64)
    weights = scaled_bessel_i(np.abs(order)[None], np.square(sigma))
    lost = np.maximum(1.0 - weights.sum(axis=1), 0.0)  # no rounding below nothing
    weights[:, 0] += 0.5 * lost
    weights[:, -1] += 0.5 * lost
    return weights


def falloff_per_mm2(profile: DiffusionProfile, offsets_mm: npt.ArrayLike) -> Array:
    """Return q (n, 3) so that a(sqrt(x^2 + z^2)) is near a(x) exp(-q z^2), a the line marginal.

    q = -a'(x) / (2 x a(x)), 1/mm^2: exact for one Gaussian (1 / 2v), exact to first order in z^2
    for every profile. At x = 0 it is taken a thousandth of the profile's width away. What lets a
    separable kernel see depth in mm, with no scale constant.
    """
    widths = np.asarray(profile.radius_for(0.5))
    x = np.maximum(np.abs(as_array(offsets_mm))[:, None], 1e-3 * widths.min())
    result = np.empty((len(x), 3))
    for row, at in enumerate(x[:, 0]):
        near, here, far = (profile.line_marginal(at * f) for f in (0.999, 1.0, 1.001))
        slope = (np.asarray(far) - np.asarray(near)) / (0.002 * at)
        result[row] = -slope / (2.0 * at * np.maximum(np.asarray(here), 1e-300))
    return np.maximum(result, 0.0)


def separable_preintegrated(
    profile: DiffusionProfile, samples: int, extent_mm: float, spacing: Spacing = "quadratic"
) -> SeparableTaps:
    """Return the taps of the pre-integrated separable kernel of ``profile``.

    The 1-D kernel is the line marginal a(x) = integral of R(sqrt(x^2 + y^2)) dy, and the 2-D
    one a(x) a(y) (Jimenez et al. 2015, "Separable Subsurface Scattering"): exact
    for straight edges along x or y, but a rank-1 picture of a round profile (28 % of red's
    energy is misplaced). ``samples`` is 1 to 1023, ``extent_mm`` 1e-6 to 1e6 mm, ``spacing`` as
    in ``tap_positions``. Raises ConfigError out of these ranges.
    """
    offsets, inner_edges = tap_positions(samples, extent_mm, spacing)
    return _cells(offsets, profile.line_cdf(inner_edges))


def separable_artistic(
    near_sigma: npt.ArrayLike,
    far_sigma: npt.ArrayLike,
    strength: npt.ArrayLike,
    samples: int,
    extent: float,
    spacing: Spacing = "quadratic",
) -> SeparableTaps:
    """Return the taps of the artistic kernel w G(near, x) + (1 - w) G(far, x), per channel.

    ``near_sigma`` and ``far_sigma`` (3,) are standard deviations in mm, ``strength`` (3,) the
    weight w of the near Gaussian in 0 to 1, ``extent`` the half width in mm; the rest as in
    ``separable_preintegrated`` (Jimenez et al. 2015). Raises ConfigError.
    """
    near = _checked_sigmas(near_sigma, "near_sigma")
    far = _checked_sigmas(far_sigma, "far_sigma")
    w = as_array(checked_rgb(strength, "strength", 0.0, 1.0))
    offsets, inner_edges = tap_positions(samples, extent, spacing)
    x = inner_edges[:, None] / math.sqrt(2.0)
    cumulative = 0.5 * (1.0 + w * erf(x / near) + (1.0 - w) * erf(x / far))
    return _cells(offsets, cumulative)


def tap_positions(samples: int, extent_mm: float, spacing: Spacing) -> tuple[Array, Array]:
    """Return tap offsets (n,) over +-``extent_mm`` and the n - 1 cell edges between them, mm.

    Edges lie halfway between taps. ``quadratic`` puts taps at extent * sign(t) t^2, dense where
    profiles are steep (the spacing of Jimenez' demo); ``uniform`` at extent * t; t in [-1, 1].
    Odd counts have a tap at exactly 0. Raises ConfigError for what is out of range.
    """
    _check_samples(samples, MAX_SAMPLES)
    _check_length(extent_mm, "extent_mm", MIN_LENGTH_MM, MAX_LENGTH_MM, "mm")
    # integers over an integer: exactly symmetric, exactly 0 in the middle
    t = np.arange(1 - samples, samples, 2, dtype=np.float64) / max(samples - 1, 1)
    if spacing == "quadratic":
        t = np.sign(t) * np.square(t)
    elif spacing != "uniform":
        raise ConfigError(f"unknown spacing {spacing!r}", "spacing", "use quadratic or uniform")
    offsets = extent_mm * t
    return offsets, 0.5 * (offsets[1:] + offsets[:-1])


def disk_taps(
    profile: DiffusionProfile,
    n: int,
    inner_radius_mm: float = 0.0,
    outer_radius_mm: float = math.inf,
) -> DiskTaps:
    """Return ``n`` (1 to 1023) golden-angle taps, each for a ring that holds 1/n of the mean of the
    channels' energy between ``inner_radius_mm`` and ``outer_radius_mm``.

    What lies inside belongs to the pixel itself, and needs no tap; what lies outside is left out of
    the weights, for a subject that is not as large. Drawn from the widest channel alone, a narrow
    one meets a few taps by chance; of the mean each channel has its share of them. A tap's weights
    are exact ring integrals and it stands at the ring's root mean square radius, so that a constant
    stays constant and the variance is that of the profile. Raises ConfigError for n out of range.
    """
    _check_samples(n, MAX_SAMPLES)
    reach = float(profile.radius_for(1.0 - 1e-6).max())
    inner = float(np.clip(inner_radius_mm, 0.0, reach))
    # Finer where the narrow channels are: their rings are micrometres wide.
    is_cut = outer_radius_mm < 1.5 * reach
    end = max(outer_radius_mm, 2.0 * inner) if is_cut else 1.5 * reach
    r = inner + (end - inner) * np.linspace(0.0, 1.0, _RING_STEPS) ** 3
    mean = profile.cdf(r).mean(axis=1)
    whole = mean[-1] if is_cut else 1.0
    shares = mean[0] + (whole - mean[0]) * np.arange(1, n) / n
    borders = np.interp(shares, mean, r)
    within = profile.cdf(np.concatenate([[inner], borders]))
    last = profile.cdf(np.array([end])) if is_cut else np.ones((1, 3))
    weights = np.diff(np.concatenate([within, last]), axis=0)
    middle = 0.5 * (r[1:] + r[:-1])
    ring = np.searchsorted(borders, middle)
    mass = np.diff(mean)
    square = np.bincount(ring, mass * middle**2, n)
    total = np.bincount(ring, mass, n)
    # Where next to nothing lies outside, a ring may hold none of the steps.
    radius = np.sqrt(square / np.maximum(total, 1e-300))
    return DiskTaps(
        radius_mm=_frozen(np.maximum.accumulate(np.maximum(radius, inner))),
        angle_rad=_frozen(np.mod(np.arange(n) * GOLDEN_ANGLE_RAD, 2.0 * math.pi)),
        weights=_frozen(weights),
        centre=_frozen(within[0]),
    )


def _cells(offsets_mm: Array, cumulative: Array) -> SeparableTaps:
    """Return taps whose weights are differences of ``cumulative`` (n - 1, 3), 0 and 1 outside."""
    ends = np.zeros((1, 3)), np.ones((1, 3))
    weights = np.diff(np.concatenate((ends[0], cumulative.reshape(-1, 3), ends[1])), axis=0)
    # the profile is even; make the taps so to the last bit, or a mirrored face differs
    weights = 0.5 * (weights + weights[::-1])
    half_gaps = 0.5 * np.diff(offsets_mm)
    outside = np.zeros(1) if len(offsets_mm) == 1 else half_gaps[:1]
    cell = np.minimum(np.concatenate((outside, half_gaps)), np.concatenate((half_gaps, outside)))
    return SeparableTaps(_frozen(offsets_mm), _frozen(weights), _frozen(cell))


def _folded(tails: Array, edges: Array) -> Array:
    """Return tap weights (m, n + 1) from what lies beyond the n ``edges`` between taps (n,): to the
    left of those up to 0, to the right of the others, ``tails`` (m, n)."""
    none = np.zeros((len(tails), 1))
    beyond = np.concatenate((none, tails, none), axis=1)
    is_left = np.concatenate(([True], edges <= 0.0, [False]))
    low, high = beyond[:, :-1], beyond[:, 1:]
    middle = np.where(is_left[:-1], 1.0 - low - high, low - high)
    return np.asarray(np.where(is_left[1:], high - low, middle))


def _checked_sigmas(sigma_mm: npt.ArrayLike, where: str) -> Array:
    return as_array(checked_rgb(sigma_mm, where, MIN_LENGTH_MM, MAX_LENGTH_MM, unit=" mm"))


def _check_samples(samples: int, most: int) -> None:
    if not 1 <= samples <= most:
        raise ConfigError(f"{samples} samples is outside 1 to {most}", "samples")


def _check_length(value: float, where: str, low: float, high: float, unit: str) -> None:
    if not low <= value <= high:
        raise ConfigError(f"{value:g} is outside {low:g} to {high:g} {unit}", where)


def _frozen(array: Array) -> Array:
    array.flags.writeable = False
    return array
