"""diffusion_input: irradiance times albedo^m, with the mask that says what scatters."""

from __future__ import annotations

from collections.abc import Mapping

import moderngl

from scanrender.render.device import bind
from scanrender.render.graph import Buffer, Pass
from scanrender.render.scene import Scene, Shot


def passes(scene: Scene) -> list[Pass]:
    diffusion = scene.pipeline.diffusion
    by_area = diffusion.halo == "measure" and diffusion.method != "disk"
    reads = ("irradiance", "albedo", "skin", *(["jacobian", "depth_mm"] if by_area else []))

    def draw(
        shot: Shot, inputs: Mapping[str, moderngl.Texture], target: moderngl.Framebuffer
    ) -> None:
        program = scene.device.program("diffusion_input")
        bind(
            program,
            {
                **inputs,
                **shot.screen_uniforms,
                "albedo_power": scene.albedo_power,
                "working_distance_mm": shot.working_distance_mm,
                "farthest_mm": shot.far_mm,
                "use_skin": scene.uses_skin_map,
                "use_jacobian": by_area,
            },
        )
        scene.device.fill(program)

    return [Pass("diffusion_input", reads, (Buffer("diffusion_input"),), draw)]
