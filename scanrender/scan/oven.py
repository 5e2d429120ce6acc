"""All maps of one preparation: what each is made from, at its own size, gutters filled."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from scanrender.images import Image
from scanrender.scan.bake_albedo import (
    ColorSource,
    averaging,
    bake_albedo,
    bake_albedo_supersampled,
    supersampling,
)
from scanrender.scan.bake_normals import NormalSource, bake_normals
from scanrender.scan.bake_shape import THICKNESS_CAP_MM, THICKNESS_FALL_MM, ambient_occlusion
from scanrender.scan.bake_shape import thickness as thickness_of
from scanrender.scan.bakedlight import WARN_CONTRAST, WARN_EXPLAINED, baked_light
from scanrender.scan.diffuse import diffuse
from scanrender.scan.gutters import Gutters
from scanrender.scan.high import High, Low
from scanrender.scan.journal import Journal
from scanrender.scan.map_sizes import halved
from scanrender.scan.pages import Page
from scanrender.scan.project import Projector, Samples
from scanrender.scan.rasterize import rasterize
from scanrender.scan.rays import Target
from scanrender.scan.skinmap import skin_probability
from scanrender.scan.skinmask import SkinMask
from scanrender.scan.topology import vertex_areas
from scanrender.settings.prep import BakeSettings

Array = npt.NDArray[Any]

THICKNESS_SMOOTH_MM = 1.0
LEAST_LIGHT = float(np.exp(-THICKNESS_CAP_MM / THICKNESS_FALL_MM))
SKIN_TEXEL_MM = 0.75  # coarsest texels that still show a brow's border and the line of the lashes


@dataclass
class Oven:
    """What the bakes share: samples and gutters by map size, computed once."""

    projector: Projector
    low: Low
    maps: dict[str, Image] = field(default_factory=dict)
    _samples: dict[int, Samples] = field(default_factory=dict)
    _gutters: dict[int, Gutters] = field(default_factory=dict)

    def samples(self, size: int) -> Samples:
        if size not in self._samples:
            self._samples[size] = self.projector.samples(size)
        return self._samples[size]

    def forget(self, size: int) -> None:
        """Free what the maps of one size needed."""
        self._samples.pop(size, None)
        self._gutters.pop(size, None)

    def put(self, name: str, size: int, values: Array) -> None:
        """Store the map of `values` (k, c) at the texels of `size`, gutters filled."""
        texels = self.samples(size).texels
        if size not in self._gutters:
            self._gutters[size] = Gutters(texels.mask)
        self.maps[name] = self._gutters[size].fill(texels.scatter(values))

    def put_vertices(self, name: str, size: int, values: Array) -> None:
        """Store the map of values (n,) at the welded vertices."""
        low = self.low
        corners = values[low.unwrapped.source][low.mesh.faces][:, :, None]
        self.put(name, size, self.samples(size).texels.interpolate(corners))


def bake_maps(
    oven: Oven,
    high: High,
    shape: dict[str, Array],
    color: ColorSource,
    normals: NormalSource,
    mask: SkinMask | None,
    bake: BakeSettings,
    journal: Journal,
) -> dict[str, Any]:
    """Fill oven.maps with those asked for; shape: values (n,) per welded vertex by map name.
    Returns the angles between the prepared and the raw surface, in degrees."""
    lost: dict[str, Any] = {}
    if {"albedo", "skin"} & set(bake.maps):
        with journal.stage("albedo") as notes:
            _albedo(oven, color, bake, notes)
            if color.kind == "none":
                journal.warnings.append("the scan has no colour: prep.bake.default_albedo is used")
    if "normal_ts" in bake.maps:
        with journal.stage("normals") as notes:
            values, angle = bake_normals(oven.low.mesh, normals, oven.samples(bake.normal_px))
            oven.put("normal_ts", bake.normal_px, values)
            notes["detail_map"] = normals.tangents is not None
            lost["normal_deviation_deg"] = float(angle.mean()) if len(angle) else 0.0
    for size in {bake.albedo_px, bake.normal_px} - {bake.data_px}:
        oven.forget(size)
    if {"curvature", "normal_geometry", "ao", "thickness_mm", "skin"} & set(bake.maps):
        with journal.stage("geometry"):
            _geometry(oven, high, shape, normals, bake)
    if "skin" in bake.maps:
        with journal.stage("skin") as notes:
            _skin(oven, high, shape, normals, color, mask, bake, notes, journal)
    for name in set(oven.maps) - set(bake.maps):
        del oven.maps[name]
    return lost


def shape_values(
    positions: Array, faces: Array, normals: Array, bake: BakeSettings
) -> dict[str, Array]:
    """Occlusion and thickness (n,) at the welded vertices, as far as they are asked for."""
    values: dict[str, Array] = {}
    if not {"ao", "thickness_mm"} & set(bake.maps):
        return values
    target = Target(positions, faces)
    if "ao" in bake.maps:
        rays, reach = bake.ao_rays, bake.ao_distance_mm
        values["ao"] = ambient_occlusion(target, positions, normals, rays, reach)
    if "thickness_mm" in bake.maps:
        deep = thickness_of(target, positions, normals, bake.thickness_rays)
        # Few rays are noisy: the light, not the distance, is averaged with the surroundings.
        light = np.exp(-deep / THICKNESS_FALL_MM) * vertex_areas(positions, faces)
        light = diffuse(positions, faces, light, THICKNESS_SMOOTH_MM)
        values["thickness_mm"] = -THICKNESS_FALL_MM * np.log(np.clip(light, LEAST_LIGHT, 1.0))
    return values


def _albedo(oven: Oven, source: ColorSource, bake: BakeSettings, notes: dict[str, Any]) -> None:
    size = bake.albedo_px
    texel_mm = oven.low.texel_mm(size)
    source_mm, page_mm = source.pixels_mm()
    supersample = bake.supersample or supersampling(source_mm, texel_mm)
    shrink = averaging(page_mm, texel_mm / supersample)
    source = source.shrunk(shrink)
    if supersample == 1:
        samples = oven.samples(size)
        oven.put("albedo", size, bake_albedo(source, samples))
        missed = samples.missed
    else:
        albedo, covered, missed = bake_albedo_supersampled(
            oven.projector, source, size, supersample
        )
        oven.maps["albedo"] = Gutters(covered).fill(albedo)
    notes.update(color=source.kind, texel_mm=texel_mm, supersample=supersample)
    notes.update(pages_shrunk_by=shrink, nearest_point_share=missed)


def _geometry(
    oven: Oven, high: High, shape: dict[str, Array], normals: NormalSource, bake: BakeSettings
) -> None:
    """The maps that depend on shape only, at data_px."""
    size = bake.data_px
    hits = oven.samples(size).hits
    if "curvature" in bake.maps and high.curvature is not None:
        values = oven.projector.target.interpolate(hits, high.curvature[:, None])
        oven.put("curvature", size, values)
    if "normal_geometry" in bake.maps:
        oven.put("normal_geometry", size, normals.smooth(hits))
    for name, values in shape.items():
        oven.put_vertices(name, size, values)


def _skin(
    oven: Oven,
    high: High,
    shape: dict[str, Array],
    normals: NormalSource,
    color: ColorSource,
    mask: SkinMask | None,
    bake: BakeSettings,
    notes: dict[str, Any],
    journal: Journal,
) -> None:
    size = bake.data_px
    if mask is None and color.kind == "none":
        oven.maps["skin"] = np.ones((size, size, 1), np.float32)
        return
    samples = oven.samples(size)
    if mask is not None:
        notes["from"] = "mask"
        skin = mask.at(high.surface, samples.hits, oven.low.texel_mm(size))
    else:
        notes["from"] = "colours"
        skin = _guessed_skin(oven, shape.get("ao"), size, notes)
        if notes.get("no_skin_colour"):
            journal.warnings.append(
                "no part of the scan has a skin's colour: all of it counts as skin "
                "(prep.skin.mask can say otherwise)"
            )
    oven.put("skin", size, skin[:, None])
    if color.kind == "none":
        return
    albedo = _resized(oven.maps["albedo"], size).reshape(-1, 3)[samples.texels.index]
    light = baked_light(albedo, normals.smooth(samples.hits), skin)
    notes["baked_light"] = light
    # No shading can take the capture's light out again: it is measured, and told.
    if light and light["explained"] > WARN_EXPLAINED and light["contrast"] > WARN_CONTRAST:
        journal.warnings.append(
            f"the albedo holds the light of the capture: {100 * light['explained']:.0f} % of its "
            f"variation follows the normal (contrast {light['contrast']:.2f})"
        )


def _guessed_skin(oven: Oven, ao: Array | None, size: int, notes: dict[str, Any]) -> Array:
    """Skin (k,) at the texels of `size`, found on a map whose texels are no finer than it needs."""
    coarse = halved(size, oven.low.texel_mm(1) / SKIN_TEXEL_MM)
    mesh, texels = oven.low.mesh, oven.samples(size).texels
    seen = texels if coarse == size else rasterize(mesh.uv, mesh.faces, coarse)
    albedo = _resized(oven.maps["albedo"], coarse).reshape(-1, 3)[seen.index]
    skin, found = skin_probability(oven.low, seen, albedo, ao)
    notes.update(found, texel_mm=oven.low.texel_mm(coarse))
    if coarse == size:
        return skin
    image = Gutters(seen.mask).fill(seen.scatter(skin))
    row, column = np.divmod(texels.index, size)
    uv = (np.stack([column, row], axis=1) + 0.5) / size
    return Page("skin", np.repeat(image, 3, axis=2), "linear").sample(uv)[:, 0]


def _resized(image: Image, size: int) -> Image:
    """Box average where the size divides, else the nearest texel."""
    side = image.shape[0]
    if side % size == 0:
        factor = side // size
        blocks = image.reshape(size, factor, size, factor, image.shape[2])
        total = np.zeros((size, size, image.shape[2]), np.float32)
        for row in range(factor):
            for column in range(factor):
                total += blocks[:, row, :, column]
        return total / np.float32(factor * factor)
    pick = np.minimum(((np.arange(size) + 0.5) * side / size).astype(np.int64), side - 1)
    return np.asarray(image[pick][:, pick])
