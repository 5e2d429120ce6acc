"""`scanrender bench truth`: each method against the truth of one front view; what a frame takes.

512 x 512 of a real head under one lamp: diffuse light alone with four samples a pixel, as the truth
has them, then whole frames as they are shipped and as a measured plan leaves them.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from scanrender.asset import Asset, load_asset
from scanrender.files import make_folder
from scanrender.measure import tables
from scanrender.measure.limits import Limits
from scanrender.measure.plan_bench import TOLERANCE, subjects
from scanrender.measure.prep_bench import write_rows
from scanrender.measure.render_bench import HEAD_MM, VIEWS
from scanrender.measure.trade import DIFFUSE_ALONE, error_of, truth_of
from scanrender.render.device import Device, device
from scanrender.render.frame import Renderer
from scanrender.render.measured_plan import measure_plan
from scanrender.settings.loading import load_pipeline
from scanrender.settings.pipeline import Pipeline

SIZE_PX = 512
FRONT = (
    f"camera.width_px={SIZE_PX}", f"camera.height_px={SIZE_PX}", "turntable.start_deg=0",
    f"camera.height_mm={HEAD_MM / VIEWS['close']:.1f}",
)  # fmt: skip
PUBLISHED = (
    "diffusion.method=gaussian_sum", "diffusion.samples=25", "diffusion.halo=cbf_normalized",
    "diffusion.limit=lab", "curvature.modulation=reduce_to_minimum", "curvature.source=screen",
)  # fmt: skip
TURN = 24  # frames that a planned frame is planned for
REPEATS = 7


@dataclass(frozen=True)
class Way:
    """One way to render, which integral judges it, and what is promised of it."""

    name: str
    overrides: tuple[str, ...]
    integral: str = "truth_mean"
    limits: Limits = field(default_factory=dict)


_DISK = ("diffusion.method=disk", "diffusion.disk_taps=64")
WAYS = (
    Way("none", ("diffusion.method=none",)),
    Way("disk, 64 taps", _DISK,
        limits={"dE2000.mean": ("<=", 0.5), "dE2000.p95": ("<=", 1.5),
                "truth.seconds": ("<=", 240.0), "truth.halving_dE2000.mean": ("<=", 0.1)}),
    Way("gaussian_sum", ("diffusion.method=gaussian_sum",)),
    Way("separable_preintegrated", ("diffusion.method=separable_preintegrated",)),
    Way("separable_artistic", ("diffusion.method=separable_artistic",)),
    Way("gaussian_sum as published", PUBLISHED),
    Way("disk, 64 taps, normalize: none, with transmission",
        (*_DISK, "diffusion.normalize=none", "skin.transmission.method=shadow_map",
         "skin.transmission.wrap=0"),
        "truth_sum"),
    Way("disk, 64 taps, normalize: visible", _DISK, "truth_sum"),
)  # fmt: skip
PLANNED_LIMITS: Limits = {"frame_ms": ("<=", 400.0), "dE2000.mean": ("<=", 0.5)}


def bench_truth(
    out: Path, scans: Path, say: Callable[[str], None], asset: Path | None = None
) -> list[dict[str, Any]]:
    """One row a way; writes OUT/truth.json and OUT/truth.csv.

    The head is `asset`, or Lee Perry-Smith's where `scans` has it, or our own. Raises
    ScanrenderError's kinds.
    """
    make_folder(out)
    name, head = front_head(out, scans, say, asset)
    gl = device()
    settings = (*FRONT, *DIFFUSE_ALONE)
    file = out / "truth" / f"{name}, front {SIZE_PX}.npz"
    truth = truth_of(gl, head, "trade", settings, file, say)
    rows: list[dict[str, Any]] = []

    def keep(row: dict[str, Any]) -> None:
        rows.append({**row, "head": name, "truth": truth["notes"], "renderer": gl.renderer})
        say(f"{row['case']}: {row['frame_ms']:.0f} ms, dE2000 {row['dE2000']['mean']:.3f}")
        write_rows(out, "truth", rows)

    for way in WAYS:
        pipeline = load_pipeline("trade", (*settings, "quality.supersampling=2", *way.overrides))
        renderer = Renderer(gl, head, pipeline)
        figures = error_of(renderer, truth, integral=way.integral)
        keep({"case": way.name, "integral": way.integral, "frame_ms": median_ms(renderer),
              **figures, "limits": way.limits})  # fmt: skip
    for label, frame in whole_frames(gl, head, FRONT, "trade").items():
        figures = error_of(Renderer(gl, head, diffuse_alone(frame.pipeline)), truth)
        keep({"case": f"whole frame, {label}", "integral": "truth_mean",
              "frame_ms": median_ms(frame), **figures,
              "limits": PLANNED_LIMITS if label == "planned" else {}})  # fmt: skip
    return rows


def front_head(
    out: Path, scans: Path, say: Callable[[str], None], asset: Path | None
) -> tuple[str, Asset]:
    """The name and the asset of the head that is looked at."""
    if asset is not None:
        return "asset", load_asset(asset)
    heads = subjects(out, scans, say)
    name = "lee_perry_smith" if "lee_perry_smith" in heads else "own_head"
    return name, heads[name]


def whole_frames(
    gl: Device, head: Asset, framing: Sequence[str], pipeline: str
) -> dict[str, Renderer]:
    """Highlights and transmission included: the settings as shipped, and what a plan for a
    turntable leaves of them."""
    shipped = Renderer(gl, head, load_pipeline(pipeline, (*framing, f"turntable.frames={TURN}")))
    return {"as shipped": shipped, "planned": planned_for_turn(shipped)}


def planned_for_turn(renderer: Renderer) -> Renderer:
    """What a measured plan leaves of a shot, for TURN frames of it."""
    plan = measure_plan(renderer, range(TURN), TOLERANCE)
    return Renderer(renderer.device, renderer.scene.asset, plan.pipeline, renderer)


def diffuse_alone(pipeline: Pipeline) -> Pipeline:
    """The shot without what the truth leaves out, as `trade.DIFFUSE_ALONE` says it."""
    skin = pipeline.skin
    specular = skin.specular.model_copy(update={"strength": 0.0})
    transmission = skin.transmission.model_copy(update={"method": "none"})
    matt = skin.model_copy(update={"specular": specular, "transmission": transmission})
    return pipeline.model_copy(update={"skin": matt})


def median_ms(renderer: Renderer) -> float:
    """Milliseconds of its first frame."""
    return statistics.median(turns_ms([renderer], REPEATS)[0])


def turns_ms(renderers: Sequence[Renderer], turns: int) -> list[list[float]]:
    """Milliseconds of each one's first frame, in turns, after one that compiles: what else the
    machine does meanwhile meets all of them."""
    spent: list[list[float]] = [[] for _ in renderers]
    for turn in range(turns + 1):
        for renderer, times in zip(renderers, spent, strict=True):
            begun = time.perf_counter()
            renderer.render(renderer.view(0))
            if turn > 0:
                times.append(1e3 * (time.perf_counter() - begun))
    return spent


def truth_text(rows: Sequence[Mapping[str, Any]]) -> str:
    """A line a way."""
    return tables.text(truth_table(rows))


def truth_table(rows: Sequence[Mapping[str, Any]]) -> tables.Table:
    head = ["way", "against", "ms", "dE2000 mean", "95 %", "most", "FLIP", "red", "green", "blue"]
    lines = [head]
    for row in rows:
        found = row["dE2000"]
        lines.append([
            row["case"], row["integral"], f"{row['frame_ms']:.0f}", f"{found['mean']:.3f}",
            f"{found['p95']:.3f}", f"{found['maximum']:.1f}", f"{row['FLIP']['mean']:.4f}",
            *(f"{share:.4f}" for share in row["energy_ratio"]),
        ])  # fmt: skip
    return lines
