"""gaussian_sum: the levels of the sum of Gaussians, each blurred from the one before."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from functools import lru_cache
from typing import Any

import moderngl
import numpy as np

from scanrender.optics.kernels import discrete_gaussian_taps, footprint_taps
from scanrender.render.device import Device, bind
from scanrender.render.graph import Buffer, Pass
from scanrender.render.passes._scatter import (
    DIRECTIONS,
    MAX_TAPS,
    WeightDraw,
    defines,
    guides,
    largest_width_factor,
    sample_shift_px,
    uniforms,
    weight_pass,
)
from scanrender.render.scene import Scene, Shot

# A Gaussian is empty beyond this many sigma (0.3 % of it).
REACH_SIGMA = 3.0
# Whole-pixel taps up to this sigma, at any number of samples up to the lesser one.
TABLE_PX = 4.0
NARROW_PX = 0.75
TABLE_ROWS = 129
TABLE_RADIUS = 13


def taps_for(samples: int, sigma_px: float) -> int:
    """Taps that a Gaussian needs: never more than one a pixel, which is all there is to read.

    Odd, so that the centre is a tap. `samples` is what the user allows at most.
    """
    return min(samples, 2 * math.ceil(REACH_SIGMA * sigma_px) + 1)


def narrow_taps(samples: int) -> tuple[int, float]:
    """(radius, sigma_px up to which it serves) of the whole-pixel taps that `samples` allows."""
    radius = min(TABLE_RADIUS, (samples - 1) // 2)
    return radius, min(TABLE_PX, max(NARROW_PX, (radius - 1) / REACH_SIGMA))


def passes(scene: Scene) -> list[Pass]:
    if scene.pipeline.diffusion.method != "gaussian_sum":
        return []
    found = [weight_pass(scene, lambda shot: _weight_draws(scene, shot), "gaussian_sum")]
    count = len(scene.levels.variances_mm2)
    for level in range(count):
        source = "diffusion_input" if level == 0 else f"gaussian_{level - 1}"
        between = "diffuse_horizontal" if level == count - 1 else f"_horizontal_{level}"
        found.append(_direction(scene, source, between, (1, 0), level))
        found.append(_direction(scene, between, f"gaussian_{level}", (0, 1), level))
    return found


def _direction(
    scene: Scene, source: str, written: str, direction: tuple[int, int], level: int
) -> Pass:
    def draw(
        shot: Shot, inputs: Mapping[str, moderngl.Texture], target: moderngl.Framebuffer
    ) -> None:
        program = scene.device.program("gaussian_sum", defines=defines(scene, shot))
        is_direct = level == 0 or level_is_narrow(scene, shot, level)
        blurred = "diffusion_input" if is_direct and direction == (1, 0) else source
        bind(
            program,
            {
                **uniforms(scene, shot, inputs, blurred, direction),
                **level_uniforms(scene, shot, direction, level, is_direct),
            },
        )
        scene.device.fill(program)

    first = ("diffusion_input",) if direction == (1, 0) else ()
    reads = tuple(dict.fromkeys((source, *first, *guides(scene))))
    return Pass(written.lstrip("_"), reads, (Buffer(written),), draw)


def _weight_draws(scene: Scene, shot: Shot) -> Iterator[WeightDraw]:
    """Each level in both directions, by its weight in the sum."""
    weights = scene.levels.weights
    for level, (r, g, b) in enumerate(weights):
        is_direct = level == 0 or level_is_narrow(scene, shot, level)
        for direction in DIRECTIONS:
            taps = level_uniforms(scene, shot, direction, level, is_direct)
            yield WeightDraw(direction, taps, (r / 2, g / 2, b / 2), 0.5 / len(weights))


def level_is_narrow(scene: Scene, shot: Shot, level: int) -> bool:
    """Whether whole-pixel taps hold all of this level's variance, so that it needs no other level.

    Blurs below a pixel do not add up: each would have to know how the last one met the pixels.
    """
    sigma_mm = math.sqrt(scene.levels.variances_mm2[level])
    widest_px = _widest_px(scene, shot, sigma_mm)
    return widest_px <= narrow_taps(scene.pipeline.diffusion.samples)[1]


def _widest_px(scene: Scene, shot: Shot, sigma_mm: float) -> float:
    return sigma_mm * largest_width_factor(scene) * shot.px_per_mm(shot.near_mm)


def level_uniforms(
    scene: Scene, shot: Shot, direction: tuple[int, int], level: int, is_direct: bool
) -> dict[str, Any]:
    """Taps of one level along `direction`.

    A direct level turns samples into what the pixel's footprint sees; the others blur a level.
    """
    samples = scene.pipeline.diffusion.samples
    variance = scene.levels.variances_mm2[level]
    if not is_direct:
        variance = float(scene.levels.increments_mm2()[level])
    sigma_mm = math.sqrt(variance)
    widest_px = _widest_px(scene, shot, sigma_mm)
    radius, narrow_px = narrow_taps(samples)
    radius = max(1, min(radius, math.ceil(REACH_SIGMA * min(widest_px, narrow_px)) + 1))
    tap_count = taps_for(samples, widest_px)
    offsets = scene.gaussian_taps(tap_count, MAX_TAPS)
    shift_px, bilinear_px2, cells = 0.0, 1.0 / 6.0, 0
    if is_direct:
        cells = scene.scattered_samples
        shift_px = sample_shift_px(shot, direction)
        bilinear_px2 = (1.0 - 1.0 / cells**2) / 12.0
    first = np.frombuffer(offsets, np.float32)[0:4:2]
    return {
        "table": _table(scene.device, radius, shift_px, cells),
        "radius": radius,
        "table_px": TABLE_PX,
        "narrow_px": narrow_px,
        "taps": offsets,
        "tap_count": tap_count,
        "tap_cell": 0.5 * float(first[1] - first[0]) if tap_count > 1 else 0.0,
        "sigma_mm": sigma_mm,
        "bilinear_px2": bilinear_px2,
        "shift_px": shift_px,
    }


@lru_cache(maxsize=1024)
def _table(device: Device, radius: int, shift_px: float, cells: int) -> moderngl.Texture:
    """Whole-pixel taps over sigma in [0, TABLE_PX]; `cells` 0 for the later levels."""
    sigma_px = np.linspace(0.0, TABLE_PX, TABLE_ROWS)
    if cells:
        weights = footprint_taps(sigma_px, radius, shift_px, cells)
    else:
        weights = discrete_gaussian_taps(sigma_px, radius)
    return device.table(weights[:, :, None], linear=True)
