"""lab: the albedo in CIE Lab, smoothed with its edges kept; the guide of the limit."""

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
        program = scene.device.program("lab", defines=("CONVERT",))
        bind(program, {"source": inputs["albedo"], "depth_mm": inputs["depth_mm"]})
        scene.device.fill(program)

    smooths = scene.pipeline.diffusion.limit_smooth_mm > 0.0
    converted = "_lab_raw" if smooths else "lab"
    found = [Pass("lab_raw", ("albedo", "depth_mm"), (Buffer(converted),), draw)]
    if smooths:
        found.append(_direction(scene, "_lab_raw", "_lab_horizontal", (1, 0)))
        found.append(_direction(scene, "_lab_horizontal", "lab", (0, 1)))
    return found


def _direction(scene: Scene, source: str, written: str, direction: tuple[int, int]) -> Pass:
    diffusion = scene.pipeline.diffusion

    def draw(
        shot: Shot, inputs: Mapping[str, moderngl.Texture], target: moderngl.Framebuffer
    ) -> None:
        taps = scene.smoothing_taps
        program = scene.device.program("lab")
        bind(
            program,
            {
                "source": inputs[source],
                "depth_mm": inputs["depth_mm"],
                "taps": taps,
                "tap_count": taps.size[0],
                "direction": direction,
                "sigma_mm": diffusion.limit_smooth_mm,
                **shot.screen_uniforms,
                "colour_falloff": 0.5 / diffusion.limit_delta_e**2,
            },
        )
        scene.device.fill(program)

    return Pass(written.lstrip("_"), (source, "depth_mm"), (Buffer(written),), draw)
