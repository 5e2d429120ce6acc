"""energy_ratio: diffused over undiffused light, per channel."""

from __future__ import annotations

from collections.abc import Mapping

import moderngl

from scanrender.render.device import bind
from scanrender.render.graph import Buffer, Pass
from scanrender.render.scene import Scene, Shot


def passes(scene: Scene) -> list[Pass]:
    if scene.pipeline.diffusion.method == "none":
        return []

    def draw(
        shot: Shot, inputs: Mapping[str, moderngl.Texture], target: moderngl.Framebuffer
    ) -> None:
        program = scene.device.program("energy_ratio")
        bind(program, inputs)
        scene.device.fill(program)

    reads = ("scattered", "diffusion_input")
    return [Pass("energy_ratio", reads, (Buffer("energy_ratio"),), draw)]
