"""Close the neck: a flat cap over the opening at which a bust was cut off.

The cap has vertices of its own along the rim: the edge stays sharp in shading, and the curvature of
the skin beside it is not that of a knife's edge. Ear clipping after Meisters: Polygons have ears,
American Mathematical Monthly 82, 1975, and ElGindy, Everett, Toussaint 1993 for the choice of ear.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from scanrender.scan.surface import Surface
from scanrender.scan.topology import boundary_loops

LOW = 0.35  # of the height: an opening whose middle lies higher is no neck
WIDE = 0.15  # of the scan's diagonal: a narrower opening is a hole


def close_neck(surface: Surface) -> tuple[Surface, int]:
    """The surface (mm, +Y up) with a cap over its largest low opening; and the number of faces of
    the cap, which come last. 0 where there is no such opening. The cap has no texture page."""
    loop = _neck(surface)
    if loop is None:
        return surface, 0
    ring = surface.positions[loop]
    corners = cap_faces(ring)
    first = len(surface.positions)
    capped = surface.add_faces(corners + first, ring)
    if surface.colors is not None and capped.colors is not None:
        capped.colors[first:] = surface.colors[loop]
    return capped, len(corners)


def _neck(surface: Surface) -> npt.NDArray[np.int64] | None:
    used = surface.positions[np.unique(surface.faces)]
    low, size = used[:, 1].min(), np.ptp(used, axis=0)
    best, widest = None, WIDE * float(np.linalg.norm(size))
    for loop in boundary_loops(surface.faces):
        ring = surface.positions[loop]
        width = float(np.linalg.norm(np.ptp(ring, axis=0)))
        if ring[:, 1].mean() - low <= LOW * size[1] and width > widest:
            best, widest = loop, width
    return best


def cap_faces(ring: npt.NDArray[np.float64]) -> npt.NDArray[np.int64]:
    """(n - 2, 3) triangles of a loop (n, 3) without holes, in its order, by clipping ears of its
    projection along its mean normal. Where the projection crosses itself, so do the triangles."""
    flat = _projected(ring)
    left = list(range(len(ring)))
    faces = []
    while len(left) > 3:
        ear = _widest_ear(flat[left])
        n = len(left)
        faces.append((left[ear - 1], left[ear], left[(ear + 1) % n]))
        del left[ear]
    return np.array([*faces, tuple(left)], np.int64)


def _projected(ring: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """(n, 2) along the loop's vector area, so that it runs counter-clockwise."""
    offset = ring - ring.mean(axis=0)
    normal = np.cross(offset, np.roll(offset, -1, axis=0)).sum(axis=0)
    normal /= max(float(np.linalg.norm(normal)), 1e-300)
    across = np.cross(np.eye(3)[np.abs(normal).argmin()], normal)
    across /= max(float(np.linalg.norm(across)), 1e-300)
    return np.asarray(offset @ np.stack([across, np.cross(normal, across)], axis=1))


def _widest_ear(polygon: npt.NDArray[np.float64]) -> int:
    """The convex corner with the shortest diagonal across it that holds no other corner."""
    before, after = np.roll(polygon, 1, axis=0), np.roll(polygon, -1, axis=0)
    turn = _cross(polygon - before, after - polygon)
    order = np.argsort(np.linalg.norm(after - before, axis=1), kind="stable")
    reflex = polygon[turn <= 0.0]
    for corner in order[turn[order] > 0.0]:
        a, b, c = before[corner], polygon[corner], after[corner]
        inside = (
            (_cross(b - a, reflex - a) >= 0.0)
            & (_cross(c - b, reflex - b) >= 0.0)
            & (_cross(a - c, reflex - c) >= 0.0)
        )
        # The ear's own ends may be reflex corners.
        own = (reflex == a).all(axis=1) | (reflex == c).all(axis=1)
        if not (inside & ~own).any():
            return int(corner)
    return int(turn.argmax())  # the projection crosses itself: the sharpest corner will do


def _cross(a: npt.NDArray[np.float64], b: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    return np.asarray(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])
