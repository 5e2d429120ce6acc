"""Texture coordinates by a ladder: the scan's if asked for, own charts, xatlas, six projections.

Every rung is checked; the one that ran, and why those above did not, is in the report.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt

from scanrender.errors import ScanrenderError, StageError
from scanrender.scan.child import run_task
from scanrender.scan.flatten import signed_areas
from scanrender.scan.rasterize import overlap_share
from scanrender.scan.topology import face_areas, unique_rows
from scanrender.scan.unwrap_box import pack_shelves, possible_padding, project
from scanrender.settings.prep import UnwrapSettings

Array = npt.NDArray[Any]
# Of the scan's own coordinates. Overlapping ones (mirrored halves) cannot hold occlusion.
AS_IS_OVERLAP, OVERLAP_PX = 0.02, 1024
# Of the surface, what may lie in no texel: shown a hundred times as coarsely as the rest, or worse.
AS_IS_FLAT, FLAT_DENSITY = 0.01, 1e-4
# Of the map. Own charts cover two thirds: on a twentieth, texels are four times as coarse as those.
AS_IS_USE = 0.05
# What a rung gives: chart (m,), packed corner_uv (m, 3, 2) with y up, and notes.
Rung = tuple[Array, Array, dict[str, Any]]


@dataclass(frozen=True)
class Unwrapped:
    """source (k,) the input vertex of each output vertex; faces (m, 3) in input order; uv (k, 2),
    origin top left; chart (m,); report (rung, charts, why other rungs failed)."""

    source: npt.NDArray[np.int64]
    faces: npt.NDArray[np.int64]
    uv: npt.NDArray[np.float64]
    chart: npt.NDArray[np.int64]
    report: dict[str, Any]


def unwrap(
    positions: Array,
    faces: Array,
    settings: UnwrapSettings,
    size_px: int,
    handed_over: Callable[[], None] = lambda: None,
    own_uv: Array | None = None,
    page: Array | None = None,
) -> Unwrapped:
    """Unwrap (n, 3) mm positions and (m, 3) faces for a map of size_px. `handed_over` is called
    once the first child has them. own_uv (m, 3, 2), origin top left, on the pages (m,), is kept
    where it will do. Raises StageError."""
    failures: list[str] = []
    rungs: list[tuple[str, Callable[..., Rung]]] = [
        ("charts", partial(_by_charts, handed_over=handed_over)),
        ("xatlas", _by_xatlas),
        ("box", _by_box),
    ]
    if own_uv is not None:
        rungs.insert(0, ("as is", partial(_as_is, own_uv, page)))
    for name, rung in rungs:
        try:
            chart, corner_uv, notes = rung(positions, faces, settings, size_px)
            result = _joined(faces, chart, corner_uv)
            _check(result)
        except (ScanrenderError, ValueError) as error:
            text = error.what if isinstance(error, ScanrenderError) else str(error)
            failures.append(f"{name}: {text}")
            continue
        flipped = int((signed_areas(_y_up(result.uv), result.faces) < 0).sum())
        result.report.update(
            rung=name, **notes, charts=int(chart.max()) + 1, flipped=flipped, failed_rungs=failures
        )
        return result
    raise StageError(f"no way of unwrapping worked: {'; '.join(failures)}")


def _by_charts(
    positions: Array,
    faces: Array,
    settings: UnwrapSettings,
    size_px: int,
    handed_over: Callable[[], None],
) -> Rung:
    arrays = {"positions": positions, "faces": faces}
    asked = {"padding": settings.padding_px / size_px}
    flat, report = run_task("charts", arrays, asked, settings.timeout_s, handed_over)
    chart, padding = flat["chart"], report["padding"]
    notes = _padding_notes(padding, settings, size_px)
    if "packed" in flat:
        return chart, flat["packed"], {"packer": "bitmap", **notes}
    reasons = [report["not_packed"]]
    params = {"resolution": size_px, "padding": max(1, int(padding * size_px + 1e-9))}
    try:
        packed, report = run_task("pack", flat, params, settings.timeout_s)
        if report["atlases"] == 1:
            notes = {"packer": "xatlas", "packer_reason": reasons, **notes}
            return chart, packed["corner_uv"], notes
        reasons.append(f"{report['atlases']} atlases")
    except StageError as error:
        reasons.append(error.what)
    shelves = pack_shelves(chart, flat["corner_uv"], padding)
    return chart, shelves, {"packer": "shelves", "packer_reason": reasons, **notes}


def _padding_notes(padding: float, settings: UnwrapSettings, size_px: int) -> dict[str, Any]:
    """What became of the padding where there is no room for all of it."""
    if padding >= settings.padding_px / size_px:
        return {}
    return {"padding_px": padding * size_px, "padding_px_asked": settings.padding_px}


def _by_xatlas(positions: Array, faces: Array, settings: UnwrapSettings, size_px: int) -> Rung:
    arrays = {"positions": positions, "faces": faces}
    params = {"resolution": size_px, "padding": settings.padding_px}
    packed, report = run_task("xatlas", arrays, params, settings.timeout_s)
    if report["atlases"] != 1:
        raise StageError(f"xatlas made {report['atlases']} atlases")
    return _charts_of(packed["corner_uv"], faces), packed["corner_uv"], {"packer": "xatlas"}


def _by_box(positions: Array, faces: Array, settings: UnwrapSettings, size_px: int) -> Rung:
    chart, flat = project(positions, faces)
    padding = possible_padding(settings.padding_px / size_px, int(chart.max()) + 1)
    notes = _padding_notes(padding, settings, size_px)
    return chart, pack_shelves(chart, flat, padding), {"packer": "shelves", **notes}


def _as_is(
    uv: Array,
    page: Array | None,
    positions: Array,
    faces: Array,
    settings: UnwrapSettings,
    size_px: int,
) -> Rung:
    """The scan's own coordinates. Raises ValueError where they do not make one map of it all."""
    if blank := int((~np.isfinite(uv).all(axis=(1, 2))).sum()):
        raise ValueError(
            f"{blank:,} of {len(uv):,} faces have no texture coordinates, "
            "as those that close a hole or the neck"
        )
    if page is not None and len(np.unique(page)) > 1:
        raise ValueError("the faces lie on several texture pages, which cannot share one map")
    if uv.min() < -1e-4 or uv.max() > 1.0 + 1e-4:
        raise ValueError("texture coordinates outside the map, where the image repeats")
    up = np.stack([uv[:, :, 0], 1.0 - uv[:, :, 1]], axis=2).astype(np.float64)
    up = np.clip(up, 0.0, 1.0)
    flat, corners = up.reshape(-1, 2), np.arange(3 * len(up)).reshape(-1, 3)
    share, surface = np.abs(signed_areas(flat, corners)), face_areas(positions, faces)
    lost = share * surface.sum() <= FLAT_DENSITY * share.sum() * surface
    if (gone := float(surface[lost].sum() / surface.sum())) > AS_IS_FLAT:
        raise ValueError(f"{100 * gone:.0f} % of the surface has no area in the map")
    if share.sum() < AS_IS_USE:
        raise ValueError(f"the charts cover only {100 * share.sum():.3g} % of the map")
    if (overlap := overlap_share(flat, corners, OVERLAP_PX)) > AS_IS_OVERLAP:
        raise ValueError(f"{100 * overlap:.0f} % of the map lies under more than one face")
    return _charts_of(up, faces), up, {}


def _charts_of(corner_uv: Array, faces: Array) -> Array:
    """Charts as the pieces that stay connected when vertices are told apart by their UV."""
    from scanrender.scan.segment import edge_components

    key = np.concatenate([faces.reshape(-1, 1), corner_uv.reshape(-1, 2)], axis=1)
    _, index = np.unique(key, axis=0, return_inverse=True)
    return edge_components(index.reshape(-1, 3))


def _joined(faces: Array, chart: Array, corner_uv: Array) -> Unwrapped:
    """One vertex per (input vertex, chart, uv); UV turned to glTF's origin, top left."""
    vertex, (u, v) = faces.reshape(-1), corner_uv.reshape(-1, 2).T
    first, index = unique_rows(vertex, np.repeat(chart, 3), u, v)
    flipped = np.stack([u[first], 1.0 - v[first]], axis=1)
    return Unwrapped(vertex[first].astype(np.int64), index.reshape(-1, 3), flipped, chart, {})


def _y_up(uv: Array) -> Array:
    return np.stack([uv[:, 0], 1.0 - uv[:, 1]], axis=1)


def _check(result: Unwrapped) -> None:
    if not np.isfinite(result.uv).all():
        raise ValueError("non-finite texture coordinates")
    if result.uv.min() < -1e-6 or result.uv.max() > 1.0 + 1e-6:
        raise ValueError("texture coordinates outside the map")
    area = np.abs(signed_areas(result.uv, result.faces)).sum()
    if area < 1e-4:
        raise ValueError(f"the charts cover only {100 * area:.3g} % of the map")
