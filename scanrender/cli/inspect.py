"""`scanrender inspect SCAN`"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import click

from scanrender.cli import options

_PAGES = 6  # textures that are named; photogrammetry exports up to twenty


@click.command("inspect")
@click.argument("scan", type=click.Path(path_type=Path))
@options.overrides
@options.as_json
@options.debug
def command(scan: Path, overrides: tuple[str, ...], as_json: bool) -> None:
    """Say what is in SCAN: counts, size and units with their reason, holes, pieces, colours."""
    from scanrender.settings.loading import load_pipeline

    settings = load_pipeline("prep_only", overrides)
    options.existing(scan, "scan")
    from scanrender.scan.inspect import inspect_scan
    from scanrender.scan.memory import limit_memory

    limit_memory(settings.prep.memory_mib)
    health = inspect_scan(scan, settings.scan)
    click.echo(json.dumps(health, indent=2) if as_json else "\n".join(lines(health)))


def lines(health: Mapping[str, Any]) -> list[str]:
    """The health of a scan on one screen: what it is, then what is wrong, then what was decided."""
    units, axes = health["units"], health["axes"]
    width, height, depth = health["size_mm"]
    turn = f", turned by {axes['front_turn_deg']:g} degrees" if axes["front_turn_deg"] else ""
    rows = [
        ("size", f"{width:.4g} mm wide, {height:.4g} mm high, {depth:.4g} mm deep"),
        ("unit", f"{units['mm_per_unit']:.6g} mm ({units['confidence']}): {units['reason']}"),
        ("up", f"{axes['up']} ({axes['up_confidence']}): {axes['up_reason']}"),
        ("front", f"{axes['front']}{turn} ({axes['front_confidence']}): {axes['front_reason']}"),
        ("bounds", _bounds(*health["bounds_scan_units"])),
        ("pieces", _pieces(health["components"], health["largest_component_share"])),
        ("surface", _surface(health)),
        ("vertices", _vertices(health)),
        ("colour", _color(health)),
        *(("note", note) for note in health["notes"]),
        *(("warning", warning) for warning in health["warnings"]),
    ]
    title = f"{health['file']}: {health['triangles']:,} triangles"
    return [title, *(f"  {name:<9} {text}" for name, text in rows)]


def _bounds(low: list[float], high: list[float]) -> str:
    spans = zip("xyz", low, high, strict=True)
    return ", ".join(f"{axis} {a:.7g} to {b:.7g}" for axis, a, b in spans) + " in its own units"


def _pieces(count: int, share: float) -> str:
    if count == 1:
        return "1"
    return f"{count:,}, of which the largest has {100.0 * share:.3g} % of the area"


def _surface(health: Mapping[str, Any]) -> str:
    found = {
        "boundary edges": health["boundary_edges"],
        "edges with more than two faces": health["non_manifold_edges"],
        "faces without an area": health["degenerate_faces"],
        "faces that are there twice": health["duplicate_faces"],
    }
    wrong = [f"{count:,} {name}" for name, count in found.items() if count]
    return ", ".join([*(["watertight"] if health["watertight"] else []), *wrong])


def _vertices(health: Mapping[str, Any]) -> str:
    stored, welded = health["vertices"], health["welded_vertices"]
    return f"{stored:,}" + ("" if stored == welded else f", at {welded:,} places that are used")


def _color(health: Mapping[str, Any]) -> str:
    if health["color"] != "texture":
        return {"vertex": "at the vertices", "none": "none"}[health["color"]]
    pages = health["pages"]
    shown = [
        f"{page['name']} {page['size_px'][0]} x {page['size_px'][1]}"
        + (f" with normal map {page['normal_map']}" if page["normal_map"] else "")
        for page in pages[:_PAGES]
    ]
    more = [f"and {len(pages) - _PAGES} more"] if len(pages) > _PAGES else []
    return ", ".join([*shown, *more])
