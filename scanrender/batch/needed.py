"""`prep.bake.need: shot`: of the maps, what the shots of a batch read, no finer than they show."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from scanrender.settings.pipeline import Pipeline

if TYPE_CHECKING:
    from scanrender.render.plan import Decision

# Maps are read a level finer than a texel a pixel (decision 22).
TEXELS_A_PX = 2.0


def with_needed_maps(pipelines: Sequence[Pipeline]) -> list[Pipeline]:
    """The pipelines, those with `need: shot` baking what any of those reads: they share an asset
    where nothing else tells their preparations apart. A figure's panels may read any map."""
    asking = [p for p in pipelines if p.prep.bake.need == "shot" and not p.figure.panels]
    if not asking:
        return list(pipelines)
    # Not before: whether a batch has anything to do is known without what frames need.
    from scanrender.render.camera import finest_px_per_mm
    from scanrender.render.plan import maps_read

    read = {name for pipeline in asking for name in maps_read(pipeline)}
    scales = [finest_px_per_mm(pipeline.camera) for pipeline in asking]
    finest = max(scale or 0.0 for scale in scales)
    texel_mm = None if None in scales else 1.0 / (TEXELS_A_PX * finest)
    return [_baking(p, read, texel_mm) if p in asking else p for p in pipelines]


def unread_maps(pipeline: Pipeline) -> list[Decision]:
    """The maps that are baked though no pass of this shot reads them."""
    if "prep" not in pipeline.stages or pipeline.figure.panels:
        return []
    from scanrender.render.plan import Decision, maps_read

    read = maps_read(pipeline)
    reason = "no pass of this shot reads it; prep.bake.need: shot leaves it out"
    return [Decision(f"map {name}", reason) for name in pipeline.prep.bake.maps if name not in read]


def _baking(pipeline: Pipeline, read: set[str], texel_mm: float | None) -> Pipeline:
    bake = pipeline.prep.bake
    coarser = max((x for x in (bake.texel_mm, texel_mm) if x is not None), default=None)
    maps = tuple(name for name in bake.maps if name in read)
    less = bake.model_copy(update={"maps": maps, "texel_mm": coarser})
    prep = pipeline.prep.model_copy(update={"bake": less})
    return pipeline.model_copy(update={"prep": prep})
