"""Polygons, strips and fans to triangles, and per-face colours to vertices, vectorised."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

_MOST_CORNERS = 256  # of a polygon whose ears are cut one by one; a larger one stays a fan
_MOST_WORK = 30_000_000  # tests of a point in a corner, for all polygons: some 10 s
_LEAST_WORK = 30  # what a polygon takes beside its tests
Array = npt.NDArray[Any]


def fan_corners(sizes: npt.NDArray[Any]) -> npt.NDArray[np.int64]:
    """Corner indices (t, 3) of the triangle fans of polygons laid end to end.

    sizes (p,): corners per polygon; polygons of fewer than 3 corners give no triangle. The fan
    starts at each polygon's first corner: exact for convex ones.
    """
    sizes = np.asarray(sizes, np.int64)
    if (sizes == 3).all():  # nearly every scan: a fifth of the time of reading it
        return np.arange(3 * len(sizes)).reshape(-1, 3)
    starts = np.cumsum(sizes) - sizes
    triangles = np.maximum(sizes - 2, 0)
    first = np.repeat(starts, triangles)
    step = np.arange(triangles.sum()) - np.repeat(np.cumsum(triangles) - triangles, triangles)
    return np.stack([first, first + step + 1, first + step + 2], axis=1)


def polygon_corners(
    sizes: Array, vertex: Array, positions: Array, notes: list[str] | None = None
) -> npt.NDArray[np.int64]:
    """The same (t, 3) of polygons of any shape: a fan where it lies within the polygon, else ears.

    vertex (c,): the vertex of each corner; corners that name none (-1 or too large) decide nothing.
    notes: takes a sentence when there was too much to cut, so that the rest are fans, too.
    Ear clipping: Meisters: Polygons Have Ears, American Mathematical Monthly 82(6), 1975.
    """
    sizes, triangles = np.asarray(sizes, np.int64), fan_corners(sizes)
    if not len(triangles) or int(sizes.max()) <= 3:
        return triangles
    polygon_of = np.repeat(np.arange(len(sizes)), np.maximum(sizes - 2, 0))
    many = np.flatnonzero(sizes[polygon_of] > 3)
    known = (vertex >= 0) & (vertex < len(positions))
    place = positions[np.where(known, vertex, 0)]
    a, b, c = (place[triangles[many, i]] for i in range(3))
    with np.errstate(invalid="ignore", over="ignore"):
        normal = np.cross(b - a, c - a)
        # The fan's sum is the vector area of the polygon, wherever the fan begins.
        owner = polygon_of[many]
        total = np.stack([np.bincount(owner, normal[:, k], len(sizes)) for k in range(3)], axis=1)
        against = np.einsum("ij,ij->i", normal, total[owner]) < 0.0
    first = np.cumsum(sizes) - sizes
    row = np.cumsum(np.maximum(sizes - 2, 0)) - np.maximum(sizes - 2, 0)
    concave = np.unique(owner[against])
    concave = concave[sizes[concave] <= _MOST_CORNERS]
    work = 0
    for done, polygon in enumerate(concave):
        if work > _MOST_WORK:
            if notes is not None:
                notes.append(f"{len(concave) - done} concave polygons too many: they may be folded")
            break
        size, start = int(sizes[polygon]), int(first[polygon])
        ears, tests = _ears(place[start : start + size], total[polygon])
        triangles[row[polygon] : row[polygon] + size - 2] = start + ears
        work += tests
    return triangles


def _ears(polygon: Array, normal: Array) -> tuple[npt.NDArray[np.int64], int]:
    """(n - 2, 3) corners of the triangles of a polygon (n, 3), seen along its normal, and how many
    points were tested for it at most (and what it takes beside that)."""
    axis = int(np.abs(normal).argmax())
    flat = np.delete(polygon, axis, axis=1)
    if (normal[axis] < 0.0) != (axis == 1):
        flat = flat[:, ::-1]
    points = [(float(x), float(y)) for x, y in flat]
    left = list(range(len(points)))
    found, tests = [], _LEAST_WORK
    while len(left) > 3:
        for i in range(len(left)):
            ear = left[i - 1], left[i], left[(i + 1) % len(left)]
            corner = [points[k] for k in ear]
            others = (points[k] for k in left if k not in ear)
            if _turn(*corner) > 0.0 and not any(_within(corner, other) for other in others):
                tests += (i + 1) * len(left)
                break
        else:  # it crosses itself: nothing is right
            tests += len(left) ** 2
            i, ear = 1, (left[0], left[1], left[2])
        found.append(ear)
        del left[i]
    return np.array([*found, tuple(left)], np.int64), tests


def _turn(a: tuple[float, float], b: tuple[float, float], c: tuple[float, float]) -> float:
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


def _within(corner: list[tuple[float, float]], point: tuple[float, float]) -> bool:
    return all(_turn(corner[i - 1], corner[i], point) >= 0.0 for i in range(3))


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
    """Colours (t, 3) of triangles as the mean (n, 3) of those around each vertex; of those that
    name no vertex nothing."""
    if len(faces) and (faces.min() < 0 or faces.max() >= vertex_count):
        there = ((faces >= 0) & (faces < vertex_count)).all(axis=1)
        per_face, faces = per_face[there], faces[there]
    flat = faces.reshape(-1)
    count = np.maximum(np.bincount(flat, minlength=vertex_count), 1)
    per_corner = np.repeat(per_face, 3, axis=0)
    mean = [np.bincount(flat, per_corner[:, k], vertex_count) / count for k in range(3)]
    return np.stack(mean, axis=1).astype(np.float32)
