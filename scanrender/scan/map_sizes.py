"""How large a map has to be: no finer on the surface than somebody will look."""

from __future__ import annotations

import math

from scanrender.scan.unwrap_box import possible_padding
from scanrender.settings.prep import BakeSettings

# Of an atlas, what charts cover that lie close: less makes the texels that are there coarser.
ATLAS_USE = 0.65
CHARTS = 36  # of a head, with a gap at each: so the use is right to a few per cent down to 64 px
LEAST_PX = 64


def fitted_sizes(bake: BakeSettings, area_mm2: float, padding_px: int = 0) -> BakeSettings:
    """The settings with each side halved while its maps keep `texel_mm` on this surface.

    Gaps are in texels of the albedo map: its side decides how much of every map is used.
    """
    if bake.texel_mm is None or area_mm2 <= 0.0:
        return bake
    covered_px = math.sqrt(area_mm2) / bake.texel_mm  # the side, if charts covered all of the map
    albedo_px = bake.albedo_px
    while _may_halve(albedo_px, covered_px / _used_side(padding_px, albedo_px // 2)):
        albedo_px //= 2
    enough_px = covered_px / _used_side(padding_px, albedo_px)
    others = {name: halved(getattr(bake, name), enough_px) for name in ("normal_px", "data_px")}
    return bake.model_copy(update={"albedo_px": albedo_px, **others})


def halved(side_px: int, enough_px: float) -> int:
    """The side halved while it stays `enough_px` and no map is too small to show anything."""
    while _may_halve(side_px, enough_px):
        side_px //= 2
    return side_px


def _may_halve(side_px: int, enough_px: float) -> bool:
    return side_px % 2 == 0 and side_px // 2 >= max(enough_px, LEAST_PX)


def _used_side(padding_px: int, albedo_px: int) -> float:
    """The share of the side that all charts would take as one square, each with its gap."""
    gap = possible_padding(padding_px / albedo_px, CHARTS)
    return math.sqrt(ATLAS_USE) - gap * math.sqrt(CHARTS)
