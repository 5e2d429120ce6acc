"""From texels of the prepared mesh to points of the raw scan.

A ray starts a cage distance outside the low surface and runs inward along its interpolated normal;
the cage follows the local error, so that the ray cannot meet another part of the body first. Where
it meets nothing, or the back of something, the nearest point is taken.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from scanrender.asset import Mesh
from scanrender.scan.parallel import Shape, fill_rows
from scanrender.scan.rasterize import Texels, rasterize
from scanrender.scan.rays import Hits, Target
from scanrender.scan.topology import face_centres, unit

Array = npt.NDArray[Any]

CAGE_MM = (0.05, 6.0)  # smallest: float32 and flat patches; largest: never through a lip or an ear
PIECE = 100_000  # texels at a time: temporary arrays stay near the caches, and cores stay busy


@dataclass(frozen=True)
class Samples:
    """The raw points under all texels of one map; missed: the share of nearest-point fallbacks."""

    texels: Texels
    hits: Hits
    missed: float

    def piece(self, start: int, stop: int) -> tuple[Texels, Hits]:
        """The samples start:stop."""
        hits = self.hits
        part = Hits(hits.face[start:stop], hits.bary[start:stop], hits.distance[start:stop])
        return self.texels.rows(start, stop), part

    def bake(
        self, shapes: Sequence[Shape], work: Callable[[Texels, Hits], Sequence[Array]]
    ) -> list[Array]:
        """Arrays (k, ...) of what work(texels, hits) returns for each piece, on all cores."""
        return fill_rows(
            len(self.texels.index), shapes, lambda i, j: work(*self.piece(i, j)), PIECE
        )


@dataclass(frozen=True)
class Projector:
    """Projects texels of `mesh` onto `target`; cage (n,) mm at the mesh's vertices."""

    mesh: Mesh
    target: Target
    cage: Array
    target_normals: Array

    def samples(self, size: int) -> Samples:
        """Project every texel of a map of `size` pixels."""
        texels = rasterize(self.mesh.uv, self.mesh.faces, size)
        return Samples(texels, *self.project(texels))

    def project(self, texels: Texels) -> tuple[Hits, float]:
        """The raw point under each texel, and the share that needed the nearest point."""
        count = len(texels.index)
        shapes: list[Shape] = [((), np.int32), ((3,), np.float32), ((), np.float32), ((), bool)]
        face, bary, distance, missed = fill_rows(
            count, shapes, lambda i, j: self._project(texels.rows(i, j)), PIECE
        )
        return Hits(face, bary, distance), float(missed.sum()) / max(1, count)

    def _project(self, texels: Texels) -> tuple[Array, Array, Array, Array]:
        point, normal, cage = self._rays(texels)
        hits = self.target.cast(point + normal * cage[:, None], -normal, 2.0 * cage)
        facing = np.einsum("ij,ij->i", self.target_normals[hits.face], normal) > 0.1
        missed = (hits.face < 0) | ~facing
        offset = np.abs(hits.distance - cage)
        again = np.flatnonzero(missed)
        if len(again):
            near = self.target.nearest(point[again])
            hits.face[again], hits.bary[again] = near.face, near.bary
            offset[again] = near.distance
        return hits.face, hits.bary, offset, missed

    def _rays(self, texels: Texels) -> tuple[Array, Array, Array]:
        """Points (k, 3) on the low surface, unit normals (k, 3) and cage (k,) there."""
        mesh = self.mesh
        table = np.concatenate([mesh.positions_mm, mesh.normals, self.cage[:, None]], axis=1)
        both = texels.interpolate(table[mesh.faces])
        normal = unit(both[:, 3:6], fallback=(0.0, 0.0, 1.0))
        return both[:, :3], normal, both[:, 6]


def make_projector(mesh: Mesh, target: Target, cage: Array | None = None) -> Projector:
    """A projector with the given cage (n,) mm, or one measured here."""
    if cage is None:
        cage = measured_cage(mesh.positions_mm.astype(np.float64), mesh.faces, target)
    return Projector(mesh, target, cage.astype(np.float32), target.face_normals)


def measured_cage(positions: Array, faces: Array, target: Target) -> Array:
    """(n,) mm from the local error at vertices and face centres."""
    cage = target.nearest(positions).distance.copy()
    at_face = target.nearest(face_centres(positions, faces)).distance
    np.maximum.at(cage, faces.reshape(-1), np.repeat(at_face, 3))
    return np.clip(2.0 * cage + CAGE_MM[0], *CAGE_MM)
