"""`scanrender bench prep`: seconds, memory and fidelity of the preparation, on inputs of its own.

Every row is one whole preparation in child processes, from the file on disk to the asset folder,
as `scanrender prep` runs it.
"""

from __future__ import annotations

import os
import platform
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from scanrender import __version__
from scanrender.errors import ScanrenderError
from scanrender.files import make_folder, write_json, write_text
from scanrender.measure import prep_inputs, tables
from scanrender.measure.chosen import chosen
from scanrender.measure.limits import ATLAS, Limits
from scanrender.measure.stage_costs import add_plain_calls, stage_costs
from scanrender.measure.watch import Watch
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
    atlas: Limits = field(default_factory=dict)

    @property
    def limits(self) -> dict[str, tuple[str, float]]:
        """All of them by the key of the flat row."""
        bounds = {"seconds": self.limit_s, "peak_tree_mib": self.limit_mib}
        stated = {key: ("<=", float(x)) for key, x in bounds.items() if x is not None}
        return {**stated, **self.atlas}


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
             _phantom(1_100_000), _TO_50K, 60.0, 3 * 1024, ATLAS),
        Case("head", "real head, 1.13 M to 50 k, albedo and normal at 4096", "head_1131k.ply",
             _head(3), _TO_50K, 60.0, 3 * 1024, ATLAS),
        Case("chain", "real head, 1.13 M to 20 k, albedo and normal only, at 2048, 1 sample",
             "head_1131k.ply", _head(3), _CHAIN, 10.0),
        Case("5m", "phantom, 5 M to 50 k, albedo and normal at 4096", "phantom_5m.ply",
             _phantom(5_000_000), _TO_50K, 240.0, 8 * 1024, ATLAS),
        Case("20m", "phantom, 20 M to 50 k, albedo and normal at 4096", "phantom_20m.ply",
             _phantom(20_000_000), _TO_50K, None, 16 * 1024, ATLAS),
        Case("pages", "phantom, 0.4 M with 8 pages of 8192, to 50 k, maps at 4096",
             "pages/head.obj", _pages(400_000, 8, 8192), _TO_50K, None, 16 * 1024, ATLAS),
    )
}  # fmt: skip
DEFAULT_CASES = ("1m", "head", "chain")


def case_list(text: str) -> list[Case]:
    """`1m,chain`, or `all`. Raises UsageError for a case that does not exist."""
    return [CASES[name] for name in chosen(text, CASES)]


def bench_prep(
    cases: Sequence[Case],
    out: Path,
    scans: Path,
    say: Callable[[str], None],
    plain: bool = False,
) -> list[dict[str, Any]]:
    """Run the cases and write OUT/prep.json and OUT/prep.csv; one row each, also for failures.

    Inputs are kept in OUT/inputs for the next run. With `plain`, each stage is compared with a
    plain library call on the same scan, run right after the preparation. Raises OutputError.
    """
    make_folder(out)
    rows = []
    for case in cases:
        say(f"{case.name}: {case.meaning}")
        try:
            rows.append(_row(case, out, scans, plain, say))
        except ScanrenderError as error:
            say(str(error))
            rows.append({"case": case.name, "meaning": case.meaning, "failed": error.what})
        say(_sentence(rows[-1]))
        # After each case: a run of an hour that is stopped has not measured nothing.
        write_rows(out, "prep", rows)
    return rows


def write_rows(out: Path, name: str, rows: Sequence[Mapping[str, Any]]) -> None:
    """OUT/NAME.json with the machine's description, and OUT/NAME.csv. Raises OutputError."""
    document = {"scanrender": __version__, "machine": _machine(), "rows": rows}
    write_json(out / f"{name}.json", document)
    write_text(out / f"{name}.csv", tables.csv_text(rows))


def _row(
    case: Case, out: Path, scans: Path, plain: bool, say: Callable[[str], None]
) -> dict[str, Any]:
    scan = out / "inputs" / case.file
    if not scan.exists():
        case.make(scan, scans)
    settings = PrepSettings.model_validate(case.prep)
    folder = out / "assets" / case.name
    begun: list[float] = []

    def progress(stage: str, fraction: float) -> None:
        begun.append(time.perf_counter())

    with Watch() as watch:
        asset = prepare(scan, ScanSettings(), settings, folder, progress=progress, maps=())
    info, stop = asset.info, time.perf_counter()
    costs = stage_costs(info["stages"], watch, begun[0], stop - begun[0])
    if plain:
        add_plain_calls(costs, scan, folder, say)
    return {
        "case": case.name,
        "meaning": case.meaning,
        "raw_triangles": info["counts"]["raw"]["triangles"],
        "triangles": info["counts"]["prepared"]["triangles"],
        **asdict(watch.usage),
        "stages": costs,
        "lost": info["lost"],
        "warnings": info["warnings"],
        "limits": case.limits,
    }


def _machine() -> dict[str, Any]:
    return {
        "system": platform.platform(),
        "processor": _processor(),
        "python": platform.python_version(),
        "cores": len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else None,
        "load": list(os.getloadavg()) if hasattr(os, "getloadavg") else None,
    }


def _processor() -> str:
    """Its name where Linux tells it."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.processor()
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor()


def table_text(rows: Sequence[Mapping[str, Any]]) -> str:
    """The rows as tables for people: one column a case, then one table of stages a case."""
    cases = tables.text(tables.case_table(rows, LINES))
    if not cases:
        return "no case was completed"
    blocks = [cases]
    for row in rows:
        if "failed" not in row:
            blocks.append(f"{row['case']}\n{tables.text(tables.stage_table(row))}")
    return "\n\n".join(blocks)


LINES = (
    ("case", "case"),
    ("raw_triangles", "raw triangles"),
    ("triangles", "triangles"),
    ("seconds", "wall clock s"),
    ("cpu_seconds", "processor s"),
    ("peak_tree_mib", "peak of all processes MiB"),
    ("lost.charts", "charts"),
    ("lost.atlas_use", "atlas use"),
    ("lost.flipped_triangles", "flipped triangles"),
    ("lost.overlap", "atlas overlap"),
    ("lost.stretch.within_1_5", "texels within 1.5x density"),
    ("stages.unwrap.seconds", "unwrap s"),
    ("lost.symmetric_mm.mean", "distance mean mm"),
    ("lost.symmetric_mm.p99", "distance 99 % mm"),
    ("lost.color_de2000.mean", "colour dE2000 mean"),
    ("lost.color_de2000.p95", "colour dE2000 95 %"),
)


def _sentence(row: Mapping[str, Any]) -> str:
    if "failed" in row:
        return f"{row['case']}: failed"
    memory = row["peak_tree_mib"] or row["peak_child_mib"]
    return f"{row['case']}: {row['seconds']:.1f} s, {memory or 'unknown'} MiB"
