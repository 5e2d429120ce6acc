"""How large a map has to be: no finer on the surface than somebody will look."""

from __future__ import annotations

import math

from scanrender.settings.prep import BakeSettings

# Of an atlas, what charts cover: less makes the texels that are there coarser.
ATLAS_USE = 0.65
LEAST_PX = 64
SIDES = ("albedo_px", "normal_px", "data_px")


def fitted_sizes(bake: BakeSettings, area_mm2: float) -> BakeSettings:
    """The settings with each side halved while its maps keep `texel_mm` on this surface."""
    if bake.texel_mm is None or area_mm2 <= 0.0:
        return bake
    enough_px = math.sqrt(area_mm2 / ATLAS_USE) / bake.texel_mm
    return bake.model_copy(update={name: halved(getattr(bake, name), enough_px) for name in SIDES})


def halved(side_px: int, enough_px: float) -> int:
    """The side halved while it stays `enough_px` and no map is too small to show anything."""
    while side_px % 2 == 0 and side_px // 2 >= max(enough_px, LEAST_PX):
        side_px //= 2
    return side_px
