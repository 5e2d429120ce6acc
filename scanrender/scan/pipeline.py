r"""The stages of the preparation in their order, in the calling process (a child, see `prepare`).

    ingest -> clean -> simplify -> unwrap ------------------> project -> albedo, normals, geometry,
                   \-> raw surface -> occlusion, thickness, distance -/         skin -> report

What runs below the main line runs beside it: the upper line waits for children of its own.
"""

from __future__ import annotations

import hashlib
import importlib
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from threading import Event, Thread
from typing import Any

import numpy as np
import numpy.typing as npt

from scanrender.asset import Asset, Mesh
from scanrender.errors import ScanError, ScanrenderError, StageError
from scanrender.images import Image
from scanrender.scan.bake_albedo import ColorSource
from scanrender.scan.bake_normals import NormalSource
from scanrender.scan.beside import answers
from scanrender.scan.child import started_early
from scanrender.scan.clean import Cleaned, clean
from scanrender.scan.high import High, Low, make_high
from scanrender.scan.ingest import read_scan
from scanrender.scan.inspect import inspect_scan
from scanrender.scan.journal import Journal, Progress
from scanrender.scan.levels import make_lods
from scanrender.scan.lost import surface_distance
from scanrender.scan.map_sizes import fitted_sizes
from scanrender.scan.mend import plain_surface
from scanrender.scan.meshlab import count_self_intersections
from scanrender.scan.neck import close_neck
from scanrender.scan.oven import Oven, bake_maps, shape_values
from scanrender.scan.parallel import Aside
from scanrender.scan.project import make_projector, measured_cage
from scanrender.scan.raw import RawMesh
from scanrender.scan.report import atlas_report, color_error
from scanrender.scan.simplify import simplify
from scanrender.scan.skinmask import SkinMask, read_skin_mask
from scanrender.scan.surface import Surface
from scanrender.scan.tangents import vertex_tangents
from scanrender.scan.topology import components, edges_of, face_areas, vertex_normals
from scanrender.scan.unwrap import unwrap
from scanrender.scan.views import make_views
from scanrender.settings.prep import PrepSettings
from scanrender.settings.scan import ScanSettings

Array = npt.NDArray[Any]

MESHLAB_TIMEOUT_S = 60.0  # it only counts: not worth waiting for
NOTABLE_MM = 0.2  # a surface moved by more shows in a portrait's outline
LOOSE_SHARE = 0.1  # pieces to a triangle
# Health is looked at beside the cleaning, with a mesh of its own: not where memory is short.
HEALTH_MAX_BYTES = 250_000_000
# Above it the collapse and the raw surface take turns: at 20 M each needs some 9 GB.
BESIDE_MAX_FACES = 8_000_000
KEEP_MAX_FACES = 2_000_000  # half a gigabyte to a million


def prepare_here(
    path: Path,
    scan: ScanSettings,
    prep: PrepSettings,
    *,
    progress: Progress | None = None,
    as_is: bool = False,
    views: Path | None = None,
    keep: list[Any] | None = None,
) -> Asset:
    """Prepare one scan in this process; `prepare.prepare` is the safe way to call it.

    With a full report, the arrays of `views.make_views` are written to `views` (.npz). A raw
    surface that is not too large is left in `keep`: to take it apart, tree and all, takes a third
    of a second, which a process that ends soon can spare. Raises UsageError, ConfigError,
    ScanError, StageError.
    """
    journal = Journal(progress)
    health, source = _health(path, scan, prep), Aside(lambda: _source(path))
    # While the file is read; it has to end before the next copy of this process is made.
    library = Thread(target=importlib.import_module, args=("scipy.spatial",))
    library.start()
    with journal.stage("ingest") as notes:
        raw = read_scan(path, scan)
        notes.update(notes=list(raw.notes), color=raw.color_source)
        mask = read_skin_mask(path, raw, prep.skin.mask) if prep.skin.mask is not None else None
        journal.warnings += raw.notes
        raw = raw.in_order_of_use()
        library.join()
    size = {"vertices": len(raw.positions), "triangles": len(raw.faces)}
    with started_early(_early_tasks(raw, as_is), copied=True):
        with journal.stage("clean") as notes:
            cleaned = clean(raw, scan, prep.clean)
            notes["steps"] = list(cleaned.steps)
            area = face_areas(cleaned.surface.positions, cleaned.surface.faces).sum()
            bake = fitted_sizes(prep.bake, float(area), prep.unwrap.padding_px)
            prep = prep.model_copy(update={"bake": bake})
            journal.warnings += cleaned.frame.warnings
        raw = raw.without_geometry()
        high, low, shape, lost = _shapes(cleaned, prep, journal, as_is)
    if keep is not None and len(high.surface.faces) <= KEEP_MAX_FACES:
        keep.append(high)
    lods, levels = _levels_of_detail(high, low, prep, journal)
    maps, more = _baked(raw, high, low, shape, mask, prep, journal, views)
    lost.update(more)
    _warn_of_losses(lost, prep, low, journal)
    crossing = lost.pop("self_intersecting_faces", None)
    info = {
        "source": {**source.result(), "beside": answers(path)},
        "units": cleaned.frame.units,
        "axes": cleaned.frame.axes,
        "raw_from_asset": cleaned.frame.raw_from_asset,
        "counts": {"raw": size, **_counts(cleaned.surface, low, crossing)},
        "settings": {"scan": scan.model_dump(mode="json"), "prep": prep.model_dump(mode="json")},
        "as_is": as_is,
        "health": health.result() if health else None,
        "stages": journal.stages,
        "lost": lost,
        "lods": levels,
        "warnings": journal.warnings,
    }
    return Asset(low.mesh, maps, info, lods)


def _early_tasks(raw: RawMesh, as_is: bool) -> dict[str, dict[str, int]]:
    """The children that will be needed, and what is known of their input."""
    if as_is:
        return {}
    size = {"faces": len(raw.faces), "vertices": len(raw.positions)}
    return {"charts": {}, "simplify": size if len(raw.faces) <= BESIDE_MAX_FACES else {}}


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
    surface, handed_over, fed = cleaned.surface, Event(), Event()
    with ThreadPoolExecutor(1) as beside:
        simple = beside.submit(_simplified, cleaned, prep, journal, as_is, handed_over.set)
        simple.add_done_callback(lambda _: handed_over.set())
        unwrapped = beside.submit(
            lambda: _low_mesh(surface, *simple.result(), prep, journal, as_is, fed.set)
        )
        unwrapped.add_done_callback(lambda _: fed.set())
        crossing = beside.submit(
            lambda: (
                count_self_intersections(*simple.result(), MESHLAB_TIMEOUT_S)
                if prep.report == "full"
                else None
            )
        )
        if len(surface.faces) > BESIDE_MAX_FACES:
            simple.result()
        # What follows holds the interpreter's lock for a second: the collapse would wait with it.
        handed_over.wait()
        with journal.stage("raw surface"):
            high = make_high(surface, prep.bake)
            _ = high.target.face_normals
        # So would the unwrapping wait for these: two seconds of a million faces.
        fed.wait()
        with journal.stage("search trees"):
            high.target.build()
            high.target.make_tree()
        positions, faces = simple.result()
        with journal.stage("occlusion, thickness"):
            normals = vertex_normals(positions, faces)
            shape = shape_values(positions, faces, normals, prep.bake)
        with journal.stage("distance"):
            lost = surface_distance(high.target, positions, faces)
            cage = measured_cage(positions, faces, high.target)
        import scipy.ndimage  # noqa: F401  for the gutters: this process only waits now

        low = replace(unwrapped.result(), cage=cage)
        lost["self_intersecting_faces"] = crossing.result()
    return high, low, shape, lost


def _simplified(
    cleaned: Cleaned,
    prep: PrepSettings,
    journal: Journal,
    as_is: bool,
    handed_over: Callable[[], None],
) -> tuple[Array, Array]:
    with journal.stage("simplify") as notes:
        if as_is:
            notes["method"] = "none: as is"
            return cleaned.surface.positions, cleaned.surface.faces
        try:
            positions, faces, report = simplify(
                cleaned.skin, prep.simplify, prep.timeout_s, handed_over, cap=bool(cleaned.cap)
            )
        except StageError as error:
            raise _loose(cleaned.skin) or error from error
        notes.update(report)
        if report["over_budget"]:
            journal.warnings.append(
                f"{report['triangles'][1]} triangles remain, more than prep.simplify.triangles: "
                "fewer would damage the surface"
            )
        journal.warnings += [f"after simplification {damage}" for damage in report["damage"]]
        if cleaned.cap:
            # Not simplified with it: the cap's edge has vertices of its own, and would come apart.
            capped, notes["cap_faces"] = close_neck(plain_surface(positions, faces))
            return capped.positions, capped.faces
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
    handed_over: Callable[[], None],
) -> Low:
    """Unwrap, and give normals and tangents in float32, as the asset will hold them."""
    with journal.stage("unwrap") as notes:
        own = (surface.corner_uv, surface.page) if as_is else (None, None)
        result = unwrap(positions, faces, prep.unwrap, prep.bake.albedo_px, handed_over, *own)
        notes.update(result.report)
        normals = vertex_normals(positions, faces)
        split = positions[result.source].astype(np.float32)
        split_normals = normals[result.source].astype(np.float32)
        uv = result.uv.astype(np.float32)
        tangents = vertex_tangents(split, result.faces, split_normals, uv)
        mesh = Mesh(split, split_normals, tangents, uv, result.faces.astype(np.uint32))
    return Low(positions, faces, normals, result, mesh)


def _levels_of_detail(
    high: High, low: Low, prep: PrepSettings, journal: Journal
) -> tuple[list[Mesh], list[dict[str, Any]]]:
    """Coarser meshes on the same atlas, and for each its triangles and errors in mm."""
    if not prep.simplify.lods:
        return [], []
    with journal.stage("levels of detail") as notes:
        meshes, slides, notes["problems"] = make_lods(low.mesh, prep.simplify.lods, prep.timeout_s)
        journal.warnings += [f"no level of detail of {what}" for what in notes["problems"]]
        levels = []
        for mesh, slide in zip(meshes, slides, strict=True):
            positions, faces = mesh.positions_mm.astype(np.float64), mesh.faces.astype(np.int64)
            error = surface_distance(high.target, positions, faces)["symmetric_mm"]["p99"]
            levels.append({"triangles": len(faces), "error_mm": error, "texture_slide_mm": slide})
            edge = float(np.sqrt(face_areas(positions, faces).sum() / len(faces)))
            if error > edge:  # a surface sampled that coarsely strays by a fraction of it
                journal.warnings.append(
                    f"the level of detail of {len(faces)} triangles is up to {error:.2f} mm from "
                    f"the raw surface, more than its edges' {edge:.2f} mm: do not use it, and "
                    "raise its number in prep.simplify.lods"
                )
        return meshes, levels


def _baked(
    raw: RawMesh,
    high: High,
    low: Low,
    shape: dict[str, Array],
    mask: SkinMask | None,
    prep: PrepSettings,
    journal: Journal,
    views: Path | None,
) -> tuple[dict[str, Image], dict[str, Any]]:
    bake = prep.bake
    with journal.stage("project"):
        cage = None if low.cage is None else low.cage[low.unwrapped.source]
        oven = Oven(make_projector(low.mesh, high.target, cage), low)
        oven.samples(bake.albedo_px)
    color = ColorSource(high.surface, raw.pages, bake.default_albedo)
    normals = NormalSource(high.surface, high.normals, raw.normal_pages)
    lost = bake_maps(oven, high, shape, color, normals, mask, bake, journal)
    with journal.stage("report") as notes:
        lost.update(atlas_report(low, bake.albedo_px))
        if prep.report == "full" and "albedo" in oven.maps:
            lost["color_de2000"] = color_error(high, low, color, oven.maps["albedo"])
        notes["curvature_scale_mm"] = high.curvature_scale_mm
        if prep.report == "full" and views is not None:
            arrays = make_views(high, low, color, oven.maps, bake.albedo_px)
            np.savez(views, **arrays)  # type: ignore[arg-type]
    return oven.maps, lost


def _counts(surface: Surface, low: Low, crossing: int | None) -> dict[str, Any]:
    edges = edges_of(low.faces)
    return {
        "cleaned": {"vertices": len(surface.positions), "triangles": len(surface.faces)},
        "prepared": {
            "vertices": len(low.mesh.positions_mm),
            "welded_vertices": len(low.positions),
            "triangles": len(low.faces),
            "boundary_edges": int((edges.count == 1).sum()),
            "non_manifold_edges": int((edges.count > 2).sum()),
            "self_intersecting_faces": crossing,
        },
    }


def _warn_of_losses(lost: dict[str, Any], prep: PrepSettings, low: Low, journal: Journal) -> None:
    error = lost["raw_to_prepared_mm"]["p99"]
    if error > max(prep.simplify.error_mm, NOTABLE_MM):
        journal.warnings.append(
            f"1 % of the raw surface is further than {error:.2f} mm from the prepared one: "
            "raise prep.simplify.triangles"
        )
    for failure in low.unwrapped.report.get("failed_rungs", []):
        journal.warnings.append(f"unwrapping fell back: {failure}")


def _source(path: Path) -> dict[str, Any]:
    digest = hashlib.sha256()
    with path.open("rb") as stream:
        while block := stream.read(1 << 22):
            digest.update(block)
    return {"file": path.name, "sha256": digest.hexdigest(), "bytes": path.stat().st_size}
