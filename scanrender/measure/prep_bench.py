"""`scanrender bench prep`: seconds, memory and fidelity of the preparation, on inputs of its own.

Every row is one whole preparation in child processes, from the file on disk to the asset folder,
as `scanrender prep` runs it.
"""

from __future__ import annotations

import csv
import io
import os
import platform
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from scanrender import __version__
from scanrender.errors import ScanrenderError, UsageError
from scanrender.files import make_folder, write_json, write_text
from scanrender.measure import prep_inputs
from scanrender.measure.watch import Watch
from scanrender.scan.child import run_task
from scanrender.scan.ingest import read_scan
from scanrender.scan.prepare import prepare
from scanrender.settings.prep import PrepSettings
from scanrender.settings.scan import ScanSettings

LARGE_MAPS = {"albedo_px": 4096, "normal_px": 4096, "data_px": 1024}
CHAIN_MAPS = {"albedo_px": 2048, "normal_px": 2048, "maps": ["albedo", "normal_ts"]}


@dataclass(frozen=True)
class Case:
    """One input and how it is prepared; the limits are those of the project on two cores."""

    name: str
    meaning: str
    file: str
    make: Callable[[Path, Path], Path]  # (file, folder of the real scans)
    prep: dict[str, Any] = field(default_factory=dict)
    limit_s: float | None = None
    limit_mib: int | None = None


def _phantom(triangles: int) -> Callable[[Path, Path], Path]:
    return lambda file, scans: prep_inputs.phantom_scan(file, triangles)


def _head(levels: int) -> Callable[[Path, Path], Path]:
    return lambda file, scans: prep_inputs.dense_head_scan(file, scans, levels)


def _pages(triangles: int, count: int, size: int) -> Callable[[Path, Path], Path]:
    return lambda file, scans: prep_inputs.paged_scan(file.parent, triangles, count, size)


_TO_50K = {"simplify": {"triangles": 50_000}, "bake": LARGE_MAPS}
_CHAIN = {
    "simplify": {"triangles": 20_000},
    "bake": {**CHAIN_MAPS, "supersample": 1},
    "report": "short",
}

CASES = {
    case.name: case
    for case in (
        Case("small", "phantom, 0.1 M to 10 k, maps at 1024", "phantom_100k.ply", _phantom(100_000),
             {"simplify": {"triangles": 10_000},
              "bake": {"albedo_px": 1024, "normal_px": 1024, "data_px": 512}}),
        Case("1m", "phantom, 1.1 M to 50 k, albedo and normal at 4096", "phantom_1100k.ply",
             _phantom(1_100_000), _TO_50K, 60.0, 3 * 1024),
        Case("head", "real head, 1.13 M to 50 k, albedo and normal at 4096", "head_1131k.ply",
             _head(3), _TO_50K, 60.0, 3 * 1024),
        Case("chain", "real head, 1.13 M to 20 k, albedo and normal only, at 2048, 1 sample",
             "head_1131k.ply", _head(3), _CHAIN, 10.0),
        Case("5m", "phantom, 5 M to 50 k, albedo and normal at 4096", "phantom_5m.ply",
             _phantom(5_000_000), _TO_50K, 240.0, 8 * 1024),
        Case("20m", "phantom, 20 M to 50 k, albedo and normal at 4096", "phantom_20m.ply",
             _phantom(20_000_000), _TO_50K, None, 16 * 1024),
        Case("pages", "phantom, 0.4 M with 8 pages of 8192, to 50 k, maps at 4096",
             "pages/head.obj", _pages(400_000, 8, 8192), _TO_50K, None, 16 * 1024),
    )
}  # fmt: skip
DEFAULT_CASES = ("1m", "head", "chain")


def case_list(text: str) -> list[Case]:
    """`1m,chain`, or `all`. Raises UsageError for a case that does not exist."""
    names = list(CASES) if text == "all" else [name.strip() for name in text.split(",") if name]
    for name in names:
        if name not in CASES:
            raise UsageError(f"no such case: {name!r}", fix=f"one of {', '.join(CASES)}, or all")
    return [CASES[name] for name in names]


def bench_prep(
    cases: Sequence[Case],
    out: Path,
    scans: Path,
    say: Callable[[str], None],
    plain: bool = False,
) -> list[dict[str, Any]]:
    """Run the cases and write OUT/prep.json and OUT/prep.csv; one row each, also for failures.

    Inputs are kept in OUT/inputs for the next run. With `plain`, the bare library calls for
    simplifying and unwrapping are timed on the same mesh. Raises OutputError.
    """
    make_folder(out)
    rows = []
    for case in cases:
        say(f"{case.name}: {case.meaning}")
        try:
            rows.append(_row(case, out, scans, plain))
        except ScanrenderError as error:
            say(str(error))
            rows.append({"case": case.name, "meaning": case.meaning, "failed": error.what})
        say(_sentence(rows[-1]))
    document = {"scanrender": __version__, "machine": _machine(), "rows": rows}
    write_json(out / "prep.json", document)
    write_text(out / "prep.csv", csv_text(rows))
    return rows


def _row(case: Case, out: Path, scans: Path, plain: bool) -> dict[str, Any]:
    scan = out / "inputs" / case.file
    if not scan.exists():
        case.make(scan, scans)
    settings = PrepSettings.model_validate(case.prep)
    with Watch() as watch:
        asset = prepare(scan, ScanSettings(), settings, out / "assets" / case.name, maps=())
    info = asset.info
    row = {
        "case": case.name,
        "meaning": case.meaning,
        "raw_triangles": info["counts"]["raw"]["triangles"],
        "triangles": info["counts"]["prepared"]["triangles"],
        **asdict(watch.usage),
        "limit_s": case.limit_s,
        "limit_mib": case.limit_mib,
        "stages": {stage["name"]: stage["seconds"] for stage in info["stages"]},
        "stage_mib": {stage["name"]: stage["peak_memory_mib"] for stage in info["stages"]},
        "lost": info["lost"],
        "warnings": info["warnings"],
    }
    if plain:
        row["plain"] = _plain_calls(scan, len(asset.mesh.faces))
    return row


def _plain_calls(scan: Path, triangles: int) -> dict[str, float]:
    """Seconds of the bare libraries: one collapse of the raw mesh, and xatlas on its result."""
    raw = read_scan(scan)
    unique, index = np.unique(raw.positions, axis=0, return_inverse=True)
    arrays = {"positions": unique, "faces": index.reshape(-1)[raw.faces]}
    start = time.perf_counter()
    params = {"target": triangles, "aggressiveness": 7.0}
    simple, _ = run_task("simplify", arrays, params, 600.0)
    middle = time.perf_counter()
    try:
        run_task("xatlas", simple, {"resolution": 2048, "padding": 4}, 600.0)
        unwrapped = round(time.perf_counter() - middle, 3)
    except ScanrenderError:
        unwrapped = float("inf")
    return {"fast_simplification_s": round(middle - start, 3), "xatlas_s": unwrapped}


def _machine() -> dict[str, Any]:
    return {
        "system": platform.platform(),
        "python": platform.python_version(),
        "cores": len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else None,
        "load": list(os.getloadavg()) if hasattr(os, "getloadavg") else None,
    }


def flat_row(row: dict[str, Any]) -> dict[str, Any]:
    """One row without nesting: `stage.albedo`, `lost.charts`."""
    flat: dict[str, Any] = {}

    def put(prefix: str, value: Any) -> None:
        if isinstance(value, dict):
            for key, inner in value.items():
                put(f"{prefix}.{key}" if prefix else key, inner)
        elif isinstance(value, list):
            flat[prefix] = len(value)
        elif isinstance(value, float):
            flat[prefix] = round(value, 4)
        else:
            flat[prefix] = value

    put("", row)
    return flat


def csv_text(rows: Sequence[dict[str, Any]]) -> str:
    """All rows as CSV; a column that a row lacks is empty. `warnings` counts them."""
    flat = [flat_row(row) for row in rows]
    names = list(dict.fromkeys(name for row in flat for name in row))
    stream = io.StringIO()
    writer = csv.DictWriter(stream, names, restval="", lineterminator="\n")
    writer.writeheader()
    writer.writerows(flat)
    return stream.getvalue()


def table_text(rows: Sequence[dict[str, Any]]) -> str:
    """The rows as a table for people, one column a case."""
    good = [flat_row(row) for row in rows if "failed" not in row]
    if not good:
        return "no case was completed"
    lines = []
    for name, label in _LINES:
        cells = [_cell(row.get(name)) for row in good]
        if any(cells):
            lines.append([label, *cells])
    for name in dict.fromkeys(n for row in good for n in row if n.startswith("stages.")):
        lines.append([f"  {name[7:]} s", *(_cell(row.get(name)) for row in good)])
    widths = [max(len(line[i]) for line in lines) for i in range(len(lines[0]))]
    texts = []
    for line in lines:
        cells = [line[0].ljust(widths[0])]
        cells += [cell.rjust(width) for cell, width in zip(line[1:], widths[1:], strict=True)]
        texts.append("  ".join(cells).rstrip())
    return "\n".join(texts)


_LINES = (
    ("case", "case"),
    ("raw_triangles", "raw triangles"),
    ("triangles", "triangles"),
    ("seconds", "wall clock s"),
    ("limit_s", "  limit s"),
    ("cpu_seconds", "processor s"),
    ("peak_tree_mib", "peak of all processes MiB"),
    ("peak_child_mib", "peak of one process MiB"),
    ("limit_mib", "  limit MiB"),
    ("lost.charts", "charts"),
    ("lost.atlas_use", "atlas use"),
    ("lost.flipped_triangles", "flipped triangles"),
    ("lost.overlap", "atlas overlap"),
    ("lost.stretch.within_1_5", "texels within 1.5x density"),
    ("lost.symmetric_mm.mean", "distance mean mm"),
    ("lost.symmetric_mm.p99", "distance 99 % mm"),
    ("lost.color_de2000.mean", "colour dE2000 mean"),
    ("lost.color_de2000.p95", "colour dE2000 95 %"),
    ("plain.fast_simplification_s", "fast-simplification alone s"),
    ("plain.xatlas_s", "xatlas alone s"),
)


def _cell(value: Any) -> str:
    if value is None or value == "":
        return ""
    return (
        f"{value:,}"
        if isinstance(value, int)
        else f"{value:.3g}"
        if isinstance(value, float) and abs(value) < 10
        else f"{value:.1f}"
        if isinstance(value, float)
        else str(value)
    )


def _sentence(row: dict[str, Any]) -> str:
    if "failed" in row:
        return f"{row['case']}: failed"
    memory = row["peak_tree_mib"] or row["peak_child_mib"]
    return f"{row['case']}: {row['seconds']:.1f} s, {memory} MiB"


def missed_limits(rows: Sequence[dict[str, Any]]) -> list[str]:
    """Sentences for the rows that took more time or memory than the project allows."""
    found = [f"{row['case']} failed: {row['failed']}" for row in rows if "failed" in row]
    for row in rows:
        for key, limit, unit in (
            ("seconds", "limit_s", "s"),
            ("peak_tree_mib", "limit_mib", "MiB"),
        ):
            value, bound = row.get(key), row.get(limit)
            if value is not None and bound is not None and value > bound:
                found.append(f"{row['case']}: {value:.1f} {unit}, the limit is {bound:g} {unit}")
    return found
