"""`scanrender bench published`: what the planned frame gains on the paper's, at equal error.

`gaussian_sum` as published: 25 samples a Gaussian and direction, the depth correction with the
normalized guide, the Lab limit, curvature from the screen, every pass ("Optimized Skin Rendering
for Scanned Models", WSCG 2016, section 4). Both frames are 1920 x 1080, close, under one lamp, in
turns; both are compared with the truth of diffuse light at every sixth pixel of every sixth row.
At equal error: `quality.max_delta_e` is asked for what the published frame is off by, and a
measured plan leaves out of that what does not show.
"""

from __future__ import annotations

import statistics
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from scanrender.asset import Asset
from scanrender.files import make_folder
from scanrender.measure import tables
from scanrender.measure.choice import choose
from scanrender.measure.prep_bench import write_rows
from scanrender.measure.render_bench import HEAD_MM, VIEWS
from scanrender.measure.trade import DIFFUSE_ALONE, error_of, truth_of
from scanrender.measure.truth_bench import (
    PUBLISHED,
    TURN,
    diffuse_alone,
    front_head,
    planned_for_turn,
    turns_ms,
    whole_frames,
)
from scanrender.render.device import Device, device
from scanrender.render.frame import Renderer
from scanrender.settings.loading import load_pipeline

CLOSE = (f"camera.height_mm={HEAD_MM / VIEWS['close']:.1f}",)
EVERY_PX = 6
TURNS = 9
_EQUAL = "planned at the published error"
_ITS_METHOD = (*PUBLISHED[:3], "diffusion.limit=none", "curvature.modulation=none")


def bench_published(
    out: Path, scans: Path, say: Callable[[str], None], asset: Path | None = None
) -> list[dict[str, Any]]:
    """One row a way; writes OUT/published.json and OUT/published.csv. `faster` is how many times
    the frame at equal error fits into this one.

    The head is `asset`, or Lee Perry-Smith's where `scans` has it, or our own. Raises
    ScanrenderError's kinds.
    """
    make_folder(out)
    name, head = front_head(out, scans, say, asset)
    gl = device()
    file = out / "truth" / f"{name}, close every {EVERY_PX}.npz"
    truth = truth_of(gl, head, "bench", (*CLOSE, *DIFFUSE_ALONE), file, say, EVERY_PX)
    frames = {
        "as published": Renderer(gl, head, load_pipeline("bench", (*CLOSE, *PUBLISHED))),
        "published, without limit and curvature": Renderer(
            gl, head, load_pipeline("bench", (*CLOSE, *_ITS_METHOD))
        ),
    }

    def error(renderer: Renderer) -> dict[str, Any]:
        return error_of(Renderer(gl, head, diffuse_alone(renderer.pipeline)), truth)

    say("planning")
    frames |= whole_frames(gl, head, CLOSE, "bench")
    bound = error(frames["as published"])["dE2000"]["mean"]
    frames[_EQUAL] = _at_equal_error(gl, head, bound, say)
    say("timing")
    times = dict(zip(frames, turns_ms(list(frames.values()), TURNS), strict=True))
    rows = [
        {
            "case": label, "frame_ms": statistics.median(times[label]),
            "faster": _times_longer(times[label], times[_EQUAL]),
            **{key: value for key, value in error(renderer).items() if key != "FLIP"},
            "method": renderer.pipeline.diffusion.model_dump(mode="json"),
            "head": name, "truth": truth["notes"], "renderer": gl.renderer,
        }
        for label, renderer in frames.items()
    ]  # fmt: skip
    rows[0]["limits"] = {"faster": (">=", 4.0)}
    rows[-1]["limits"] = {"dE2000.mean": ("<=", bound)}
    write_rows(out, "published", rows)
    return rows


def _times_longer(mine: Sequence[float], its: Sequence[float]) -> float:
    """The median over turns of how many times longer mine took."""
    return statistics.median(a / b for a, b in zip(mine, its, strict=True))


def _at_equal_error(gl: Device, head: Asset, bound: float, say: Callable[[str], None]) -> Renderer:
    settings = (*CLOSE, f"turntable.frames={TURN}", f"quality.max_delta_e={bound:.3f}")
    choice = choose(gl, head, load_pipeline("bench", settings), range(TURN), say)
    assert choice is not None
    return planned_for_turn(Renderer(gl, head, choice.pipeline))


def published_text(rows: Sequence[Mapping[str, Any]]) -> str:
    """A line a way."""
    return tables.text(published_table(rows))


def published_table(rows: Sequence[Mapping[str, Any]]) -> tables.Table:
    lines = [["1920 x 1080, close", "ms", "times the last", "dE2000 mean", "95 %"]]
    for row in rows:
        lines.append([
            row["case"], f"{row['frame_ms']:.0f}", f"{row['faster']:.2f}",
            f"{row['dE2000']['mean']:.3f}", f"{row['dE2000']['p95']:.3f}",
        ])  # fmt: skip
    return lines
