"""tonemap: the view transform; the last pass of a frame."""

from __future__ import annotations

from collections.abc import Mapping

import moderngl

from scanrender.render.device import bind
from scanrender.render.graph import Buffer, Pass
from scanrender.render.scene import Scene, Shot
from scanrender.render.view import LOG2_RANGE, TABLE_SIZE


def passes(scene: Scene) -> list[Pass]:
    view = scene.pipeline.view

    def draw(
        shot: Shot, inputs: Mapping[str, moderngl.Texture], target: moderngl.Framebuffer
    ) -> None:
        program = scene.device.program("tonemap")
        bind(
            program,
            {
                "beauty": inputs["beauty"],
                "view_table": scene.view_table,
                "background": view.background,
                "exposure": 2.0**view.exposure_ev,
                "log2_range": LOG2_RANGE,
                "table_size": float(TABLE_SIZE),
            },
        )
        # The background lies outside the subject's bounds, the guard band outside the picture.
        width, height = shot.size
        guard = shot.guard_px
        target.scissor = guard, guard, width - 2 * guard, height - 2 * guard
        scene.device.fill(program)

    return [Pass("tonemap", ("beauty",), (Buffer("display", exact=True),), draw)]
