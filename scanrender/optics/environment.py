"""Light from all around on the sphere: what a latitude-longitude picture gives a surface.

A picture is (rows, columns, 3) radiance, top row first: row centres at polar angles (i + 1/2) pi /
rows from +Y, its middle column from +Z, azimuth (toward +X) falling from left to right, so that
somebody at the origin who looks along +Z sees it the right way round.

A kernel that depends on the angle alone is a convolution on the sphere (Ramamoorthi & Hanrahan
2001); between two rows it depends on the difference of azimuth alone, so that each pair of rows is
one circular convolution, done exactly by FFT. Order-2 spherical harmonics would ring around a sun.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from scanrender.errors import ConfigError
from scanrender.optics._math import Array
from scanrender.optics.surface import beckmann_d, fresnel_schlick

Kernel = Callable[[Array], Array]


def directions(rows: int, columns: int) -> Array:
    """Unit vectors (rows, columns, 3) of the texel centres."""
    theta = (np.arange(rows) + 0.5) * np.pi / rows
    azimuth = (0.5 - (np.arange(columns) + 0.5) / columns) * 2.0 * np.pi
    sine = np.sin(theta)[:, None]
    y = np.broadcast_to(np.cos(theta)[:, None], (rows, columns))
    return np.stack([sine * np.sin(azimuth), y, sine * np.cos(azimuth)], axis=-1)


def solid_angles(rows: int, columns: int) -> Array:
    """Steradians of a texel of each row, exact: (rows,); times `columns` they sum to 4 pi."""
    edges = np.cos(np.arange(rows + 1) * np.pi / rows)
    return np.asarray((edges[:-1] - edges[1:]) * 2.0 * np.pi / columns)


def resampled(picture: npt.NDArray[np.floating], rows: int, columns: int) -> Array:
    """The picture at another size; means over solid angle, so that no light is lost or made."""
    height, width = picture.shape[:2]
    down = _overlaps(
        np.cos(np.linspace(np.pi, 0, height + 1)), np.cos(np.linspace(np.pi, 0, rows + 1))
    )
    across = _overlaps(np.linspace(0, 1, width + 1), np.linspace(0, 1, columns + 1))
    narrow = np.einsum("cw,hwk->hck", across, picture, optimize=True)
    return np.asarray(np.einsum("rh,hck->rck", down[::-1, ::-1], narrow, optimize=True))


def _overlaps(edges: Array, new_edges: Array) -> Array:
    """(new, old) share of each new cell that each old cell covers; rows sum to 1."""
    low = np.maximum(edges[None, :-1], new_edges[:-1, None])
    high = np.minimum(edges[None, 1:], new_edges[1:, None])
    return np.asarray(np.maximum(high - low, 0.0) / np.diff(new_edges)[:, None])


def filtered(
    picture: npt.NDArray[np.floating], kernel: Kernel, rows: int, *, normalized: bool
) -> Array:
    """Integral over the sphere of kernel(cos angle) times the picture: (rows, columns, 3).

    `normalized` divides by the kernel's own integral, sampled alike, so that a constant picture
    stays what it is even under a kernel narrower than a texel. Raises ConfigError for a kernel that
    meets no texel at all.
    """
    height, width = picture.shape[:2]
    weight = solid_angles(height, width)
    spectrum = np.fft.rfft(np.asarray(picture, dtype=np.float64) * weight[:, None, None], axis=1)
    around = np.cos(np.arange(width) * 2.0 * np.pi / width)
    from_top = (np.arange(height) + 0.5) * np.pi / height
    out = np.empty((rows, width, picture.shape[2]))
    for row, theta in enumerate((np.arange(rows) + 0.5) * np.pi / rows):
        flat = np.cos(theta) * np.cos(from_top)[:, None]
        cosine = flat + np.sin(theta) * np.sin(from_top)[:, None] * around
        values = kernel(np.clip(cosine, -1.0, 1.0))
        total = float(weight @ values.sum(axis=1)) if normalized else 1.0
        if total <= 0.0:
            raise ConfigError("the lobe is narrower than the environment's texels", "roughness")
        mixed = np.einsum("jf,jfk->fk", np.fft.rfft(values, axis=1), spectrum, optimize=True)
        out[row] = np.fft.irfft(mixed, n=width, axis=0) / total
    return np.maximum(out, 0.0)  # the FFT's rounding around a black background


def irradiance_kernel(cosines: Array, rho: Array) -> Kernel:
    """Clamped cosine times what the specular lobes let in, over pi: irradiance in units of pi.

    `rho` is the directional albedo at `cosines` (ascending), interpolated between them.
    """

    def kernel(cosine: Array) -> Array:
        entering = 1.0 - np.interp(cosine, cosines, rho)
        return np.asarray(np.maximum(cosine, 0.0) * entering / np.pi)

    return kernel


def lobe_kernel(m: float, f0: float) -> Kernel:
    """The Kelemen/Szirmay-Kalos lobe over the angle between light and mirror direction.

    With normal = view = mirror direction, as split-sum prefilters have it (Karis 2013):
    D(N.H) F(V.H) / (h.h) N.L, where N.H = V.H = cos(angle / 2) and h.h = 2 + 2 cos(angle).
    """

    def kernel(cosine: Array) -> Array:
        half = np.sqrt(np.maximum(0.5 * (1.0 + cosine), 0.0))
        value = beckmann_d(half, m) * fresnel_schlick(half, f0) * np.maximum(cosine, 0.0)
        return np.asarray(value / np.maximum(2.0 + 2.0 * cosine, 1e-9))

    return kernel
