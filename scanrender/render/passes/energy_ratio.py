"""energy_ratio: diffused over undiffused light, per channel."""

from __future__ import annotations

from collections.abc import Mapping

import moderngl

from scanrender.render.device import bind
from scanrender.render.graph import Buffer, Pass
from scanrender.render.scene import Scene, Shot

# Of all light: darker than this, a shadow's core has no light of its own to be compared with.
LEAST_SHARE = 1e-4


def passes(scene: Scene) -> list[Pass]:
    if scene.pipeline.diffusion.method == "none":
        return []

    def draw(
        shot: Shot, inputs: Mapping[str, moderngl.Texture], target: moderngl.Framebuffer
    ) -> None:
        program = scene.device.program("energy_ratio")
        bind(program, {**inputs, "least_light": LEAST_SHARE * scene.light_level})
        scene.device.fill(program)

    reads = ("scattered", "diffusion_input")
    return [Pass("energy_ratio", reads, (Buffer("energy_ratio"),), draw)]
