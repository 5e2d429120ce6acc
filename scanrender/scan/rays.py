"""Rays and nearest points against one triangle mesh, by Embree and libigl.

Wald, Woop, Benthin, Johnson, Ernst: Embree, ACM TOG 33(4), 2014.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from scanrender.scan.topology import face_normals

Array = npt.NDArray[Any]
CHUNK = 1_000_000


@dataclass(frozen=True)
class Hits:
    """face (k,) int32, -1 where nothing was hit; bary (k, 3); distance (k,) along the ray."""

    face: Array
    bary: Array
    distance: Array


class Target:
    """A mesh to shoot at: positions (n, 3) mm, faces (m, 3)."""

    def __init__(self, positions: Array, faces: Array) -> None:
        from embreex.mesh_construction import TriangleMesh
        from embreex.rtcore_scene import EmbreeScene

        self.positions = np.ascontiguousarray(positions, np.float64)
        self.faces = np.ascontiguousarray(faces, np.int64)
        self._scene = EmbreeScene()
        # It reads each number by itself, and rounds it: those of float64 and int64 take the least.
        TriangleMesh(self._scene, self.positions, self.faces)
        self._tree: Any = None

    def cast(self, origin: Array, direction: Array, reach: Array | float) -> Hits:
        """First hits of rays from origin (k, 3) along unit direction (k, 3), up to `reach` mm."""
        count = len(origin)
        face = np.full(count, -1, np.int32)
        bary = np.zeros((count, 3), np.float32)
        distance = np.full(count, np.inf, np.float32)
        reach = np.broadcast_to(np.asarray(reach, np.float32), (count,))
        for start in range(0, count, CHUNK):
            cut = slice(start, min(start + CHUNK, count))
            found = self._scene.run(
                np.ascontiguousarray(origin[cut], np.float32),
                np.ascontiguousarray(direction[cut], np.float32),
                np.array(reach[cut], np.float32),
                output=True,
            )
            hit = found["primID"] >= 0
            face[cut] = found["primID"]
            u, v = found["u"], found["v"]
            bary[cut] = np.where(hit[:, None], np.stack([1.0 - u - v, u, v], axis=1), 0.0)
            distance[cut] = np.where(hit, found["tfar"], np.inf)
        return Hits(face, bary, distance)

    def occluded(self, origin: Array, direction: Array, reach: float) -> npt.NDArray[np.bool_]:
        """(k,) whether anything lies within `reach` mm along each ray."""
        result = np.empty(len(origin), bool)
        for start in range(0, len(origin), CHUNK):
            cut = slice(start, min(start + CHUNK, len(origin)))
            rays = np.ascontiguousarray(origin[cut], np.float32)
            reaches = np.full(len(rays), reach, np.float32)
            ways = np.ascontiguousarray(direction[cut], np.float32)
            result[cut] = self._scene.run(rays, ways, reaches) >= 0
        return result

    @cached_property
    def face_normals(self) -> npt.NDArray[np.float32]:
        """(m, 3) unit; zero for a face without area."""
        return face_normals(self.positions, self.faces, np.float32)

    def build(self) -> None:
        """Embree builds its hierarchy at the first ray: here, once, and not in each copy of this
        process that would cast it."""
        self.occluded(np.zeros((1, 3)), np.array([[0.0, 0.0, 1.0]]), 1.0)

    def make_tree(self) -> None:
        """What `nearest` needs, ahead of its first call."""
        import igl

        if self._tree is None:
            self._tree = igl.AABB()
            self._tree.init(self.positions, self.faces)

    def nearest(self, points: Array) -> Hits:
        """The closest point of the mesh to each of points (k, 3), with its distance in mm."""
        self.make_tree()
        squared, face, closest = self._tree.squared_distance(
            self.positions, self.faces, np.ascontiguousarray(points, np.float64)
        )
        corners = self.positions[self.faces[face]]
        bary = barycentric(np.asarray(closest), corners)
        return Hits(np.asarray(face, np.int32), bary, np.sqrt(np.maximum(squared, 0.0)))

    def interpolate(self, hits: Hits, vertex_values: Array) -> Array:
        """(k, c) from values (n, c) at the mesh's vertices; hits must have a face."""
        table = np.ascontiguousarray(vertex_values, np.float32)
        corners = np.take(table, self.faces[hits.face], axis=0)
        return np.asarray(np.einsum("kc,kcd->kd", hits.bary, corners))


def barycentric(points: Array, corners: Array) -> npt.NDArray[np.float32]:
    """Clamped barycentric coordinates (k, 3) of points (k, 3) in triangles (k, 3, 3)."""
    e1, e2 = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    d = points - corners[:, 0]
    d11, d12, d22 = (np.einsum("ij,ij->i", x, y) for x, y in ((e1, e1), (e1, e2), (e2, e2)))
    p1, p2 = np.einsum("ij,ij->i", d, e1), np.einsum("ij,ij->i", d, e2)
    determinant = d11 * d22 - d12 * d12
    safe = np.where(determinant > 1e-300, determinant, 1.0)
    v = np.where(determinant > 1e-300, (d22 * p1 - d12 * p2) / safe, 0.0)
    w = np.where(determinant > 1e-300, (d11 * p2 - d12 * p1) / safe, 0.0)
    bary = np.clip(np.stack([1.0 - v - w, v, w], axis=1), 0.0, 1.0)
    return np.asarray(bary / bary.sum(axis=1, keepdims=True), np.float32)
