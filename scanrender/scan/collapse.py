"""Quadric edge collapse in steps; runs inside the child process of `simplify`.

Garland and Heckbert: Surface Simplification Using Quadric Error Metrics, SIGGRAPH 1997, in the
variant of sp4cerat/Fast-Quadric-Mesh-Simplification through the fast-simplification wheel.
In steps, since each run starts with new quadrics of the present triangles: Lindstrom and Turk:
Fast and Memory Efficient Polygonal Simplification, IEEE Visualization 1998, found that forgetting
the original planes follows the shape more closely, and the library is quick on few triangles.

The library knows no weights, but its quadrics are sums over triangles: one that is cut into three
weighs three times as much. So detail (`detail_faces`) keeps more. The trap is the cut: at the
centroid it adds one vertex of valence three, at the edges it would leave holes and folds behind.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from scanrender.scan.curvature import mean_curvature
from scanrender.scan.lost import sample_surface
from scanrender.scan.mend import (
    SAMPLES,
    Reference,
    mended,
    nearest_mm,
    plain_surface,
    surface_tree,
    tidied,
)
from scanrender.scan.neck import close_neck
from scanrender.scan.parallel import run
from scanrender.scan.refit import noise_mm, refitted
from scanrender.scan.surface import Surface
from scanrender.scan.topology import extent, face_areas, span

Array = npt.NDArray[Any]

STEPS = (3.0, 2.0, 1.4, 1.0)  # triangles after each step, in multiples of the target
# From here on two processes collapse a half each: the first step of a million takes two thirds of
# the time of all. Whatever the machine, so that the result is the same on all.
HALVED_FACES = 400_000
FINER = 0.7  # of the triangles stay in each step of the search below the budget
LEAST = 12  # triangles at which that search ends: a box
HARDER = (7.0, 10.0)  # aggressiveness where a gentler collapse comes to less than half of the way
TRIMS = 4  # each costs a collapse of few triangles; the first nearly always does
# The collapse threshold is an absolute squared length: this diagonal makes it that of a head in mm.
DIAGONAL = 500.0
# Detail bends by more than this (1/mm, mean curvature over DETAIL_MM): ears, lids, nostrils, lips.
DETAIL_CURVATURE = 0.05
DETAIL_MM = 2.0
DETAIL_SHARE = 0.25  # of the area at most: where all is detail, nothing is


def collapse_task(
    arrays: dict[str, Any], params: dict[str, Any]
) -> tuple[dict[str, Any], dict[str, Any]]:
    """In the child. Parameters: target, error_mm, aggressiveness (first, others), detail, cap
    (whether the neck will be closed: `close_neck`'s faces are part of the target).

    Returns positions, faces; the report has error_mm (99 % of the distance, the worse direction),
    stop (what ended it: "budget", or, once the error bound is kept, what `_fewer` gives),
    cap_faces, ruined, damage, repaired, flipped, detail.
    """
    raw = plain_surface(arrays["positions"], arrays["faces"])
    reference = Reference(raw)
    first, others = params["aggressiveness"]
    target, bound = int(params["target"]), float(params["error_mm"])
    simple, detail = raw, None
    for step, multiple in enumerate(STEPS):
        count = int(multiple * target)
        if len(simple.faces) <= count:
            continue
        if multiple == STEPS[-1] and params["detail"]:
            simple, detail = weighed(simple)
        reduced = collapsed if len(simple.faces) < HALVED_FACES else collapsed_in_halves
        simple = tidied(*reduced(simple, count, others if step else first))
    if simple is not raw:
        simple = mended(simple.positions, simple.faces)
    error = ErrorOf(reference)
    reached = 0.0 if simple is raw else error(simple, bound)
    stop = "budget"
    if reached <= bound:
        simple, reached, stop = _fewer(simple, reached, bound, error, others)
    else:
        simple, reached = _without_noise(simple, reached, bound, raw, error)
    simple, found = reference.validated(simple)
    cap = _cap_faces(simple, params)
    if len(simple.faces) + cap > target:  # filled holes and the cap come on top
        simple, found, cap = _trimmed(simple, found, cap, reference, params)
        reached, stop = error(simple, bound), "budget"
    report = {"error_mm": reached, "stop": stop, "cap_faces": cap, "detail": detail}
    return {"positions": simple.positions, "faces": simple.faces}, {**report, **found}


def _trimmed(
    simple: Surface, found: dict[str, Any], cap: int, reference: Reference, params: dict[str, Any]
) -> tuple[Surface, dict[str, Any], int]:
    """Within the target where a few more collapses reach it soundly; what `validated` found, and
    the faces of the cap. The rim of the neck, and so its cap, is known only afterwards."""
    for _ in range(TRIMS):
        excess = len(simple.faces) + cap - int(params["target"])
        if excess <= 0:
            break
        count = max(LEAST, len(simple.faces) - excess)
        less = mended(*collapsed(simple, count, params["aggressiveness"][1]))
        less, again = reference.validated(less)
        if len(less.faces) >= len(simple.faces) or again["ruined"]:
            break
        repaired = {key: found["repaired"].get(key, 0) + n for key, n in again["repaired"].items()}
        simple, found, cap = less, {**again, "repaired": repaired}, _cap_faces(less, params)
    return simple, found, cap


def _cap_faces(simple: Surface, params: dict[str, Any]) -> int:
    return close_neck(simple)[1] if params["cap"] else 0


def _fewer(
    simple: Surface, reached: float, bound: float, error: ErrorOf, aggressiveness: float
) -> tuple[Surface, float, str]:
    """The least triangles found that keep the bound, by steps down from what keeps it already; and
    what speaks against fewer: "bound", "ruined", "stalled" (no collapse goes on), or "least"."""
    share, stop = FINER, "least"
    while len(simple.faces) > LEAST:
        fewer = _stepped(simple, max(LEAST, int(share * len(simple.faces))), aggressiveness)
        against, within = _objection(fewer, simple, bound, error)
        if not against:
            simple, reached = fewer, within
        elif share > FINER:
            # That half a step is too small for the collapse says nothing of a whole one.
            return simple, reached, stop if against == "stalled" else against
        else:
            share, stop = np.sqrt(FINER), against  # once more, half as far
    return simple, reached, "least"


def _stepped(simple: Surface, count: int, aggressiveness: float) -> Surface:
    """Collapsed to about `count` faces, by a harder collapse where a gentle one stalls."""
    half_way = 0.5 * (len(simple.faces) + count)
    fewer = mended(*collapsed(simple, count, aggressiveness))
    for harder in HARDER:
        if harder > aggressiveness and len(fewer.faces) > half_way:
            fewer = mended(*collapsed(simple, count, harder))
    return fewer


def _objection(fewer: Surface, simple: Surface, bound: float, error: ErrorOf) -> tuple[str, float]:
    """What speaks against taking `fewer` for `simple`, if anything; and its error in mm."""
    if len(fewer.faces) >= len(simple.faces):
        return "stalled", np.inf
    if not len(fewer.faces):
        return "ruined", np.inf
    within = error(fewer, bound)
    if within > bound:
        return "bound", within
    # The distance alone does not see that a plane shrinks, or that a sheet folds.
    return "ruined" if error.reference.ruined(fewer) else "", within


def _without_noise(
    simple: Surface, reached: float, bound: float, raw: Surface, error: ErrorOf
) -> tuple[Surface, float]:
    """Refitted to the raw points where these scatter by more than the bound, if that is nearer."""
    if noise_mm(raw.positions, raw.faces) <= bound:
        return simple, reached
    moved = refitted(simple.positions, simple.faces, raw.positions, surface_tree(simple))
    nearer = replace(simple, positions=moved)
    within = error(nearer, np.inf)
    return (nearer, within) if within < reached else (simple, reached)


def make_room(faces: int, vertices: int) -> None:
    """Let the library's lists grow to this size. They keep it, and grow by copying themselves to
    fresh memory again and again: half a second of a million faces."""
    import fast_simplification

    if faces >= HALVED_FACES:
        faces, vertices = faces // 2, vertices // 2
    corners = np.zeros((faces, 3), np.int32)
    fast_simplification.simplify(np.zeros((vertices, 3)), corners, target_count=faces)


def collapsed(
    surface: Surface,
    target: int,
    aggressiveness: float,
    keep_border: bool = False,
    scaled: tuple[Array, float] | None = None,
) -> tuple[Array, Array]:
    """One run of the library: positions (n, 3), faces (m, 3) as it leaves them; with `keep_border`
    no edge with an end on the boundary collapses. `scaled` is `_head_sized` of a larger whole.

    It raises when the target exceeds the input, and drops all attributes.
    """
    import fast_simplification

    low, scale = scaled or _head_sized(surface.positions)
    positions, faces = fast_simplification.simplify(
        np.ascontiguousarray((surface.positions - low) * scale, np.float64),
        np.ascontiguousarray(surface.faces, np.int32),
        target_count=min(target, len(surface.faces)),
        agg=float(aggressiveness),
        preserve_border=keep_border,
    )
    return np.asarray(positions, np.float64) / scale + low, np.asarray(faces, np.int64)


def _head_sized(positions: Array) -> tuple[Array, float]:
    """What to subtract from positions, and then to multiply them with, for a diagonal in mm."""
    low, high = extent(positions)
    return low, DIAGONAL / max(float(np.linalg.norm(high - low)), 1e-300)


def collapsed_in_halves(
    surface: Surface, target: int, aggressiveness: float
) -> tuple[Array, Array]:
    """`collapsed` on both sides of a plane across the longest extent, at the same time.

    The vertices that both halves use come first in each and stay, in their order, since they lie on
    the border of both: so the halves fit. What is left too fine there is for the next step.
    """
    corner = surface.positions[surface.faces[:, 0], int(np.argmax(span(surface.positions)))]
    upper = corner > np.median(corner)
    sides = [surface.faces[~upper], surface.faces[upper]]
    if not len(sides[1]):  # most begin at the very top
        return collapsed(surface, target, aggressiveness)
    used = np.zeros((2, len(surface.positions)), bool)
    for mine, faces in zip(used, sides, strict=True):
        mine[faces] = True
    cut = np.flatnonzero(used[0] & used[1])
    scaled = _head_sized(surface.positions)

    def half(faces: Array, mine: Array) -> tuple[Array, Array]:
        source = np.concatenate([cut, np.flatnonzero(mine & ~(used[0] & used[1]))])
        number = np.empty(len(mine), np.int32)
        number[source] = np.arange(len(source), dtype=np.int32)
        count = round(target * len(faces) / len(surface.faces))
        part = plain_surface(surface.positions[source], number[faces])
        return collapsed(part, count, aggressiveness, keep_border=True, scaled=scaled)

    pairs = zip(sides, used, strict=True)
    jobs = [lambda faces=faces, mine=mine: half(faces, mine) for faces, mine in pairs]
    (first, faces), (second, others) = run(jobs)
    shared = len(cut)
    if not np.array_equal(first[:shared], second[:shared]):
        # The library moved what it should keep. Rather slowly than with a gap.
        return collapsed(surface, target, aggressiveness)
    moved = np.where(others < shared, others, others + len(first) - shared)
    return np.concatenate([first, second[shared:]]), np.concatenate([faces, moved])


def weighed(surface: Surface) -> tuple[Surface, dict[str, Any]]:
    """The same shape, with three triangles for each one that is detail; and what share is."""
    detail = detail_faces(surface.positions, surface.faces)
    corners = surface.faces[detail]
    centre = len(surface.positions) + np.arange(len(corners))
    cut = [np.stack([corners[:, k], corners[:, (k + 1) % 3], centre], axis=1) for k in range(3)]
    positions = np.concatenate([surface.positions, surface.positions[corners].mean(axis=1)])
    faces = np.concatenate([surface.faces[~detail], *cut])
    area = face_areas(surface.positions, surface.faces)
    share = float(area[detail].sum() / max(float(area.sum()), 1e-300))
    report = {"area_share": share, "triangle_share_before": float(detail.mean())}
    return plain_surface(positions, faces), report


def detail_faces(positions: Array, faces: Array) -> npt.NDArray[np.bool_]:
    """(m,) the faces whose surround bends strongly, at most DETAIL_SHARE of the area."""
    area = face_areas(positions, faces)
    bend = np.abs(mean_curvature(positions, faces, DETAIL_MM))[faces].max(axis=1)
    order = np.argsort(-bend, kind="stable")
    allowed = np.empty(len(faces), bool)
    allowed[order] = np.cumsum(area[order]) <= DETAIL_SHARE * area.sum()
    return np.asarray((bend > DETAIL_CURVATURE) & allowed)


class ErrorOf:
    """The distance in mm within which 99 % of both surfaces lie from the other, whichever way is
    the worse (Cignoni, Rocchini, Scopigno 1998), by seeded samples."""

    def __init__(self, reference: Reference) -> None:
        self.reference = reference
        self._tree: Any = None

    def __call__(self, simple: Surface, bound: float) -> float:
        """The second way is left out once the first exceeds `bound`: it needs a tree of the raw
        surface, which takes longer to make than all the rest."""
        worst = float(np.percentile(self.reference.distances(simple), 99))
        if worst <= bound:
            raw = self.reference.raw
            self._tree = self._tree or surface_tree(raw)
            points = sample_surface(simple.positions, simple.faces, SAMPLES, 1)
            worst = max(worst, float(np.percentile(nearest_mm(self._tree, raw, points), 99)))
        return worst
