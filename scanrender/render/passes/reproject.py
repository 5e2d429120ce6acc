"""reproject: what scattered at the pixel's centre, for another sample of the pixel.

Light that has scattered is smooth over a pixel of one surface: `sampling: contrast` scatters it
once a pixel, `resolution: half` once in four, and each sample takes it from the neighbours that its
own surface has.
"""

from __future__ import annotations

from collections.abc import Mapping

import moderngl

from scanrender.render.device import bind
from scanrender.render.graph import Buffer, Pass
from scanrender.render.scene import Scene, Shot

GIVEN = {"scattered": "_centre_scattered", "position": "_centre_position"}


def passes(scene: Scene) -> list[Pass]:
    """For the graph of further samples alone: there it takes the place of all that scatters."""

    def draw(
        shot: Shot, inputs: Mapping[str, moderngl.Texture], target: moderngl.Framebuffer
    ) -> None:
        program = scene.device.program("reproject")
        right, down = shot.jitter_px
        halves = scene.pipeline.diffusion.resolution == "half"
        bind(
            program,
            {
                "position": inputs["position"],
                "diffusion_input": inputs["diffusion_input"],
                "centre_scattered": inputs[GIVEN["scattered"]],
                "centre_position": inputs[GIVEN["position"]],
                "moved_px": (right, -down),
                "scale": 0.5 if halves else 1.0,
                "size_px": tuple(map(float, shot.size)),
                **shot.screen_uniforms,
            },
        )
        scene.device.fill(program)

    reads = ("position", "diffusion_input", *GIVEN.values())
    return [Pass("reproject", reads, (Buffer("scattered"),), draw, in_picture=True)]
