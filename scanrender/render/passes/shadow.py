"""shadow: what each lamp sees first, as linear depth in millimetres."""

from __future__ import annotations

from collections.abc import Mapping

import moderngl

from scanrender.render.camera import Matrix
from scanrender.render.device import bind
from scanrender.render.graph import Buffer, Pass
from scanrender.render.lamps import Lamp
from scanrender.render.scene import Scene, Shot


def passes(scene: Scene) -> list[Pass]:
    return [_shadow(scene, lamp) for lamp in scene.lamps]


def _shadow(scene: Scene, lamp: Lamp) -> Pass:
    side = lamp.settings.shadow_px
    far = lamp.far_mm - lamp.near_mm

    def draw(
        shot: Shot, inputs: Mapping[str, moderngl.Texture], target: moderngl.Framebuffer
    ) -> None:
        linear = lamp.linear_depth
        defines = ("LINEAR_DEPTH",) if linear else ()
        program = scene.device.program("shadow", vertex="shadow", defines=defines)
        bind(program, {**_uniforms(lamp, shot), **linear})
        scene.draw_mesh(program)

    buffer = Buffer(f"shadow_{lamp.index}", components=1, size=(side, side), clear=far, exact=True)
    return Pass(f"shadow_{lamp.index}", (), (buffer,), draw, depth_test=True)


def _uniforms(lamp: Lamp, shot: Shot) -> dict[str, Matrix | float]:
    rig_from_object = shot.rig_from_world(lamp.settings.follows) @ shot.world_from_object
    return {
        "light_from_object": lamp.light_from_rig @ rig_from_object,
        "clip_from_light": lamp.clip_from_light,
        "light_front_mm": lamp.distance_mm - lamp.near_mm,
    }
