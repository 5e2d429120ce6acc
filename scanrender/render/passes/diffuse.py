"""diffuse: scattered light, or the levels' weighted sum, after albedo; or plain irradiance."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import moderngl
import numpy as np

from scanrender.render.device import bind
from scanrender.render.graph import Buffer, Pass
from scanrender.render.scene import Scene, Shot

SURFACE = ("albedo", "skin", "position", "normal_shading")
WHITE = (1.0, 1.0, 1.0)
LEVELS_A_DRAW = 8
Term = tuple[str, tuple[float, float, float], int]
NO_MASK, SKIN_SHARE, OTHER_SHARE = 0, 1, 2


def passes(scene: Scene) -> list[Pass]:
    terms = _terms(scene)

    def draw(
        shot: Shot, inputs: Mapping[str, moderngl.Texture], target: moderngl.Framebuffer
    ) -> None:
        device = scene.device
        program = device.program("diffuse")
        common: dict[str, Any] = {name: inputs[name] for name in SURFACE}
        common |= shot.screen_uniforms
        common["directional_albedo"] = scene.directional_albedo
        device.context.enable(moderngl.BLEND)
        device.context.blend_func = moderngl.ONE, moderngl.ONE
        for first in range(0, len(terms), LEVELS_A_DRAW):
            group = terms[first : first + LEVELS_A_DRAW]
            # Samplers past the group repeat its first level: unused, but never unbound.
            levels = [inputs[name] for name, _, _ in group]
            levels += [levels[0]] * (LEVELS_A_DRAW - len(group))
            uniforms: dict[str, Any] = {f"level_{k}": level for k, level in enumerate(levels)}
            uniforms["weight"] = _weights(group)
            uniforms["level_count"] = len(group)
            uniforms["albedo_power"] = scene.albedo_power
            bind(program, {**common, **uniforms})
            device.fill(program)

    reads = (*SURFACE, *(name for name, _, _ in terms))
    return [Pass("diffuse", reads, (Buffer("diffuse"),), draw)]


def _weights(group: Sequence[Term]) -> bytes:
    """vec4[LEVELS_A_DRAW] of (RGB weight, how the skin map shares it)."""
    array = np.zeros((LEVELS_A_DRAW, 4), dtype=np.float32)
    for row, (_, weight, blend) in zip(array, group, strict=False):
        row[:] = (*weight, blend)
    return array.tobytes()


def _terms(scene: Scene) -> list[Term]:
    """(buffer, weight, how the skin map shares it) of everything that is added."""
    if scene.pipeline.diffusion.method == "none":
        return [("diffusion_input", WHITE, NO_MASK)]
    masked = scene.uses_skin_map
    blend = SKIN_SHARE if masked else NO_MASK
    levels: list[Term] = [("scattered", WHITE, blend)]
    if scene.pipeline.diffusion.method == "gaussian_sum":
        levels = [(f"gaussian_{k}", w, blend) for k, w in enumerate(scene.profile.weights)]
    return [*levels, *([("diffusion_input", WHITE, OTHER_SHARE)] if masked else [])]
