"""Checks that all profiles share, so that they refuse the same things in the same words."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from scanrender.errors import ConfigError
from scanrender.optics._math import Array, Rgb, as_array

# A scattering length outside this range is a unit mistake; inside it, neither 1/v nor exp
# overflows in float64.
MIN_LENGTH_MM = 1e-6
MAX_LENGTH_MM = 1e6


def checked_rgb(
    values: npt.ArrayLike, where: str, low: float, high: float, *, unit: str = ""
) -> Rgb:
    """Return ``values`` as three floats in [low, high], or raise ConfigError naming ``where``."""
    try:
        array = as_array(values)
    except (TypeError, ValueError) as error:
        raise ConfigError(f"{values!r} is not three numbers", where) from error
    if array.shape != (3,):
        raise ConfigError(
            f"expected three numbers (R, G, B), got shape {array.shape}",
            where,
            "give one value per channel",
        )
    if not bool(np.all((array >= low) & (array <= high))):
        raise ConfigError(
            f"{array.tolist()} is outside {low:g} to {high:g}{unit}",
            where,
            "use finite numbers in that range",
        )
    red, green, blue = (float(value) for value in array)
    return red, green, blue


def checked_fraction(fraction: npt.ArrayLike) -> Array:
    """Return ``fraction`` as an array in [0, 1), or raise ConfigError.

    1 is refused: no finite radius encloses all of a profile's energy.
    """
    array = as_array(fraction)
    if not bool(np.all((array >= 0.0) & (array < 1.0))):
        raise ConfigError(
            "an enclosed energy fraction must be at least 0 and less than 1",
            "fraction",
            "use 0.999 for nearly everything",
        )
    return array


def invert_increasing(
    function: Callable[[Array], Array], target: Array, first_guess: Array
) -> Array:
    """Return x >= 0 with function(x) = target, elementwise, to float64 resolution.

    ``function`` maps ``(..., 3)`` to ``(..., 3)`` channel by channel, rises from 0 at 0, and
    must exceed ``target`` somewhere. Bracketing cannot diverge, unlike Newton on a sum of
    Gaussians whose widths differ by 30 times.
    """
    low = np.zeros_like(target)
    high = np.broadcast_to(first_guess, target.shape).astype(np.float64)
    for _ in range(200):
        short = function(high) < target
        if not bool(np.any(short)):
            break
        low = np.where(short, high, low)
        high = np.where(short, 2.0 * high, high)
    for _ in range(1100):  # enough to halve any float64 bracket to one ulp, even at zero
        middle = 0.5 * (low + high)
        if bool(np.all((middle <= low) | (middle >= high))):
            break
        short = function(middle) < target
        low, high = np.where(short, middle, low), np.where(short, high, middle)
    return high
