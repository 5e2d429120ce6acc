"""scattered: the weighted sum of the levels before albedo, as the separable methods have it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import moderngl
import numpy as np

from scanrender.render.device import bind
from scanrender.render.graph import Buffer, Pass
from scanrender.render.scene import Scene, Shot

LEVELS_A_DRAW = 8
Term = tuple[str, tuple[float, float, float]]


def passes(scene: Scene) -> list[Pass]:
    if scene.pipeline.diffusion.method != "gaussian_sum":
        return []
    terms: list[Term] = [(f"gaussian_{k}", w) for k, w in enumerate(scene.levels.weights)]

    def draw(
        shot: Shot, inputs: Mapping[str, moderngl.Texture], target: moderngl.Framebuffer
    ) -> None:
        device = scene.device
        program = device.program("scattered")
        device.context.enable(moderngl.BLEND)
        device.context.blend_func = moderngl.ONE, moderngl.ONE
        for first in range(0, len(terms), LEVELS_A_DRAW):
            group = terms[first : first + LEVELS_A_DRAW]
            # Samplers past the group repeat its first level: unused, but never unbound.
            levels = [inputs[name] for name, _ in group]
            levels += [levels[0]] * (LEVELS_A_DRAW - len(group))
            uniforms: dict[str, Any] = {f"level_{k}": level for k, level in enumerate(levels)}
            uniforms["diffusion_input"] = inputs["diffusion_input"]
            uniforms["weight"] = _weights(group)
            uniforms["level_count"] = len(group)
            uniforms["brings_mask"] = first == 0
            bind(program, uniforms)
            device.fill(program)

    reads = ("diffusion_input", *(name for name, _ in terms))
    return [Pass("scattered", reads, (Buffer("scattered"),), draw, in_picture=True)]


def _weights(group: Sequence[Term]) -> bytes:
    """vec4[LEVELS_A_DRAW] of (RGB weight, 0)."""
    array = np.zeros((LEVELS_A_DRAW, 4), dtype=np.float32)
    array[: len(group), :3] = [weight for _, weight in group]
    return array.tobytes()
