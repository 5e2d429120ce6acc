"""nan_map: where the radiance is not a finite, non-negative number."""

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
        program = scene.device.program("nan_map")
        bind(program, inputs)
        scene.device.fill(program)

    return [Pass("nan_map", ("radiance",), (Buffer("nan_map", components=1),), draw)]
