"""Samples of the whole surface by area: triangles halved until their sides are short enough.

A triangle becomes 4^b equal ones in quadtree order, so that each four neighbours are one triangle
of the level above: light is averaged over them, never sampled more coarsely.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from scanrender.optics._math import Array
from scanrender.reference.parallel import each
from scanrender.reference.rays import Faces, Flags
from scanrender.reference.surface import Surface

#: What diffuses at barycentric coordinates (k, 3) of faces (k,): light (k, 3), mask (k,).
Field = Callable[[Faces, Array], tuple[Array, Array]]
#: Whether the camera sees the surface there: (k,).
Sees = Callable[[Faces, Array], Flags]
#: Side of an equilateral triangle whose area is the square of 1.
SIDE_OF_UNIT_AREA = 1.52
_MAX_DEPTH = 10
_CHUNK = 60_000


@dataclass(frozen=True)
class Samples:
    """k cells of the surface: middle (k, 3) mm, face (k,), ``area`` (k,) mm^2.

    ``source`` (k, 3) is area x mask x light, ``mass`` (k,) is area x mask; ``seen`` (k,) the share
    that the camera sees. ``spread_mm2`` is the variance, along one axis, of what was averaged into
    a cell around the cell's middle: a kernel at the middle acts as if it were that much wider.
    """

    position: Array
    face: Faces
    area: Array
    source: Array
    mass: Array
    seen: Array
    spread_mm2: float = 0.0


@dataclass(frozen=True)
class SurfaceSamples:
    """Samples grouped by depth b: faces that were divided into 4^b."""

    groups: tuple[tuple[int, Samples], ...]

    @property
    def count(self) -> int:
        """Of the finest samples."""
        return sum(len(samples.area) for _, samples in self.groups)

    def coarser(self, levels: int) -> Samples:
        """All samples, each 4^levels neighbours of one face averaged into one."""
        parts = [_merged(samples, min(levels, depth)) for depth, samples in self.groups]
        second = sum(float(part.area.sum()) * part.spread_mm2 for part in parts)
        area = sum(float(part.area.sum()) for part in parts)
        join = np.concatenate
        return Samples(
            join([part.position for part in parts]),
            join([part.face for part in parts]),
            join([part.area for part in parts]),
            join([part.source for part in parts]),
            join([part.mass for part in parts]),
            join([part.seen for part in parts]),
            second / area if area > 0.0 else 0.0,
        )


def surface_samples(
    surface: Surface, field: Field, spacing_mm: float, faces: Faces, sees: Sees | None = None
) -> SurfaceSamples:
    """Samples of ``faces`` (j,) with at most spacing_mm^2 of area each, where a face is regular.

    Deterministic, and the same for any number of cores. Without ``sees`` all count as seen.
    """
    corners = surface.positions[surface.faces[faces]]
    sides = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
    halvings = np.ceil(np.log2(np.maximum(sides / (SIDE_OF_UNIT_AREA * spacing_mm), 1.0)))
    depths = np.minimum(halvings, _MAX_DEPTH).astype(np.int64)
    jobs: list[tuple[int, Faces]] = []
    for depth in np.unique(depths).tolist():
        mine = faces[depths == depth]
        step = max(1, _CHUNK >> (2 * depth))
        jobs += [(depth, mine[start : start + step]) for start in range(0, len(mine), step)]
    parts = each(len(jobs), lambda i: _sample(surface, field, sees, *jobs[i]))
    groups = []
    for depth in np.unique(depths).tolist():
        mine = [part for part, job in zip(parts, jobs, strict=True) if job[0] == depth]
        groups.append((depth, _joined(mine)))
    return SurfaceSamples(tuple(groups))


def _sample(surface: Surface, field: Field, sees: Sees | None, depth: int, faces: Faces) -> Samples:
    middles = _middles(depth)
    face = np.repeat(faces, len(middles))
    bary = np.tile(middles, (len(faces), 1))
    area = surface.face_areas[face] / len(middles)
    light, mask = field(face, bary)
    mass = area * mask
    seen = np.ones(len(face)) if sees is None else sees(face, bary).astype(np.float64)
    position = surface.positions_at(face, bary)
    return Samples(position, face, area, mass[:, None] * light, mass, seen)


@lru_cache(maxsize=_MAX_DEPTH + 1)
def _middles(depth: int) -> Array:
    """(4^depth, 3) barycentric middles of the small triangles, in quadtree order."""
    corners = np.eye(3)[None]
    for _ in range(depth):
        a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
        ab, bc, ca = 0.5 * (a + b), 0.5 * (b + c), 0.5 * (c + a)
        children = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (bc, ca, ab)]
        corners = np.stack([np.stack(child, axis=1) for child in children], axis=1)
        corners = corners.reshape(-1, 3, 3)
    return np.asarray(corners.mean(axis=1))


def _merged(fine: Samples, levels: int) -> Samples:
    if levels == 0:
        return fine
    each_of = 4**levels
    position = fine.position.reshape(-1, each_of, 3)
    middle = position.mean(axis=1)
    squared = np.sum((position - middle[:, None]) ** 2, axis=(1, 2)) / each_of
    area = fine.area.reshape(-1, each_of).sum(axis=1)
    return Samples(
        middle,
        fine.face[::each_of],
        area,
        fine.source.reshape(-1, each_of, 3).sum(axis=1),
        fine.mass.reshape(-1, each_of).sum(axis=1),
        fine.seen.reshape(-1, each_of).mean(axis=1),
        float(np.average(squared, weights=area)) / 2.0,
    )


def _joined(parts: Sequence[Samples]) -> Samples:
    join = np.concatenate
    return Samples(
        join([part.position for part in parts]),
        join([part.face for part in parts]),
        join([part.area for part in parts]),
        join([part.source for part in parts]),
        join([part.mass for part in parts]),
        join([part.seen for part in parts]),
    )
