"""Rays against one triangle mesh, by Embree.

Wald, Woop, Benthin, Johnson, Ernst: Embree, ACM TOG 33(4), 2014. Single precision: about 1e-5 mm
at a head's size, so origins near the mesh are what callers must choose.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from scanrender.optics._math import Array

Faces = npt.NDArray[np.int64]
Flags = npt.NDArray[np.bool_]
CHUNK = 500_000


class Caster:
    """A mesh to shoot at: positions (n, 3) mm, faces (m, 3)."""

    def __init__(self, positions_mm: Array, faces: Faces) -> None:
        from embreex.mesh_construction import TriangleMesh
        from embreex.rtcore_scene import EmbreeScene

        self._scene: Any = EmbreeScene()
        TriangleMesh(
            self._scene,
            np.ascontiguousarray(positions_mm, np.float32),
            np.ascontiguousarray(faces, np.int32),
        )
        # Embree builds its hierarchy at the first ray: here, and not again in each forked copy.
        self.is_blocked(np.zeros((1, 3)), np.array([[0.0, 0.0, 1.0]]), 1.0)

    def first_hit(
        self, origin_mm: Array, direction: Array, reach_mm: float = np.inf
    ) -> tuple[Faces, Array]:
        """Face (k,), -1 for none, and barycentric coordinates (k, 3) of the first hits.

        Rays start at ``origin_mm`` (k, 3) and go along unit ``direction`` (k, 3), ``reach_mm`` far.
        """
        face = np.full(len(origin_mm), -1, np.int64)
        bary = np.zeros((len(origin_mm), 3))
        for cut, ways, reaches in _chunks(origin_mm, direction, reach_mm):
            start = np.ascontiguousarray(origin_mm[cut], np.float32)
            found = self._scene.run(start, ways, reaches, output=True)
            u, v = found["u"].astype(np.float64), found["v"].astype(np.float64)
            face[cut] = found["primID"]
            bary[cut] = np.stack([1.0 - u - v, u, v], axis=1)
        return face, bary

    def is_blocked(self, origin_mm: Array, direction: Array, reach_mm: float | Array) -> Flags:
        """(k,) whether anything lies within ``reach_mm`` (or (k,)) along each ray."""
        result = np.zeros(len(origin_mm), np.bool_)
        for cut, ways, reaches in _chunks(origin_mm, direction, reach_mm):
            start = np.ascontiguousarray(origin_mm[cut], np.float32)
            result[cut] = self._scene.run(start, ways, reaches) >= 0
        return result

    def clear_mm(self, origin_mm: Array, direction: Array, reach_mm: Array) -> Array:
        """(k,) how far each ray goes before it hits, at most ``reach_mm`` (k,)."""
        result = np.zeros(len(origin_mm))
        for cut, ways, reaches in _chunks(origin_mm, direction, reach_mm):
            start = np.ascontiguousarray(origin_mm[cut], np.float32)
            found = self._scene.run(start, ways, reaches, output=True)
            result[cut] = np.where(found["primID"] >= 0, found["tfar"], reach_mm[cut])
        return result


def _chunks(origin_mm: Array, direction: Array, reach_mm: float | Array) -> Any:
    count = len(origin_mm)
    reaches = np.broadcast_to(np.asarray(np.minimum(reach_mm, 1e30), np.float32), (count,))
    for start in range(0, count, CHUNK):
        cut = slice(start, min(start + CHUNK, count))
        yield cut, np.ascontiguousarray(direction[cut], np.float32), np.array(reaches[cut])
