"""The renderer of a shot: as it was asked for, less what a measured plan leaves out."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

from scanrender.asset import Asset
from scanrender.measure.choice import Choice, choose
from scanrender.render.device import Device
from scanrender.render.frame import Renderer
from scanrender.render.measured_plan import MeasuredPlan, measure_plan
from scanrender.settings.pipeline import Pipeline

# A plan takes as long as some ten frames (docs/rendering.md): it pays for a turntable.
LEAST_FRAMES = 24


@dataclass(frozen=True)
class PreparedShot:
    """A renderer, the settings it was made with, what it does not run and why, and what was chosen
    and measured for that."""

    renderer: Renderer
    pipeline: Pipeline
    not_run: list[str]
    choice: Choice | None = None
    measured: dict[str, Any] = field(default_factory=dict)

    @property
    def predicted(self) -> dict[str, Any]:
        """What was picked, and what is predicted of it; nothing where nothing was asked for."""
        if self.choice is None:
            return {}
        return {
            "picked": self.choice.recipe.name,
            "satisfies": self.choice.satisfies,
            "predicted_delta_e": round(self.choice.delta_e, 3),
            "predicted_ms": round(self.choice.frame_ms, 1),
        }


def prepare_shot(
    device: Device,
    asset: Asset,
    pipeline: Pipeline,
    frames: Sequence[int],
    say: Callable[[str], None] = lambda _: None,
) -> PreparedShot:
    """Ready to render `frames`: the way that `quality` asks for is chosen, and with
    `quality.tolerance_delta_e`, and frames enough to pay for it, a measured plan decides what of
    that is left out."""
    choice = choose(device, asset, pipeline, frames, say)
    chosen = pipeline if choice is None else choice.pipeline
    renderer = Renderer(device, asset, chosen)
    not_run = [f"{d.what}: {d.reason}" for d in renderer.decisions]
    tolerance = pipeline.quality.tolerance_delta_e
    if tolerance is None:
        return PreparedShot(renderer, chosen, not_run, choice)
    if len(frames) < LEAST_FRAMES:
        few = f"measured plan: {len(frames)} frames take less time than it, {LEAST_FRAMES} pay"
        return PreparedShot(renderer, chosen, [*not_run, few], choice)
    found = measure_plan(renderer, frames, tolerance, say)
    planned = Renderer(device, asset, found.pipeline, renderer)
    left_out = [f"{f.what}: {f.sentence}" for f in found.findings if f.is_left_out]
    return PreparedShot(planned, found.pipeline, [*not_run, *left_out], choice, as_data(found))


def as_data(plan: MeasuredPlan) -> dict[str, Any]:
    """What a manifest keeps of a plan."""
    return {
        "findings": [
            {
                "what": f.what,
                "value": f.value,
                "left_out": f.is_left_out,
                "delta_e": round(f.difference.delta_e, 4),
                "frame": f.difference.frame,
                "tolerance": f.tolerance,
            }
            for f in plan.findings
        ],
        "delta_e": None if plan.final is None else round(plan.final.delta_e, 4),
        "asked_ms": round(plan.asked_ms, 1),
        "planned_ms": round(plan.planned_ms, 1),
        "seconds": round(plan.seconds, 2),
    }
