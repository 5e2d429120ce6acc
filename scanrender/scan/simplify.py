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

TOLERANCE = 1.02  # of the budget


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


@dataclass(frozen=True)
class _Tried:
    attempt: Attempt
    positions: npt.NDArray[np.float64]
    faces: npt.NDArray[np.int64]
    report: dict[str, Any]
    excess: float  # triangles above the budget

    @property
    def rank(self) -> tuple[float, int]:
        """The lower, the better."""
        return max(self.excess, 0.0), len(self.report["damage"])

    @property
    def problems(self) -> list[str]:
        over = [f"{len(self.faces)} triangles remain"] if self.excess > 0 else []
        return [*self.report["ruined"], *self.report["damage"], *over]


def simplify(
    surface: Surface,
    settings: SimplifySettings,
    timeout_s: float,
    handed_over: Callable[[], None] = lambda: None,
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.int64], dict[str, Any]]:
    """Positions (n, 3) mm, faces (m, 3) with m <= settings.triangles, and a report.

    `stopped_by` in the report says in one sentence whether the budget or the error bound ended it.
    `over_budget` says that the budget could not be reached (boundaries and pieces need some
    triangles). `handed_over` is called once the first child has the surface. Raises StageError when
    each attempt ruins it.
    """
    arrays = {"positions": surface.positions, "faces": surface.faces}
    rejected: list[str] = []
    best: _Tried | None = None
    for attempt in ATTEMPTS:
        # A harder collapse cures an excess and nothing else.
        if attempt.hard and best is not None and best.excess <= 0:
            continue
        try:
            tried = _try(attempt, arrays, settings, timeout_s, handed_over)
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
) -> _Tried:
    params = {
        "target": settings.triangles,
        "error_mm": settings.error_mm,
        "aggressiveness": attempt.aggressiveness,
        "detail": attempt.detail,
    }
    result, report = run_task("simplify", arrays, params, timeout_s, handed_over)
    excess = len(result["faces"]) - TOLERANCE * settings.triangles
    return _Tried(attempt, result["positions"], result["faces"], report, excess)


def _report(
    tried: _Tried, rejected: list[str], before: int, settings: SimplifySettings
) -> dict[str, Any]:
    count, report = len(tried.faces), tried.report
    method = f"quadric edge collapse (fast-simplification), {tried.attempt.name}"
    return {
        "method": "none: all triangles are kept" if count == before else method,
        "stopped_by": _stopped_by(report, count, settings),
        "triangles": [before, count],
        "rejected": rejected,
        "over_budget": tried.excess > 0,
        **{key: report[key] for key in ("error_mm", "damage", "repaired", "flipped", "detail")},
    }


def _stopped_by(report: dict[str, Any], count: int, settings: SimplifySettings) -> str:
    error, bound = report["error_mm"], settings.error_mm
    if report["bound"]:
        return (
            f"stopped by the error bound: {count:,} triangles keep 99 % within {error:.2g} mm "
            f"(bound {bound:g} mm, budget {settings.triangles:,})"
        )
    return (
        f"stopped by the budget: {count:,} triangles, 99 % within {error:.2g} mm "
        f"(error bound {bound:g} mm)"
    )
