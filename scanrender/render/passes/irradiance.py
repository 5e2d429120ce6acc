"""irradiance: light that enters the skin, albedo-free, summed over all lights."""

from __future__ import annotations

from collections.abc import Mapping

import moderngl
import numpy as np

from scanrender.render.device import bind
from scanrender.render.graph import Buffer, Pass
from scanrender.render.passes._lamp import (
    AMBIENT,
    ENVIRONMENT,
    LAMP,
    environment_uniforms,
    light_uniforms,
)
from scanrender.render.scene import Scene, Shot


def passes(scene: Scene) -> list[Pass]:
    shadowed = [f"visibility_{lamp.index}" for lamp in scene.lamps if lamp.settings.shadow]
    has_ambient = bool(np.any(scene.ambient))
    # What hides the sky hides no lamp.
    hides_sky = has_ambient or bool(scene.environments)

    def draw(
        shot: Shot, inputs: Mapping[str, moderngl.Texture], target: moderngl.Framebuffer
    ) -> None:
        device = scene.device
        common = {
            "position": inputs["position"],
            "normal_shading": inputs["normal_shading"],
            "directional_albedo": scene.directional_albedo,
        }
        common |= {"ao": inputs["ao"]} if hides_sky else {}
        if has_ambient:
            ambient = {
                "ambient": scene.ambient,
                "mean_directional_albedo": scene.mean_directional_albedo,
                "visibility": scene.white,
                "irradiance_map": scene.white,
            }
            program = device.program("irradiance", defines=(AMBIENT,))
            bind(program, {**common, **ambient})
            device.fill(program)
        device.context.enable(moderngl.BLEND)
        device.context.blend_func = moderngl.ONE, moderngl.ONE
        for environment in scene.environments:
            around = {
                **environment_uniforms(environment, shot),
                "irradiance_map": environment.irradiance,
                "visibility": scene.white,
            }
            program = device.program("irradiance", defines=(ENVIRONMENT,))
            bind(program, {**common, **around})
            device.fill(program)
        for lamp in scene.lamps:
            if not np.any(lamp.irradiance):
                continue
            has_shadow = lamp.settings.shadow
            uniforms = {
                **common,
                **light_uniforms(lamp, shot),
                "has_shadow": has_shadow,
                "visibility": inputs[f"visibility_{lamp.index}"] if has_shadow else scene.white,
            }
            program = device.program("irradiance", defines=(LAMP,))
            bind(program, uniforms)
            device.fill(program)

    reads = ("position", "normal_shading", *(["ao"] if hides_sky else []), *shadowed)
    return [Pass("irradiance", reads, (Buffer("irradiance"),), draw)]
