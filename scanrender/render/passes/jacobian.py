"""jacobian: how much skin each pixel shows; what makes a screen filter a surface integral."""

from __future__ import annotations

from collections.abc import Mapping

import moderngl

from scanrender.render.device import bind
from scanrender.render.graph import Buffer, Pass
from scanrender.render.scene import Scene, Shot

# As the square of the depth: a surface behind the subject can pass what half floats hold.
AREA = Buffer("jacobian", components=1, exact=True)
READS = ("position", "normal_geometry")


def passes(scene: Scene) -> list[Pass]:
    def draw(
        shot: Shot, inputs: Mapping[str, moderngl.Texture], target: moderngl.Framebuffer
    ) -> None:
        program = scene.device.program("jacobian")
        bind(
            program,
            {**inputs, **shot.screen_uniforms, "working_distance_mm": shot.working_distance_mm},
        )
        scene.device.fill(program)

    return [Pass("jacobian", READS, (AREA,), draw)]
