"""Fewer triangles: at most the budget, and no more than the error bound needs; checked after.

Each attempt runs in a child (`collapse.collapse_task`): the quadric collapse can crash, leaves
holes and folds now and then, and may not reach its target. An attempt that damages the surface is
followed by a gentler one, one that stays above the budget by harder ones; what was wrong with each
is in the report.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from scanrender.errors import StageError
from scanrender.scan.child import run_task
from scanrender.scan.surface import Surface
from scanrender.settings.prep import SimplifySettings


@dataclass(frozen=True)
class Attempt:
    """name; how fast the collapse threshold grows per sweep, in the first step and in the others
    (the library's default is 7: lower keeps shape better, but may stop above a small target);
    whether detail is weighted; whether it is only for budgets not reached otherwise."""

    name: str
    aggressiveness: tuple[float, float]
    detail: bool
    hard: bool


ATTEMPTS = (
    Attempt("in steps, detail weighted", (7.0, 5.0), detail=True, hard=False),
    Attempt("in gentler steps", (5.0, 5.0), detail=False, hard=False),
    Attempt("in harder steps", (7.0, 7.0), detail=False, hard=True),
    Attempt("in the hardest steps", (10.0, 10.0), detail=False, hard=True),
)

# What ended the search for fewer triangles than the budget, by the name that the child gives it.
STOPPED = {
    "bound": "stopped by the error bound",
    "ruined": "stopped where fewer would ruin the surface",
    "stalled": "stopped where no edge collapses any more",
    "least": "stopped at the fewest triangles that are tried",
}


@dataclass(frozen=True)
class _Tried:
    attempt: Attempt
    positions: npt.NDArray[np.float64]
    faces: npt.NDArray[np.int64]
    report: dict[str, Any]
    budget: int

    @property
    def count(self) -> int:
        """Triangles with the cap that the neck will get."""
        return len(self.faces) + int(self.report["cap_faces"])

    @property
    def excess(self) -> int:
        """Triangles above the budget."""
        return max(self.count - self.budget, 0)

    @property
    def rank(self) -> tuple[int, int]:
        """The lower, the better."""
        return self.excess, len(self.report["damage"])

    @property
    def problems(self) -> list[str]:
        over = [f"{self.count} triangles remain"] if self.excess else []
        return [*self.report["ruined"], *self.report["damage"], *over]


def simplify(
    surface: Surface,
    settings: SimplifySettings,
    timeout_s: float,
    handed_over: Callable[[], None] = lambda: None,
    cap: bool = False,
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.int64], dict[str, Any]]:
    """Positions (n, 3) mm, faces (m, 3) with m <= settings.triangles, and a report.

    With `cap` there is room in the budget for the faces that `close_neck` will add, and all counts
    in the report include these. `stopped_by` in the report says in one sentence what ended it.
    `over_budget` says that the budget could not be reached (boundaries and pieces need some
    triangles). `handed_over` is called once the first child has the surface. Raises StageError when
    each attempt ruins it.
    """
    arrays = {"positions": surface.positions, "faces": surface.faces}
    rejected: list[str] = []
    best: _Tried | None = None
    for attempt in ATTEMPTS:
        # A harder collapse cures an excess and nothing else.
        if attempt.hard and best is not None and not best.excess:
            continue
        try:
            tried = _try(attempt, arrays, settings, timeout_s, handed_over, cap)
        except StageError as error:
            rejected.append(f"{attempt.name}: {error.what}")
            continue
        if not tried.report["ruined"] and (best is None or tried.rank < best.rank):
            best = tried
        if not tried.problems:
            break
        rejected.append(f"{attempt.name}: {'; '.join(tried.problems)}")
    if best is None:
        raise StageError(
            f"simplification to {settings.triangles} triangles fails: {'. '.join(rejected)}",
            fix="change prep.simplify.triangles, or simplify in the scanning software",
        )
    return best.positions, best.faces, _report(best, rejected, len(surface.faces), settings)


def _try(
    attempt: Attempt,
    arrays: dict[str, Any],
    settings: SimplifySettings,
    timeout_s: float,
    handed_over: Callable[[], None],
    cap: bool,
) -> _Tried:
    params = {
        "target": settings.triangles,
        "error_mm": settings.error_mm,
        "aggressiveness": attempt.aggressiveness,
        "detail": attempt.detail,
        "cap": cap,
    }
    result, report = run_task("simplify", arrays, params, timeout_s, handed_over)
    return _Tried(attempt, result["positions"], result["faces"], report, settings.triangles)


def _report(
    tried: _Tried, rejected: list[str], before: int, settings: SimplifySettings
) -> dict[str, Any]:
    report = tried.report
    method = f"quadric edge collapse (fast-simplification), {tried.attempt.name}"
    return {
        "method": "none: all triangles are kept" if len(tried.faces) == before else method,
        "stopped_by": _stopped_by(tried, settings),
        "triangles": [before, tried.count],
        "rejected": rejected,
        "over_budget": tried.excess > 0,
        **{key: report[key] for key in ("error_mm", "damage", "repaired", "flipped", "detail")},
    }


def _stopped_by(tried: _Tried, settings: SimplifySettings) -> str:
    error, stop = tried.report["error_mm"], tried.report["stop"]
    count, bound, budget = tried.count, settings.error_mm, settings.triangles
    if stop != "budget":
        return (
            f"{STOPPED[stop]}: {count:,} triangles keep 99 % within {error:.2g} mm "
            f"(error bound {bound:g} mm, budget {budget:,})"
        )
    budget_text = f"above the budget of {budget:,}" if tried.excess else "by the budget"
    return (
        f"stopped {budget_text}: {count:,} triangles, 99 % within {error:.2g} mm "
        f"(error bound {bound:g} mm)"
    )
