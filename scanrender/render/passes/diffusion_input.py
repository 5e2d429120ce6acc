"""diffusion_input: irradiance times albedo^m, with the mask that says what scatters."""

from __future__ import annotations

from collections.abc import Mapping

import moderngl

from scanrender.render.device import bind
from scanrender.render.graph import Buffer, Pass
from scanrender.render.scene import Scene, Shot

READS = ("irradiance", "albedo", "skin")


def passes(scene: Scene) -> list[Pass]:
    def draw(
        shot: Shot, inputs: Mapping[str, moderngl.Texture], target: moderngl.Framebuffer
    ) -> None:
        program = scene.device.program("diffusion_input")
        uniforms = {name: inputs[name] for name in READS}
        bind(
            program,
            {
                **uniforms,
                "albedo_power": scene.albedo_power,
                "use_skin": scene.uses_skin_map,
            },
        )
        scene.device.fill(program)

    return [Pass("diffusion_input", READS, (Buffer("diffusion_input"),), draw)]
