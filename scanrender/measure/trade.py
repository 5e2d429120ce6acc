"""`scanrender trade`: what each setting costs in time and in error against the truth.

The error is against `truth_mean` (reference/truth.py) of the same shot: colour difference on the
skin after the sRGB view. The truth is supersampled 2 x 2 for every point, so that a picture with
one sample a pixel pays for its aliasing. Finished points are kept in OUT/trade.json, truths in
OUT/truth; a study that was stopped goes on where it was.
"""

from __future__ import annotations

import hashlib
import json
import statistics
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from scanrender.asset import Asset, load_asset
from scanrender.buffers import Frame
from scanrender.files import atomic_path, make_folder
from scanrender.measure.compare import Picture, compare_pictures
from scanrender.measure.knobs import name_of, overrides, points
from scanrender.measure.prep_bench import write_rows
from scanrender.measure.render_bench import HEAD_MM, VIEWS
from scanrender.metrics import DEFAULT_PPD
from scanrender.reference.points import PictureCamera
from scanrender.reference.truth import truth_picture
from scanrender.render.device import Device, device
from scanrender.render.frame import Renderer
from scanrender.render.samples import sample_offsets_px
from scanrender.render.scene import profile_of
from scanrender.settings.loading import load_pipeline
from scanrender.settings.pipeline import Pipeline

TRUTH_SUPERSAMPLING = 2
# Frames of which the median counts: three, and more where they are quick, since a GPU that has just
# woken is slow for its first ones.
REPEATS, MOST_REPEATS, MEASURED_S = 3, 50, 0.5
SURE_SKIN = 0.99
# The truth is of diffuse light: whatever the pipeline says, the study leaves the rest out.
DIFFUSE_ALONE = ("skin.specular.strength=0", "skin.transmission.method=none")


def run_trade(
    pipeline: str,
    asset_folder: Path,
    views: Sequence[str],
    out: Path,
    say: Callable[[str], None],
    changes: Sequence[str] = (),
) -> list[dict[str, Any]]:
    """One row a view and point, written to OUT/trade.json and OUT/trade.csv as they are made.

    `changes` override the pipeline's settings. Raises ScanrenderError's kinds; ConfigError for
    lights whose truth cannot be integrated.
    """
    make_folder(out)
    asset, gl = load_asset(asset_folder), device()
    stamp = _stamp(asset_folder, pipeline, changes)
    rows = _kept(out / "trade.json", stamp, gl.renderer)
    for view in views:
        framing = (f"camera.height_mm={HEAD_MM / VIEWS[view]:.1f}", *changes, *DIFFUSE_ALONE)
        waiting = [p for p in points() if not any(_is(row, view, p) for row in rows)]
        if not waiting:
            say(f"{view}: all {len(points())} points are measured already")
            continue
        truth = truth_of(gl, asset, pipeline, framing, out / "truth" / f"{view}_{stamp}.npz", say)
        for number, point in enumerate(waiting):
            row = {
                "case": f"{view}: {name_of(point)}", "view": view, "point": point,
                **measured(
                    gl, asset, load_pipeline(pipeline, (*framing, *overrides(point))), truth
                ),
                "truth": truth["notes"], "renderer": gl.renderer, "stamp": stamp,
            }  # fmt: skip
            rows.append(row)
            write_rows(out, "trade", rows)
            said = f"{row['frame_ms']:.0f} ms, dE2000 {row['dE2000']['mean']:.3f}"
            say(f"{number + 1} of {len(waiting)}: {row['case']}: {said}")
    return rows


def measured(
    gl: Device, asset: Asset, settings: Pipeline, truth: Mapping[str, Any]
) -> dict[str, Any]:
    """Median milliseconds of a frame, and its figures against the truth."""
    renderer = Renderer(gl, asset, settings)
    frame = renderer.render(renderer.view(0))  # compiles, and fills the pool of textures
    seconds: list[float] = []
    while len(seconds) < REPEATS or (sum(seconds) < MEASURED_S and len(seconds) < MOST_REPEATS):
        begun = time.perf_counter()
        renderer.render(renderer.view(0))
        seconds.append(time.perf_counter() - begun)
    figures = error_of(renderer, truth, frame)
    return {"frame_ms": 1e3 * statistics.median(seconds), **figures}


def error_of(
    renderer: Renderer,
    truth: Mapping[str, Any],
    frame: Frame | None = None,
    integral: str = "truth_mean",
) -> dict[str, Any]:
    """Every figure of a picture (its first frame, where none is given) against a truth."""
    frame = frame or renderer.render(renderer.view(0))
    skin = truth["skin"] * (truth["coverage"] == 1.0)
    mine = Picture(frame.buffers["beauty"].astype(np.float64), frame.alpha, skin)
    right = Picture(truth[integral], truth["coverage"], (skin > SURE_SKIN).astype(np.float64))
    figures, _ = compare_pictures(mine, right, "skin", DEFAULT_PPD)
    return {k: v for k, v in figures.items() if k not in ("silhouette_leak", "border_leak")}


def truth_of(
    gl: Device,
    asset: Asset,
    pipeline: str,
    framing: Sequence[str],
    file: Path,
    say: Callable[[str], None],
    every_px: int = 1,
    convergence_spots: int = 24,
) -> dict[str, Any]:
    """truth_mean, truth_sum, coverage, skin (arrays) and notes (seconds, convergence); kept in
    `file`. Coverage is 0 in rows and columns that `every_px` leaves out."""
    if file.exists():
        with np.load(file, allow_pickle=False) as stored:
            arrays: dict[str, Any] = {key: stored[key] for key in stored.files if key != "notes"}
            return {**arrays, "notes": json.loads(str(stored["notes"]))}
    settings = load_pipeline(pipeline, framing)
    renderer = Renderer(gl, asset, settings)
    view = renderer.view(0)
    shot = renderer.scene.shot(renderer.camera.turned(view.camera_deg), view.subject_deg)
    size_px, offsets_px = renderer.camera.size_px, sample_offsets_px(TRUTH_SUPERSAMPLING)
    camera = PictureCamera(
        shot.view_from_world, shot.world_from_object, shot.clip_from_view, size_px, offsets_px,
        every_px,
    )  # fmt: skip
    say(f"integrating the truth, {size_px[0]} x {size_px[1]}, {len(offsets_px)} samples a pixel")
    begun = time.perf_counter()
    found = truth_picture(
        asset, renderer.pipeline, profile_of(settings.skin), camera,
        convergence_spots=convergence_spots,
    )  # fmt: skip
    assert found.convergence is not None
    notes = {
        "seconds": round(time.perf_counter() - begun, 1),
        "halving_dE2000": asdict(found.convergence.truth_mean),
        "spacing_mm": found.quality.spacing_mm,
    }
    halved = found.convergence.truth_mean.mean
    say(f"  {notes['seconds']} s; half its spacing moves it by dE2000 {halved:.3f}")
    arrays = {
        "truth_mean": found.truth_mean, "truth_sum": found.truth_sum,
        "coverage": found.coverage, "skin": found.skin,
    }  # fmt: skip
    make_folder(file.parent)
    with atomic_path(file) as beside:
        np.savez_compressed(beside, notes=np.array(json.dumps(notes)), **arrays)
    return {**arrays, "notes": notes}


def _is(row: Mapping[str, Any], view: str, point: Mapping[str, Any]) -> bool:
    return bool(row["view"] == view and row["point"] == point)


def _kept(file: Path, stamp: str, renderer: str) -> list[dict[str, Any]]:
    """Rows of an earlier run of this very study on this device."""
    if not file.exists():
        return []
    rows = json.loads(file.read_text(encoding="utf-8"))["rows"]
    return [row for row in rows if (row["stamp"], row["renderer"]) == (stamp, renderer)]


def _stamp(asset: Path, pipeline: str, changes: Sequence[str]) -> str:
    """What the truth depends on: the asset as it was prepared, and the shot."""
    shot = load_pipeline(pipeline, changes).model_dump_json()
    prepared = (asset / "asset.json").read_bytes()
    return hashlib.sha256(prepared + shot.encode()).hexdigest()[:12]


def pareto(rows: Sequence[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """The rows that no other beats in both time and error, the fastest first."""
    best: list[Mapping[str, Any]] = []
    for row in sorted(rows, key=lambda r: (r["frame_ms"], r["dE2000"]["mean"])):
        if not best or row["dE2000"]["mean"] < best[-1]["dE2000"]["mean"]:
            best.append(row)
    return best
