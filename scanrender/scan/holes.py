"""Close small holes.

Barequet and Sharir: Filling gaps in the boundary of a polyhedron, CAGD 12(2), 1995 (least-area
triangulation of a loop by dynamic programming); long loops get a fan around their mean instead.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from scanrender.scan.surface import Surface
from scanrender.scan.topology import boundary_loops, edges_of

# The dynamic programme takes n^3 / 6 steps: past this a fan around the middle is used.
LEAST_AREA_LIMIT = 32


def fill_holes(surface: Surface, diameter: float) -> tuple[Surface, int]:
    """Close loops that fit in a circle of `diameter` (the unit of positions); returns how many.

    New faces carry no texture page: the bake takes their colour from the rim.
    """
    new_faces: list[npt.NDArray[np.int64]] = []
    new_points: list[npt.NDArray[np.float64]] = []
    filled = 0
    for loop in boundary_loops(surface.faces):
        ring = surface.positions[loop]
        middle = ring.mean(axis=0)
        if 2.0 * np.linalg.norm(ring - middle, axis=1).max() > diameter:
            continue
        if len(loop) <= LEAST_AREA_LIMIT:
            new_faces.append(loop[least_area(ring)])
        else:
            hub = np.full(len(loop), len(surface.positions) + len(new_points))
            new_points.append(middle)
            new_faces.append(np.stack([loop, np.roll(loop, -1), hub], axis=1))
        filled += 1
    if not filled:
        return surface, 0
    before = len(surface.faces)
    points = np.array(new_points) if new_points else None
    closed = surface.add_faces(np.concatenate(new_faces), points)
    # A filling may run along an edge that exists already: then it made things worse, not better.
    edges = edges_of(closed.faces)
    crowded = np.asarray((edges.count > 2)[edges.half].reshape(3, -1).any(axis=0))
    crowded[:before] = False
    return (closed.keep_faces(~crowded) if crowded.any() else closed), filled


def least_area(ring: npt.NDArray[np.float64]) -> npt.NDArray[np.int64]:
    """The triangulation (n - 2, 3) of a loop (n, 3) with the least total area."""
    n = len(ring)
    cost = np.zeros((n, n))
    split = np.zeros((n, n), np.int64)
    for gap in range(2, n):
        for i in range(n - gap):
            j = i + gap
            between = np.arange(i + 1, j)
            area = np.linalg.norm(np.cross(ring[between] - ring[i], ring[j] - ring[i]), axis=1)
            total = cost[i, between] + cost[between, j] + area
            best = int(total.argmin())
            cost[i, j], split[i, j] = total[best], between[best]
    faces = []
    stack = [(0, n - 1)]
    while stack:
        i, j = stack.pop()
        if j - i >= 2:
            k = int(split[i, j])
            faces.append((i, k, j))
            stack += [(i, k), (k, j)]
    return np.array(faces, np.int64)
