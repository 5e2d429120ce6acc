"""visibility: how much of each lamp reaches the surface, with a soft edge."""

from __future__ import annotations

from collections.abc import Mapping

import moderngl

from scanrender.render.device import bind
from scanrender.render.graph import Buffer, Pass
from scanrender.render.lamps import Lamp
from scanrender.render.passes._lamp import DISK_TAPS, shadow_uniforms
from scanrender.render.scene import Scene, Shot

# Widest penumbra that is looked for, as a share of the subject's bounding radius: taps spread wider
# than that would miss the subject.
MAX_PENUMBRA = 0.3
# Half as many miss what covers less than a fifth of the light, and its shadow ends in a step.
SEARCH_TAPS = 32


def passes(scene: Scene) -> list[Pass]:
    return [_visibility(scene, lamp) for lamp in scene.lamps if lamp.settings.shadow]


def _visibility(scene: Scene, lamp: Lamp) -> Pass:
    shadow_map = f"shadow_{lamp.index}"

    def draw(
        shot: Shot, inputs: Mapping[str, moderngl.Texture], target: moderngl.Framebuffer
    ) -> None:
        program = scene.device.program("visibility", defines=("SIZED",) if lamp.size > 0 else ())
        bind(
            program,
            {
                **shadow_uniforms(lamp, shot, inputs[shadow_map]),
                "position": inputs["position"],
                "normal_geometry": inputs["normal_geometry"],
                "normal_shading": inputs["normal_shading"],
                "light_size": lamp.size,
                "reach_mm": MAX_PENUMBRA * scene.radius_mm,
                "blur_mm": min(lamp.settings.shadow_blur_mm, MAX_PENUMBRA * scene.radius_mm),
                "taps": DISK_TAPS,
                "search_taps": SEARCH_TAPS,
            },
        )
        scene.device.fill(program)

    return Pass(
        f"visibility_{lamp.index}",
        ("position", "normal_geometry", "normal_shading", shadow_map),
        (Buffer(f"visibility_{lamp.index}", components=1),),
        draw,
    )
