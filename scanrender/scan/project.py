"""From texels of the prepared mesh to points of the raw scan.

A ray starts a cage distance outside the low surface and runs inward along its interpolated normal;
the cage follows the local error, so that the ray cannot meet another part of the body first. Where
it meets nothing, or the back of something, the nearest point is taken.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from scanrender.asset import Mesh
from scanrender.scan.rasterize import Texels, rasterize
from scanrender.scan.rays import CHUNK, Hits, Target
from scanrender.scan.topology import area_normals, unit

Array = npt.NDArray[Any]

CAGE_MM = (0.05, 6.0)  # smallest: float32 and flat patches; largest: never through a lip or an ear


@dataclass(frozen=True)
class Samples:
    """The raw points under all texels of one map; missed: the share of nearest-point fallbacks."""

    texels: Texels
    hits: Hits
    missed: float

    def pieces(self) -> Iterator[tuple[slice, Texels, Hits]]:
        """In pieces that keep temporary arrays small."""
        for start in range(0, len(self.texels.index), CHUNK):
            cut = slice(start, start + CHUNK)
            hits = Hits(self.hits.face[cut], self.hits.bary[cut], self.hits.distance[cut])
            yield cut, self.texels.rows(start, start + CHUNK), hits


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
        parts, misses = [], 0
        for start in range(0, len(texels.index), CHUNK):
            hits, missed = self._project(texels.rows(start, start + CHUNK))
            parts.append(hits)
            misses += missed
        if not parts:
            return Hits(np.zeros(0, np.int32), np.zeros((0, 3), np.float32), np.zeros(0)), 0.0
        joined = Hits(
            np.concatenate([p.face for p in parts]),
            np.concatenate([p.bary for p in parts]),
            np.concatenate([p.distance for p in parts]),
        )
        return joined, misses / max(1, len(texels.index))

    def _project(self, texels: Texels) -> tuple[Hits, int]:
        faces = self.mesh.faces
        point = texels.interpolate(self.mesh.positions_mm[faces])
        normal = unit(texels.interpolate(self.mesh.normals[faces]), fallback=(0.0, 0.0, 1.0))
        cage = texels.interpolate(self.cage[faces][:, :, None])[:, 0]
        hits = self.target.cast(point + normal * cage[:, None], -normal, 2.0 * cage)
        facing = np.einsum("ij,ij->i", self.target_normals[hits.face], normal) > 0.1
        missed = np.flatnonzero((hits.face < 0) | ~facing)
        offset = np.abs(hits.distance - cage)
        if len(missed):
            near = self.target.nearest(point[missed])
            hits.face[missed], hits.bary[missed] = near.face, near.bary
            offset[missed] = near.distance
        return Hits(hits.face, hits.bary, offset), len(missed)


def make_projector(mesh: Mesh, target: Target) -> Projector:
    """Measure the local error at vertices and face centres, and set the cage from it."""
    positions = mesh.positions_mm.astype(np.float64)
    at_vertex = target.nearest(positions).distance
    at_face = target.nearest(positions[mesh.faces].mean(axis=1)).distance
    cage = at_vertex.copy()
    np.maximum.at(cage, mesh.faces.reshape(-1), np.repeat(at_face, 3))
    cage = np.clip(2.0 * cage + CAGE_MM[0], *CAGE_MM)
    normals = unit(area_normals(target.positions, target.faces))
    return Projector(mesh, target, cage.astype(np.float32), normals.astype(np.float32))
