"""kernel_px: how wide the diffusion profile is on screen."""

from __future__ import annotations

from collections.abc import Mapping

import moderngl

from scanrender.render.device import bind
from scanrender.render.graph import Buffer, Pass
from scanrender.render.passes._scatter import width_by_curvature
from scanrender.render.scene import Scene, Shot


def passes(scene: Scene) -> list[Pass]:
    by_curvature = scene.pipeline.curvature.modulation != "none"
    reads = ("position", "curvature") if by_curvature else ("position",)

    def draw(
        shot: Shot, inputs: Mapping[str, moderngl.Texture], target: moderngl.Framebuffer
    ) -> None:
        program = scene.device.program("kernel_px", defines=("CURVATURE",) if by_curvature else ())
        bind(
            program,
            {
                **inputs,
                "width_by_curvature": width_by_curvature(scene),
                "radius_mm": scene.reach_mm,
                **shot.screen_uniforms,
            },
        )
        scene.device.fill(program)

    return [Pass("kernel_px", reads, (Buffer("kernel_px", exact=True),), draw)]
