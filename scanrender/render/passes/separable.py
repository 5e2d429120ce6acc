"""separable: a kernel that blurs along rows, then along columns, and is done."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any

import moderngl
import numpy as np

from scanrender.optics.kernels import (
    SeparableTaps,
    falloff_per_mm2,
    separable_artistic,
    separable_preintegrated,
)
from scanrender.render.device import bind
from scanrender.render.graph import Buffer, Pass
from scanrender.render.passes._scatter import (
    DIRECTIONS,
    MAX_TAPS,
    WeightDraw,
    defines,
    guides,
    largest_width_factor,
    uniforms,
    weight_pass,
)
from scanrender.render.scene import SEPARABLE, Scene, Shot, artistic_sigmas_mm

LEAST_TAPS = 9


def passes(scene: Scene) -> list[Pass]:
    if scene.pipeline.diffusion.method not in SEPARABLE:
        return []
    half = (0.5, 0.5, 0.5)

    def draws(shot: Shot) -> Iterable[WeightDraw]:
        program = scene.device.program("separable", defines=(*defines(scene, shot), "WEIGHTS"))
        taps = tap_uniforms(scene, shot, program)
        return [WeightDraw(direction, taps, half, 0.5) for direction in DIRECTIONS]

    return [
        weight_pass(scene, draws, "separable"),
        _direction(scene, "diffusion_input", "diffuse_horizontal", (1, 0)),
        _direction(scene, "diffuse_horizontal", "scattered", (0, 1)),
    ]


def _direction(scene: Scene, source: str, written: str, direction: tuple[int, int]) -> Pass:
    def draw(
        shot: Shot, inputs: Mapping[str, moderngl.Texture], target: moderngl.Framebuffer
    ) -> None:
        program = scene.device.program("separable", defines=defines(scene, shot))
        bind(
            program,
            {
                **uniforms(scene, shot, inputs, source, direction),
                **tap_uniforms(scene, shot, program),
            },
        )
        scene.device.fill(program)

    reads, is_last = (source, *guides(scene)), written == "scattered"
    return Pass(written, reads, (Buffer(written),), draw, in_picture=is_last)


def taps_for(samples: int, reach_px: float) -> int:
    """Taps that the kernel needs: about two a pixel of its reach, at most `samples`."""
    return min(samples, max(LEAST_TAPS, 2 * math.ceil(reach_px) + 1))


def tap_uniforms(scene: Scene, shot: Shot, program: moderngl.Program) -> dict[str, Any]:
    """Bind the kernel's block for this shot; return how many taps it holds."""
    reach_mm = float(scene.reach_mm.max())
    reach_px = reach_mm * largest_width_factor(scene) * shot.px_per_mm(shot.near_mm)
    count = taps_for(scene.pipeline.diffusion.samples, reach_px)
    block: Any = program["Taps"]
    block.binding = 0
    scene.tap_block(count, kernel_block).bind_to_uniform_block(0)
    return {"tap_count": count}


def kernel_taps(scene: Scene, count: int) -> SeparableTaps:
    """The kernel of the settings in `count` taps, out to the radius of 99.9 % of the light."""
    reach_mm = float(scene.reach_mm.max())
    if scene.pipeline.diffusion.method == "separable_preintegrated":
        return separable_preintegrated(scene.scattering, count, reach_mm)
    near_mm, far_mm = artistic_sigmas_mm(scene.pipeline)
    strength = scene.pipeline.diffusion.artistic.strength
    return separable_artistic(near_mm, far_mm, strength, count, reach_mm)


def kernel_block(scene: Scene, count: int) -> bytes:
    """std140: vec4[255] of (RGB weight, offset mm), vec4[255] of (RGB falloff, cell mm)."""
    taps = kernel_taps(scene, count)
    block = np.zeros((2, MAX_TAPS, 4), dtype=np.float32)
    block[0, :count] = np.hstack([taps.weights, taps.offsets_mm[:, None]])
    falloff = falloff_per_mm2(scene.scattering, taps.offsets_mm)
    block[1, :count] = np.hstack([falloff, taps.cell_mm[:, None]])
    return block.tobytes()
