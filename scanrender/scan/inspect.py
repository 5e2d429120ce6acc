"""The health of a scan, without preparing it: what `scanrender inspect` and `validate` print."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from scanrender.errors import ScanError
from scanrender.scan.clean import nothing_left
from scanrender.scan.floaters import drop_floaters
from scanrender.scan.frame import find_frame
from scanrender.scan.header import named
from scanrender.scan.ingest import read_scan
from scanrender.scan.memory import OUT_OF_MEMORY
from scanrender.scan.orient import orient
from scanrender.scan.outliers import FAR, drop_outliers
from scanrender.scan.raw import RawMesh
from scanrender.scan.surface import surface_from_raw
from scanrender.scan.topology import components, edges_of, face_areas, used_vertices
from scanrender.scan.weld import drop_degenerate, drop_duplicates, weld
from scanrender.settings.prep import CleanSettings
from scanrender.settings.scan import ScanSettings


def inspect_scan(path: Path | str, settings: ScanSettings | None = None) -> dict[str, Any]:
    """Counts, size, inferred unit and axes, defects and colour of a scan, as plain JSON data.

    Raises UsageError, ConfigError or ScanError as `read_scan` does.
    """
    settings = settings or ScanSettings()
    raw = read_scan(path, settings)
    try:
        return _health(raw, Path(path), settings)
    except MemoryError as error:
        what = f"{Path(path).name} does not fit into memory"
        raise ScanError(what, str(path), OUT_OF_MEMORY) from error


def _health(raw: RawMesh, path: Path, settings: ScanSettings) -> dict[str, Any]:
    surface = drop_outliers(surface_from_raw(raw))
    notes = list(raw.notes)
    if outliers := len(raw.faces) - len(surface.faces):
        notes.append(f"{outliers} faces lead to vertices {FAR:.0f} times its size away: dropped")
    welded = weld(surface)
    sound = drop_degenerate(welded)
    if not len(sound.faces):
        raise named(nothing_left("drop degenerate faces"), path)
    single = drop_duplicates(sound)
    count, piece = components(single.faces, len(single.positions))
    edges = edges_of(single.faces)
    area = np.bincount(piece, face_areas(single.positions, single.faces), minlength=count)
    main, _ = orient(drop_floaters(single, CleanSettings().floater_fraction))
    frame = find_frame(raw, main.positions, main.faces, settings)
    low, high = raw.positions.min(axis=0), raw.positions.max(axis=0)
    used = used_vertices(main.faces, len(main.positions))
    size = np.ptp(frame.asset_from_raw(main.positions[used]), axis=0)
    return {
        "file": path.name,
        "vertices": len(raw.positions),
        "triangles": len(raw.faces),
        "welded_vertices": int(used_vertices(welded.faces, len(welded.positions)).sum()),
        "bounds_scan_units": [low.tolist(), high.tolist()],
        "size_mm": size.tolist(),
        "units": frame.units,
        "axes": frame.axes,
        "components": count,
        "largest_component_share": float(area.max() / max(float(area.sum()), 1e-300)),
        "degenerate_faces": len(welded.faces) - len(sound.faces),
        "duplicate_faces": len(sound.faces) - len(single.faces),
        "boundary_edges": int((edges.count == 1).sum()),
        "non_manifold_edges": int((edges.count > 2).sum()),
        "watertight": bool((edges.count == 2).all()),
        "color": raw.color_source,
        "pages": _pages(raw),
        "notes": notes,
        "warnings": list(frame.warnings),
    }


def _pages(raw: RawMesh) -> list[dict[str, Any]]:
    return [
        {
            "name": page.name,
            "size_px": list(page.size),
            "normal_map": normal.name if normal is not None else None,
        }
        for page, normal in zip(raw.pages, raw.normal_pages, strict=True)
    ]
