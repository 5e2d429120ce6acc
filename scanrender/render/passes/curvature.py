"""curvature: curvature_raw, or the asset's map, smoothed on the surface, rows then columns.

Two Gaussians for one: a narrow one with a tap on every pixel, then a wide one with taps as far
apart as the narrow one allows. On noise that is within 1.6 % of a tap on every pixel from 0.5 to
60 px, and costs the root of the radius: 50 taps a direction at 9 px (instead of 55), 116 at 60 px
(instead of 361). Decision 15.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import moderngl

from scanrender.render.device import bind
from scanrender.render.graph import Buffer, Pass
from scanrender.render.scene import Scene, Shot

STEPS = (("FINE", (1, 0)), ("FINE", (0, 1)), ("COARSE", (1, 0)), ("COARSE", (0, 1)))


def passes(scene: Scene) -> list[Pass]:
    names = [
        "_baked" if scene.pipeline.curvature.source == "baked" else "curvature_raw",
        *(f"_curvature_{number}" for number in range(1, len(STEPS))),
        "curvature",
    ]
    return [
        _step(scene, names[number], names[number + 1], step, direction)
        for number, (step, direction) in enumerate(STEPS)
    ]


def _sigma_mm(scene: Scene) -> float:
    """What is left to smooth; variances add.

    On screen, too, in all no less than what the bake found necessary to lose the scan's triangles
    and noise: below it the curvature is that of facets, and differs from the baked one by a third.
    """
    curvature, needed = scene.pipeline.curvature, scene.baked_curvature_mm
    done = needed if curvature.source == "baked" else scene.facet_mm
    return math.sqrt(max(max(curvature.smooth_mm, needed) ** 2 - done**2, 0.0))


def _step(scene: Scene, source: str, written: str, step: str, direction: tuple[int, int]) -> Pass:
    def draw(
        shot: Shot, inputs: Mapping[str, moderngl.Texture], target: moderngl.Framebuffer
    ) -> None:
        program = scene.device.program("curvature", defines=(step,))
        bind(
            program,
            {
                "source": inputs[source],
                "position": inputs["position"],
                "direction": direction,
                "sigma_mm": _sigma_mm(scene),
                **shot.screen_uniforms,
            },
        )
        scene.device.fill(program)

    return Pass(written.lstrip("_"), (source, "position"), (Buffer(written, components=1),), draw)
