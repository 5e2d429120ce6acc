"""How far two pictures are apart: colour difference, FLIP, and errors of linear light.

NumPy only, so that the plan, the trade study and the tests share it. Images are (H, W, 3)
float arrays; "linear" means scene-linear Rec.709, "srgb" means encoded sRGB in [0, 1]. Masks
are boolean (H, W). Per-pixel maps come back as float64 (H, W); a NaN in stays a NaN out, so
that a broken pixel is never averaged away. Wrong shapes raise ValueError.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

Array: TypeAlias = npt.NDArray[np.float64]
Mask: TypeAlias = npt.NDArray[np.bool_]

# Rec.709 primaries and D65 white at xy = (0.3127, 0.3290), as the exact fractions that FLIP's
# authors derive from BT.709; the rows' sums are the white point.
_XYZ_FROM_LINEAR = np.array(
    [
        [10135552 / 24577794, 8788810 / 24577794, 4435075 / 24577794],
        [2613072 / 12288897, 8788810 / 12288897, 887015 / 12288897],
        [1425312 / 73733382, 8788810 / 73733382, 70074185 / 73733382],
    ]
)
_LINEAR_FROM_XYZ = np.linalg.inv(_XYZ_FROM_LINEAR)
_WHITE_XYZ = _XYZ_FROM_LINEAR.sum(axis=1)

# CIE 15: f(t) is a cube root above (6/29)^3 and its tangent line below. As float literals, since
# 6/29 in integer arithmetic is how one port of Lab came to be 0.
_LAB_DELTA = 6.0 / 29.0


@dataclass(frozen=True)
class Summary:
    """A per-pixel map over a mask: mean, 95 % quantile, maximum, and number of pixels.

    With ``count`` 0 the figures are NaN: no pixels is not a perfect score.
    """

    mean: float
    p95: float
    maximum: float
    count: int


def summarize(values: npt.ArrayLike, mask: Mask | None = None) -> Summary:
    """Return the Summary of ``values`` (H, W) where ``mask`` (H, W), or everywhere."""
    chosen = _select(_as_array(values), mask)
    if chosen.size == 0:
        return Summary(math.nan, math.nan, math.nan, 0)
    return Summary(
        mean=float(np.mean(chosen)),
        p95=float(np.quantile(chosen, 0.95)),
        maximum=float(np.max(chosen)),
        count=int(chosen.size),
    )


def rmse(image: npt.ArrayLike, reference: npt.ArrayLike, mask: Mask | None = None) -> float:
    """Root mean square error over masked pixels and channels, in the images' unit; NaN if none."""
    test, truth = _pair(image, reference)
    squared = _select(np.square(test - truth), mask)
    return math.sqrt(float(np.mean(squared))) if squared.size else math.nan


def rel_mse(
    image: npt.ArrayLike,
    reference: npt.ArrayLike,
    mask: Mask | None = None,
    *,
    epsilon: float = 1e-2,
) -> float:
    """Mean of (image - reference)^2 / (reference^2 + epsilon), dimensionless; NaN if no pixels.

    The relative error of Rousselle et al. 2011, with their epsilon 0.01, which keeps
    black pixels from deciding the result.
    """
    test, truth = _pair(image, reference)
    relative = _select(np.square(test - truth) / (np.square(truth) + epsilon), mask)
    return float(np.mean(relative)) if relative.size else math.nan


def energy_ratio(image: npt.ArrayLike, reference: npt.ArrayLike, mask: Mask | None = None) -> Array:
    """Sum of ``image`` over sum of ``reference`` per channel over the mask, (3,); NaN at 0/0."""
    test, truth = _pair(image, reference)
    total = _select(truth, mask).sum(axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(_select(test, mask).sum(axis=0) / total)


def lab_from_linear_rec709(linear: npt.ArrayLike) -> Array:
    """CIE L*a*b* (D65) of scene-linear Rec.709 (..., 3); (1, 1, 1) is exactly (100, 0, 0).

    Negative light follows the straight piece of f and stays finite (CIE 15:2004, 8.2.1).
    """
    return _lab_from_xyz(_as_array(linear) @ _XYZ_FROM_LINEAR.T)


def linear_from_srgb(srgb: npt.ArrayLike) -> Array:
    """Decode sRGB in [0, 1], any shape, to linear (IEC 61966-2-1). Clamped to [0, 1]."""
    value = np.clip(_as_array(srgb), 0.0, 1.0)
    return np.asarray(np.where(value > 0.04045, ((value + 0.055) / 1.055) ** 2.4, value / 12.92))


def delta_e_2000(lab_1: npt.ArrayLike, lab_2: npt.ArrayLike) -> Array:
    """CIEDE2000 difference of two L*a*b* arrays (..., 3), as (...); about 1 is just noticeable.

    Sharma, Wu & Dalal 2005, "The CIEDE2000 Color-Difference Formula: Implementation Notes",
    eq. 2-22, with k_L = k_C = k_H = 1. Symmetric; hue angles in radians.
    """
    l_1, a_1, b_1 = np.moveaxis(_as_array(lab_1), -1, 0)
    l_2, a_2, b_2 = np.moveaxis(_as_array(lab_2), -1, 0)
    mean_chroma = 0.5 * (np.hypot(a_1, b_1) + np.hypot(a_2, b_2))
    stretch = 1.5 - 0.5 * np.sqrt(_seventh_power_share(mean_chroma))  # 1 + G, eq. 4-5
    a_1, a_2 = stretch * a_1, stretch * a_2
    c_1, c_2 = np.hypot(a_1, b_1), np.hypot(a_2, b_2)
    h_1, h_2 = _hue(a_1, b_1), _hue(a_2, b_2)

    turn = h_2 - h_1
    turn = np.where(turn > math.pi, turn - 2 * math.pi, turn)
    turn = np.where(turn < -math.pi, turn + 2 * math.pi, turn)
    d_lightness, d_chroma = l_2 - l_1, c_2 - c_1
    # 0 where either is grey, so that a grey's meaningless hue below has no weight either
    d_hue = 2.0 * np.sqrt(c_1 * c_2) * np.sin(0.5 * turn)

    lightness, chroma = 0.5 * (l_1 + l_2), 0.5 * (c_1 + c_2)
    total = h_1 + h_2
    far = np.abs(h_1 - h_2) > math.pi  # the short way passes through hue 0
    hue = 0.5 * (total + np.where(far, np.where(total < 2 * math.pi, 2.0, -2.0) * math.pi, 0.0))
    return _weighted_difference(d_lightness, d_chroma, d_hue, lightness, chroma, hue)


def delta_e_2000_linear(image: npt.ArrayLike, reference: npt.ArrayLike) -> Array:
    """CIEDE2000 of two linear Rec.709 images (..., 3), clamped to [0, 1] as a display would."""
    test, truth = _pair(image, reference)
    return delta_e_2000(
        lab_from_linear_rec709(np.clip(test, 0.0, 1.0)),
        lab_from_linear_rec709(np.clip(truth, 0.0, 1.0)),
    )


def _seventh_power_share(chroma: Array) -> Array:
    """Return C^7 / (C^7 + 25^7), written so that it cannot overflow."""
    ratio = np.power(chroma / 25.0, 3.5)
    return np.square(ratio / np.hypot(ratio, 1.0))


def _hue(a: Array, b: Array) -> Array:
    """Return the hue angle in [0, 2 pi), 0 for grey (eq. 7)."""
    return np.mod(np.arctan2(b, a), 2.0 * math.pi)


def _weighted_difference(
    d_lightness: Array, d_chroma: Array, d_hue: Array, lightness: Array, chroma: Array, hue: Array
) -> Array:
    """Return eq. 15-22 of Sharma et al.: weights at the mean colour, then the difference."""
    degree = math.pi / 180.0
    t = (
        1.0
        - 0.17 * np.cos(hue - 30.0 * degree)
        + 0.24 * np.cos(2.0 * hue)
        + 0.32 * np.cos(3.0 * hue + 6.0 * degree)
        - 0.20 * np.cos(4.0 * hue - 63.0 * degree)
    )
    from_50 = np.square(lightness - 50.0)
    s_lightness = 1.0 + 0.015 * from_50 / np.sqrt(20.0 + from_50)
    s_chroma = 1.0 + 0.045 * chroma
    s_hue = 1.0 + 0.015 * chroma * t
    d_theta = 30.0 * degree * np.exp(-np.square((hue / degree - 275.0) / 25.0))
    rotation = -np.sin(2.0 * d_theta) * 2.0 * np.sqrt(_seventh_power_share(chroma))
    x, y, z = d_lightness / s_lightness, d_chroma / s_chroma, d_hue / s_hue
    # the rotation term can leave -1e-17 under the root for equal colours
    squared = np.square(x) + np.square(y) + np.square(z) + rotation * y * z
    return np.asarray(np.sqrt(np.maximum(squared, 0.0)))


# --- FLIP ----------------------------------------------------------------------------------
# Andersson et al. 2020, "FLIP: A Difference Evaluator for Alternating Images", HPG. Symbols and
# constants are the paper's.

#: 0.7 m from a 0.7 m wide, 3840 pixel screen: 3840 / 0.7 * 0.7 * pi / 180.
DEFAULT_PPD = 3840.0 * math.pi / 180.0

_CONTRAST_SENSITIVITY = (  # (a1, b1, a2, b2) of A, RG, BY; b in square degrees
    (1.0, 0.0047, 0.0, 1e-5),
    (1.0, 0.0053, 0.0, 1e-5),
    (34.1, 0.04, 13.5, 0.025),
)
_COLOUR_EXPONENT = 0.7  # q_c
_COLOUR_KNEE = 0.4  # p_c
_COLOUR_KNEE_VALUE = 0.95  # p_t
_FEATURE_WIDTH_DEGREES = 0.082  # w
_FEATURE_EXPONENT = 0.5  # q_f

# Strips this high of a wide image stay in cache between taps: about a quarter faster.
_STRIP_ROWS = 16


def flip(srgb: npt.ArrayLike, reference_srgb: npt.ArrayLike, ppd: float = DEFAULT_PPD) -> Array:
    """LDR-FLIP map (H, W) in [0, 1] of two encoded sRGB images (H, W, 3) clamped to [0, 1].

    The difference seen when flipping between the two at ``ppd`` pixels per degree, which a
    report must state: the same images differ less from farther away. Symmetric; 0 for equal
    images. Raises ValueError for ppd outside 1 to 1000.
    """
    if not 1.0 <= ppd <= 1000.0:
        raise ValueError(f"{ppd:g} pixels per degree is outside 1 to 1000")
    test, truth = _pair(srgb, reference_srgb)
    if test.ndim != 3:
        raise ValueError(f"FLIP needs (H, W, 3) images, got {test.shape}")
    opponent_test, opponent_truth = _opponent_from_srgb(test), _opponent_from_srgb(truth)
    colour = _flip_colour(opponent_test, opponent_truth, ppd)
    feature = _flip_feature(opponent_test[..., 0], opponent_truth[..., 0], ppd)
    return np.power(colour, 1.0 - feature)


def _opponent_from_srgb(srgb: Array) -> Array:
    """Return YCxCz, the opponent space in which contrast sensitivity is separable."""
    x, y, z = np.moveaxis(linear_from_srgb(srgb) @ _XYZ_FROM_LINEAR.T / _WHITE_XYZ, -1, 0)
    return np.stack((116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)), axis=-1)


def _linear_from_opponent(opponent: Array) -> Array:
    y = (opponent[..., 0] + 16.0) / 116.0
    x, z = y + opponent[..., 1] / 500.0, y - opponent[..., 2] / 200.0
    return np.asarray(np.stack((x, y, z), axis=-1) * _WHITE_XYZ @ _LINEAR_FROM_XYZ.T)


def _flip_colour(test: Array, truth: Array, ppd: float) -> Array:
    """Return the colour difference in [0, 1] of two YCxCz images."""
    perceived = []
    for opponent in (test, truth):
        filtered = np.clip(_linear_from_opponent(_contrast_filtered(opponent, ppd)), 0.0, 1.0)
        perceived.append(_hunt_adjusted(lab_from_linear_rec709(filtered)))
    distance = np.power(_hyab(perceived[0], perceived[1]), _COLOUR_EXPONENT)
    primaries = _hunt_adjusted(lab_from_linear_rec709(np.eye(3)))
    largest = float(_hyab(primaries[1], primaries[2])) ** _COLOUR_EXPONENT  # green to blue
    knee = _COLOUR_KNEE * largest
    above = (distance - knee) / (largest - knee) * (1.0 - _COLOUR_KNEE_VALUE) + _COLOUR_KNEE_VALUE
    return np.asarray(np.where(distance < knee, _COLOUR_KNEE_VALUE / knee * distance, above))


def _contrast_filtered(opponent: Array, ppd: float) -> Array:
    """Blur each opponent channel by what the eye cannot resolve at ``ppd``."""
    widest = max(b for _, b_1, _, b_2 in _CONTRAST_SENSITIVITY for b in (b_1, b_2))
    radius = math.ceil(3.0 * math.sqrt(widest / (2.0 * math.pi**2)) * ppd)
    degrees = np.arange(-radius, radius + 1) / ppd
    channels = []
    for channel, (a_1, b_1, a_2, b_2) in enumerate(_CONTRAST_SENSITIVITY):
        blurred, total = np.zeros(opponent.shape[:2]), 0.0
        for a, b in ((a_1, b_1), (a_2, b_2)):
            if a == 0.0:
                continue
            taps = np.exp(-(math.pi**2) / b * np.square(degrees))
            # sqrt(pi / b) as published; the 2-D transform of the sensitivity would have pi / b
            amplitude = a * math.sqrt(math.pi / b)
            blurred += amplitude * _filtered(opponent[..., channel], taps, taps)
            total += amplitude * float(taps.sum()) ** 2
        channels.append(blurred / total)
    return np.stack(channels, axis=-1)


def _hunt_adjusted(lab: Array) -> Array:
    """Return L*a*b* with chroma scaled by lightness: dim colours look greyer."""
    return lab * np.stack((np.ones_like(lab[..., 0]), *(0.01 * lab[..., 0],) * 2), axis=-1)


def _hyab(lab_1: Array, lab_2: Array) -> Array:
    """Return |dL| + sqrt(da^2 + db^2), better than dE for large differences."""
    d = lab_1 - lab_2
    return np.asarray(np.abs(d[..., 0]) + np.hypot(d[..., 1], d[..., 2]))


def _flip_feature(test_y: Array, truth_y: Array, ppd: float) -> Array:
    """Return the edge and point difference in [0, 1] of two Y images."""
    sigma = 0.5 * _FEATURE_WIDTH_DEGREES * ppd
    radius = math.ceil(3.0 * sigma)
    x = np.arange(-radius, radius + 1, dtype=np.float64)
    gaussian = np.exp(-np.square(x) / (2.0 * sigma**2))
    smooth = gaussian / gaussian.sum()
    edge = _balanced(-x * gaussian)
    point = _balanced((np.square(x / sigma) - 1.0) * gaussian)
    differences = []
    for derivative in (edge, point):
        strengths = []
        for y in ((test_y + 16.0) / 116.0, (truth_y + 16.0) / 116.0):
            along_x = _filtered(y, smooth, derivative)
            along_y = _filtered(y, derivative, smooth)
            strengths.append(np.hypot(along_x, along_y))
        differences.append(np.abs(strengths[0] - strengths[1]))
    strongest = np.maximum(differences[0], differences[1]) / math.sqrt(2.0)
    return np.asarray(np.power(np.minimum(strongest, 1.0), _FEATURE_EXPONENT))


def _balanced(taps: Array) -> Array:
    """Return ``taps`` with its positive part summing to 1 and its negative part to -1."""
    positive, negative = np.maximum(taps, 0.0), np.maximum(-taps, 0.0)
    return np.asarray(positive / positive.sum() - negative / negative.sum())


def _filtered(image: Array, taps_y: Array, taps_x: Array) -> Array:
    """Correlate ``image`` (H, W) with two odd 1-D filters, repeating the border pixels."""
    radius_y, radius_x = taps_y.size // 2, taps_x.size // 2
    height, width = image.shape
    padded = np.pad(image, ((radius_y, radius_y), (radius_x, radius_x)), mode="edge")
    result = np.zeros((height, width))
    for top in range(0, height, _STRIP_ROWS):
        target = result[top : top + _STRIP_ROWS]
        rows = np.zeros((target.shape[0], padded.shape[1]))
        for index, tap in enumerate(taps_y.tolist(), start=top):
            rows += tap * padded[index : index + rows.shape[0]]
        for index, tap in enumerate(taps_x.tolist()):
            target += tap * rows[:, index : index + width]
    return result


# --- shared --------------------------------------------------------------------------------


def _as_array(values: npt.ArrayLike) -> Array:
    return np.asarray(values, dtype=np.float64)


def _lab_from_xyz(xyz: Array) -> Array:
    t = xyz / _WHITE_XYZ
    f = np.where(t > _LAB_DELTA**3, np.cbrt(t), t / (3.0 * _LAB_DELTA**2) + 4.0 / 29.0)
    fx, fy, fz = np.moveaxis(f, -1, 0)
    return np.stack((116.0 * fy - 16.0, 500.0 * (fx - fy), 200.0 * (fy - fz)), axis=-1)


def _pair(image: npt.ArrayLike, reference: npt.ArrayLike) -> tuple[Array, Array]:
    test, truth = _as_array(image), _as_array(reference)
    if test.shape != truth.shape or test.shape[-1:] != (3,):
        raise ValueError(f"expected two (..., 3) images, got {test.shape} and {truth.shape}")
    return test, truth


def _select(values: Array, mask: Mask | None) -> Array:
    """Return ``values`` (H, W, ...) where ``mask`` (H, W), flattened over pixels."""
    if mask is None:
        return values.reshape(-1, *values.shape[2:])
    if mask.dtype != np.bool_ or mask.shape != values.shape[:2]:
        raise ValueError(f"a mask of {mask.shape} {mask.dtype} does not fit {values.shape}")
    return values[mask]
