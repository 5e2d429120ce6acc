"""The trade study for people: a page in words and tables, and a plot of each view."""

from __future__ import annotations

import statistics
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from scanrender.files import write_text
from scanrender.measure import tables
from scanrender.measure.knobs import KNOBS, METHOD, Knob, twins
from scanrender.measure.trade import pareto
from scanrender.measure.trade_plot import write_plot

Row = Mapping[str, Any]

INTRO = """# What each setting buys

Time of a frame against its error: the colour difference (dE2000, mean over the skin) to the truth,
the surface integral in float64, of diffuse light alone. A difference of 1 can just be noticed.
Times are medians of three frames or more on the device named below; only their ratios mean much
elsewhere.

    {command}
"""


def write_page(out: Path, rows: Sequence[Row], command: str) -> list[Path]:
    """OUT/trade.md, with the command that made it, and OUT/pareto_VIEW.png. Raises OutputError."""
    parts = [INTRO.format(command=command), _machine(rows)]
    files = []
    for view in dict.fromkeys(row["view"] for row in rows):
        mine = [row for row in rows if row["view"] == view]
        files.append(write_plot(out / f"pareto_{view}.png", mine, view))
        parts += [f"## {view}\n", f"![{view}](pareto_{view}.png)\n", _best_in_words(mine)]
        parts += [tables.markdown(_table(pareto(mine))), ""]
    parts += ["## What each knob buys\n", *_knobs_in_words(rows), ""]
    parts += ["## All points\n", tables.markdown(_table(rows)), ""]
    return [write_text(out / "trade.md", "\n".join(parts)), *files]


def _machine(rows: Sequence[Row]) -> str:
    halved = [row["truth"]["halving_dE2000"]["mean"] for row in rows]
    return (
        f"Device: {rows[0]['renderer']}. Half the spacing of the truth's samples moves it by "
        f"dE2000 {max(halved):.3f} at most.\n"
    )


def _best_in_words(rows: Sequence[Row]) -> str:
    best = pareto(rows)
    fast, right = best[0], best[-1]
    ratio = right["frame_ms"] / fast["frame_ms"]
    return (
        f"The fastest, {_name(fast)}, is off by {fast['dE2000']['mean']:.2f}; the nearest, "
        f"{_name(right)}, by {right['dE2000']['mean']:.2f} in {ratio:.1f} times the time. Points "
        "that no other beats in both:\n"
    )


def _table(rows: Sequence[Row]) -> list[list[str]]:
    head = ["view", "point", "ms", "dE2000 mean", "95 %", "FLIP", "energy R", "G", "B"]
    body = [
        [
            row["view"], _name(row), f"{row['frame_ms']:.0f}", f"{row['dE2000']['mean']:.3f}",
            f"{row['dE2000']['p95']:.3f}", f"{row['FLIP']['mean']:.4f}",
            *(f"{x:.4f}" for x in row["energy_ratio"]),
        ]
        for row in rows
    ]  # fmt: skip
    return [head, *body]


def _name(row: Row) -> str:
    return str(row["case"].split(": ", 1)[1])


def _knobs_in_words(rows: Sequence[Row]) -> list[str]:
    """One sentence a knob, value and view, from pairs of points that differ in it alone."""
    lines = _methods_in_words(rows)
    for knob in KNOBS:
        for value in knob.others:
            lines.append(_knob_in_words(rows, knob, value))
    return [line for line in lines if line]


def _knob_in_words(rows: Sequence[Row], knob: Knob, value: Any) -> str:
    said = []
    for view in dict.fromkeys(row["view"] for row in rows):
        pairs = twins([row for row in rows if row["view"] == view], knob, value)
        if pairs:
            said.append(f"{view}: {_change(pairs)}")
    return f"- `{knob.key}` {value} instead of {knob.usual}: {'; '.join(said)}." if said else ""


def _methods_in_words(rows: Sequence[Row]) -> list[str]:
    """Each method as it is without further settings, against gaussian_sum."""
    lines = []
    for view in dict.fromkeys(row["view"] for row in rows):
        plain = {_name(row): row for row in rows if row["view"] == view}
        usual = plain.get("gaussian_sum")
        if usual is not None:
            others = [n for n in plain if n == plain[n]["point"][METHOD] and n != "gaussian_sum"]
            said = [f"{name} {_change([(usual, plain[name])])}" for name in others]
            lines.append(f"- {view}, against gaussian_sum: {'; '.join(said)}.")
    return lines


def _change(pairs: Sequence[tuple[Row, Row]]) -> str:
    time = statistics.median(b["frame_ms"] / a["frame_ms"] for a, b in pairs)
    error = statistics.median(b["dE2000"]["mean"] - a["dE2000"]["mean"] for a, b in pairs)
    return f"{time:.2f} times the time, dE2000 {error:+.3f}"
