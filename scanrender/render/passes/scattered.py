"""scattered: the weighted sum of the levels before albedo, as the separable methods have it."""

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
        program = device.program("scattered")
        device.context.enable(moderngl.BLEND)
        device.context.blend_func = moderngl.ONE, moderngl.ONE
        for number, (name, weight) in enumerate(zip(levels, scene.profile.weights, strict=True)):
            first = 1.0 if number == 0 else 0.0
            bind(program, {"level": inputs[name], "weight": weight, "first": first})
            device.fill(program)

    return [Pass("scattered", tuple(levels), (Buffer("scattered"),), draw)]
