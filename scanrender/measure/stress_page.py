"""The page of `scanrender stress`: one row an axis, then the random scenes, in Markdown."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from itertools import groupby
from typing import Any

from scanrender.measure.extremes import AXES, SUBJECT
from scanrender.measure.invariants import INVARIANTS, Finding, Refusal
from scanrender.measure.stress import Examined, Stress, in_words

Walk = Sequence[tuple[Any, Sequence[Examined]]]
INTRO = """# Stable at the extremes

Written by `scanrender stress`. Each axis is walked alone, from a head-sized ball under a lamp and
ambient light with everything on; at each value all invariants are tested. Then scenes are drawn in
which many axes are moved at once. A clear refusal is fine, a wrong picture is not.
"""
LIMITS = """## What is not compared, and why

- `mirror` of what is noise by choice: `jitter`, environments (their shadow taps follow the normals)
  and normals that are none of the surface's. Of coincident surfaces, which is seen is chance.
- `mirror` and `resolution` of a disk with few taps: each is a sample of the surface. With 64 taps
  and the skin of a head they differ by dE2000 0.1, with 16 taps by 0.6.
- `scale` of `halo: cbf`, whose guide grows with the distance in metres by its definition (paper,
  equation 8; `cbf_normalized` has no unit), and of modulated curvature: beyond 2 1/mm, half a
  millimetre of radius, it is cut off, and that is a length.
- `resolution` of `diffusion.resolution: half`, which is a trade of resolution for time.
- `resolution` of curvature on the screen of normals that are noise: they turn within a pixel or
  two, and their differences are those of the pixels.

Where a kernel outgrows the subject (`skin.scale` from 30 on a head, a head of two millimetres), the
separable kernels and the disk hand over to the sum of Gaussians, and say so (decision 29).
"""


def stress_page(stress: Stress, renderer: str, version: str, precision: str) -> str:
    """The whole page; `precision` are its sections on floats (stress_precision.py)."""
    return "\n".join([
        INTRO,
        f"scanrender {version}, {renderer}, {stress.seconds:.0f} s.\n",
        "## Invariants\n", _invariants(stress),
        "## Axes\n", _axes(stress),
        "## Random scenes\n", _scenes(stress),
        LIMITS,
        precision,
    ])  # fmt: skip


def _invariants(stress: Stress) -> str:
    walked = [e for walk in stress.walks.values() for _, examined in walk for e in examined]
    rows = []
    for name, test in INVARIANTS.items():
        found = [f for f in _findings([*stress.tests, *walked]) if f.invariant == name]
        if not found:
            continue
        worst = max(found, key=lambda f: f.figure)
        unit = worst.sentence if "dE" in worst.sentence or "relative" in worst.sentence else ""
        says = (test.__doc__ or "").splitlines()[0].strip()
        broken = sum(not f.holds for f in found)
        rows.append((name, says, f"{worst.bound:g} {unit}".strip(), f"{worst.figure:.2g}",
                     str(len(found)), str(broken)))  # fmt: skip
    head = ("Invariant", "What must hold", "Bound", "Worst", "Tests", "Broken")
    return table(head, rows)


def _axes(stress: Stress) -> str:
    rows = [(f"`{name}`", *_axis_row(name, walk)) for name, walk in stress.walks.items()]
    return table(("Axis", "Values walked", "Holds at", "Worst, share of its bound", "Beyond"), rows)


def _axis_row(name: str, walk: Walk) -> tuple[str, str, str, str]:
    unit = (AXES.get(name) or SUBJECT[name]).unit
    holds = [not _broken(examined) and not _refused(examined) for _, examined in walk]
    beyond = []
    for value, examined in walk:
        if refused := _refused(examined):
            beyond.append(f"{_short(value)}: refused ({refused[0].sentence})")
        elif broken := _broken(examined):
            beyond.append(f"{_short(value)}: {in_words(broken[0])}")
    bounded = [f for _, es in walk for f in _findings(es) if f.bound > 0.0]
    worst = max(bounded, key=lambda f: f.figure / f.bound, default=None)
    words = "" if worst is None else f"{worst.figure / worst.bound:.0%} ({worst.invariant})"
    shown = _span([value for value, _ in walk], unit)
    # One span for each run of values that hold: a gap between two is no range.
    runs = groupby(zip(holds, walk, strict=True), key=lambda pair: pair[0])
    spans = [_span([value for _, (value, _) in run], unit) for good, run in runs if good]
    return shown, "all" if all(holds) else ", ".join(spans) or "nowhere", words, "; ".join(beyond)


def _scenes(stress: Stress) -> str:
    refusals = Counter(e.outcome.sentence for e in stress.tests if isinstance(e.outcome, Refusal))
    first, last = stress.seeds
    lines = [
        f"{stress.scenes} scenes (seeds {first} to {last}), {len(stress.tests)} tests, "
        f"{len(stress.broken)} broken, {sum(refusals.values())} refused.\n"
    ]
    if stress.broken:
        rows = [(str(b.seed), in_words(b.finding), f"`{dict(b.case.axes)}`") for b in stress.broken]
        lines.append(table(("Scene", "What broke", "Simplest axes that break it"), rows))
    if refusals:
        lines.append(table(("Refusal", "Scenes"), [(s, str(n)) for s, n in refusals.most_common()]))
    return "\n".join(lines)


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Markdown, aligned to the left."""
    lines = [head, ["---"] * len(head), *rows]
    cells = ([cell.replace("|", "/").replace("\n", " ") for cell in line] for line in lines)
    return "\n".join("| " + " | ".join(line) + " |" for line in cells) + "\n"


def _findings(examined: Iterable[Examined]) -> list[Finding]:
    return [e.outcome for e in examined if isinstance(e.outcome, Finding)]


def _broken(examined: Iterable[Examined]) -> list[Finding]:
    return [f for f in _findings(examined) if not f.holds]


def _refused(examined: Iterable[Examined]) -> list[Refusal]:
    return [e.outcome for e in examined if isinstance(e.outcome, Refusal)]


def _span(values: Sequence[Any], unit: str) -> str:
    if all(isinstance(v, int | float) for v in values):
        if len(values) == 1:
            return f"{values[0]:g} {unit}".strip()
        return f"{min(values):g} to {max(values):g} {unit}".strip()
    return ", ".join(_short(v) for v in values) + (f" {unit}" if unit else "")


def _short(value: Any) -> str:
    if isinstance(value, dict):
        return " ".join(str(v) for k, v in value.items() if k != "shadow_px")
    if isinstance(value, list):
        return " × ".join(f"{v:g}" for v in value)
    return f"{value:g}" if isinstance(value, int | float) else str(value)
