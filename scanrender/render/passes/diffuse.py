"""diffuse: the weighted sum of the levels, after albedo; or plain irradiance without diffusion."""

from __future__ import annotations

from collections.abc import Mapping

import moderngl

from scanrender.render.device import bind
from scanrender.render.graph import Buffer, Pass
from scanrender.render.scene import Scene, Shot

SURFACE = ("albedo", "skin", "position", "normal_shading")
WHITE = (1.0, 1.0, 1.0)
NO_MASK, SKIN_SHARE, OTHER_SHARE = 0, 1, 2


def passes(scene: Scene) -> list[Pass]:
    terms = _terms(scene)

    def draw(
        shot: Shot, inputs: Mapping[str, moderngl.Texture], target: moderngl.Framebuffer
    ) -> None:
        device = scene.device
        program = device.program("diffuse")
        common = {name: inputs[name] for name in SURFACE}
        common["directional_albedo"] = scene.directional_albedo
        device.context.enable(moderngl.BLEND)
        device.context.blend_func = moderngl.ONE, moderngl.ONE
        for name, weight, blend in terms:
            bind(
                program,
                {
                    **common,
                    "level": inputs[name],
                    "weight": weight,
                    "blend": blend,
                    "albedo_power": scene.albedo_power,
                },
            )
            device.fill(program)

    reads = (*SURFACE, *(name for name, _, _ in terms))
    return [Pass("diffuse", reads, (Buffer("diffuse"),), draw)]


def _terms(scene: Scene) -> list[tuple[str, tuple[float, float, float], int]]:
    """(buffer, weight, how the skin map shares it) of everything that is added."""
    if scene.pipeline.diffusion.method == "none":
        return [("diffusion_input", WHITE, NO_MASK)]
    masked = scene.uses_skin_map
    blend = SKIN_SHARE if masked else NO_MASK
    levels = [(f"gaussian_{k}", weight, blend) for k, weight in enumerate(scene.profile.weights)]
    return [*levels, *([("diffusion_input", WHITE, OTHER_SHARE)] if masked else [])]
