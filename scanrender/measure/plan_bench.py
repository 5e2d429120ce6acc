"""`scanrender bench plan`: whether planned frames are as promised, on shots that nobody chose.

Each shot is rendered with everything on and as planned, at frames that the plan did not look at.
Promised are the tolerance, in every shot, and half of the time in the median.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from scanrender.asset import Asset, load_asset
from scanrender.buffers import Frame
from scanrender.files import make_folder
from scanrender.measure import tables
from scanrender.measure.own_head import own_head
from scanrender.measure.prep_bench import write_rows
from scanrender.measure.random_shots import FRAMES, random_shot
from scanrender.metrics import delta_e_2000_linear, linear_from_srgb, summarize
from scanrender.render.device import Device, device
from scanrender.render.frame import Renderer
from scanrender.render.measured_plan import measure_plan
from scanrender.scan.prepare import prepare
from scanrender.settings.prep import PrepSettings
from scanrender.settings.scan import ScanSettings

SHOTS = 48
SIZE_PX = 480
TOLERANCE = 1.0
UNSEEN = (5, 15)  # frames between those that a plan of FRAMES looks at
SCANS: Mapping[str, tuple[str, dict[str, Any]]] = {
    "lee_perry_smith": ("lee_perry_smith/LeePerrySmith.obj", {"height_mm": 388}),
    "james_3dmd": ("james_3dmd/james.obj", {"units": "mm"}),
}
PREPARED = {
    "simplify": {"triangles": 20_000},
    "bake": {"albedo_px": 2048, "normal_px": 2048, "data_px": 1024},
    "report": "short",
}


def bench_plan(
    out: Path,
    scans: Path,
    say: Callable[[str], None],
    asset: Path | None = None,
    count: int = SHOTS,
) -> list[dict[str, Any]]:
    """One row a shot; writes OUT/plan.json and OUT/plan.csv.

    The subjects are `asset`, or our own head and the real scans that are there. Raises
    ScanrenderError's kinds.
    """
    make_folder(out)
    heads = {"asset": load_asset(asset)} if asset else subjects(out, scans, say)
    names, rows = list(heads), []
    for number in range(count):
        name = names[number % len(names)]
        rows.append(_row(device(), heads[name], name, number))
        last = rows[-1]
        say(
            f"{last['case']}: {last['asked_ms']:.0f} -> {last['planned_ms']:.0f} ms, "
            f"dE2000 95 % {last['p95']:.2f}; {', '.join(last['left_out'])}"
        )
        write_rows(out, "plan", rows)
    return rows


def subjects(out: Path, scans: Path, say: Callable[[str], None]) -> dict[str, Asset]:
    """Our own head, and the real ones that are in `scans`; prepared once into OUT/assets."""
    found = {"own_head": load_asset(own_head(out, say))}
    for name, (file, settings) in SCANS.items():
        folder = out / "assets" / f"plan_{name}"
        if (scans / file).exists():
            if not folder.exists():
                say(f"preparing {name}")
                how = PrepSettings.model_validate(PREPARED)
                prepare(scans / file, ScanSettings.model_validate(settings), how, folder, maps=())
            found[name] = load_asset(folder)
        else:
            say(f"{name} is not in {scans}: left out")
    return found


def _row(gl: Device, asset: Asset, name: str, number: int) -> dict[str, Any]:
    asked = Renderer(gl, asset, random_shot(number, SIZE_PX))
    plan = measure_plan(asked, range(FRAMES), TOLERANCE)
    planned = Renderer(gl, asset, plan.pipeline, asked)
    errors, times = [], ([], [])  # type: tuple[list[Any], tuple[list[float], list[float]]]
    for index in UNSEEN:
        frames = []
        for renderer, spent in zip((asked, planned), times, strict=True):
            begun = time.perf_counter()
            frames.append(renderer.render(renderer.view(index)))
            spent.append(1e3 * (time.perf_counter() - begun))
        errors.append(_error(frames[1], frames[0]))
    asked_ms, planned_ms = (statistics.median(spent) for spent in times)
    return {
        "case": f"{number}: {name}",
        "p95": max(error.p95 for error in errors),
        "mean": max(error.mean for error in errors),
        "asked_ms": asked_ms,
        "planned_ms": planned_ms,
        "share": planned_ms / asked_ms,
        "plan_s": plan.seconds,
        "height_mm": asked.pipeline.camera.height_mm,
        "left_out": [f"{f.what}={f.value}" for f in plan.findings if f.is_left_out],
        "renderer": gl.renderer,
        "limits": {"p95": ("<=", TOLERANCE)},
    }


def _error(planned: Frame, asked: Frame) -> Any:
    """dE2000 of the display over the subject."""
    seen = np.maximum(planned.alpha, asked.alpha) > 0.0
    shown = [linear_from_srgb(frame.buffers["display"]) for frame in (planned, asked)]
    heat = delta_e_2000_linear(shown[0], shown[1])
    return summarize(heat, seen) if seen.any() else summarize(np.zeros(1))


def plan_text(rows: Sequence[Mapping[str, Any]]) -> str:
    """The distributions over shots, and how often each setting was left out."""
    return "\n\n".join(tables.text(table) for table in plan_tables(rows))


def plan_tables(rows: Sequence[Mapping[str, Any]]) -> list[tables.Table]:
    shares = (0, 10, 25, 50, 75, 90, 100)
    columns = ["", *("least" if q == 0 else "most" if q == 100 else f"{q} %" for q in shares)]
    lines = [columns]
    for key, label, form in (
        ("p95", "dE2000 95 %, planned against everything on", ".2f"),
        ("mean", "dE2000 mean", ".2f"),
        ("share", "share of its time", ".2f"),
        ("asked_ms", "everything on, ms", ".0f"),
        ("planned_ms", "planned, ms", ".0f"),
        ("plan_s", "planning, s", ".1f"),
    ):
        values = np.percentile([row[key] for row in rows], shares)
        lines.append([label, *(format(float(value), form) for value in values)])
    counts: dict[str, int] = {}
    for row in rows:
        for said in row["left_out"]:
            counts[said] = counts.get(said, 0) + 1
    often = sorted(counts.items(), key=lambda item: (item[0].split("=")[0], item[0]))
    taken = [["left out, or less of it", f"shots of {len(rows)}"]]
    taken += [[said, str(count)] for said, count in often]
    return [lines, taken]
