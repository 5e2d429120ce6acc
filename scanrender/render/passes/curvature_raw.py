"""curvature_raw: mean curvature of the geometry normals from screen differences."""

from __future__ import annotations

from collections.abc import Mapping

import moderngl

from scanrender.render.device import bind
from scanrender.render.graph import Buffer, Pass
from scanrender.render.scene import Scene, Shot

READS = ("position", "normal_geometry")
# A radius of half a millimetre: nothing of a face that a scanner sees is sharper.
LIMIT_PER_MM = 2.0


def passes(scene: Scene) -> list[Pass]:
    def draw(
        shot: Shot, inputs: Mapping[str, moderngl.Texture], target: moderngl.Framebuffer
    ) -> None:
        program = scene.device.program("curvature_raw")
        bind(program, {**inputs, "limit_per_mm": LIMIT_PER_MM})
        scene.device.fill(program)

    return [Pass("curvature_raw", READS, (Buffer("curvature_raw", components=1),), draw)]
