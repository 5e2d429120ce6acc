"""The stages of the preparation in their order, in the calling process (a child, see `prepare`).

ingest -> clean -> simplify -> unwrap -> project -> albedo, normals -> curvature, occlusion,
thickness -> skin -> what was lost.
"""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from scanrender.asset import Asset, Mesh
from scanrender.images import Image
from scanrender.scan.bake_albedo import ColorSource, bake_albedo, bake_albedo_supersampled, sampling
from scanrender.scan.bake_normals import NormalSource, bake_normals
from scanrender.scan.bake_shape import (
    THICKNESS_CAP_MM,
    THICKNESS_FALL_MM,
    ambient_occlusion,
    thickness,
)
from scanrender.scan.bakedlight import WARN_CONTRAST, WARN_EXPLAINED, baked_light
from scanrender.scan.clean import Cleaned, clean
from scanrender.scan.curvature import mean_curvature
from scanrender.scan.diffuse import diffuse, smooth_normals
from scanrender.scan.gutters import Gutters
from scanrender.scan.ingest import read_scan
from scanrender.scan.lost import surface_distance
from scanrender.scan.meshlab import count_self_intersections
from scanrender.scan.project import Projector, Samples, make_projector
from scanrender.scan.raw import RawMesh
from scanrender.scan.rays import Target
from scanrender.scan.simplify import simplify
from scanrender.scan.skinmap import skin_probability
from scanrender.scan.surface import Surface
from scanrender.scan.tangents import vertex_tangents
from scanrender.scan.topology import edges_of, face_areas, vertex_areas, vertex_normals
from scanrender.scan.unwrap import Unwrapped, as_is_unwrapped, unwrap
from scanrender.settings.prep import BakeSettings, PrepSettings
from scanrender.settings.scan import ScanSettings

Array = npt.NDArray[Any]
Progress = Callable[[str, float], None]

MESHLAB_TIMEOUT_S = 60.0  # it only counts: not worth waiting for
THICKNESS_SMOOTH_MM = 1.0
LEAST_LIGHT = float(np.exp(-THICKNESS_CAP_MM / THICKNESS_FALL_MM))
SKIN_SMOOTH_MM = 1.0  # pores and stubble are not a different material

# Share of the whole preparation that has passed when a stage begins, for progress bars.
_FRACTIONS = {
    "ingest": 0.0,
    "clean": 0.05,
    "simplify": 0.1,
    "unwrap": 0.15,
    "project": 0.35,
    "albedo": 0.4,
    "normals": 0.6,
    "curvature": 0.75,
    "occlusion": 0.8,
    "thickness": 0.87,
    "skin": 0.9,
    "lost": 0.93,
}


@dataclass
class Journal:
    """Seconds, notes and peak memory of the stages, and warnings, as they happen."""

    progress: Progress | None
    stages: list[dict[str, Any]] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)

    @contextmanager
    def stage(self, name: str) -> Iterator[dict[str, Any]]:
        if self.progress is not None:
            self.progress(name, _FRACTIONS[name])
        notes: dict[str, Any] = {}
        start = time.perf_counter()
        yield notes
        seconds = round(time.perf_counter() - start, 3)
        self.stages.append(
            {"name": name, "seconds": seconds, "peak_memory_mib": _peak_mib(), "notes": notes}
        )


@dataclass(frozen=True)
class Low:
    """The prepared mesh twice: welded (positions, faces, normals), and split along seams (mesh)."""

    positions: Array
    faces: Array
    normals: Array
    unwrapped: Unwrapped
    mesh: Mesh


def prepare_here(
    path: Path,
    scan: ScanSettings,
    prep: PrepSettings,
    *,
    progress: Progress | None = None,
    as_is: bool = False,
) -> Asset:
    """Prepare one scan in this process; `prepare.prepare` is the safe way to call it.

    Raises UsageError, ConfigError, ScanError, StageError.
    """
    journal = Journal(progress)
    with journal.stage("ingest") as notes:
        raw = read_scan(path, scan)
        notes.update(notes=list(raw.notes), color=raw.color_source)
        journal.warnings += raw.notes
    with journal.stage("clean") as notes:
        cleaned = clean(raw, scan, prep.clean)
        notes["steps"] = list(cleaned.steps)
        journal.warnings += cleaned.frame.warnings
    low = _low_mesh(cleaned, prep, journal, as_is)
    with journal.stage("project"):
        surface = cleaned.surface
        target = Target(surface.positions, surface.faces)
        projector = make_projector(low.mesh, target)
    maps, lost = _bake(raw, surface, low, projector, prep.bake, journal)
    with journal.stage("lost"):
        lost.update(surface_distance(target, low.positions, low.faces))
        crossing = count_self_intersections(low.positions, low.faces, MESHLAB_TIMEOUT_S)
    _warn_of_losses(lost, prep, low, journal)
    counts = _counts(raw, surface, low)
    counts["prepared"]["self_intersecting_faces"] = crossing
    info = {
        "source": _source(path),
        "units": cleaned.frame.units,
        "axes": cleaned.frame.axes,
        "raw_from_asset": cleaned.frame.raw_from_asset,
        "counts": counts,
        "settings": {"scan": scan.model_dump(mode="json"), "prep": prep.model_dump(mode="json")},
        "as_is": as_is,
        "stages": journal.stages,
        "lost": lost,
        "warnings": journal.warnings,
    }
    return Asset(low.mesh, maps, info)


def _low_mesh(cleaned: Cleaned, prep: PrepSettings, journal: Journal, as_is: bool) -> Low:
    """Simplify, unwrap, and give normals and tangents in float32, as the asset will hold them."""
    surface = cleaned.surface
    with journal.stage("simplify") as notes:
        if as_is:
            positions, faces = surface.positions, surface.faces
            notes["method"] = "none: as is"
        else:
            positions, faces, report = simplify(surface, prep.simplify.triangles, prep.timeout_s)
            notes.update(report)
            if report.get("over_budget"):
                journal.warnings.append(
                    f"{len(faces)} triangles remain, more than prep.simplify.triangles: "
                    "fewer would damage the surface"
                )
    with journal.stage("unwrap") as notes:
        result = as_is_unwrapped(surface) if as_is else None
        if result is None:
            result = unwrap(positions, faces, prep.unwrap, prep.bake.albedo_px)
        notes.update(result.report)
        normals = vertex_normals(positions, faces)
        split = positions[result.source].astype(np.float32)
        split_normals = normals[result.source].astype(np.float32)
        uv = result.uv.astype(np.float32)
        tangents = vertex_tangents(split, result.faces, split_normals, uv)
        mesh = Mesh(split, split_normals, tangents, uv, result.faces.astype(np.uint32))
    return Low(positions, faces, normals, result, mesh)


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


def _bake(
    raw: RawMesh,
    surface: Surface,
    low: Low,
    projector: Projector,
    bake: BakeSettings,
    journal: Journal,
) -> tuple[dict[str, Image], dict[str, Any]]:
    oven = Oven(projector, low)
    source = ColorSource(surface, raw.pages, bake.default_albedo)
    with journal.stage("albedo") as notes:
        atlas_use = _bake_albedo(oven, source, bake, notes)
        if source.kind == "none":
            journal.warnings.append("the scan has no colour: prep.bake.default_albedo is used")
    with journal.stage("normals") as notes:
        smooth = vertex_normals(surface.positions, surface.faces)
        smooth = smooth_normals(surface.positions, surface.faces, smooth, bake.footprint_mm)
        normals = NormalSource(surface, smooth, raw.normal_pages)
        values, deviation = bake_normals(low.mesh, normals, oven.samples(bake.normal_px))
        oven.put("normal_ts", bake.normal_px, values)
        notes["detail_map"] = normals.tangents is not None
    _bake_geometry(oven, surface, normals, bake, journal)
    with journal.stage("skin") as notes:
        if source.kind == "none":
            oven.maps["skin"] = np.ones((bake.data_px, bake.data_px, 1), np.float32)
        else:
            oven.maps["skin"] = _skin(oven, bake, notes)
            _judge_light(oven, bake, notes, journal)
    lost = {
        "normal_deviation_deg": deviation,
        "atlas_use": atlas_use,
        "charts": low.unwrapped.report["charts"],
        "flipped_triangles": low.unwrapped.report["flipped"],
    }
    return oven.maps, lost


def _bake_albedo(
    oven: Oven, source: ColorSource, bake: BakeSettings, notes: dict[str, Any]
) -> float:
    """The albedo map; returns the share of the atlas that is covered."""
    size = bake.albedo_px
    texel_mm = _texel_mm(oven.low, size)
    supersample, shrink = sampling(source.pixel_mm(), texel_mm)
    source = source.shrunk(shrink)
    if supersample == 1:
        samples = oven.samples(size)
        oven.put("albedo", size, bake_albedo(source, samples))
        missed, use = samples.missed, float(samples.texels.mask.mean())
    else:
        albedo, covered, missed = bake_albedo_supersampled(
            oven.projector, source, size, supersample
        )
        oven.maps["albedo"] = Gutters(covered).fill(albedo)
        use = float(covered.mean())
    notes.update(color=source.kind, texel_mm=texel_mm, supersample=supersample)
    notes.update(pages_shrunk_by=shrink, nearest_point_share=missed)
    return use


def _bake_geometry(
    oven: Oven, surface: Surface, normals: NormalSource, bake: BakeSettings, journal: Journal
) -> None:
    """The maps that depend on shape only, at data_px."""
    low, size = oven.low, bake.data_px
    with journal.stage("curvature"):
        curvature = mean_curvature(surface.positions, surface.faces, bake.curvature_smooth_mm)
        hits = oven.samples(size).hits
        oven.put("curvature", size, oven.projector.target.interpolate(hits, curvature[:, None]))
        oven.put("normal_geometry", size, normals.smooth(hits))
    target = Target(low.positions, low.faces)
    with journal.stage("occlusion"):
        rays, reach = bake.ao_rays, bake.ao_distance_mm
        free = ambient_occlusion(target, low.positions, low.normals, rays, reach)
        oven.put_vertices("ao", size, free)
    with journal.stage("thickness"):
        deep = thickness(target, low.positions, low.normals, bake.thickness_rays)
        # Few rays are noisy: the light, not the distance, is averaged with the surroundings.
        light = np.exp(-deep / THICKNESS_FALL_MM) * vertex_areas(low.positions, low.faces)
        light = diffuse(low.positions, low.faces, light, THICKNESS_SMOOTH_MM)
        deep = -THICKNESS_FALL_MM * np.log(np.clip(light, LEAST_LIGHT, 1.0))
        oven.put_vertices("thickness_mm", size, deep)


def _skin(oven: Oven, bake: BakeSettings, notes: dict[str, Any]) -> Image:
    small = _resized(oven.maps["albedo"], bake.data_px)
    covered = oven.samples(bake.data_px).texels.mask
    texel_mm = _texel_mm(oven.low, bake.data_px)
    skin, lab = skin_probability(small, covered, SKIN_SMOOTH_MM / texel_mm)
    notes["skin_lab"] = lab
    return Gutters(covered).fill(skin[:, :, None])


def _judge_light(oven: Oven, bake: BakeSettings, notes: dict[str, Any], journal: Journal) -> None:
    """Measure the capture's light in the albedo; warn, since no shading can take it out again."""
    index = oven.samples(bake.data_px).texels.index
    albedo = _resized(oven.maps["albedo"], bake.data_px).reshape(-1, 3)[index]
    normal = oven.maps["normal_geometry"].reshape(-1, 3)[index]
    light = baked_light(albedo, normal, oven.maps["skin"].reshape(-1)[index])
    notes["baked_light"] = light
    if light and light["explained"] > WARN_EXPLAINED and light["contrast"] > WARN_CONTRAST:
        journal.warnings.append(
            f"the albedo holds the light of the capture: {100 * light['explained']:.0f} % of its "
            f"variation follows the normal (contrast {light['contrast']:.2f})"
        )


def _texel_mm(low: Low, size: int) -> float:
    """Typical side of a texel on the surface."""
    uv = low.mesh.uv.astype(np.float64)[low.mesh.faces]
    e1, e2 = uv[:, 1] - uv[:, 0], uv[:, 2] - uv[:, 0]
    share = 0.5 * np.abs(e1[:, 0] * e2[:, 1] - e1[:, 1] * e2[:, 0]).sum()
    area = face_areas(low.positions, low.faces).sum()
    return float(np.sqrt(area / max(share, 1e-12)) / size)


def _resized(image: Image, size: int) -> Image:
    """Box average where the size divides, else the nearest texel."""
    side = image.shape[0]
    if side % size == 0:
        factor = side // size
        return np.asarray(image.reshape(size, factor, size, factor, -1).mean(axis=(1, 3)))
    pick = np.minimum((np.arange(size) + 0.5) * side / size, side - 1).astype(np.int64)
    return np.asarray(image[pick][:, pick])


def _counts(raw: RawMesh, surface: Surface, low: Low) -> dict[str, Any]:
    edges = edges_of(low.faces)
    return {
        "raw": {"vertices": len(raw.positions), "triangles": len(raw.faces)},
        "cleaned": {"vertices": len(surface.positions), "triangles": len(surface.faces)},
        "prepared": {
            "vertices": len(low.mesh.positions_mm),
            "welded_vertices": len(low.positions),
            "triangles": len(low.faces),
            "boundary_edges": int((edges.count == 1).sum()),
            "non_manifold_edges": int((edges.count > 2).sum()),
        },
    }


def _warn_of_losses(lost: dict[str, Any], prep: PrepSettings, low: Low, journal: Journal) -> None:
    error = lost["raw_to_prepared_mm"]["p99"]
    if error > prep.simplify.error_mm:
        journal.warnings.append(
            f"1 % of the raw surface is further than {error:.2f} mm from the prepared one "
            f"(prep.simplify.error_mm {prep.simplify.error_mm:g}): raise prep.simplify.triangles"
        )
    for failure in low.unwrapped.report.get("failed_rungs", []):
        journal.warnings.append(f"unwrapping fell back: {failure}")


def _source(path: Path) -> dict[str, Any]:
    digest = hashlib.sha256()
    with path.open("rb") as stream:
        while block := stream.read(1 << 22):
            digest.update(block)
    return {"file": path.name, "sha256": digest.hexdigest(), "bytes": path.stat().st_size}


def _peak_mib() -> int | None:
    try:
        import resource
    except ImportError:  # Windows
        return None
    return int(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024)
