"""disk: the surface integral itself, over a disk of taps in the tangent plane of each pixel."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import moderngl
import numpy as np

from scanrender.optics.kernels import MAX_SAMPLES, DiskTaps, disk_taps
from scanrender.optics.profiles import GaussianSum
from scanrender.render.device import bind
from scanrender.render.graph import Buffer, Pass
from scanrender.render.passes._scatter import WeightDraw, defines, guides, uniforms, weight_pass
from scanrender.render.scene import Scene, Shot

TABLE_TEXELS = 1024
# What the profile holds within this radius stays in the pixel and needs no tap. Of what goes
# further a part stays too: with the radius of a pixel's area (0.56) hard edges are off by 3 %.
INNER_PX = 0.25
# Of the tangent plane to the eye: closer to edge on it has no taps.
LEAST_COSINE = 0.2
# Of a plain sum: where the plane of taps faces the eye, and where no further taps are added.
FACING_RADII = 12.5
MOST_RADII = 5.0
GOLDEN_RATIO = 0.5 * (1.0 + math.sqrt(5.0))
PLASTIC = (0.7548776662466927, 0.5698402909980532)  # of the R2 sequence (Roberts 2018)
TABLE_ENERGY = 1.0 - 1e-9  # of the widest channel lies within the table


def passes(scene: Scene) -> list[Pass]:
    diffusion = scene.pipeline.diffusion
    if diffusion.method != "disk":
        return []
    reach_mm = float(scene.scattering.radius_for(TABLE_ENERGY).max())
    profile = scene.device.table(_log_profile(scene.scattering, reach_mm), linear=True)
    made: dict[tuple[float, int], dict[str, Any]] = {}

    def given(shot: Shot) -> dict[str, Any]:
        """Taps for this shot's pixels; those of a turntable are all of one size."""
        inner_mm = INNER_PX / shot.px_per_mm(shot.working_distance_mm)
        count = tap_count(scene, shot)
        if (inner_mm, count) not in made:
            cosine, outer_mm = _plane(scene)
            disk = disk_taps(scene.scattering, count, inner_mm, outer_mm)
            made[inner_mm, count] = {
                "taps": scene.device.table(_table(disk)),
                "tap_count": count,
                "centre_weight": disk.centre,
                "profile": profile,
                "profile_reach_mm": reach_mm,
                "least_cosine": cosine,
            }
        return {**made[inner_mm, count], "turn": _turn(shot.sample)}

    def draw(
        shot: Shot, inputs: Mapping[str, moderngl.Texture], target: moderngl.Framebuffer
    ) -> None:
        program = scene.device.program("disk", defines=defines(scene, shot))
        shared = uniforms(scene, shot, inputs, "diffusion_input", (1, 0))
        bind(program, {**shared, **given(shot)})
        scene.device.fill(program)

    def draws(shot: Shot) -> list[WeightDraw]:
        return [WeightDraw((1, 0), given(shot), (1.0, 1.0, 1.0), 1.0)]

    reads = ("diffusion_input", *guides(scene))
    return [
        weight_pass(scene, draws, "disk"),
        Pass("scattered", reads, (Buffer("scattered"),), draw, in_picture=True),
    ]


def _plane(scene: Scene) -> tuple[float, float]:
    """Least cosine of the plane of taps to the eye, and the radius (mm) beyond which it has none.

    A plain sum over a subject much smaller than the profile loses nearly all light, and a tap that
    by chance met the subject was a spark (`normalize: visible` has a sum of Gaussians there). What
    can be met is no further than the subject is wide, on a plane that faces the eye; on one that is
    tilted, further by its cosine. So the plane turns to the eye as the profile outgrows it, wholly
    at FACING_RADII bounding radii. The sum is the same on any plane.
    """
    radius_mm, curvature = scene.radius_mm, scene.pipeline.curvature
    narrowest = {"reduce": 0.0, "reduce_to_minimum": curvature.minimum}
    width = narrowest.get(curvature.modulation, 1.0)
    cosine = min(1.0, _wide_mm(scene) / (FACING_RADII * radius_mm))
    if scene.pipeline.diffusion.normalize == "visible" or cosine <= LEAST_COSINE or width == 0.0:
        return LEAST_COSINE, math.inf
    return cosine, 2.0 * radius_mm / (cosine * width)


def tap_count(scene: Scene, shot: Shot) -> int:
    """Taps of one shot's disk.

    Where every sample scatters its own light, their disks are turned against each other and make up
    one of as many more taps. The picture of half the size stands for all samples, and has these
    taps at once: with one sample's, a spiral's hand showed (dE2000 0.9 between a mirrored picture
    and the picture of a mirrored scene). At a quarter of the pixels that is a quarter of the time.

    A plain sum over a subject smaller than its profile has more taps, so that as many meet it as
    on a larger one, up to 25 times: with 64 the mirrored picture differed by 2.8, now by 0.4.
    """
    quality, count = scene.pipeline.quality, scene.pipeline.diffusion.disk_taps
    if shot.is_halved and quality.sampling == "everywhere":
        count *= quality.supersampling**2
    if scene.pipeline.diffusion.normalize == "none":
        radii = _wide_mm(scene) / scene.radius_mm
        count = math.ceil(count * min(max(radii, 1.0), MOST_RADII) ** 2)
    return min(count, MAX_SAMPLES)


def _wide_mm(scene: Scene) -> float:
    """Radius of 99.9 % of the light, in the widest channel."""
    return float(scene.scattering.radius_for(0.999).max())


def _turn(sample: int) -> float:
    """Radians that the disk is turned by for one supersample, so that they share no tap."""
    return math.tau * math.fmod(sample * GOLDEN_RATIO, 1.0)


def _table(disk: DiskTaps) -> Any:
    """(2, n, 4): RGB weight and radius in mm; then cosine and sine of the angle, and where in the
    pixel the tap begins, in px from its centre."""
    count = len(disk.radius_mm)
    table = np.zeros((2, count, 4))
    table[0] = np.hstack([disk.weights, disk.radius_mm[:, None]])
    table[1, :, 0], table[1, :, 1] = np.cos(disk.angle_rad), np.sin(disk.angle_rad)
    table[1, :, 2:] = np.mod(np.outer(np.arange(count), PLASTIC), 1.0) - 0.5
    return table


def _log_profile(profile: GaussianSum, reach_mm: float) -> Any:
    """(1, TABLE_TEXELS, 3): ln R(r), texels at u = sqrt(r / reach) in [0, 1]: fine at the centre,
    where the profile is narrower than the rest by a factor of a hundred."""
    u = np.linspace(0.0, 1.0, TABLE_TEXELS)
    return np.log(np.maximum(profile.R(reach_mm * u * u), 1e-300))[None]
