"""kernel_px: how wide the diffusion profile is on screen."""

from __future__ import annotations

from collections.abc import Mapping

import moderngl

from scanrender.render.device import bind
from scanrender.render.graph import Buffer, Pass
from scanrender.render.scene import Scene, Shot


def passes(scene: Scene) -> list[Pass]:
    def draw(
        shot: Shot, inputs: Mapping[str, moderngl.Texture], target: moderngl.Framebuffer
    ) -> None:
        program = scene.device.program("kernel_px")
        bind(
            program,
            {
                "position": inputs["position"],
                "radius_mm": scene.reach_mm,
                **shot.screen_uniforms,
            },
        )
        scene.device.fill(program)

    return [Pass("kernel_px", ("position",), (Buffer("kernel_px"),), draw)]
