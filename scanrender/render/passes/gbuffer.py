"""gbuffer: geometry and maps of the surface that each pixel sees."""

from __future__ import annotations

import math
from collections.abc import Mapping

import moderngl

from scanrender.render.device import bind
from scanrender.render.graph import Buffer, Pass
from scanrender.render.scene import Scene, Shot

# Mip levels finer than a texel a footprint: trilinear filtering blurs over two (decision 22).
SHARPER = -1.0
WRITES = (
    Buffer("position", exact=True),
    Buffer("normal_geometry"),
    Buffer("normal_shading"),
    Buffer("albedo"),
    Buffer("depth_mm", components=1, exact=True),
    # Last, where they are left out if nothing reads them.
    Buffer("skin", components=1),
    Buffer("ao", components=1),
)


def lod_bias(footprint_px: float) -> float:
    """Mip levels to add to GL's, for a sample that stands for this much of the pixel's side.

    Of more than 2 x 2 samples each is less sharp, down to its own footprint: their mean loses no
    detail by it, and detail finer than the way between samples would be noise.
    """
    return SHARPER * min(1.0, 2.0 * footprint_px) + math.log2(footprint_px)


def passes(scene: Scene) -> list[Pass]:
    def draw(
        shot: Shot, inputs: Mapping[str, moderngl.Texture], target: moderngl.Framebuffer
    ) -> None:
        linear = shot.linear_depth
        defines = ("LINEAR_DEPTH",) if linear else ()
        program = scene.device.program("gbuffer", vertex="mesh", defines=defines)
        maps = scene.maps
        bind(
            program,
            {
                "view_from_object": shot.view_from_object,
                "clip_from_view": shot.clip_from_view,
                **linear,
                **shot.screen_uniforms,
                "albedo_map": maps["albedo"],
                "normal_map": maps["normal_ts"],
                "ao_map": maps["ao"],
                "skin_map": maps["skin"],
                "lod_bias": lod_bias(shot.footprint_px),
                "inside_albedo": scene.pipeline.view.inside_albedo,
            },
        )
        scene.draw_mesh(program)

    return [Pass("gbuffer", (), WRITES, draw, depth_test=True)]
