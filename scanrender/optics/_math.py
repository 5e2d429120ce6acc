"""Special functions with types, so that the one untyped import lives in one place."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import TypeAlias, cast

import numpy as np
import numpy.typing as npt
from scipy import special

Array: TypeAlias = npt.NDArray[np.float64]
Rgb: TypeAlias = tuple[float, float, float]

_UfuncOfOne: TypeAlias = Callable[[Array], Array]

erf = cast(_UfuncOfOne, special.erf)
#: exp(x^2) erfc(x), which neither overflows nor cancels.
erfcx = cast(_UfuncOfOne, special.erfcx)
erfc = cast(_UfuncOfOne, special.erfc)
bessel_k0 = cast(_UfuncOfOne, special.k0)
#: e^{-x} I_n(x) of order n and x, broadcast.
scaled_bessel_i = cast(Callable[[Array, Array], Array], special.ive)
_integrals_of_i0_and_k0 = cast(Callable[[Array], tuple[Array, Array]], special.iti0k0)


def as_array(values: npt.ArrayLike) -> Array:
    """Return ``values`` as a float64 array of unchanged shape (scalars become shape ``()``)."""
    return np.asarray(values, dtype=np.float64)


def bessel_k0_integral(x: Array) -> Array:
    """Return the integral of K0 from 0 to ``x`` >= 0, any shape, within 2e-12; at inf, pi/2.

    K0 is log-singular at 0 but integrable (Abramowitz & Stegun 11.1).
    """
    # scipy returns NaN for subnormal x, where the integral is below 1e-297 anyway
    return _integrals_of_i0_and_k0(np.where(x < 1e-300, 0.0, x))[1]


@lru_cache(maxsize=16)
def gauss_legendre(nodes: int) -> tuple[Array, Array]:
    """Return Gauss-Legendre nodes and weights, (nodes,) each, on [-1, 1]; read only."""
    node, weight = np.polynomial.legendre.leggauss(nodes)
    node.flags.writeable = False  # shared by every caller
    weight.flags.writeable = False
    return node, weight
