"""gaussian_sum: the levels of the sum of Gaussians, each blurred from the one before."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
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
    width_by_curvature,
)
from scanrender.render.scene import Scene, Shot

# A Gaussian is empty beyond this many sigma (0.3 % of it).
REACH_SIGMA = 3.0
# Taps, over this, are how many times wider than what it blurs a Gaussian may be; no fewer times
# than LEAST_STEP.
GAPLESS_TAPS = 5.0
LEAST_STEP = 1.8
# From this share of the subject's bounding radius on, a Gaussian's taps also have to find outlines:
# three times as close, whatever the user allows. With fewer taps, more steps would take longer.
OUTLINE_SHARE, OUTLINE_TAPS, OUTLINE_STEP = 0.1, 15, 1.0
# From so many radii on a Gaussian weighs all of the subject alike: its edges by 3 % less across it.
EVEN_SHARE, LEAST_FACTOR = 8.0, 0.02
DIRECT = "diffusion_input"
# Whole-pixel taps up to this sigma, at any number of samples up to the lesser one.
TABLE_PX = 4.0
NARROW_PX = 0.75
TABLE_ROWS = 129
TABLE_RADIUS = 13


def taps_for(samples: int, sigma_px: float) -> int:
    """Taps that a Gaussian needs: never more than one a pixel, which is all there is to read.

    Odd, so that the centre is a tap: four leave the pixel itself out, and differ from one
    resolution to the next by more than three. `samples` is what the user allows at most.
    """
    odd = samples - (samples + 1) % 2
    return min(odd, 2 * math.ceil(REACH_SIGMA * sigma_px) + 1)


def narrow_taps(samples: int) -> tuple[int, float]:
    """(radius, sigma_px up to which it serves) of the whole-pixel taps that `samples` allows."""
    radius = min(TABLE_RADIUS, (samples - 1) // 2)
    return radius, min(TABLE_PX, max(NARROW_PX, (radius - 1) / REACH_SIGMA))


@dataclass(frozen=True)
class Blur:
    """One Gaussian of the chain: it blurs `source`, which has `before_mm2` of variance already, to
    `variance_mm2`, along rows into `between` and then along columns into `written`."""

    source: str
    between: str
    written: str
    variance_mm2: float
    before_mm2: float

    def is_direct(self, scene: Scene, shot: Shot) -> bool:
        """Whether it blurs the light itself: the first one, and those that whole pixels hold."""
        return self.before_mm2 == 0.0 or is_narrow(scene, shot, self.variance_mm2)

    def uniforms(self, scene: Scene, shot: Shot, direction: tuple[int, int]) -> dict[str, Any]:
        is_direct = self.is_direct(scene, shot)
        done = 0.0 if is_direct else self.before_mm2
        samples = scene.pipeline.diffusion.samples
        if math.sqrt(self.variance_mm2) > OUTLINE_SHARE * scene.radius_mm:
            samples = max(samples, OUTLINE_TAPS)
        added = self.variance_mm2 - done
        return level_uniforms(scene, shot, direction, added, is_direct, samples)


def blurs(scene: Scene) -> list[Blur]:
    """The profile's levels in order, and before or between them what closes the gaps of their taps.

    Taps of a Gaussian many times wider than what it blurs lie far apart, and show as many copies
    of every edge. Steps in between have taps no further apart than 1.2 sigmas of what is blurred,
    where copies are far below 0.1 % high. A profile on a surface that is not very near needs none.
    """
    pixel_mm = 1.0 / (scene.nearest_px_per_mm * largest_width_factor(scene))
    narrowest = max(width_by_curvature(scene)[0], LEAST_FACTOR)
    even_mm2 = (EVEN_SHARE * scene.radius_mm / narrowest) ** 2
    found: list[Blur] = []
    source, done = "diffusion_input", 0.0
    last = len(scene.levels.variances_mm2) - 1
    for level, variance in enumerate(np.minimum(scene.levels.variances_mm2, even_mm2)):
        while math.sqrt(variance - done) > (step_mm := _widest_step_mm(scene, done, pixel_mm)):
            name, total = f"_before_{len(found)}", done + step_mm**2
            found.append(Blur(source, f"{name}_horizontal", name, total, done))
            source, done = name, total
        between = "diffuse_horizontal" if level == last else f"_horizontal_{level}"
        found.append(Blur(source, between, f"gaussian_{level}", variance, done))
        source, done = f"gaussian_{level}", variance
    return found


def _widest_step_mm(scene: Scene, done_mm2: float, pixel_mm: float) -> float:
    """Sigma of the widest Gaussian that may blur what has this variance already.

    Beyond an outline there is no light that an earlier level could have blurred: taps as far apart
    as inside the subject find one more or one less of it from pixel to pixel, and its copies show.
    """
    blurred_mm = max(math.sqrt(done_mm2), pixel_mm)
    inside = max(scene.pipeline.diffusion.samples / GAPLESS_TAPS, LEAST_STEP)
    narrow_mm = min(inside * blurred_mm, OUTLINE_SHARE * scene.radius_mm)
    return max(narrow_mm, OUTLINE_STEP * blurred_mm)


def passes(scene: Scene) -> list[Pass]:
    if scene.pipeline.diffusion.method != "gaussian_sum":
        return []
    found = [weight_pass(scene, lambda shot: _weight_draws(scene, shot), "gaussian_sum")]
    for blur in blurs(scene):
        found.append(_direction(scene, blur, blur.source, blur.between, (1, 0)))
        found.append(_direction(scene, blur, blur.between, blur.written, (0, 1)))
    return found


def _direction(
    scene: Scene, blur: Blur, source: str, written: str, direction: tuple[int, int]
) -> Pass:
    def draw(
        shot: Shot, inputs: Mapping[str, moderngl.Texture], target: moderngl.Framebuffer
    ) -> None:
        program = scene.device.program("gaussian_sum", defines=defines(scene, shot))
        is_first = direction == (1, 0) and blur.is_direct(scene, shot)
        bind(
            program,
            {
                **uniforms(scene, shot, inputs, DIRECT if is_first else source, direction),
                **blur.uniforms(scene, shot, direction),
            },
        )
        scene.device.fill(program)

    first = (DIRECT,) if direction == (1, 0) else ()
    reads = tuple(dict.fromkeys((source, *first, *guides(scene))))
    return Pass(written.lstrip("_"), reads, (Buffer(written),), draw)


def _weight_draws(scene: Scene, shot: Shot) -> Iterator[WeightDraw]:
    """Each level in both directions, by its weight in the sum."""
    weights = scene.levels.weights
    levels = [blur for blur in blurs(scene) if not blur.written.startswith("_")]
    for blur, (r, g, b) in zip(levels, weights, strict=True):
        for direction in DIRECTIONS:
            taps = blur.uniforms(scene, shot, direction)
            yield WeightDraw(direction, taps, (r / 2, g / 2, b / 2), 0.5 / len(weights))


def is_narrow(scene: Scene, shot: Shot, variance_mm2: float) -> bool:
    """Whether whole-pixel taps hold all of this variance, so that it needs no other level.

    Blurs below a pixel do not add up: each would have to know how the last one met the pixels.
    """
    widest_px = _widest_px(scene, shot, math.sqrt(variance_mm2))
    return widest_px <= narrow_taps(scene.pipeline.diffusion.samples)[1]


def _widest_px(scene: Scene, shot: Shot, sigma_mm: float) -> float:
    return sigma_mm * largest_width_factor(scene) * shot.px_per_mm(shot.near_mm)


def level_uniforms(
    scene: Scene,
    shot: Shot,
    direction: tuple[int, int],
    variance_mm2: float,
    is_direct: bool,
    samples: int,
) -> dict[str, Any]:
    """Taps that add a variance along `direction`.

    A direct level turns samples into what the pixel's footprint sees; the others blur a level.
    """
    sigma_mm = math.sqrt(variance_mm2)
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
