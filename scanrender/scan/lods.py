"""Coarser meshes that share the atlas of the first one. Runs inside a child process.

Each chart keeps its outline, thinned alike on both sides of a seam (`seams`), so that charts still
meet; inside, triangles collapse as in `collapse`, and each vertex takes the texture coordinates,
normal and tangent of the nearest point of the same chart of the first mesh. So a texel is found at
the same place of the skin, and its tangent space is the one that the normal map was baked in.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from scipy import sparse

from scanrender.errors import ScanrenderError
from scanrender.scan.collapse import collapsed
from scanrender.scan.flatten import signed_areas
from scanrender.scan.lost import sample_hits
from scanrender.scan.mend import drop_pockets, plain_surface
from scanrender.scan.rays import Target, barycentric
from scanrender.scan.seams import Seams
from scanrender.scan.topology import components, edges_of

Array = npt.NDArray[Any]

AGGRESSIVENESS = (5.0, 7.0, 10.0)
TOLERANCE = 1.05  # of the budget
SAME = 1e-6  # of the extent: closer vertices are one place
FINER_BORDERS = (1.0, 1.5, 2.0)  # times the share of the border's points that should be enough
# How inner corners of triangles that lie upside down are moved, gentlest first.
# A sweep to the mean takes that many rings of faces along; None stands for the widest place.
SWEEPS = (0,) * 10 + (None,) * 6 + (1,) * 10 + (None,) * 6 + (3,) * 40 + (None,) * 6
MOST_MOVED = 100
SLIDE_SAMPLES = 10_000
FIELDS = ("normals", "tangents", "uv")
# What is raised of a mesh that cannot be taken, here or in a library; anything else is a bug.
UNSOUND = (ScanrenderError, ValueError, ArithmeticError, LookupError, RuntimeError)


def lods_task(
    arrays: dict[str, Any], params: dict[str, Any]
) -> tuple[dict[str, Any], dict[str, Any]]:
    """In the child: positions_mm, normals, tangents, uv, faces of the first mesh, and `targets`.

    Returns the same arrays for each level that came out sound, with its number in front. The report
    has `problems`, a sentence for each that did not, and `slide_mm`, by number: 99 % of the surface
    finds its texel within this distance of where the first mesh has it.
    """
    first = {key: np.asarray(arrays[key], np.float64) for key in ("positions_mm", *FIELDS)}
    faces = np.asarray(arrays["faces"], np.int64)
    result: dict[str, Any] = {}
    problems: list[str] = []
    slide: dict[str, float] = {}
    for number, target in enumerate(params["targets"], 1):
        try:
            level, problem = coarser(first, faces, int(target))
        except UNSOUND as error:  # the other levels may be sound
            problem = f"{type(error).__name__}: {error}"
        if problem is None:
            result.update({f"{number}_{key}": value for key, value in level.items()})
            slide[str(number)] = _slide_mm(first, faces, level)
        else:
            problems.append(f"{target} triangles: {problem}")
    return result, {"problems": problems, "slide_mm": slide}


def coarser(
    first: dict[str, Array], faces: Array, target: int
) -> tuple[dict[str, Array], str | None]:
    """One level of about `target` triangles; or what is wrong with each that was tried."""
    problems: dict[str, None] = {}
    # A border is a line: its points become fewer by the root of what the area's do.
    share = float(np.sqrt(target / len(faces)))
    for finer in FINER_BORDERS:
        level, problem = _coarser(first, faces, target, min(1.0, finer * share))
        if problem is None:
            return level, None
        problems[problem] = None
    return {}, "; ".join(problems)


def _coarser(
    first: dict[str, Array], faces: Array, target: int, share: float
) -> tuple[dict[str, Array], str | None]:
    positions, uv = first["positions_mm"], first["uv"]
    place = _places(positions)
    thin = Seams(positions, uv, faces, place).thinned(share)
    used, inverse = np.unique(thin, return_inverse=True)
    split = plain_surface(positions[used], inverse.reshape(-1, 3))
    for aggressiveness in AGGRESSIVENESS:
        points, corners = collapsed(split, target, aggressiveness, keep_border=True)
        sound = drop_pockets(plain_surface(points, corners)).compact()
        points, corners = sound.positions, sound.faces
        if len(corners) <= TOLERANCE * target:
            break
    else:
        return {}, f"{len(corners)} remain, since the charts' outlines need some"
    border = _border_of(split.positions, split.faces)
    origin = _origins(points, corners, split.positions[border], used[border], place)
    if origin is None:
        return {}, "the charts' outlines are not as they were"
    count, chart = components(faces, len(uv))
    chart_of = _charts_of(points, corners, origin, positions, faces)
    level = _carried(points, corners, origin, chart_of, first, faces)
    # Charts of an atlas as it was given may be mirrored.
    side = np.sign(np.bincount(chart, signed_areas(uv, faces), count))
    flipped = _unflipped(level["uv"], corners, origin < 0, side[chart_of])
    if flipped:
        return {}, f"{flipped} triangles lie upside down in the atlas"
    return {**level, "faces": corners}, None


def _slide_mm(first: dict[str, Array], faces: Array, level: dict[str, Array]) -> float:
    hits = sample_hits(level["positions_mm"], level["faces"], SLIDE_SAMPLES, 4)
    corners = level["faces"][hits.face]
    here = np.einsum("kc,kcd->kd", hits.bary, level["positions_mm"][corners])
    at = np.einsum("kc,kcd->kd", hits.bary, level["uv"][corners])
    atlas = np.pad(first["uv"], ((0, 0), (0, 1)))
    near = Target(atlas, faces).nearest(np.pad(at, ((0, 0), (0, 1))))
    there = np.einsum("kc,kcd->kd", near.bary, first["positions_mm"][faces[near.face]])
    return float(np.percentile(np.linalg.norm(here - there, axis=1), 99))


def _places(positions: Array) -> Array:
    """(n,) the same number for vertices at the same place, as a split along seams leaves them."""
    _, place = np.unique(positions.astype(np.float32), axis=0, return_inverse=True)
    return np.asarray(place.reshape(-1))


def _border_of(positions: Array, faces: Array) -> Array:
    edges = edges_of(faces)
    mask = np.zeros(len(positions), bool)
    mask[edges.pairs[edges.count == 1]] = True
    return np.flatnonzero(mask)


def _origins(
    points: Array, faces: Array, border: Array, border_vertex: Array, place: Array
) -> Array | None:
    """(k,) which vertex of the first mesh each border vertex is, -1 inside; None if they differ.

    The collapse keeps the order of vertices and does not touch borders; so where the two sides of a
    seam lie at one place, they come in the order in which they went in.
    """
    from scipy.spatial import cKDTree

    span = float(np.linalg.norm(np.ptp(points, axis=0)))
    distance, nearest = cKDTree(border).query(points)
    mine = np.flatnonzero(distance < SAME * span)
    if len(mine) != len(border):
        return None
    at = place[border_vertex]
    origin = np.full(len(points), -1)
    came_out = mine[np.lexsort((mine, at[nearest[mine]]))]
    went_in = np.lexsort((np.arange(len(border)), at))
    if (at[nearest[came_out]] != at[went_in]).any():
        return None
    origin[came_out] = border_vertex[went_in]
    same = np.array_equal(np.flatnonzero(origin >= 0), _border_of(points, faces))
    return origin if same else None


def _charts_of(
    points: Array, corners: Array, origin: Array, positions: Array, faces: Array
) -> Array:
    """(k,) the chart of the first mesh that each face lies on: the one whose border it has, or the
    nearest other one where there is no border."""
    import igl

    _, old = components(faces, len(positions))
    count, new = components(corners, len(points))
    known = origin[corners] >= 0
    old_of = np.zeros(len(positions), np.int64)
    old_of[faces] = old[:, None]
    chart_of = np.full(count, -1)
    chart_of[np.repeat(new, 3)[known.ravel()]] = old_of[origin[corners[known]]]
    closed, first = np.unique(new, return_index=True)
    closed, first = closed[chart_of < 0], first[chart_of < 0]
    if len(closed):
        left = ~np.isin(old, chart_of)
        start = points[corners[first, 0]]
        _, near, _ = igl.point_mesh_squared_distance(start, positions, faces[left])
        chart_of[closed] = old[left][near]
    return np.asarray(chart_of[new])


def _carried(
    points: Array,
    corners: Array,
    origin: Array,
    chart_of: Array,
    first: dict[str, Array],
    faces: Array,
) -> dict[str, Array]:
    """Values of the first mesh: of the same vertex on borders, of the nearest point of the same
    chart inside."""
    import igl

    known = origin >= 0
    level = {"positions_mm": points.copy()}
    level["positions_mm"][known] = first["positions_mm"][origin[known]]
    for key in FIELDS:
        level[key] = np.zeros((len(points), first[key].shape[1]))
        level[key][known] = first[key][origin[known]]
    _, old = components(faces, len(first["uv"]))
    new_of = np.full(len(points), -1)
    new_of[corners] = chart_of[:, None]
    for chart in np.unique(chart_of):
        inner = np.flatnonzero((new_of == chart) & ~known)
        if not len(inner):
            continue
        mine = faces[old == chart]
        _, face, closest = igl.point_mesh_squared_distance(
            points[inner], first["positions_mm"], mine
        )
        hit = mine[face]
        bary = barycentric(np.asarray(closest), first["positions_mm"][hit]).astype(np.float64)
        for key in FIELDS:
            level[key][inner] = np.einsum("kc,kcd->kd", bary, first[key][hit])
    return _orthonormal(level)


def _orthonormal(level: dict[str, Array]) -> dict[str, Array]:
    normal = level["normals"]
    normal = normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    tangent = level["tangents"][:, :3]
    tangent = tangent - np.einsum("ij,ij->i", tangent, normal)[:, None] * normal
    tangent /= np.maximum(np.linalg.norm(tangent, axis=1, keepdims=True), 1e-12)
    side = np.where(level["tangents"][:, 3:] < 0.0, -1.0, 1.0)
    return {**level, "normals": normal, "tangents": np.concatenate([tangent, side], axis=1)}


def _unflipped(uv: Array, faces: Array, inner: Array, side: Array) -> int:
    """Move the inner corners of triangles that lie upside down, in place, until none does; how many
    such triangles stay. To their neighbours' mean, or to where their ring is widest. The upper side
    of each is in `side` (m,): 1, -1, or 0 in a chart without area, where none can turn over."""
    edges = edges_of(faces).pairs
    ones = np.ones(2 * len(edges))
    ends = np.concatenate([edges, edges[:, ::-1]])
    around = sparse.coo_matrix((ones, ends.T), shape=(len(uv), len(uv))).tocsr()
    degree = np.maximum(np.asarray(around.sum(axis=1)), 1.0)
    for rings in SWEEPS:
        wrong = _upside_down(uv, faces, side)
        if not len(wrong):
            return 0
        corners = np.unique(faces[wrong])
        for _ in range(rings or 0):  # tangles are of several triangles
            corners = np.unique(faces[np.isin(faces, corners).any(axis=1)])
        corners = corners[inner[corners]]
        if rings is not None:
            uv[corners] = (around[corners] @ uv) / degree[corners]
            continue
        for corner in corners[:MOST_MOVED]:
            ring = np.flatnonzero((faces == corner).any(axis=1))
            uv[corner] = _widest(uv, faces[ring], corner, float(side[ring[0]]))
    return len(_upside_down(uv, faces, side))


def _upside_down(uv: Array, faces: Array, side: Array) -> Array:
    return np.flatnonzero((side * signed_areas(uv, faces) <= 0.0) & (side != 0.0))


def _widest(uv: Array, ring: Array, vertex: int, side: float) -> Array:
    """Where the least area of the triangles in `ring` around a vertex is largest: a linear
    programme in the place (2) and that area, since a triangle's area is linear in one corner."""
    from scipy.optimize import linprog

    turned = np.stack([np.roll(face, -int(np.argmax(face == vertex))) for face in ring])
    b, c = uv[turned[:, 1]], uv[turned[:, 2]]
    low, high = np.minimum(b, c).min(axis=0), np.maximum(b, c).max(axis=0)
    size = max(float(np.ptp([low, high])), 1e-12)
    b, c = (b - low) / size, (c - low) / size
    # Twice the signed area of (x, b, c) is cross(b, c) - cross(x, c) + cross(x, b).
    constant = side * (b[:, 0] * c[:, 1] - b[:, 1] * c[:, 0])
    slope = side * np.stack([b[:, 1] - c[:, 1], c[:, 0] - b[:, 0]], axis=1)
    found = linprog(
        [0.0, 0.0, -1.0],
        A_ub=np.concatenate([-slope, np.ones((len(slope), 1))], axis=1),
        b_ub=constant,
        bounds=[(0.0, 1.0), (0.0, 1.0), (None, None)],
    )
    return np.asarray(low + size * found.x[:2] if found.success else uv[vertex])
