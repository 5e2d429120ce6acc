r"""The stages of the preparation in their order, in the calling process (a child, see `prepare`).

    ingest -> clean -> simplify -> unwrap ------------------> project -> albedo, normals, geometry,
                   \-> raw surface -> occlusion, thickness, distance -/         skin -> report

What runs below the main line runs beside it: the upper line waits for children of its own.
"""

from __future__ import annotations

import hashlib
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from scanrender.asset import Asset, Mesh
from scanrender.errors import ScanError, ScanrenderError, StageError
from scanrender.images import Image
from scanrender.scan.bake_albedo import ColorSource
from scanrender.scan.bake_normals import NormalSource
from scanrender.scan.clean import Cleaned, clean
from scanrender.scan.high import High, Low, make_high
from scanrender.scan.ingest import read_scan
from scanrender.scan.inspect import inspect_scan
from scanrender.scan.journal import Journal, Progress
from scanrender.scan.lost import surface_distance
from scanrender.scan.meshlab import count_self_intersections
from scanrender.scan.oven import Oven, bake_maps, shape_values
from scanrender.scan.parallel import Aside
from scanrender.scan.project import make_projector
from scanrender.scan.raw import RawMesh
from scanrender.scan.report import atlas_report, color_error
from scanrender.scan.simplify import simplify
from scanrender.scan.surface import Surface
from scanrender.scan.tangents import vertex_tangents
from scanrender.scan.topology import components, edges_of, vertex_normals
from scanrender.scan.unwrap import as_is_unwrapped, unwrap
from scanrender.scan.views import make_views
from scanrender.settings.prep import PrepSettings
from scanrender.settings.scan import ScanSettings

Array = npt.NDArray[Any]

MESHLAB_TIMEOUT_S = 60.0  # it only counts: not worth waiting for
LOOSE_SHARE = 0.1  # pieces to a triangle
# Health is looked at beside the cleaning, with a mesh of its own: not where memory is short.
HEALTH_MAX_BYTES = 250_000_000


def prepare_here(
    path: Path,
    scan: ScanSettings,
    prep: PrepSettings,
    *,
    progress: Progress | None = None,
    as_is: bool = False,
    views: Path | None = None,
) -> Asset:
    """Prepare one scan in this process; `prepare.prepare` is the safe way to call it.

    With a full report, the arrays of `views.make_views` are written to `views` (.npz). Raises
    UsageError, ConfigError, ScanError, StageError.
    """
    journal = Journal(progress)
    health = _health(path, scan, prep)
    with journal.stage("ingest") as notes:
        raw = read_scan(path, scan)
        notes.update(notes=list(raw.notes), color=raw.color_source)
        journal.warnings += raw.notes
    with journal.stage("clean") as notes:
        cleaned = clean(raw, scan, prep.clean)
        notes["steps"] = list(cleaned.steps)
        journal.warnings += cleaned.frame.warnings
    high, low, shape, lost = _shapes(cleaned, prep, journal, as_is)
    maps, more = _baked(raw, high, low, shape, prep, journal, views)
    lost.update(more)
    _warn_of_losses(lost, prep, low, journal)
    counts = _counts(raw, cleaned.surface, low)
    counts["prepared"]["self_intersecting_faces"] = lost.pop("self_intersecting_faces", None)
    info = {
        "source": _source(path),
        "units": cleaned.frame.units,
        "axes": cleaned.frame.axes,
        "raw_from_asset": cleaned.frame.raw_from_asset,
        "counts": counts,
        "settings": {"scan": scan.model_dump(mode="json"), "prep": prep.model_dump(mode="json")},
        "as_is": as_is,
        "health": health.result() if health else None,
        "stages": journal.stages,
        "lost": lost,
        "warnings": journal.warnings,
    }
    return Asset(low.mesh, maps, info)


def _health(
    path: Path, scan: ScanSettings, prep: PrepSettings
) -> Aside[dict[str, Any] | None] | None:
    """`inspect_scan` of the raw file, begun in a process beside this one."""
    if prep.report != "full" or path.stat().st_size > HEALTH_MAX_BYTES:
        return None

    def look() -> dict[str, Any] | None:
        try:
            return inspect_scan(path, scan)
        except ScanrenderError:  # the preparation itself will say what is wrong
            return None

    return Aside(look)


def _shapes(
    cleaned: Cleaned, prep: PrepSettings, journal: Journal, as_is: bool
) -> tuple[High, Low, dict[str, Array], dict[str, Any]]:
    """Both surfaces, occlusion and thickness, and the distance between raw and prepared.

    Simplifying and unwrapping run in children; a thread waits for them while this one works.
    """
    surface = cleaned.surface
    with ThreadPoolExecutor(1) as beside:
        simple = beside.submit(_simplified, surface, prep, journal, as_is)
        unwrapped = beside.submit(
            lambda: _low_mesh(surface, *simple.result(), prep, journal, as_is)
        )
        crossing = beside.submit(
            lambda: (
                count_self_intersections(*simple.result(), MESHLAB_TIMEOUT_S)
                if prep.report == "full"
                else None
            )
        )
        with journal.stage("raw surface"):
            high = make_high(surface, prep.bake)
        positions, faces = simple.result()
        with journal.stage("occlusion, thickness"):
            normals = vertex_normals(positions, faces)
            shape = shape_values(positions, faces, normals, prep.bake)
        with journal.stage("distance"):
            lost = surface_distance(high.target, positions, faces)
        low = unwrapped.result()
        lost["self_intersecting_faces"] = crossing.result()
    return high, low, shape, lost


def _simplified(
    surface: Surface, prep: PrepSettings, journal: Journal, as_is: bool
) -> tuple[Array, Array]:
    with journal.stage("simplify") as notes:
        if as_is:
            notes["method"] = "none: as is"
            return surface.positions, surface.faces
        try:
            positions, faces, report = simplify(surface, prep.simplify.triangles, prep.timeout_s)
        except StageError as error:
            raise _loose(surface) or error from error
        notes.update(report)
        if report.get("over_budget"):
            journal.warnings.append(
                f"{len(faces)} triangles remain, more than prep.simplify.triangles: "
                "fewer would damage the surface"
            )
        return positions, faces


def _loose(surface: Surface) -> ScanError | None:
    """What is wrong with a surface that cannot be simplified, when it is that it is none."""
    count, _ = components(surface.faces, len(surface.positions))
    if count < LOOSE_SHARE * len(surface.faces):
        return None
    size = len(surface.faces) / count
    what = f"the scan is {count:,} loose pieces of {size:.1f} triangles each, no surface"
    return ScanError(what, fix="weld it in the scanning software, or reconstruct it again")


def _low_mesh(
    surface: Surface,
    positions: Array,
    faces: Array,
    prep: PrepSettings,
    journal: Journal,
    as_is: bool,
) -> Low:
    """Unwrap, and give normals and tangents in float32, as the asset will hold them."""
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


def _baked(
    raw: RawMesh,
    high: High,
    low: Low,
    shape: dict[str, Array],
    prep: PrepSettings,
    journal: Journal,
    views: Path | None,
) -> tuple[dict[str, Image], dict[str, Any]]:
    bake = prep.bake
    with journal.stage("project"):
        oven = Oven(make_projector(low.mesh, high.target), low)
        oven.samples(bake.albedo_px)
    color = ColorSource(high.surface, raw.pages, bake.default_albedo)
    normals = NormalSource(high.surface, high.normals, raw.normal_pages)
    lost = bake_maps(oven, high, shape, color, normals, bake, journal)
    with journal.stage("report") as notes:
        lost.update(atlas_report(low, bake.albedo_px))
        if prep.report == "full" and "albedo" in oven.maps:
            lost["color_de2000"] = color_error(high, low, color, oven.maps["albedo"])
        notes["curvature_scale_mm"] = high.curvature_scale_mm
        if prep.report == "full" and views is not None:
            arrays = make_views(high, low, color, oven.maps, bake.albedo_px)
            np.savez(views, **arrays)  # type: ignore[arg-type]
    return oven.maps, lost


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
