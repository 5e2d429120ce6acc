"""What an edge collapse breaks: found, repaired where that is safe, reported where it is not."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
from scipy import sparse
from scipy.sparse import csgraph

from scanrender.scan.holes import least_area
from scanrender.scan.orient import orient
from scanrender.scan.raw import NO_PAGE
from scanrender.scan.repair import drop_extra_faces, split_vertices
from scanrender.scan.surface import Surface
from scanrender.scan.topology import (
    area_normals,
    boundary_loops,
    components,
    edges_of,
    face_areas,
    face_pairs,
    unit,
)
from scanrender.scan.weld import drop_degenerate, drop_duplicates

if TYPE_CHECKING:  # the preparation loads it beside reading the scan
    from scipy.spatial import cKDTree

Array = npt.NDArray[Any]

AREA_CHANGE = 0.3
FOLDED_SHARE = 0.01  # of the faces may have an edge folded over
FLIPPED_SHARE = 2e-4  # of the faces may look the wrong way before a gentler attempt is made
NORMALS_PER_FACE = 4  # raw normals kept for each face to compare with
NEAREST = 6  # of them are asked: beside a crease the very nearest may lie on its other side
NEW_HOLE_EDGES = 16  # a collapse opens holes of three or four edges
MANY_LOOPS = 40  # from here on the whole raw boundary is looked up instead of each surrounding
UNFOLD_ROUNDS = 4
# A piece that the collapse may not lose is larger than this share of the largest.
PIECE_SHARE = 1e-3
PIECE_SAMPLES = 16
OUTLIER = 30.0  # times the median distance: the largest of a sound collapse is half of that
SAMPLES = 10_000
FACES_PER_SAMPLE = 20  # of the raw surface are weighed by their area; a million take too long


def plain_surface(positions: Array, faces: Array) -> Surface:
    """Geometry alone."""
    return Surface(positions, faces, None, np.full(len(faces), NO_PAGE, np.int16), None)


def tidied(positions: Array, faces: Array) -> Surface:
    """Without what would mislead another collapse: broken, empty, doubled and crowding faces."""
    kept = faces[np.isfinite(positions[faces]).all(axis=(1, 2))]
    simple = plain_surface(np.nan_to_num(positions), kept)
    simple = drop_pockets(drop_degenerate(simple))
    return drop_extra_faces(drop_duplicates(simple)).compact()


def drop_pockets(surface: Surface) -> Surface:
    """Without closed bubbles that hang from the rest by an edge or a vertex.

    A collapse makes them where it joins the two ends of a narrow neck. In a group of faces that
    hang together by vertices only the largest part that hangs together by edges may be closed.
    """
    faces = surface.faces
    edges = edges_of(faces)
    first, second, _ = face_pairs(faces, edges)
    ones = np.ones(len(first), np.int8)
    graph = sparse.coo_matrix((ones, (first, second)), shape=(len(faces), len(faces)))
    parts, part = csgraph.connected_components(graph, directed=False)
    count, group = components(faces, len(surface.positions))
    if parts == count:
        return surface
    area = np.bincount(part, face_areas(surface.positions, faces), minlength=parts)
    is_open = np.zeros(parts, bool)
    is_open[np.tile(part, 3)[edges.count[edges.half] == 1]] = True
    of_part = np.zeros(parts, np.int64)
    of_part[part] = group
    order = np.lexsort((-area, of_part))
    largest = np.zeros(parts, bool)
    largest[order[np.unique(of_part[order], return_index=True)[1]]] = True
    return surface.keep_faces((is_open | largest)[part])


def mended(positions: Array, faces: Array) -> Surface:
    """The collapse's own damage undone; manifold, and wound consistently."""
    simple, _ = orient(split_vertices(tidied(positions, faces)).compact())
    return simple


def fold_count(positions: Array, faces: Array) -> int:
    """Edges whose two faces look in opposite directions (more than 150 degrees apart)."""
    first, second, _ = face_pairs(faces)
    normal = unit(area_normals(positions, faces))
    return int((np.einsum("ij,ij->i", normal[first], normal[second]) < -0.866).sum())


def surface_tree(surface: Surface) -> Any:
    """libigl's tree for `nearest_mm`; a second for a million faces."""
    import igl

    tree = igl.AABB()
    tree.init(surface.positions, surface.faces)
    return tree


def nearest_mm(tree: Any, surface: Surface, points: Array) -> Array:
    """(k,) distances of points (k, 3) from a surface."""
    squared, _, _ = tree.squared_distance(surface.positions, surface.faces, points)
    return np.asarray(np.sqrt(np.maximum(squared, 0.0)))


class Reference:
    """The surface before the collapse, to compare with."""

    def __init__(self, raw: Surface) -> None:
        self.raw = raw

    @cached_property
    def _chosen(self) -> tuple[Array, Array]:
        """Some raw faces (k, 3), all alike likely, and the sums of their areas up to each."""
        faces, count = self.raw.faces, FACES_PER_SAMPLE * SAMPLES
        if len(faces) > count:
            faces = faces[np.random.default_rng(1).integers(len(faces), size=count)]
        return faces, np.cumsum(face_areas(self.raw.positions, faces))

    @property
    def area(self) -> float:
        """mm^2, from the chosen faces."""
        faces, passed = self._chosen
        return float(passed[-1]) * len(self.raw.faces) / len(faces)

    @cached_property
    def points(self) -> Array:
        """(SAMPLES, 3) spread evenly by area over the raw surface."""
        rng = np.random.default_rng(2)
        faces, passed = self._chosen
        # Rounding may place a number at the very end.
        at = np.searchsorted(passed, rng.random(SAMPLES) * passed[-1])
        chosen = faces[np.minimum(at, len(faces) - 1)]
        r, s = np.sqrt(rng.random(SAMPLES)), rng.random(SAMPLES)
        bary = np.stack([1.0 - r, r * (1.0 - s), r * s], axis=1)
        return np.asarray(np.einsum("kc,kcd->kd", bary, self.raw.positions[chosen]))

    def distances(self, simple: Surface) -> Array:
        """(SAMPLES,) mm from `points` to a simplified surface."""
        return nearest_mm(surface_tree(simple), simple, self.points)

    def validated(self, simple: Surface) -> tuple[Surface, dict[str, Any]]:
        """Repaired where possible; `ruined` and `damage` are sentences, `repaired` counts, and
        `flipped` the faces that look the wrong way at last."""
        if simple is self.raw:
            return simple, {"ruined": [], "damage": [], "repaired": {}, "flipped": 0}
        simple, filled = self._without_new_holes(simple)
        simple, before, flipped = self._turned_back(simple)
        found = {
            "ruined": self.ruined(simple),
            "damage": self._damage(simple, flipped),
            "repaired": {"holes": filled, "flipped_faces": before - flipped},
            "flipped": flipped,
        }
        return simple, found

    def ruined(self, simple: Surface) -> list[str]:
        """Why this is no likeness of the raw surface, in sentences."""
        raw, sentences = self.raw, []
        if len(simple.faces) < min(4, len(raw.faces)):
            return ["nothing is left"]
        before = self.area
        after = face_areas(simple.positions, simple.faces).sum()
        change = after / max(before, 1e-300) - 1.0
        if abs(change) > AREA_CHANGE:
            sentences.append(f"the area changed by {100 * change:.0f} %")
        folded = fold_count(simple.positions, simple.faces)
        if folded > FOLDED_SHARE * len(simple.faces):
            sentences.append(f"{folded} edges are folded over")
        return sentences

    def _damage(self, simple: Surface, flipped: int) -> list[str]:
        sentences = []
        crowded = int((edges_of(simple.faces).count > 2).sum())
        if crowded:
            sentences.append(f"{crowded} edges have more than two faces")
        lost = self._lost_pieces(simple)
        if lost:
            sentences.append(f"{lost} pieces of the surface are gone")
        holes = len(self._new_loops(simple))
        if holes:
            sentences.append(f"{holes} new holes")
        if flipped > FLIPPED_SHARE * len(simple.faces):
            sentences.append(f"{flipped} faces look the wrong way")
        return sentences

    def _new_loops(self, simple: Surface) -> list[Array]:
        """Short boundary loops that lie apart from each boundary of the raw surface."""
        loops = [loop for loop in boundary_loops(simple.faces) if len(loop) <= NEW_HOLE_EDGES]
        rings = [simple.positions[loop] for loop in loops]
        near = (
            self._near_borders(rings)
            if len(rings) > MANY_LOOPS
            else map(self._has_border_near, rings)
        )
        return [loop for loop, is_near in zip(loops, near, strict=True) if not is_near]

    def _near_borders(self, rings: list[Array]) -> list[bool]:
        """`_has_border_near` for all of them at once: a shattered scan has 10^5."""
        if self._border_tree is None:
            return [False] * len(rings)
        sizes = np.array([len(ring) for ring in rings])
        start = np.cumsum(sizes) - sizes
        away = self._border_tree.query(np.concatenate(rings))[0]
        side = [np.linalg.norm(ring - np.roll(ring, 1, axis=0), axis=1).mean() for ring in rings]
        return [bool(x) for x in np.minimum.reduceat(away, start) <= np.array(side)]

    @cached_property
    def _border_tree(self) -> cKDTree | None:
        """The raw surface's boundary vertices."""
        from scipy.spatial import cKDTree

        edges = edges_of(self.raw.faces)
        border = np.unique(edges.pairs[edges.count == 1])
        return cKDTree(self.raw.positions[border]) if len(border) else None

    def _has_border_near(self, ring: Array) -> bool:
        """Whether the raw surface has a boundary within a side's length of the box around a loop.

        Only the faces there are looked at: each of them for each vertex in the box, so that an edge
        with an end in it is counted rightly.
        """
        raw = self.raw
        side = np.linalg.norm(ring - np.roll(ring, 1, axis=0), axis=1).mean()
        low, high = ring.min(axis=0) - side, ring.max(axis=0) + side
        inside = ((raw.positions >= low) & (raw.positions <= high)).all(axis=1)
        edges = edges_of(raw.faces[inside[raw.faces].any(axis=1)])
        return bool(inside[edges.pairs[edges.count == 1]].any())

    def _without_new_holes(self, simple: Surface) -> tuple[Surface, int]:
        """Filled, or drawn together where a filling would run along an edge of two faces."""
        loops = self._new_loops(simple)
        before = len(loops)
        for close in (_filled, _drawn_together):
            if loops:
                closed = close(simple, loops)
                left = self._new_loops(closed)
                if len(left) < len(loops):
                    simple, loops = closed, left
        return simple, before - len(loops)

    def _lost_pieces(self, simple: Surface) -> int:
        """Pieces of the raw surface, crumbs aside, near which nothing is left."""
        from scipy.spatial import cKDTree

        raw, away = self.raw, self.distances(simple)
        if away.max() <= OUTLIER * np.median(away):
            return 0  # each piece has samples
        count, piece = components(raw.faces, len(raw.positions))
        if count == 1 or components(simple.faces, len(simple.positions))[0] >= count:
            return 0
        area = np.bincount(piece, face_areas(raw.positions, raw.faces), minlength=count)
        # All pieces at once, their faces one after the other: a shattered scan has 10^5.
        order = np.argsort(piece, kind="stable")
        start = np.searchsorted(piece[order], np.arange(count))
        corners = raw.positions[raw.faces[order]]
        low = np.minimum.reduceat(corners.min(axis=1), start)
        high = np.maximum.reduceat(corners.max(axis=1), start)
        reach = 0.5 * np.linalg.norm(high - low, axis=1)
        place = np.arange(len(order)) - np.repeat(start, np.diff(start, append=len(order)))
        every = np.maximum(np.bincount(piece) // PIECE_SAMPLES, 1)
        some = np.flatnonzero(place % every[piece[order]] == 0)
        tree = cKDTree(simple.positions[np.unique(simple.faces)])
        nearest = np.full(count, np.inf)
        np.minimum.at(nearest, piece[order][some], tree.query(corners[some, 0])[0])
        return int(((nearest > reach) & (area >= PIECE_SHARE * area.max())).sum())

    def _turned_back(self, simple: Surface) -> tuple[Surface, int, int]:
        """Vertices of faces that look the wrong way are drawn to their neighbours' mean, as long as
        that helps. Returns the surface and the number of such faces before and after."""
        normals = self._normals(len(simple.faces))
        wrong = _wrong_way(simple, np.arange(len(simple.faces)), *normals)
        before = len(wrong)
        for _ in range(UNFOLD_ROUNDS):
            if not len(wrong):
                break
            moved = np.unique(simple.faces[wrong])
            calmer = _calmed(simple, moved)
            # Faces that keep their corners keep their answer: the right way.
            touched = np.flatnonzero(np.isin(simple.faces, moved).any(axis=1))
            still = _wrong_way(calmer, touched, *normals)
            if len(still) >= len(wrong):
                break
            simple, wrong = calmer, still
        return simple, before, len(wrong)

    def _normals(self, count: int) -> tuple[cKDTree, Array]:
        """Evenly chosen raw faces: a tree of their centres, and their unit normals."""
        from scipy.spatial import cKDTree

        raw = self.raw
        some = raw.faces[:: max(1, len(raw.faces) // (NORMALS_PER_FACE * count))]
        normal = unit(area_normals(raw.positions, some))
        return cKDTree(raw.positions[some].mean(axis=1)), normal


def _filled(simple: Surface, loops: list[Array]) -> Surface:
    faces = [simple.faces, *(loop[least_area(simple.positions[loop])] for loop in loops)]
    return mended(simple.positions, np.concatenate(faces))


def _drawn_together(simple: Surface, loops: list[Array]) -> Surface:
    """Each loop becomes one vertex, unless it is as large as the triangles around it."""
    edges = edges_of(simple.faces).pairs
    ends = simple.positions[edges]
    typical = float(np.median(np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1)))
    positions, target = simple.positions.copy(), np.arange(len(simple.positions))
    for loop in loops:
        if np.linalg.norm(np.ptp(simple.positions[loop], axis=0)) < typical:
            target[loop] = loop[0]
            positions[loop[0]] = simple.positions[loop].mean(axis=0)
    return mended(positions, target[simple.faces])


def _wrong_way(simple: Surface, asked: Array, tree: cKDTree, normals: Array) -> Array:
    """Those of the asked faces (k,) whose normal opposes that of each raw face nearby."""
    faces = simple.faces[asked]
    centre = simple.positions[faces].mean(axis=1)
    normal = unit(area_normals(simple.positions, faces))
    near = tree.query(centre, min(NEAREST, len(normals)))[1].reshape(len(centre), -1)
    agree = np.einsum("ijk,ik->ij", normals[near], normal).max(axis=1)
    return np.asarray(asked[agree < 0.0])


def _calmed(simple: Surface, vertices: Array) -> Surface:
    """With these vertices at their neighbours' mean."""
    pairs = edges_of(simple.faces).pairs
    here = np.concatenate([pairs[:, 0], pairs[:, 1]])
    there = np.concatenate([pairs[:, 1], pairs[:, 0]])
    chosen = np.isin(here, vertices)
    slot = np.searchsorted(vertices, here[chosen])
    total = np.zeros((len(vertices), 3))
    np.add.at(total, slot, simple.positions[there[chosen]])
    positions = simple.positions.copy()
    positions[vertices] = total / np.bincount(slot, minlength=len(vertices))[:, None]
    return replace(simple, positions=positions)
