"""transmission: light that crosses thin skin from behind, with thickness from the shadow maps."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import moderngl
import numpy as np

from scanrender.render.device import bind
from scanrender.render.graph import Buffer, Pass
from scanrender.render.lamps import Lamp
from scanrender.render.passes._lamp import DISK_TAPS, light_uniforms, shadow_uniforms
from scanrender.render.scene import Scene, Shot

SURFACE = ("position", "normal_geometry", "albedo", "skin")


def passes(scene: Scene) -> list[Pass]:
    """Thickness and transmittance of the first lamp that casts a shadow; light of all of them."""
    lamps = [lamp for lamp in scene.lamps if lamp.settings.shadow]
    if not lamps or scene.pipeline.skin.transmission.method == "none":
        return []
    rows = np.column_stack([0.5 / np.asarray(scene.profile.variances_mm2), scene.profile.weights])
    profile = scene.device.table(rows[:, None, :])

    def draw(
        shot: Shot, inputs: Mapping[str, moderngl.Texture], target: moderngl.Framebuffer
    ) -> None:
        device = scene.device
        program = device.program("transmission")
        common = {**{name: inputs[name] for name in SURFACE}, **_material(scene)}
        common |= {"profile": profile, "profile_count": len(rows)}
        for number, lamp in enumerate(lamps):
            if number == 1:
                # Later lamps add their light but must leave the first one's thickness alone.
                device.context.enable(moderngl.BLEND)
                device.context.blend_func = moderngl.ONE, moderngl.ONE
                _write_to(target, True, False, False)
            bind(program, {**common, **_lamp_uniforms(scene, lamp, shot, inputs)})
            device.fill(program)
        _write_to(target, True, True, True)

    reads = (*SURFACE, *(f"shadow_{lamp.index}" for lamp in lamps))
    writes = (Buffer("transmission"), Buffer("thickness_mm", components=1), Buffer("transmittance"))
    return [Pass("transmission", reads, writes, draw)]


def _write_to(target: moderngl.Framebuffer, *attachments: bool) -> None:
    """Which attachments take colour (moderngl's stub knows only the form for one)."""
    target.color_mask = tuple((on,) * 4 for on in attachments)  # type: ignore[assignment]


def _lamp_uniforms(
    scene: Scene, lamp: Lamp, shot: Shot, inputs: Mapping[str, moderngl.Texture]
) -> dict[str, Any]:
    return {
        **light_uniforms(lamp, shot),
        **shadow_uniforms(lamp, shot, inputs[f"shadow_{lamp.index}"]),
        "far_mm": 2.0 * scene.radius_mm,
    }


def _material(scene: Scene) -> dict[str, Any]:
    transmission = scene.pipeline.skin.transmission
    return {
        "bias_mm": transmission.bias_mm,
        "blur_mm": transmission.blur_mm,
        "wrap": transmission.wrap,
        "use_skin": scene.uses_skin_map,
        "tap_count": DISK_TAPS,
    }
