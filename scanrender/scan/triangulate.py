"""Polygons, strips and fans to triangles, and per-face colours to vertices, vectorised."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt


def fan_corners(sizes: npt.NDArray[Any]) -> npt.NDArray[np.int64]:
    """Corner indices (t, 3) of the triangle fans of polygons laid end to end.

    sizes (p,): corners per polygon; polygons of fewer than 3 corners give no triangle. The fan
    starts at each polygon's first corner: exact for convex ones, which scanners' quads are.
    """
    sizes = np.asarray(sizes, np.int64)
    starts = np.cumsum(sizes) - sizes
    triangles = np.maximum(sizes - 2, 0)
    first = np.repeat(starts, triangles)
    step = np.arange(triangles.sum()) - np.repeat(np.cumsum(triangles) - triangles, triangles)
    return np.stack([first, first + step + 1, first + step + 2], axis=1)


def strip_faces(indices: npt.NDArray[Any], restart: int = -1) -> npt.NDArray[np.int64]:
    """Triangles (t, 3) of one triangle strip; `restart` cuts it and resets the winding."""
    indices = np.asarray(indices, np.int64)
    if len(indices) < 3:
        return np.zeros((0, 3), np.int64)
    position = np.arange(len(indices))
    cut = np.maximum.accumulate(np.where(indices == restart, position, -1))
    faces = np.stack([indices[:-2], indices[1:-1], indices[2:]], axis=1)
    odd = (position[:-2] - cut[:-2] - 1) % 2 == 1
    faces[odd] = faces[odd][:, [1, 0, 2]]
    kept = (faces != restart).all(axis=1)
    distinct = (faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2])
    return np.asarray(faces[kept & distinct & (faces[:, 0] != faces[:, 2])])


def onto_vertices(
    per_face: npt.NDArray[Any], faces: npt.NDArray[Any], vertex_count: int
) -> npt.NDArray[np.float32]:
    """Colours (t, 3) of triangles as the mean (n, 3) of those around each vertex."""
    flat = faces.reshape(-1)
    count = np.maximum(np.bincount(flat, minlength=vertex_count), 1)
    per_corner = np.repeat(per_face, 3, axis=0)
    mean = [np.bincount(flat, per_corner[:, k], vertex_count) / count for k in range(3)]
    return np.stack(mean, axis=1).astype(np.float32)
