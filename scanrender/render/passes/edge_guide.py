"""edge_guide: grey albedo times a ratio of cosines; what the cross bilateral filters compare."""

from __future__ import annotations

from collections.abc import Mapping

import moderngl

from scanrender.render.device import bind
from scanrender.render.graph import Buffer, Pass
from scanrender.render.scene import Scene, Shot

# With `cbf` it grows with the square of the distance: past what half floats hold at 250 m.
GUIDE = Buffer("edge_guide", components=1, exact=True)
READS = ("position", "normal_geometry", "albedo")


def passes(scene: Scene) -> list[Pass]:
    defines = () if scene.pipeline.diffusion.halo == "cbf" else ("NORMALIZED",)

    def draw(
        shot: Shot, inputs: Mapping[str, moderngl.Texture], target: moderngl.Framebuffer
    ) -> None:
        program = scene.device.program("edge_guide", defines=defines)
        bind(program, {**inputs, **shot.screen_uniforms})
        scene.device.fill(program)

    return [Pass("edge_guide", READS, (GUIDE,), draw)]
