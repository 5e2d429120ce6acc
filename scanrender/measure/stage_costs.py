"""What each stage of one preparation took, and what a plain library call takes for the like."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from scanrender.errors import ScanrenderError
from scanrender.measure.watch import Watch
from scanrender.scan.child import run_task
from scanrender.scan.plain import CALLS

Cost = dict[str, Any]
PLAIN_TIMEOUT_S = 300.0
REST = "start, save, read back"


def stage_costs(
    stages: Sequence[Mapping[str, Any]], watch: Watch, begun: float, seconds: float
) -> dict[str, Cost]:
    """seconds and peak_mib of each stage of asset.json, and of the rest of the run.

    begun: time.perf_counter() when the first stage began. The peak is that of all processes while
    the stage ran, so that what ran beside it counts too; without /proc it is the largest memory of
    the preparing process until then.
    """
    costs: dict[str, Cost] = {}
    for stage in stages:
        start = begun + stage["at"]
        peak = watch.peak_mib(start, start + stage["seconds"])
        costs[stage["name"]] = {
            "seconds": stage["seconds"],
            "peak_mib": stage["peak_memory_mib"] if peak is None else peak,
        }
    last = max((stage["at"] + stage["seconds"] for stage in stages), default=0.0)
    end = watch.peak_mib(begun + last, float("inf"))
    costs[REST] = {"seconds": round(seconds - last, 3), "peak_mib": end}
    return costs


def add_plain_calls(
    costs: Mapping[str, Cost], scan: Path, asset: Path, say: Callable[[str], None]
) -> None:
    """Run the plain call beside each stage that has one, each in a process of its own, and add
    plain (what it is), plain_seconds, plain_mib, and ratio (ours over plain) to the stage's cost.

    A call that fails or takes longer than PLAIN_TIMEOUT_S leaves plain_failed, and no ratio;
    plain_limit_s is the limit that it exceeded, else None.
    """
    for name, cost in costs.items():
        if name not in CALLS:
            continue
        cost["plain"] = CALLS[name][0]
        params = {"stage": name, "scan": str(scan.resolve()), "asset": str(asset.resolve())}
        started = time.perf_counter()
        try:
            _, report = run_task("plain", {}, params, PLAIN_TIMEOUT_S)
        except ScanrenderError as error:
            cost["plain_failed"] = error.what
            late = time.perf_counter() - started >= PLAIN_TIMEOUT_S
            cost["plain_limit_s"] = PLAIN_TIMEOUT_S if late else None
            say(f"the plain call for {name} failed: {error.what}")
            continue
        cost["plain_seconds"] = round(report["seconds"], 3)
        cost["plain_mib"] = report["peak_mib"]
        cost["ratio"] = round(cost["seconds"] / max(report["seconds"], 1e-3), 2)
