"""Filters in float64, tap by tap, from the same buffers and the same taps as on the device."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
import numpy.typing as npt

from scanrender.optics.kernels import falloff_per_mm2, footprint_taps
from scanrender.render.passes._scatter import _ray, defines, switches
from scanrender.render.passes.curvature import _sigma_mm
from scanrender.render.passes.gaussian_sum import (
    TABLE_PX,
    TABLE_ROWS,
    blurs,
)
from scanrender.render.passes.separable import kernel_taps, taps_for
from scanrender.render.scene import SEPARABLE, Scene, Shot

Array = npt.NDArray[np.float64]
Buffers = Mapping[str, Array]
Tap = Callable[[Array], tuple[Array, Array]]
KEEP = 1e-5  # of the centre, in scatter.glsl


class Rows:
    """What a pass along rows needs of each pixel: points, slopes, and taps some pixels away."""

    def __init__(self, scene: Scene, shot: Shot, b: Buffers) -> None:
        self.folds = "FOLD" in defines(scene, shot)
        self.z = b["depth_mm"][:, :, 0]
        self.source = b["diffusion_input"]
        height, width = self.z.shape
        self.y, self.x = np.mgrid[0:height, 0:width]
        # Where there is no surface nothing is written: any depth will do.
        self.mm_per_px = np.where(self.z > 0.0, self.z, 1.0) / shot.px_per_mm(1.0)
        ray = np.array(_ray(shot))
        pixel = np.stack([self.x + 0.5, self.y + 0.5], axis=-1)
        way = pixel * ray[:2] + ray[2:]
        self.points = np.dstack([way * self.z[:, :, None], -self.z])
        r = np.dstack([way, -np.ones_like(self.z)])
        n = b["normal_geometry"][:, :, :3]
        facing, least = np.sum(n * r, axis=2), 0.05 * np.linalg.norm(r, axis=2)
        facing = np.where(facing < 0.0, np.minimum(facing, -least), np.maximum(facing, least))
        step = np.array([1.0, 0.0, 0.0]) - r * (n[:, :, 0] / facing)[:, :, None]
        self.stretch = np.maximum(np.sum(step * step, axis=2), 1e-2)

    def tap(self, steps: Array, step_mm2: Array) -> tuple[Array, Array]:
        """(source, squared distance beyond a flat surface) `steps` pixels to the right."""
        straight, width = self.x + steps.astype(np.int64), self.z.shape[1]
        x = np.clip(straight, 0, width - 1)
        if self.folds:
            doubled = np.mod(np.abs(2 * straight + 1), 4 * width)
            x = (np.minimum(doubled, 4 * width - doubled) - 1) // 2
        d = self.points[self.y, x] - self.points
        beyond = np.sum(d * d, axis=2) - steps.astype(np.float64) ** 2 * step_mm2
        known = (self.z[self.y, x] > 0.0) & ((x == straight) | (not self.folds))
        return self.source[self.y, x], np.where(known, beyond, 0.0)

    def result(self, total: Array, weights: Array) -> Array:
        """Light over weights, premultiplied by the pixel's own mask; 0 without a surface."""
        mask = self.source[:, :, 3:]
        light = (total + KEEP * self.source[:, :, :3]) / np.maximum(weights + KEEP * mask, 1e-12)
        return np.where(self.z[:, :, None] > 0.0, np.dstack([light * mask, mask]), 0.0)


def _is_plain(scene: Scene, shot: Shot) -> bool:
    """Only the measure of distance and area is evaluated here, in perspective."""
    return switches(scene) == ("HALO_MEASURE",) and not shot.is_orthographic


def separable_step(scene: Scene, shot: Shot, b: Buffers) -> Array | None:
    """diffuse_horizontal of the separable kernels, `halo: measure`."""
    if scene.pipeline.diffusion.method not in SEPARABLE or not _is_plain(scene, shot):
        return None
    rows = Rows(scene, shot, b)
    stretch = np.minimum(rows.stretch, 4.0)
    step_mm2 = np.maximum(rows.mm_per_px**2 * stretch, 1e-300)
    reach_px = float(scene.reach_mm.max()) * shot.px_per_mm(shot.near_mm)
    taps = kernel_taps(scene, taps_for(scene.pipeline.diffusion.samples, reach_px))
    falloff = falloff_per_mm2(scene.scattering, taps.offsets_mm)
    total, weights = np.zeros((*rows.z.shape, 3)), np.zeros((*rows.z.shape, 3))
    for offset_mm, weight, q in zip(taps.offsets_mm, taps.weights, falloff, strict=True):
        offset = offset_mm / np.sqrt(step_mm2)
        low = np.floor(offset)
        side = q / (1.0 + 2.0 * q * step_mm2[:, :, None] / 6.0)
        for steps, share in ((low, 1.0 - (offset - low)), (low + 1, offset - low)):
            light, beyond = rows.tap(steps, step_mm2)
            near = np.minimum(np.exp(-beyond[:, :, None] * side), 4.0)
            k = weight * share[:, :, None] * near
            total += k * light[:, :, :3]
            weights += k * light[:, :, 3:]
    return rows.result(total, weights)


def gaussian_step(scene: Scene, shot: Shot, b: Buffers) -> Array | None:
    """_horizontal_0: the first level's rows, where all of it is whole-pixel taps."""
    if scene.pipeline.diffusion.method != "gaussian_sum" or not _is_plain(scene, shot):
        return None
    rows = Rows(scene, shot, b)
    first = blurs(scene)[0]
    if first.between != "_horizontal_0":
        return None
    uniforms = first.uniforms(scene, shot, (1, 0))
    variance, radius = uniforms["sigma_mm"] ** 2, uniforms["radius"]
    step_mm2 = rows.mm_per_px**2 * rows.stretch
    sigma_px = np.sqrt(variance / np.maximum(step_mm2, 1e-300))
    if np.minimum(sigma_px, 1e9)[rows.z > 0].max() > uniforms["narrow_px"]:
        return None
    grid = np.linspace(0.0, TABLE_PX, TABLE_ROWS)
    table = footprint_taps(grid, radius, uniforms["shift_px"], scene.scattered_samples)
    falloff = 0.5 / (variance + step_mm2 / 6.0)
    total, met = np.zeros((*rows.z.shape, 4)), np.zeros((*rows.z.shape, 1))
    for j in range(-radius, radius + 1):
        light, beyond = rows.tap(np.full(rows.z.shape, float(j)), step_mm2)
        k = np.interp(sigma_px, grid, table[:, j + radius].astype(np.float32))
        k = (k * np.minimum(np.exp(-beyond * falloff), 4.0))[:, :, None]
        total += k * light
        met += np.where(light[:, :, 3:] > 0.0, k, 0.0)
    mean = (total + KEEP * rows.source) / (met + KEEP)
    return np.where(rows.z[:, :, None] > 0.0, mean, 0.0)


def curvature_step(scene: Scene, shot: Shot, b: Buffers) -> Array | None:
    """_curvature_1: the fine step of the smoothing along rows."""
    if scene.pipeline.curvature.source != "screen" or shot.is_orthographic:
        return None
    p, source = b["position"], b["curvature_raw"][:, :, 0]
    height, width = source.shape
    y, x = np.mgrid[0:height, 0:width]
    sigma_mm = _sigma_mm(scene)
    depth = np.maximum(-p[:, :, 2], 1e-6)
    sigma = np.where(p[:, :, 3] > 0.0, sigma_mm * shot.px_per_mm(1.0) / depth, 0.0)
    if sigma.max() > 8.0:  # curvature.frag's DENSE_PX: then the taps' stride matters too
        return None
    side = np.ceil(3.0 * sigma)
    total, weights = source.copy(), np.ones_like(source)
    for j in range(-int(side.max()), int(side.max()) + 1):
        at = np.clip(x + j, 0, width - 1)
        counts = (x + j == at) & (abs(j) <= side) & (j != 0) & (p[y, at, 3] > 0.0)
        dz = p[y, at, 2] - p[:, :, 2]
        across = dz**2 / max(2.0 * sigma_mm**2, 1e-12)
        w = np.exp(-0.5 * j * j / np.maximum(sigma**2, 1e-12) - across)
        total += np.where(counts, w, 0.0) * source[y, at]
        weights += np.where(counts, w, 0.0)
    return np.where(p[:, :, 3] > 0.0, total / weights, 0.0)[:, :, None]
