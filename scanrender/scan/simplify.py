"""Fewer triangles by quadric edge collapse, checked afterwards.

Garland and Heckbert: Surface Simplification Using Quadric Error Metrics, SIGGRAPH 1997, in the
variant of sp4cerat/Fast-Quadric-Mesh-Simplification through the fast-simplification wheel. That
library raises when the target exceeds the input, can leave holes and folded triangles, and drops
all attributes; hence a no-op, a validation, a gentler retry, and colours looked up again at bake.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from scanrender.errors import StageError
from scanrender.scan.child import run_task
from scanrender.scan.orient import orient
from scanrender.scan.raw import NO_PAGE
from scanrender.scan.repair import drop_extra_faces, split_vertices
from scanrender.scan.surface import Surface
from scanrender.scan.topology import area_normals, face_areas, face_pairs, unit
from scanrender.scan.weld import drop_degenerate, drop_duplicates

# How fast the collapse threshold grows per sweep. The library's default comes first: 5 takes half
# as long again for a distance that is 4 to 8 % smaller, and may stop above a small target; it is
# for surfaces that 7 damages. 10 reaches targets that 7 does not.
AGGRESSIVENESS = (7.0, 10.0, 5.0)
TOLERANCE = 1.02  # of the budget


def simplify(
    surface: Surface, triangles: int, timeout_s: float
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.int64], dict[str, Any]]:
    """Positions (n, 3) mm, faces (m, 3) with m <= triangles (or all, when already few), report.

    `over_budget` in the report says that the budget could not be reached (boundaries and pieces
    need some triangles). Raises StageError when each variant tried damages the surface.
    """
    if len(surface.faces) <= triangles:
        return surface.positions, surface.faces, {"method": "none: within the budget already"}
    problems: list[str] = []
    best: Surface | None = None
    for aggressiveness in AGGRESSIVENESS:
        arrays = {"positions": surface.positions, "faces": surface.faces}
        params = {"target": triangles, "aggressiveness": aggressiveness}
        result, _ = run_task("simplify", arrays, params, timeout_s)
        simple = _cleaned(result["positions"], result["faces"])
        problem = _problem(surface, simple)
        if problem is None and (best is None or len(simple.faces) < len(best.faces)):
            best = simple
        if problem is None and len(simple.faces) > TOLERANCE * triangles:
            problem = f"{len(simple.faces)} triangles remain"
        if problem is None:
            break
        problems.append(f"aggressiveness {aggressiveness:g}: {problem}")
    if best is None:
        raise StageError(
            f"simplification to {triangles} triangles fails: {'; '.join(problems)}",
            fix="change prep.simplify.triangles, or simplify in the scanning software",
        )
    report = {
        "method": "quadric edge collapse (fast-simplification)",
        "rejected": problems,
        "over_budget": len(best.faces) > TOLERANCE * triangles,
    }
    return best.positions, best.faces, report


def quadric_simplify(
    arrays: dict[str, Any], params: dict[str, Any]
) -> tuple[dict[str, Any], dict[str, Any]]:
    """In the child: one run of the collapse."""
    import fast_simplification

    positions, faces = fast_simplification.simplify(
        np.ascontiguousarray(arrays["positions"], np.float64),
        np.ascontiguousarray(arrays["faces"], np.int32),
        target_count=int(params["target"]),
        agg=float(params["aggressiveness"]),
    )
    return {
        "positions": np.asarray(positions, np.float64),
        "faces": np.asarray(faces, np.int64),
    }, {}


def _cleaned(positions: npt.NDArray[Any], faces: npt.NDArray[Any]) -> Surface:
    """The collapse's own damage undone: folds, doubled faces, non-manifold edges."""
    kept = faces[np.isfinite(positions[faces]).all(axis=(1, 2))]
    page = np.full(len(kept), NO_PAGE, np.int16)
    simple = Surface(np.nan_to_num(positions), kept, None, page, None)
    simple = drop_extra_faces(drop_duplicates(drop_degenerate(simple)))
    simple, _ = orient(split_vertices(simple).compact())
    return simple


def _problem(before: Surface, after: Surface) -> str | None:
    """What is wrong with a simplified surface, or None."""
    if len(after.faces) < min(4, len(before.faces)):
        return "nothing is left"
    area_before = face_areas(before.positions, before.faces).sum()
    area_after = face_areas(after.positions, after.faces).sum()
    if not 0.7 < area_after / max(area_before, 1e-300) < 1.3:
        return f"the area changed by {100 * (area_after / area_before - 1):.0f} %"
    folded = fold_count(after.positions, after.faces)
    if folded > 0.01 * len(after.faces):
        return f"{folded} edges are folded over"
    return None


def fold_count(positions: npt.NDArray[Any], faces: npt.NDArray[Any]) -> int:
    """Edges whose two faces look in opposite directions (more than 150 degrees apart)."""
    first, second, _ = face_pairs(faces)
    normal = unit(area_normals(positions, faces))
    return int((np.einsum("ij,ij->i", normal[first], normal[second]) < -0.866).sum())
