"""Fewer vertices along the borders of charts, the same on both sides of each seam.

Borders are thinned by half-edge collapses, which move nothing, in the order of the triangle that
each takes away: Visvalingam and Whyatt: Line generalisation by repeated elimination of points,
Cartographic Journal 30(1), 1993, in space and in the atlas at once. A place is left alone where
more than two seams meet, and where its removal would turn a triangle over or close a chart.
"""

from __future__ import annotations

import heapq
from collections import defaultdict
from typing import Any

import numpy as np
import numpy.typing as npt

from scanrender.scan.topology import edges_of

Array = npt.NDArray[Any]

TURN = 0.2  # cosine: a triangle's normal may not turn further than this in space


class Seams:
    """positions (n, 3) mm, uv (n, 2), faces (m, 3) split along seams; place (n,) is the same number
    for the vertices that lie at one place."""

    def __init__(self, positions: Array, uv: Array, faces: Array, place: Array) -> None:
        self._positions, self._uv, self._place = positions, uv, place.tolist()
        self._faces: dict[int, list[int]] = dict(enumerate(faces.tolist()))
        self._around: dict[int, set[int]] = defaultdict(set)
        for number, face in self._faces.items():
            for vertex in face:
                self._around[vertex].add(number)
        span = np.linalg.norm(positions[faces[:, 0]] - positions[faces[:, 1]], axis=1).sum()
        across = np.linalg.norm(uv[faces[:, 0]] - uv[faces[:, 1]], axis=1).sum()
        self._mm_per_uv = float(span / max(float(across), 1e-300))
        self._beside: dict[int, list[int]] = defaultdict(list)
        edges = edges_of(faces)
        for a, b in edges.pairs[edges.count == 1].tolist():
            self._beside[a].append(b)
            self._beside[b].append(a)
        self._copies: dict[int, list[int]] = defaultdict(list)
        for vertex in sorted(self._beside):
            self._copies[self._place[vertex]].append(vertex)
        self._stamp: dict[int, int] = defaultdict(int)

    def thinned(self, share: float) -> Array:
        """Faces (k, 3) after all but about `share` of the places along borders that may go are
        gone: were those that stay counted too, a border with many would lose all the others."""
        fixed = sum(not self._ends(place) for place in self._copies)
        goal = fixed + int(share * (len(self._copies) - fixed))
        heap: list[tuple[float, int, int]] = []
        for place in self._copies:
            self._push(heap, place)
        while heap and len(self._copies) > goal:
            _, place, stamp = heapq.heappop(heap)
            if stamp != self._stamp[place] or place not in self._copies:
                continue
            ends = self._ends(place)
            here = self._positions[self._copies[place][0]]
            near = sorted(ends, key=lambda end: float(np.linalg.norm(self._at(end) - here)))
            for end in near:
                if self._merge(place, end):
                    for other in ends:
                        self._push(heap, other)
                    break
        return np.array(list(self._faces.values()), np.int64).reshape(-1, 3)

    def _at(self, place: int) -> Array:
        return np.asarray(self._positions[self._copies[place][0]])

    def _ends(self, place: int) -> list[int]:
        """The two places beside this one along its border, or none where it must stay."""
        found: set[int] | None = None
        for vertex in self._copies[place]:
            beside = {self._place[other] for other in self._beside[vertex]}
            if len(self._beside[vertex]) != 2 or len(beside) != 2 or (found or beside) != beside:
                return []
            found = beside
        return sorted(found or ()) if len(self._copies[place]) <= 2 else []

    def _push(self, heap: list[tuple[float, int, int]], place: int) -> None:
        self._stamp[place] += 1
        ends = self._ends(place)
        if not ends:
            return
        corner = self._at(place)
        u, v = (self._at(end) - corner for end in ends)
        cost = float(np.linalg.norm(np.cross(u, v)))
        for vertex in self._copies[place]:
            a, b = ((self._uv[other] - self._uv[vertex]) * self._mm_per_uv
                    for other in self._beside[vertex])  # fmt: skip
            cost = max(cost, abs(float(a[0] * b[1] - a[1] * b[0])))
        heapq.heappush(heap, (cost, place, self._stamp[place]))

    def _merge(self, place: int, end: int) -> bool:
        """Each vertex at `place` into its neighbour at `end`, if that harms no chart."""
        pairs = []
        for vertex in self._copies[place]:
            target = next(o for o in self._beside[vertex] if self._place[o] == end)
            if not self._may_merge(vertex, target):
                return False
            pairs.append((vertex, target))
        for vertex, target in pairs:
            for number in list(self._around[vertex]):
                face = self._faces[number]
                if target in face:
                    for corner in face:
                        self._around[corner].discard(number)
                    del self._faces[number]
                else:
                    self._faces[number] = [target if c == vertex else c for c in face]
                    self._around[target].add(number)
            del self._around[vertex]
            far = next(o for o in self._beside[vertex] if o != target)
            for here, there in ((target, far), (far, target)):
                self._beside[here] = [there if o == vertex else o for o in self._beside[here]]
            del self._beside[vertex]
        del self._copies[place]
        return True

    def _may_merge(self, vertex: int, target: int) -> bool:
        rings = [
            {corner for number in self._around[v] for corner in self._faces[number]} - {v}
            for v in (vertex, target)
        ]
        # A border edge has one face, whose third corner is all that its ends may share.
        if len(rings[0] & rings[1]) != 1:
            return False
        for number in self._around[vertex]:
            before = self._faces[number]
            if target not in before and not self._keeps_side(before, vertex, target):
                return False
        return True

    def _keeps_side(self, before: list[int], vertex: int, target: int) -> bool:
        after = [target if corner == vertex else corner for corner in before]
        flat = [_area(*self._uv[face]) for face in (before, after)]
        if flat[0] * flat[1] <= 0.0 or abs(flat[1]) < 1e-3 * abs(flat[0]):
            return False
        old, new = (_normal(*self._positions[face]) for face in (before, after))
        return float(old @ new) > TURN * float(np.linalg.norm(old) * np.linalg.norm(new))


def _area(a: Array, b: Array, c: Array) -> float:
    return float((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]))


def _normal(a: Array, b: Array, c: Array) -> Array:
    (x, y, z), (u, v, w) = b - a, c - a
    return np.array([y * w - z * v, z * u - x * w, x * v - y * u])
