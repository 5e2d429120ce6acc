"""curvature: curvature_raw, or the asset's map, smoothed on the surface, rows then columns."""

from __future__ import annotations

import math
from collections.abc import Mapping

import moderngl

from scanrender.render.device import bind
from scanrender.render.graph import Buffer, Pass
from scanrender.render.scene import Scene, Shot


def passes(scene: Scene) -> list[Pass]:
    source = "_baked" if scene.pipeline.curvature.source == "baked" else "curvature_raw"
    return [
        _direction(scene, source, "_curvature_horizontal", (1, 0)),
        _direction(scene, "_curvature_horizontal", "curvature", (0, 1)),
    ]


def _sigma_mm(scene: Scene) -> float:
    """What is left to smooth: the bake has done its part, and variances add."""
    curvature = scene.pipeline.curvature
    done = scene.baked_curvature_mm if curvature.source == "baked" else 0.0
    return math.sqrt(max(curvature.smooth_mm**2 - done**2, 0.0))


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
                "sigma_mm": _sigma_mm(scene),
                **shot.screen_uniforms,
            },
        )
        scene.device.fill(program)

    return Pass(written.lstrip("_"), (source, "position"), (Buffer(written, components=1),), draw)
