"""`scanrender bench render`: milliseconds of a frame, by method and by pass, near and far.

The analogue of Table 2 of "Optimized Skin Rendering for Scanned Models" (WSCG 2016): the diffusion
algorithms and the improvements at close, mid and far views, at 1920 x 1080, without supersampling,
under one directional light with its shadow map.
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
from scanrender.measure.own_head import own_head
from scanrender.measure.prep_bench import write_rows
from scanrender.render.device import Device, device
from scanrender.render.frame import Renderer
from scanrender.settings.loading import load_pipeline

HEAD_MM = 227.0  # chin to crown
# The share of the picture's height that it fills; `empty` looks past it: what a frame costs anyway.
VIEWS = {"close": 0.9, "mid": 0.45, "far": 0.15, "empty": 0.9}
PAST_MM = 1000.0
REPEATS = 5  # of which the median counts


@dataclass(frozen=True)
class Way:
    """One way to render the same shot, and what is promised about its frame in the close view."""

    name: str
    overrides: tuple[str, ...] = ()
    close: Limits = field(default_factory=dict)


_PASSES_OF = "separable_preintegrated"
_FIRST = "diffusion.method=separable_preintegrated"
WAYS = (
    Way("no diffusion", ("diffusion.method=none",)),
    Way("gaussian_sum", ("diffusion.method=gaussian_sum",), {"frame_ms": ("<=", 6000.0)}),
    Way("separable_preintegrated", (_FIRST,), {"frame_ms": ("<=", 2500.0)}),
    Way("separable_artistic", ("diffusion.method=separable_artistic",)),
    Way("disk, 64 taps", ("diffusion.method=disk",)),
    # The improvements, one by one on the separable method.
    *(Way(f"halo: {mode}", (_FIRST, f"diffusion.halo={mode}"))
      for mode in ("none", "depth", "cbf", "cbf_normalized")),
    Way("limit: lab", (_FIRST, "diffusion.limit=lab")),
    Way("curvature: screen", (_FIRST, "curvature.modulation=reduce_to_minimum")),
    Way("curvature: baked",
        (_FIRST, "curvature.modulation=reduce_to_minimum", "curvature.source=baked")),
    Way("no transmission", (_FIRST, "skin.transmission.method=none")),
)  # fmt: skip


def bench_render(
    views: Sequence[str],
    out: Path,
    say: Callable[[str], None],
    asset: Path | None = None,
    repeats: int = REPEATS,
    overrides: Sequence[str] = (),
) -> list[dict[str, Any]]:
    """One row a view and way; writes OUT/render.json and OUT/render.csv.

    asset: a prepared folder; without it our own head, 1.1 M to 50 k triangles, prepared once into
    OUT/assets/own_head. `overrides` change the shot. Raises ScanrenderError's kinds.
    """
    loaded = load_asset(asset or own_head(out, say))
    make_folder(out)
    gl = device()
    rows: list[dict[str, Any]] = []
    for view in views:
        for way in WAYS:
            rows.append(
                {**_row(gl, loaded, view, way, repeats, overrides), "renderer": gl.renderer}
            )
            say(f"{rows[-1]['case']}: {rows[-1]['frame_ms']:.0f} ms")
            write_rows(out, "render", rows)
    return rows


def _row(
    gl: Device, asset: Asset, view: str, way: Way, repeats: int, overrides: Sequence[str]
) -> dict[str, Any]:
    framing = [f"camera.height_mm={HEAD_MM / VIEWS[view]:.1f}"]
    if view == "empty":
        framing.append(f"camera.look_up_mm={PAST_MM:g}")
    pipeline = load_pipeline("bench", (*framing, *way.overrides, *overrides))
    renderer = Renderer(gl, asset, pipeline)
    frame = renderer.render(renderer.view(0))  # compiles, and fills the pool of textures
    wall, cpu = [], []
    for _ in range(repeats):
        begun, busy = time.perf_counter(), time.process_time()
        renderer.render(renderer.view(0))
        wall.append(time.perf_counter() - begun)
        cpu.append(time.process_time() - busy)
    steps: dict[str, list[float]] = {}
    for _ in range(repeats):
        timings: dict[str, float] = {}
        renderer.render(renderer.view(0), timings=timings)
        for name, seconds in timings.items():
            steps.setdefault(name, []).append(seconds)
    return {
        "case": f"{view}: {way.name}",
        "view": view,
        "way": way.name,
        "triangles": len(asset.mesh.faces),
        "covered_mpx": float((frame.alpha > 0.0).sum()) / 1e6,
        "frame_ms": 1e3 * statistics.median(wall),
        "cpu_ms": 1e3 * statistics.median(cpu),
        "passes_ms": {name: 1e3 * statistics.median(times) for name, times in steps.items()},
        "limits": way.close if view == "close" else {},
    }


def render_text(rows: Sequence[Mapping[str, Any]]) -> str:
    """Milliseconds of whole frames by way, then of the passes of the separable method."""
    return "\n\n".join(tables.text(table) for table in render_tables(rows))


def render_tables(rows: Sequence[Mapping[str, Any]]) -> list[tables.Table]:
    """One line a way and one column a view; one line a pass and one column a view."""
    views = list(dict.fromkeys(row["view"] for row in rows))
    ways = list(dict.fromkeys(row["way"] for row in rows))
    found = {(row["view"], row["way"]): row for row in rows}

    def line(label: str, figures: Sequence[float | None]) -> list[str]:
        return [label, *("" if x is None else f"{x:,.0f}" for x in figures)]

    def frame(way: str, view: str) -> float | None:
        return found[view, way]["frame_ms"] if (view, way) in found else None

    frames = [["frame, ms", *views]]
    frames += [line(way, [frame(way, view) for view in views]) for way in ways]
    columns = [found[view, _PASSES_OF] for view in views if (view, _PASSES_OF) in found]
    names = list(dict.fromkeys(name for row in columns for name in row["passes_ms"]))
    passes = [[f"{_PASSES_OF}, ms a pass", *(row["view"] for row in columns)]]
    passes += [line(name, [row["passes_ms"].get(name) for row in columns]) for name in names]
    covered = ["skin, megapixels", *(f"{row['covered_mpx']:.3f}" for row in columns)]
    return [frames, [*passes, covered]]
