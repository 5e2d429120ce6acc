"""curvature: curvature_raw smoothed along the surface, rows then columns."""

from __future__ import annotations

from collections.abc import Mapping

import moderngl

from scanrender.render.device import bind
from scanrender.render.graph import Buffer, Pass
from scanrender.render.scene import Scene, Shot


def passes(scene: Scene) -> list[Pass]:
    return [
        _direction(scene, "curvature_raw", "_curvature_horizontal", (1, 0)),
        _direction(scene, "_curvature_horizontal", "curvature", (0, 1)),
    ]


def _direction(scene: Scene, source: str, written: str, direction: tuple[int, int]) -> Pass:
    def draw(
        shot: Shot, inputs: Mapping[str, moderngl.Texture], target: moderngl.Framebuffer
    ) -> None:
        program = scene.device.program("curvature")
        taps = scene.smoothing_taps
        bind(
            program,
            {
                "source": inputs[source],
                "position": inputs["position"],
                "taps": taps,
                "tap_count": taps.size[0],
                "direction": direction,
                "sigma_mm": scene.pipeline.curvature.smooth_mm,
                **shot.screen_uniforms,
            },
        )
        scene.device.fill(program)

    return Pass(written.lstrip("_"), (source, "position"), (Buffer(written, components=1),), draw)
