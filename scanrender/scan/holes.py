"""Close small holes.

Barequet and Sharir: Filling gaps in the boundary of a polyhedron, CAGD 12(2), 1995 (least-area
triangulation of a loop by dynamic programming); long loops get a fan around their mean instead.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from scanrender.scan.surface import Surface
from scanrender.scan.topology import boundary_loops, components, edges_of

# The dynamic programme takes n^3 / 6 steps: past this a fan around the middle is used.
LEAST_AREA_LIMIT = 32
RIM = 1.5  # a piece less than this much larger than its loop is a flake, the loop its rim


def fill_holes(surface: Surface, diameter: float) -> tuple[Surface, int]:
    """Close loops that fit in a circle of `diameter` (the unit of positions); returns how many.

    New faces carry no texture page: the bake takes their colour from the rim.
    """
    new_faces: list[npt.NDArray[np.int64]] = []
    new_points: list[npt.NDArray[np.float64]] = []
    loops = boundary_loops(surface.faces)
    if not loops:
        return surface, 0
    for number in np.flatnonzero(_are_holes(surface, loops, diameter)):
        loop = loops[number]
        ring = surface.positions[loop]
        if len(loop) <= LEAST_AREA_LIMIT:
            new_faces.append(loop[least_area(ring)])
        else:
            hub = np.full(len(loop), len(surface.positions) + len(new_points))
            new_points.append(ring.mean(axis=0))
            new_faces.append(np.stack([loop, np.roll(loop, -1), hub], axis=1))
    filled = len(new_faces)
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


def _are_holes(
    surface: Surface, loops: list[npt.NDArray[np.int64]], diameter: float
) -> npt.NDArray[np.bool_]:
    """Which loops fit in the circle and are not the outer rim of a loose flake; all at once, since
    a shattered scan has 10^5 of them."""
    sizes = np.array([len(loop) for loop in loops])
    start, of = np.cumsum(sizes) - sizes, np.repeat(np.arange(len(loops)), sizes)
    flat = np.concatenate(loops)
    ring = surface.positions[flat]
    middle = np.add.reduceat(ring, start) / sizes[:, None]
    reach = np.maximum.reduceat(np.linalg.norm(ring - middle[of], axis=1), start)
    box = np.maximum.reduceat(ring, start) - np.minimum.reduceat(ring, start)
    piece_size = _piece_size(surface)[flat[start]]
    is_rim = piece_size < RIM * np.linalg.norm(box, axis=1)
    return np.asarray((2.0 * reach <= diameter) & ~is_rim)


def _piece_size(surface: Surface) -> npt.NDArray[np.float64]:
    """For each vertex, the diagonal of the box around the connected piece it belongs to."""
    count, piece = components(surface.faces, len(surface.positions))
    order = np.argsort(piece, kind="stable")
    start = np.searchsorted(piece[order], np.arange(count))
    corners = surface.positions[surface.faces[order]]
    high = np.maximum.reduceat(corners.max(axis=1), start)
    low = np.minimum.reduceat(corners.min(axis=1), start)
    size = np.zeros(len(surface.positions))
    size[surface.faces] = np.linalg.norm(high - low, axis=1)[piece][:, None]
    return size


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
