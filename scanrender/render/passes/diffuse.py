"""diffuse: scattered light, and what does not scatter, after albedo; or plain irradiance."""

from __future__ import annotations

from collections.abc import Mapping

import moderngl

from scanrender.render.device import bind
from scanrender.render.graph import Buffer, Pass
from scanrender.render.scene import Scene, Shot

SURFACE = ("albedo", "skin", "position", "normal_shading")


def passes(scene: Scene) -> list[Pass]:
    scatters = scene.pipeline.diffusion.method != "none"
    light: tuple[str, ...] = ("scattered",) if scatters else ()
    # Without a skin map everything scatters, and nothing keeps its own light.
    light += ("diffusion_input",) if scene.uses_skin_map or not scatters else ()

    def draw(
        shot: Shot, inputs: Mapping[str, moderngl.Texture], target: moderngl.Framebuffer
    ) -> None:
        defines = {"SCATTERED": scatters, "UNSCATTERED": "diffusion_input" in light}
        program = scene.device.program(
            "diffuse", defines=tuple(name for name, used in defines.items() if used)
        )
        bind(
            program,
            {
                **inputs,
                **shot.screen_uniforms,
                "directional_albedo": scene.directional_albedo,
                "albedo_power": scene.albedo_power,
            },
        )
        scene.device.fill(program)

    return [Pass("diffuse", (*SURFACE, *light), (Buffer("diffuse"),), draw, in_picture=True)]
