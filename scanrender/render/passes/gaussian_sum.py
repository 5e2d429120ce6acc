"""gaussian_sum: the levels of the sum of Gaussians, each blurred from the one before."""

from __future__ import annotations

import math
from collections.abc import Mapping

import moderngl
import numpy as np

from scanrender.render.device import bind
from scanrender.render.graph import Buffer, Pass
from scanrender.render.scene import Scene, Shot

# Size of the shader's array; `diffusion.samples` is bounded by it.
MAX_TAPS = 255
HALO = {"none": 0, "depth": 1, "measure": 2}
# A Gaussian is empty beyond this many sigma (0.3 % of it).
REACH_SIGMA = 3.0


def taps_for(samples: int, sigma_px: float) -> int:
    """Taps that a Gaussian needs: never more than one a pixel, which is all there is to read.

    Odd, so that the centre is a tap. `samples` is what the user allows at most.
    """
    return min(samples, 2 * math.ceil(REACH_SIGMA * sigma_px) + 1)


def passes(scene: Scene) -> list[Pass]:
    if scene.pipeline.diffusion.method != "gaussian_sum":
        return []
    found = []
    sigmas = np.sqrt(scene.profile.increments_mm2())
    for level, sigma_mm in enumerate(sigmas):
        source = "diffusion_input" if level == 0 else f"gaussian_{level - 1}"
        is_last = level == len(sigmas) - 1
        between = "diffuse_horizontal" if is_last else f"_horizontal_{level}"
        found.append(_direction(scene, source, between, (1, 0), float(sigma_mm)))
        found.append(_direction(scene, between, f"gaussian_{level}", (0, 1), float(sigma_mm)))
    return found


def _direction(
    scene: Scene, source: str, written: str, direction: tuple[int, int], sigma_mm: float
) -> Pass:
    diffusion = scene.pipeline.diffusion

    def draw(
        shot: Shot, inputs: Mapping[str, moderngl.Texture], target: moderngl.Framebuffer
    ) -> None:
        program = scene.device.program("gaussian_sum")
        texture = inputs[source]
        sigma_px = sigma_mm * shot.px_per_mm(shot.near_mm)
        tap_count = taps_for(diffusion.samples, sigma_px)
        taps = scene.gaussian_taps(tap_count, MAX_TAPS)
        bind(
            program,
            {
                "source": texture,
                "depth_mm": inputs["depth_mm"],
                "taps": taps,
                "tap_count": tap_count,
                "direction": direction,
                "sigma_mm": sigma_mm,
                **shot.screen_uniforms,
                "halo": HALO[diffusion.halo],
            },
        )
        texture.filter = (moderngl.LINEAR, moderngl.LINEAR)
        scene.device.fill(program)
        texture.filter = (moderngl.NEAREST, moderngl.NEAREST)

    return Pass(written.lstrip("_"), (source, "depth_mm"), (Buffer(written),), draw)
