"""Cleaning in its fixed order, with counts before and after each step."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from scanrender.errors import ScanError
from scanrender.scan.floaters import drop_floaters
from scanrender.scan.frame import Frame, find_frame
from scanrender.scan.holes import fill_holes
from scanrender.scan.neck import close_neck
from scanrender.scan.orient import orient
from scanrender.scan.outliers import drop_outliers
from scanrender.scan.parallel import Aside
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
    """surface in asset space (mm, +Y up); frame; steps: one dict per step, with the number of
    faces and vertices before and after it, whether it changed anything or not; cap: how many of
    the last faces close the neck."""

    surface: Surface
    frame: Frame
    steps: tuple[Step, ...]
    cap: int = 0

    @property
    def skin(self) -> Surface:
        """The surface without the cap at the neck."""
        if not self.cap:
            return self.surface
        return self.surface.keep_faces(np.arange(len(self.surface.faces) - self.cap)).compact()


class _Steps:
    """The surface on its way, and what each step did to it."""

    def __init__(self, surface: Surface) -> None:
        self.surface = surface
        self.records: list[Step] = []

    def apply(self, name: str, step: Callable[[Surface], Surface]) -> None:
        self.put(name, step(self.surface))

    def put(self, name: str, after: Surface, **extra: int) -> None:
        before, self.surface = self.surface, after
        self.records.append(
            {
                "step": name,
                "faces": [len(before.faces), len(after.faces)],
                "vertices": [len(before.positions), len(after.positions)],
                **extra,
            }
        )
        if len(after.faces) == 0:
            raise nothing_left(name)


def nothing_left(step: str) -> ScanError:
    if step.startswith("drop degenerate"):
        what = "none of its triangles has an area"
        return ScanError(what, fix="export it again, with all digits of its coordinates")
    return ScanError(
        f"nothing of the scan is left after the step: {step}",
        fix="lower prep.clean.floater_fraction",
    )


def clean(raw: RawMesh, scan: ScanSettings, settings: CleanSettings) -> Cleaned:
    """Drop outliers, weld, drop what is invalid, repair, orient, drop floaters, fill small holes.

    What does not depend on the unit comes first; the unit is inferred from the large pieces alone,
    because floaters would falsify the size. Raises ScanError when nothing is left.
    """
    steps = _Steps(surface_from_raw(raw))
    fraction = settings.floater_fraction
    steps.apply("drop outliers", drop_outliers)
    steps.apply("weld", weld)
    steps.apply("drop degenerate faces", drop_degenerate)
    steps.apply("drop duplicate faces", drop_duplicates)
    steps.apply("drop extra faces at edges", drop_extra_faces)
    steps.apply("split vertices between fans", split_vertices)
    steps.apply("drop unused vertices", Surface.compact)
    surface, turned = orient(steps.surface)
    steps.put("orient", surface, **turned)
    # Whether there are any does not depend on the frame: looked for beside finding that.
    spiky = Aside(lambda: flatten_spikes(surface, settings.spike_sigma)[1] > 0)
    main = drop_floaters(surface, fraction)
    frame = find_frame(raw, main.positions, main.faces, scan)
    steps.surface = replace(surface, positions=frame.asset_from_raw(surface.positions))
    steps.apply(
        "drop floaters",
        lambda s: drop_floaters(s, fraction, settings.floater_distance_mm).compact(),
    )
    may_have_spikes = spiky.result() or len(steps.surface.faces) < len(surface.faces)
    surface, spikes = steps.surface, 0
    if may_have_spikes:
        surface, spikes = flatten_spikes(surface, settings.spike_sigma)
    steps.put("flatten spikes", surface, vertices_moved=spikes)
    surface, holes = steps.surface, 0
    if settings.hole_mm > 0:
        surface, holes = fill_holes(surface, settings.hole_mm)
    steps.put("fill holes", surface, holes=holes)
    # Where nothing moved and nothing was filled, no face has become degenerate meanwhile.
    if spikes or holes:
        surface = drop_degenerate(steps.surface).compact()
    steps.put("drop what filling left over", surface)
    cap = 0
    if settings.close_neck:
        surface, cap = close_neck(steps.surface)
        steps.put("close the neck", surface, cap_faces=cap)
    return Cleaned(steps.surface, frame, tuple(steps.records), cap)
