"""A probability of skin for each texel, from colour alone.

Skin is the dominant cluster of a portrait scan in CIE Lab; brows, beard, hair and eyes lie
apart from it. First version: a robust centre and spread, and a smooth fall with the distance.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from scipy import ndimage

from scanrender.metrics import lab_from_linear_rec709

Array = npt.NDArray[Any]

# Lightness varies with baked-in light far more than hue does: it counts less.
LIGHTNESS_WEIGHT = 0.55
REDDER_WEIGHT = 0.3
FULL_DISTANCE = 2.0  # in spreads: certainly skin
NO_DISTANCE = 6.0  # in spreads: certainly not
MIN_SPREAD = 4.0  # Lab units; below this the eye itself hardly tells two skins apart


def skin_probability(
    albedo: Array, covered: npt.NDArray[np.bool_], sigma_px: float
) -> tuple[npt.NDArray[np.float32], list[float]]:
    """(h, w) in [0, 1] from linear albedo (h, w, 3), and the skin's Lab colour.

    Only covered texels take part. sigma_px: smoothing, about 1 mm in texels.
    """
    smooth = _masked_blur(albedo, covered, sigma_px)
    lab = lab_from_linear_rec709(smooth).astype(np.float32)
    sample = lab[covered]
    rng = np.random.default_rng(0)
    if len(sample) > 50_000:
        sample = sample[rng.choice(len(sample), 50_000, replace=False)]
    center, spread = _dominant(sample)
    scaled = (lab - center) / spread
    # Redder than the rest is still skin: lips, cheeks, ears. Hair, brows and eyes lose red.
    scaled[..., 1] *= np.where(scaled[..., 1] > 0.0, REDDER_WEIGHT, 1.0)
    distance = np.sqrt((scaled**2).sum(axis=-1))
    fall = np.clip((distance - FULL_DISTANCE) / (NO_DISTANCE - FULL_DISTANCE), 0.0, 1.0)
    probability = 1.0 - fall * fall * (3.0 - 2.0 * fall)
    return probability.astype(np.float32), [float(x) for x in center]


def _dominant(sample: Array) -> tuple[Array, Array]:
    """Centre (3,) and spread (3,) of the densest part of the samples, by mean shift and MAD."""
    weight = np.array([LIGHTNESS_WEIGHT, 1.0, 1.0])
    center = np.median(sample, axis=0)
    for radius in (40.0, 25.0, 18.0, 14.0, 14.0, 14.0):
        near = (((sample - center) * weight) ** 2).sum(axis=1) < radius * radius
        if near.sum() < 16:
            break
        center = np.median(sample[near], axis=0)
    near = (((sample - center) * weight) ** 2).sum(axis=1) < 20.0**2
    spread = 1.4826 * np.median(np.abs(sample[near] - center), axis=0)
    return center, np.maximum(spread, MIN_SPREAD) / weight


def _masked_blur(image: Array, covered: npt.NDArray[np.bool_], sigma: float) -> Array:
    """Gaussian blur (normalised convolution) that neither reads nor darkens at empty texels."""
    mask = covered.astype(np.float32)
    weight = ndimage.gaussian_filter(mask, sigma)
    out = np.empty(image.shape, np.float32)
    for channel in range(image.shape[2]):
        blurred = ndimage.gaussian_filter(image[:, :, channel] * mask, sigma)
        out[:, :, channel] = blurred / np.maximum(weight, 1e-6)
    return out
