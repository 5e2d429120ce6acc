"""Join vertices that lie at the same place, and drop faces that are degenerate or twice there."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from scanrender.scan.surface import Surface
from scanrender.scan.topology import all_differ, extent, face_areas, sorted_order, span

Array = npt.NDArray[Any]

# Positions are compared on a grid this fine relative to the scan: float32 files hold no more.
GRID = 1e-7


def weld(surface: Surface) -> Surface:
    """One vertex per place: exporters split them at UV and normal seams. Colours are averaged."""
    low, high = extent(surface.positions)
    step = max(float((high - low).max()) * GRID, 1e-300)
    cell = np.round((surface.positions - low) / step).astype(np.int64)
    if all_differ(*cell.T):
        return surface
    # One 64-bit key per cell would be too short (21 bits an axis), hence the sort by columns.
    order = sorted_order(cell[:, 2])
    for axis in (1, 0):
        order = order[sorted_order(cell[order, axis])]
    ordered = cell[order]
    new = np.concatenate([[True], (ordered[1:] != ordered[:-1]).any(axis=1)])
    label = np.empty(len(cell), np.int64)
    label[order] = np.cumsum(new) - 1
    if label.max() + 1 == len(cell):
        return surface
    source = np.full(label.max() + 1, len(cell), np.int64)
    np.minimum.at(source, label, np.arange(len(cell)))
    rank = np.empty(len(source), np.int64)  # keep the file's order of vertices
    rank[np.argsort(source)] = np.arange(len(source))
    label = rank[label]
    source = np.sort(source)
    welded = surface.renumber(label[surface.faces], source)
    if surface.colors is not None:
        count = np.bincount(label)
        sums = [np.bincount(label, surface.colors[:, k]) for k in range(3)]
        mean = np.stack(sums, axis=1) / count[:, None]
        welded = replace(welded, colors=mean.astype(np.float32))
    return welded


def drop_degenerate(surface: Surface) -> Surface:
    """Without faces that name a vertex twice or have no area."""
    f = surface.faces
    distinct = (f[:, 0] != f[:, 1]) & (f[:, 1] != f[:, 2]) & (f[:, 2] != f[:, 0])
    size = float(span(surface.positions).max())
    area = face_areas(surface.positions, f)
    return surface.keep_faces(distinct & (area > 1e-14 * size * size))


def drop_duplicates(surface: Surface) -> Surface:
    """Without the second copy of a face, whatever its winding (two-sided exports)."""
    a, b, c = surface.faces.T
    least, most = np.minimum(np.minimum(a, b), c), np.maximum(np.maximum(a, b), c)
    if all_differ(least, most, a + b + c):
        return surface
    a, b, c = np.sort(surface.faces, axis=1).T
    order = sorted_order(c)
    order = order[sorted_order((a * (int(b.max(initial=0)) + 1) + b)[order])]
    same = np.zeros(len(order), bool)
    i, j = order[1:], order[:-1]
    same[1:] = (a[i] == a[j]) & (b[i] == b[j]) & (c[i] == c[j])
    if not same.any():
        return surface
    return surface.keep_faces(np.sort(order[~same]))
