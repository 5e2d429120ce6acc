"""Texture coordinates by a ladder: own charts, then xatlas, then six projections.

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
from scanrender.scan.surface import Surface
from scanrender.scan.topology import unique_rows
from scanrender.scan.unwrap_box import pack_shelves, possible_padding, project
from scanrender.settings.prep import UnwrapSettings

Array = npt.NDArray[Any]
AS_IS_OVERLAP = 0.02
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
) -> Unwrapped:
    """Unwrap (n, 3) mm positions and (m, 3) faces for a map of size_px. `handed_over` is called
    once the first child has them. Raises StageError."""
    failures: list[str] = []
    rungs: list[tuple[str, Callable[..., Rung]]] = [
        ("charts", partial(_by_charts, handed_over=handed_over)),
        ("xatlas", _by_xatlas),
        ("box", _by_box),
    ]
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


def as_is_unwrapped(surface: Surface) -> Unwrapped | None:
    """The raw texture coordinates, when each face has some and they fit one map; else None.

    Several pages cannot share one map, coordinates outside [0, 1] repeat, and overlapping ones
    (mirrored halves) cannot hold occlusion: these are unwrapped anew.
    """
    uv = surface.corner_uv
    if uv is None or not np.isfinite(uv).all() or len(np.unique(surface.page)) > 1:
        return None
    if uv.min() < -1e-4 or uv.max() > 1.0 + 1e-4:
        return None
    flat = np.clip(uv.reshape(-1, 2), 0.0, 1.0)
    if overlap_share(flat, np.arange(len(flat)).reshape(-1, 3), 1024) > AS_IS_OVERLAP:
        return None
    up = np.stack([uv[:, :, 0], 1.0 - uv[:, :, 1]], axis=2).astype(np.float64)
    up = np.clip(up, 0.0, 1.0)
    chart = _charts_of(up, surface.faces)
    result = _joined(surface.faces, chart, up)
    flipped = int((signed_areas(_y_up(result.uv), result.faces) < 0).sum())
    result.report.update(
        rung="as is", charts=int(chart.max()) + 1, flipped=flipped, failed_rungs=[]
    )
    return result
