"""Rows of measurements as CSV, as text for a terminal, and as Markdown for the documentation."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from typing import Any

from scanrender.measure.limits import flat_row

Row = Mapping[str, Any]
Lines = Sequence[tuple[str, str]]  # key of the flat row, and what people read
Table = list[list[str]]  # the first line is the head

_STAGES: Table = [["stage", "s", "peak MiB", "plain s", "plain MiB", "ratio", "plain call"]]


def csv_text(rows: Sequence[Row]) -> str:
    """All rows as CSV; a column that a row lacks is empty. `warnings` counts them."""
    flat = [{k: _rounded(v) for k, v in flat_row(row).items()} for row in rows]
    names = list(dict.fromkeys(name for row in flat for name in row))
    stream = io.StringIO()
    writer = csv.DictWriter(stream, names, restval="", lineterminator="\n")
    writer.writeheader()
    writer.writerows(flat)
    return stream.getvalue()


def case_table(rows: Sequence[Row], lines: Lines) -> Table:
    """One column a case that was completed, one line a figure; below it its limit where it has
    one. Lines that no case has are left out."""
    good = [(flat_row(row), row.get("limits", {})) for row in rows if "failed" not in row]
    if not good:
        return []
    table: Table = []
    for key, label in lines:
        cells = [_cell(flat.get(key)) for flat, _ in good]
        if any(cells):
            table.append([label, *cells])
        bounds = [limits.get(key) for _, limits in good]
        if any(bounds):
            table.append(["  limit", *(_bound(bound) for bound in bounds)])
    return table


def stage_table(row: Row) -> Table:
    """Seconds and peak memory of each stage, beside the plain library call in the same run."""
    table = [list(_STAGES[0])]
    for name, cost in row["stages"].items():
        keys = ("seconds", "peak_mib", "plain_seconds", "plain_mib", "ratio")
        cells = [_cell(cost.get(key)) for key in keys]
        if "plain_failed" in cost:
            cells[2] = f"> {cost['plain_limit_s']:g}" if cost["plain_limit_s"] else "failed"
        table.append([name, *cells, cost.get("plain", "")])
    if not any(any(line[3:6]) for line in table[1:]):
        return [line[:3] for line in table]
    return table


def text(table: Table) -> str:
    """Aligned columns: words to the left, figures to the right."""
    if not table:
        return ""
    widths = [max(len(line[i]) for line in table) for i in range(len(table[0]))]
    words = {i for i in range(len(widths)) if i == 0 or table[0][i] == "plain call"}
    rows = []
    for line in table:
        cells = [
            cell.ljust(width) if i in words else cell.rjust(width)
            for i, (cell, width) in enumerate(zip(line, widths, strict=True))
        ]
        rows.append("  ".join(cells).rstrip())
    return "\n".join(rows)


def markdown(table: Table) -> str:
    """The same as a Markdown table."""
    if not table:
        return ""
    marks = ["---" if i == 0 or cell == "plain call" else "--:" for i, cell in enumerate(table[0])]
    return "\n".join("| " + " | ".join(line) + " |" for line in [table[0], marks, *table[1:]])


def _bound(bound: tuple[str, float] | None) -> str:
    return "" if bound is None else f"{bound[0]} {bound[1]:,g}"


def _rounded(value: Any) -> Any:
    return round(value, 4) if isinstance(value, float) else value


def _cell(value: Any) -> str:
    if value is None:
        return ""
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return str(value)
    if isinstance(value, int):
        return f"{value:,}"
    return f"{value:,.1f}" if abs(value) >= 10 else f"{value:.3g}"
