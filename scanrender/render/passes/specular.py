"""specular: reflection at the skin's surface, summed over all lights; never blurred."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

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

SURFACE = ("position", "normal_geometry", "normal_shading")
# A grazing mirror of a narrow lobe reflects ten thousand times what a white wall does.
HIGHLIGHTS = Buffer("specular", exact=True)


def passes(scene: Scene) -> list[Pass]:
    shadowed = [f"visibility_{lamp.index}" for lamp in scene.lamps if lamp.settings.shadow]
    has_ambient = bool(np.any(scene.ambient))
    # What hides the sky hides no lamp.
    surface = (*SURFACE, "ao") if has_ambient or scene.environments else SURFACE

    def draw(
        shot: Shot, inputs: Mapping[str, moderngl.Texture], target: moderngl.Framebuffer
    ) -> None:
        device = scene.device
        common = {**_material(scene), **shot.screen_uniforms}
        common |= {name: inputs[name] for name in surface}
        if has_ambient:
            ambient = {"ambient": scene.ambient, "visibility": scene.white}
            program = device.program("specular", defines=(AMBIENT,))
            bind(program, {**common, **ambient})
            device.fill(program)
        device.context.enable(moderngl.BLEND)
        device.context.blend_func = moderngl.ONE, moderngl.ONE
        for environment in scene.environments:
            around = {
                **environment_uniforms(environment, shot),
                "lobe_map_0": environment.lobes[0],
                "lobe_map_1": environment.lobes[1],
                "visibility": scene.white,
            }
            program = device.program("specular", defines=(ENVIRONMENT,))
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
            program = device.program("specular", defines=(LAMP,))
            bind(program, uniforms)
            device.fill(program)

    reads = (*surface, *shadowed)
    return [Pass("specular", reads, (HIGHLIGHTS,), draw, in_picture=True)]


def _material(scene: Scene) -> dict[str, Any]:
    specular = scene.pipeline.skin.specular
    return {
        "directional_albedo": scene.directional_albedo,
        "lobe_albedo": scene.lobe_albedo,
        "f0": specular.f0,
        "roughness": tuple(np.clip(specular.roughness, 0.01, 1.0)),
        "second_lobe": specular.second_lobe,
        "strength": specular.strength,
    }
