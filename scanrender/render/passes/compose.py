"""compose: the sum of what leaves the skin toward the camera."""

from __future__ import annotations

from collections.abc import Mapping

import moderngl

from scanrender.render.device import bind
from scanrender.render.graph import Buffer, Pass
from scanrender.render.scene import Scene, Shot


def passes(scene: Scene) -> list[Pass]:
    skin = scene.pipeline.skin
    reads = ["position", "diffuse"]
    has_specular = skin.specular.strength > 0.0
    has_transmission = bool(scene.transmitting_lamps)
    reads += ["specular"] if has_specular else []
    reads += ["transmission"] if has_transmission else []

    def draw(
        shot: Shot, inputs: Mapping[str, moderngl.Texture], target: moderngl.Framebuffer
    ) -> None:
        program = scene.device.program("compose")
        absent = {"specular": scene.white, "transmission": scene.white}
        bind(
            program,
            {
                **absent,
                **inputs,
                "has_specular": has_specular,
                "has_transmission": has_transmission,
            },
        )
        scene.device.fill(program)

    radiance = Buffer("radiance", exact=True)
    return [Pass("compose", tuple(reads), (radiance,), draw, in_picture=True)]
