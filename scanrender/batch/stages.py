"""What a pipeline does to one scan: known before anything is rendered, without GL."""

from __future__ import annotations

from pathlib import Path

from scanrender.asset import is_asset
from scanrender.errors import UsageError
from scanrender.settings.pipeline import Pipeline

__all__ = ["is_asset", "stages_for"]


def stages_for(scan: Path, pipeline: Pipeline) -> list[str]:
    """What is to do for this scan. Raises UsageError when that is nothing."""
    prepared = is_asset(scan)
    stages: list[str] = [stage for stage in pipeline.stages if not (prepared and stage == "prep")]
    if not stages:
        raise UsageError(
            f"{scan} is a prepared asset already, and the pipeline stops there",
            fix="name the raw scan, or add `render` to the pipeline's stages",
        )
    return stages
