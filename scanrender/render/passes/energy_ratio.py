"""energy_ratio: diffused over undiffused light, per channel."""

from __future__ import annotations

from collections.abc import Mapping

import moderngl

from scanrender.render.device import bind
from scanrender.render.graph import Buffer, Pass
from scanrender.render.scene import Scene, Shot


def passes(scene: Scene) -> list[Pass]:
    if scene.pipeline.diffusion.method != "gaussian_sum":
        return []
    levels = [f"gaussian_{k}" for k in range(len(scene.profile.weights))]

    def draw(
        shot: Shot, inputs: Mapping[str, moderngl.Texture], target: moderngl.Framebuffer
    ) -> None:
        device = scene.device
        program = device.program("energy_ratio")
        device.context.enable(moderngl.BLEND)
        device.context.blend_func = moderngl.ONE, moderngl.ONE
        for name, weight in zip(levels, scene.profile.weights, strict=True):
            undiffused = inputs["diffusion_input"]
            bind(program, {"level": inputs[name], "diffusion_input": undiffused, "weight": weight})
            device.fill(program)

    reads = ("diffusion_input", *levels)
    return [Pass("energy_ratio", reads, (Buffer("energy_ratio"),), draw)]
