"""What this scene requires, and why the rest does not run.

The first of the project's rules for a picture: a pass that would not change it is not run, and the
tool says why. These reasons need no measurement; measured ones join them here.
"""

from __future__ import annotations

from dataclasses import dataclass

from scanrender.settings.light import EnvironmentLight, LampSettings
from scanrender.settings.pipeline import Pipeline


@dataclass(frozen=True)
class Decision:
    """One pass that is not run, and the reason as a sentence."""

    what: str
    reason: str


def plan(pipeline: Pipeline) -> tuple[Pipeline, list[Decision]]:
    """The pipeline without lights and effects that cannot change the picture."""
    decisions: list[Decision] = []
    lights = []
    for index, light in enumerate(pipeline.lights):
        strength = light.intensity if isinstance(light, EnvironmentLight) else light.irradiance
        if strength == 0.0 or not any(light.colour):
            decisions.append(Decision(f"lights.{index}", "it is black"))
        else:
            lights.append(light)
    updates: dict[str, object] = {"lights": tuple(lights)}
    lamps = [light for light in lights if isinstance(light, LampSettings)]
    skin = pipeline.skin
    if skin.transmission.method != "none" and not any(lamp.shadow for lamp in lamps):
        reason = "no light casts a shadow, so nothing tells how thick the skin is"
        decisions.append(Decision("transmission", reason))
        none = skin.transmission.model_copy(update={"method": "none"})
        updates["skin"] = skin.model_copy(update={"transmission": none})
    if pipeline.diffusion.method != "none" and not lights:
        decisions.append(Decision("diffusion", "there is no light to diffuse"))
        updates["diffusion"] = pipeline.diffusion.model_copy(update={"method": "none"})
    elif pipeline.diffusion.method != "none" and skin.scale == 0.0:
        decisions.append(Decision("diffusion", "skin.scale is 0, so light leaves where it enters"))
        updates["diffusion"] = pipeline.diffusion.model_copy(update={"method": "none"})
    return pipeline.model_copy(update=updates), decisions
