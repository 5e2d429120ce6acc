"""Cleaning in its fixed order, with counts before and after each step."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from scanrender.errors import ScanError
from scanrender.scan.floaters import drop_floaters
from scanrender.scan.frame import Frame, find_frame
from scanrender.scan.holes import fill_holes
from scanrender.scan.orient import orient
from scanrender.scan.raw import RawMesh
from scanrender.scan.repair import drop_extra_faces, split_vertices
from scanrender.scan.spikes import flatten_spikes
from scanrender.scan.surface import Surface, surface_from_raw
from scanrender.scan.weld import drop_degenerate, drop_duplicates, weld
from scanrender.settings.prep import CleanSettings
from scanrender.settings.scan import ScanSettings

Step = dict[str, Any]


@dataclass(frozen=True)
class Cleaned:
    """surface in asset space (mm, +Y up); frame; steps: one dict per step that did something."""

    surface: Surface
    frame: Frame
    steps: tuple[Step, ...]


def clean(raw: RawMesh, scan: ScanSettings, settings: CleanSettings) -> Cleaned:
    """Weld, drop what is invalid, drop floaters, repair, orient, fill small holes.

    What does not depend on the unit comes first, because floaters would falsify the size from
    which the unit is inferred. Raises ScanError when nothing is left.
    """
    steps: list[Step] = []
    surface = surface_from_raw(raw)
    fraction = settings.floater_fraction

    def apply(name: str, step: Callable[[Surface], Surface]) -> None:
        nonlocal surface
        before = surface
        surface = step(surface)
        _record(steps, name, before, surface)
        if len(surface.faces) == 0:
            raise nothing_left(name)

    apply("weld", weld)
    apply("drop degenerate faces", drop_degenerate)
    apply("drop duplicate faces", drop_duplicates)
    apply("drop floaters", lambda s: drop_floaters(s, fraction))
    apply("drop extra faces at edges", drop_extra_faces)
    apply("split vertices between fans", split_vertices)
    apply("drop floaters that hung by a vertex", lambda s: drop_floaters(s, fraction))
    apply("drop unused vertices", Surface.compact)
    surface, turned = orient(surface)
    if any(turned.values()):
        steps.append({"step": "orient", **turned})
    frame = find_frame(raw, surface.positions, surface.faces, scan)
    surface = replace(surface, positions=frame.asset_from_raw(surface.positions))
    surface, spikes = flatten_spikes(surface, settings.spike_sigma)
    if spikes:
        steps.append({"step": "flatten spikes", "vertices_moved": spikes})
    if settings.hole_mm > 0:
        before = surface
        surface, holes = fill_holes(surface, settings.hole_mm)
        if holes:
            _record(steps, "fill holes", before, surface, holes=holes)
    apply("drop degenerate faces again", drop_degenerate)
    apply("drop unused vertices again", Surface.compact)
    return Cleaned(surface, frame, tuple(steps))


def nothing_left(step: str) -> ScanError:
    if step.startswith("drop degenerate"):
        what = "none of its triangles has an area"
        return ScanError(what, fix="export it again, with all digits of its coordinates")
    return ScanError(
        f"nothing of the scan is left after the step: {step}",
        fix="lower prep.clean.floater_fraction",
    )


def _record(steps: list[Step], name: str, before: Surface, after: Surface, **extra: int) -> None:
    changed = len(before.faces) != len(after.faces) or len(before.positions) != len(after.positions)
    if changed:
        steps.append(
            {
                "step": name,
                "faces": [len(before.faces), len(after.faces)],
                "vertices": [len(before.positions), len(after.positions)],
                **extra,
            }
        )


def bounds_mm(surface: Surface) -> list[list[float]]:
    low, high = surface.positions.min(axis=0), surface.positions.max(axis=0)
    return [[float(x) for x in low], [float(x) for x in high]]
