"""Brute force on the picture: the disk that a perfect screen-space method would sum.

Every pixel within reach counts, by the area of skin that it shows. What is left between this and
the truth is what a picture does not show (screen-space error); what is left between a renderer's
method and this is how it samples (sampling error). The measure is DESIGN 4's: a pixel of depth z,
phi off the axis and theta off its ray shows z^2 cos(phi) / (f^2 cos(theta)).
"""

from __future__ import annotations

import math

import numpy as np

from scanrender.errors import UsageError
from scanrender.optics._math import Array
from scanrender.optics.profiles import GaussianSum
from scanrender.reference.integral import LobeSums, lobe_sums
from scanrender.reference.points import PictureCamera
from scanrender.reference.surface import unit
from scanrender.reference.surface_samples import Samples

# A pixel that grazes the surface shows at most this much more of it than one that faces it.
_STEEPEST_COSINE = 0.05


def pixel_areas(position: Array, normal: Array, camera: PictureCamera) -> Array:
    """(h, w) mm^2 of surface in each pixel, from view-space position and unit normal (h, w, 3).

    0 where the position is 0: no surface.
    """
    scale = camera.px_per_mm_at_1mm
    depth = np.maximum(-position[..., 2], 1e-6)
    if camera.is_orthographic:
        cosine = np.maximum(np.abs(normal[..., 2]), _STEEPEST_COSINE)
        area = 1.0 / (scale**2 * cosine)
    else:
        ray = unit(position)
        cosine = np.abs(np.sum(ray * normal, axis=-1))
        area = depth**2 * np.abs(ray[..., 2]) / (scale**2 * np.maximum(cosine, _STEEPEST_COSINE))
    return np.asarray(np.where(np.any(position != 0.0, axis=-1), area, 0.0))


def gather(
    position: Array,
    light: Array,
    mask: Array,
    area_mm2: Array,
    profile: GaussianSum,
    tail: float = 1e-4,
) -> tuple[Array, Array]:
    """Sum and mean, (h, w, 3) each, at every pixel with an area.

    ``position`` (h, w, 3) mm, ``light`` (h, w, 3) is what diffuses, ``mask`` (h, w) what scatters.
    Sum: R m E dA over all pixels; mean: over the same of R m dA. A pixel's own share is what makes
    the sum over even, square pixels 1: a Gaussian narrower than a pixel is that pixel. Raises
    UsageError for shapes that differ.
    """
    shape = area_mm2.shape
    if position.shape != (*shape, 3) or light.shape != (*shape, 3) or mask.shape != shape:
        raise UsageError("position, light, mask and area are not of one picture")
    held = np.flatnonzero(area_mm2.ravel() > 0.0)
    at, e = position.reshape(-1, 3)[held], light.reshape(-1, 3)[held]
    m, area = mask.ravel()[held], area_mm2.ravel()[held]
    mass = m * area
    zero = np.zeros(len(held), np.int64)
    samples = Samples(at, zero, area, mass[:, None] * e, mass, np.ones(len(held)))
    total, whole = np.zeros((len(held), 3)), np.zeros((len(held), 3))
    for variance, weight in zip(profile.variances_mm2, profile.weights, strict=True):
        lobe: LobeSums = lobe_sums(at, zero, samples, zero[:1], variance, tail)
        # What the sum gave the pixel itself is replaced by what its neighbours leave.
        own = 1.0 - _lattice_sum(area / (2.0 * math.pi * variance))
        w = np.asarray(weight)
        total += w * (lobe.total + (own * m)[:, None] * e)
        whole += w * (lobe.mass + own * m)[:, None]
    mean = np.divide(total, whole, out=np.zeros_like(total), where=whole > 1e-12)
    results = np.zeros((2, math.prod(shape), 3))
    results[0, held], results[1, held] = total, mean
    return results[0].reshape(*shape, 3), results[1].reshape(*shape, 3)


def _lattice_sum(t: Array) -> Array:
    """Sum over all (i, j) of t exp(-pi t (i^2 + j^2)): even pixels of area 2 pi v t, any shape.

    t theta_3(e^{-pi t})^2, which is theta_3(e^{-pi / t})^2 by Jacobi's identity; each converges
    where the other does not.
    """
    q = math.pi * np.maximum(t, 1.0 / np.maximum(t, 1e-300))
    theta = 1.0 + 2.0 * sum(np.exp(-q * k * k) for k in (1, 2, 3))
    return np.asarray(np.where(t > 1.0, t, 1.0) * theta * theta)
