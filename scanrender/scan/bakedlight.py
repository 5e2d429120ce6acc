"""How much of the capture's light is baked into the albedo.

The light's low frequencies depend on the normal only: luminance is fitted by the first four
spherical harmonics (Ramamoorthi and Hanrahan, An Efficient Representation for Irradiance
Environment Maps, SIGGRAPH 2001) over skin. Albedo of one material should not know where it faces.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[Any]

# Share of explained variance and contrast above which a warning is worth reading: an evenly lit
# studio capture has .01 and .02, a clinical one with two flashes .12 and .37.
WARN_EXPLAINED, WARN_CONTRAST = 0.08, 0.15
SAMPLES = 50_000


def fit_light(value: Array, normal: Array, seed: int = 0) -> npt.NDArray[np.float64]:
    """(4,) weights of [1, normal] that fit the logarithms value (k,) at normals (k, 3) best.

    At most SAMPLES of them are looked at. Normals of one direction leave the rest of the light
    unknown: it is then taken as none.
    """
    chosen = np.random.default_rng(seed).permutation(len(value))[:SAMPLES]
    basis = np.column_stack([np.ones(len(chosen)), normal[chosen]]).astype(np.float64)
    weight, *_ = np.linalg.lstsq(basis, value[chosen].astype(np.float64), rcond=1e-6)
    return np.asarray(weight, np.float64)


def baked_light(albedo: Array, normal: Array, skin: Array, seed: int = 0) -> dict[str, Any] | None:
    """Fit luminance by a + b . normal over skin: albedo (k, 3) linear, normal (k, 3), skin (k,).

    Returns `explained` (share of the variance of log luminance), `contrast` (standard deviation of
    the fit, as a ratio) and `direction` toward which the scan is brighter; None with too little
    skin.
    """
    chosen = np.flatnonzero(skin > 0.5)
    if len(chosen) < 200:
        return None
    luminance = albedo[chosen].astype(np.float64) @ [0.2126, 0.7152, 0.0722]
    value = np.log(np.maximum(luminance, 1e-4))
    weight = fit_light(value, normal[chosen], seed)
    fit = weight[0] + normal[chosen] @ weight[1:]
    variance = float(value.var())
    length = max(float(np.linalg.norm(weight[1:])), 1e-12)
    return {
        "explained": float(fit.var() / variance) if variance > 1e-12 else 0.0,
        "contrast": float(np.expm1(fit.std())),
        "direction": [float(x) for x in weight[1:] / length],
    }
