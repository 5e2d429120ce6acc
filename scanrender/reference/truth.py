"""Truth: what leaves the skin, by two integrals over the whole prepared surface, in float64.

    truth_sum   M(p) = integral over S of R(|x_p - x|) m E dA
    truth_mean  M(p) = integral of R m E dA / integral of R m dA, over the sheet around p that the
                picture shows

E is the light that diffuses, irradiance x albedo^m of the shot's texturing, and m the skin map
where the settings use it. R is d'Eon & Luebke's sum of Gaussians (GPU Gems 3, ch. 14). Off a plane
the integral of R is not 1: `truth_sum` is the model as written, hidden parts included, to judge
`normalize: none` with transmission by; `truth_mean` judges methods that normalize.
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from scanrender.asset import Asset
from scanrender.errors import ConfigError
from scanrender.metrics import Summary, delta_e_2000_linear, summarize
from scanrender.optics._math import Array
from scanrender.optics.profiles import GaussianSum
from scanrender.reference.disc import disc_sums
from scanrender.reference.integral import LobeSums, lobe_sums, reach_mm
from scanrender.reference.points import PictureCamera, Points, camera_points, seen_by
from scanrender.reference.rays import Faces
from scanrender.reference.sheet import Labels, sheets
from scanrender.reference.skin import SkinField
from scanrender.reference.surface import Surface
from scanrender.reference.surface_samples import Field, SurfaceSamples, surface_samples
from scanrender.settings.pipeline import Pipeline

# A Gaussian is summed over samples of the surface if this many of the finest fit into its width.
_SAMPLES_A_SIGMA = 3.0


@dataclass(frozen=True)
class TruthQuality:
    """How finely the truth is computed.

    ``spacing_mm``: side of the finest samples of the whole surface. ``cells_per_sigma``: cells a
    Gaussian's width, over which finer samples are averaged. ``disc_nodes``: nodes a point for a
    Gaussian narrower than 3 spacings. ``tail``: energy of a Gaussian that is left out.
    ``shadow_rays``: rays a sample to a light whose shadows have a soft edge.
    """

    spacing_mm: float = 0.25
    cells_per_sigma: float = 2.7
    disc_nodes: int = 16
    tail: float = 1e-4
    shadow_rays: int = 2

    def __post_init__(self) -> None:
        if not 1e-3 <= self.spacing_mm <= 10.0:
            raise ConfigError(f"{self.spacing_mm:g} is outside 0.001 to 10 mm", "spacing_mm")

    def halved(self) -> TruthQuality:
        """Half the spacing of everything: four times the samples."""
        return replace(
            self,
            spacing_mm=0.5 * self.spacing_mm,
            cells_per_sigma=2.0 * self.cells_per_sigma,
            disc_nodes=4 * self.disc_nodes,
            tail=0.1 * self.tail,
            shadow_rays=2 * self.shadow_rays,
        )

    def is_sampled(self, variance_mm2: float) -> bool:
        """Whether a Gaussian is summed over surface samples, not over a disc of its own."""
        return math.sqrt(variance_mm2) >= _SAMPLES_A_SIGMA * self.spacing_mm


@dataclass(frozen=True)
class Integrals:
    """``total`` (k, 3) is truth_sum, ``mean`` (k, 3) truth_mean, ``mass`` (k, 3) all of R m dA.

    Where nothing of a point's sheet lies within reach, the mean is 0.
    """

    total: Array
    mean: Array
    mass: Array


@dataclass(frozen=True)
class Convergence:
    """dE2000 between a truth and the same at half the spacing, over ``pixels`` random pixels."""

    pixels: int
    truth_sum: Summary
    truth_mean: Summary


@dataclass(frozen=True)
class TruthPicture:
    """Diffuse radiance as in the renderer's `diffuse`, (h, w, 3) lin_rec709_scene, top row first.

    ``unscattered`` is the same without diffusion. Pictures are premultiplied by ``coverage``
    (h, w), the share of samples that hit; ``skin`` (h, w) is the mean of the skin map over them.
    ``seconds`` tells where the time went.
    """

    truth_sum: Array
    truth_mean: Array
    unscattered: Array
    coverage: Array
    skin: Array
    convergence: Convergence | None
    quality: TruthQuality
    seconds: Mapping[str, float]


def truth_picture(
    asset: Asset,
    pipeline: Pipeline,
    profile: GaussianSum,
    camera: PictureCamera,
    quality: TruthQuality | None = None,
    *,
    convergence_spots: int = 24,
    soft_edges: bool = True,
    seed: int = 1,
) -> TruthPicture:
    """The picture that `camera` sees, with the pipeline's lights, material and texturing.

    ``profile`` is the skin's, scaled. Its convergence is measured on ``convergence_spots`` random
    spots of 3 x 3 pixels (0: not at all). ``soft_edges`` gives shadows the edge that the lights'
    `shadow_blur_mm` asks for. Raises ConfigError for an environment light.
    """
    quality = quality or TruthQuality()
    began = time.perf_counter()
    surface = Surface.of(asset)
    skin = SkinField.of(surface, pipeline, camera, quality.shadow_rays, soft_edges)
    points = camera_points(surface, camera)
    shading = skin.shading(points, camera)
    scatters = np.flatnonzero(shading.skin > 0.0)
    made = time.perf_counter()
    found = integrals(surface, skin.field, points.chosen(scatters), profile, quality, camera=camera)
    done = time.perf_counter()
    width, height = camera.size_px
    shape, samples = (height, width), len(camera.offsets_px)

    def picture(scattered: Array, which: npt.NDArray[np.int64]) -> Array:
        light = shading.unscattered.copy()
        light[which] = skin.mixed(shading, which, scattered)
        return _resolved(points.pixel, shading.leaving * light, shape, samples)

    total, mean = picture(found.total, scatters), picture(found.mean, scatters)
    ones = np.ones((len(points), 1))
    result = TruthPicture(
        total,
        mean,
        _resolved(points.pixel, shading.leaving * shading.unscattered, shape, samples),
        _resolved(points.pixel, ones, shape, samples)[..., 0],
        _resolved(points.pixel, shading.skin[:, None], shape, samples)[..., 0],
        None,
        quality,
        {"points": made - began, "integrals": done - made},
    )
    if convergence_spots == 0 or len(scatters) == 0:
        return result
    spot = _spots(points.pixel[scatters], shape, convergence_spots, seed)
    chosen = np.flatnonzero(np.isin(points.pixel, spot) & (shading.skin > 0.0))
    half = quality.halved()
    finer = SkinField.of(surface, pipeline, camera, half.shadow_rays, soft_edges)
    better = integrals(surface, finer.field, points.chosen(chosen), profile, half, camera=camera)
    summaries = []
    for coarse, values in ((total, better.total), (mean, better.mean)):
        fine = picture(values, chosen).reshape(-1, 3)[spot]
        summaries.append(summarize(delta_e_2000_linear(coarse.reshape(-1, 3)[spot], fine)[None]))
    seconds = {**result.seconds, "convergence": time.perf_counter() - done}
    measured = Convergence(len(spot), summaries[0], summaries[1])
    return replace(result, convergence=measured, seconds=seconds)


def integrals(
    surface: Surface,
    field: Field,
    points: Points,
    profile: GaussianSum,
    quality: TruthQuality,
    camera: PictureCamera | None = None,
) -> Integrals:
    """Both integrals at points; without ``camera`` the mean is over the connected surface."""
    if len(points) == 0:
        return Integrals(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 3)))
    position = surface.positions_at(points.face, points.bary)
    sampled = [v for v in profile.variances_mm2 if quality.is_sampled(v)]
    sets = _sample_sets(surface, field, position, sampled, quality, camera)
    label_of_face = _sheet_of_face(surface, points.face, sets, camera)
    label = label_of_face[points.face]
    total, mass = np.zeros((len(points), 3)), np.zeros((len(points), 3))
    own, own_mass = np.zeros((len(points), 3)), np.zeros((len(points), 3))
    for variance, weight in zip(profile.variances_mm2, profile.weights, strict=True):
        lobe: LobeSums
        if quality.is_sampled(variance):
            base = _base_halvings(variance, quality)
            cells = sets[base].coarser(_cell_halvings(variance, quality) - base)
            lobe = lobe_sums(position, label, cells, label_of_face, variance, quality.tail)
        else:
            lobe = disc_sums(
                surface, field, points, label, label_of_face, camera, variance, quality.disc_nodes
            )
        w = np.asarray(weight)
        total += w * lobe.total
        mass += w * lobe.mass[:, None]
        own += w * lobe.sheet_total
        own_mass += w * lobe.sheet_mass[:, None]
    mean = np.divide(own, own_mass, out=np.zeros_like(own), where=own_mass > 1e-12)
    return Integrals(total, mean, mass)


def _cell_halvings(variance_mm2: float, quality: TruthQuality) -> int:
    """How often the finest spacing doubles in a Gaussian's cells."""
    ratio = math.sqrt(variance_mm2) / (quality.cells_per_sigma * quality.spacing_mm)
    return max(0, math.floor(math.log2(max(ratio, 1.0)) + 1e-9))


def _base_halvings(variance_mm2: float, quality: TruthQuality) -> int:
    """How often it doubles in the samples that are averaged into them: once less."""
    return max(0, _cell_halvings(variance_mm2, quality) - 1)


def _sample_sets(
    surface: Surface,
    field: Field,
    position: Array,
    variances: list[float],
    quality: TruthQuality,
    camera: PictureCamera | None,
) -> dict[int, SurfaceSamples]:
    """Samples within reach of the points, by how often their spacing is doubled."""

    def sees(face: Faces, bary: Array) -> npt.NDArray[np.bool_]:
        assert camera is not None
        return seen_by(surface, camera, face, bary)

    sets = {}
    tree = cKDTree(position)
    for base in {_base_halvings(v, quality) for v in variances}:
        widest = max(v for v in variances if _base_halvings(v, quality) == base)
        faces = _faces_near(surface, tree, reach_mm(widest, quality.tail))
        spacing = quality.spacing_mm * 2.0**base
        sets[base] = surface_samples(
            surface, field, spacing, faces, None if camera is None else sees
        )
    return sets


def _faces_near(surface: Surface, tree: cKDTree, distance_mm: float) -> Faces:
    corners = surface.positions[surface.faces]
    middle = corners.mean(axis=1)
    radius = np.linalg.norm(corners - middle[:, None], axis=2).max(axis=1)
    nearest, _ = tree.query(middle)
    near = (nearest <= distance_mm + radius) & (surface.face_areas > 0.0)
    return np.flatnonzero(near).astype(np.int64)


def _sheet_of_face(
    surface: Surface,
    of_points: Faces,
    sets: Mapping[int, SurfaceSamples],
    camera: PictureCamera | None,
) -> Labels:
    if camera is None:
        return sheets(surface, np.ones(len(surface.faces), np.bool_))
    is_seen = np.zeros(len(surface.faces), np.bool_)
    is_seen[of_points] = True
    for found in sets.values():
        for _, samples in found.groups:
            is_seen[samples.face[samples.seen > 0.0]] = True
    return sheets(surface, is_seen)


def _resolved(
    pixel: npt.NDArray[np.int64], values: Array, shape: tuple[int, int], samples: int
) -> Array:
    """(h, w, c) sums of values (k, c) over their pixels, by the number of samples a pixel."""
    count = shape[0] * shape[1]
    sums = [np.bincount(pixel, column, count) for column in values.T]
    return np.stack(sums, axis=1).reshape(*shape, -1) / samples


def _spots(
    pixel: npt.NDArray[np.int64], shape: tuple[int, int], count: int, seed: int
) -> npt.NDArray[np.int64]:
    """Numbers of the pixels in 3 x 3 around random ones among ``pixel``."""
    held = np.unique(pixel)
    middle = np.random.default_rng(seed).choice(held, min(count, len(held)), replace=False)
    row, column = np.divmod(middle, shape[1])
    around = []
    for down in (-1, 0, 1):
        for right in (-1, 0, 1):
            inside = (row + down >= 0) & (row + down < shape[0])
            inside &= (column + right >= 0) & (column + right < shape[1])
            around.append(((row + down) * shape[1] + column + right)[inside])
    return np.intersect1d(np.concatenate(around), held)
