"""An asset's maps on the device, from texels that are sound.

A map may come from another tool: texels that are not finite would spread by filtering and mip
levels over everything near them, and values that a map cannot hold (an albedo of 7) would stay with
their neighbours after filtering. Both are seen to before anything is filtered.
"""

from __future__ import annotations

from collections.abc import Mapping

import moderngl
import numpy as np
import numpy.typing as npt

from scanrender.render.device import Device

Texels = npt.NDArray[np.float32]
# What a scan without a map gets. Thickness has no neutral value: plan.py sees to it.
NEUTRAL_MAPS: Mapping[str, tuple[float, ...]] = {
    "albedo": (0.5, 0.5, 0.5),
    "normal_ts": (0.0, 0.0, 1.0),
    "ao": (1.0,),
    "skin": (1.0,),
}
LIMITS: Mapping[str, tuple[float, float]] = {
    "albedo": (0.0, 1.0),
    "normal_ts": (-1.0, 1.0),
    "ao": (0.0, 1.0),
    "skin": (0.0, 1.0),
    "thickness_mm": (0.0, np.inf),
}


def upload_map(device: Device, name: str, pixels: Texels | None) -> moderngl.Texture:
    """A mipmapped texture of map `name`; its neutral texel where the asset has none."""
    if pixels is None:
        return device.table(np.array(NEUTRAL_MAPS.get(name, (0.0,))).reshape(1, 1, -1))
    height, width, components = pixels.shape
    # Half floats hold 8-bit sRGB and unit normals to better than their own step; a length or a
    # curvature may be more than they can hold.
    dtype, kind = ("f2", np.float16) if name in NEUTRAL_MAPS else ("f4", np.float32)
    data = np.ascontiguousarray(sound_texels(name, pixels), dtype=kind)
    texture = device.context.texture(
        (width, height), components, data.tobytes(), dtype=dtype, alignment=1
    )
    texture.repeat_x = texture.repeat_y = False
    texture.build_mipmaps()
    texture.filter = (moderngl.LINEAR_MIPMAP_LINEAR, moderngl.LINEAR)
    return texture


def unsound_texels(pixels: Texels) -> int:
    """How many texels hold something that is not a finite number."""
    # The sum of a sound map is finite, and quicker to have than a test of each texel.
    with np.errstate(invalid="ignore"):
        total = pixels.sum(dtype=np.float64)
    if np.isfinite(total):
        return 0
    return int((~np.isfinite(pixels)).any(axis=2).sum())


def sound_texels(name: str, pixels: Texels) -> Texels:
    """The map with values that it can hold; an unsound texel takes the mean of the others."""
    if unsound_texels(pixels):
        bad = ~np.isfinite(pixels).all(axis=2)
        neutral = NEUTRAL_MAPS.get(name, (0.0,) * pixels.shape[2])
        pixels = pixels.copy()
        pixels[bad] = neutral if bad.all() else pixels[~bad].mean(axis=0, dtype=np.float64)
    low, high = LIMITS.get(name, (-np.inf, np.inf))
    if pixels.min() < low or pixels.max() > high:
        pixels = np.clip(pixels, low, high)
    return pixels
