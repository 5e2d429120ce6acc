"""baked: curvature and thickness from the asset's maps, for settings that ask for them."""

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
        linear = shot.linear_depth
        defines = ("LINEAR_DEPTH",) if linear else ()
        program = scene.device.program("baked", vertex="mesh", defines=defines)
        bind(
            program,
            {
                "view_from_object": shot.view_from_object,
                "clip_from_view": shot.clip_from_view,
                **linear,
                "curvature_map": scene.data_map("curvature"),
                "thickness_map": scene.data_map("thickness_mm"),
            },
        )
        scene.draw_mesh(program)

    return [Pass("baked", (), (Buffer("_baked", exact=True),), draw, depth_test=True)]
