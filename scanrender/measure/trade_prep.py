"""`scanrender trade --prepare`: what triangles and the size of maps cost, in time and in error.

Each preparation of the scan is rendered by the way nearest to truth, and compared with the truth of
the finest one: what is left is what coarser triangles and smaller maps lose.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from itertools import product
from pathlib import Path
from typing import Any

from scanrender.asset import load_asset
from scanrender.files import make_folder, write_text
from scanrender.measure import tables
from scanrender.measure.choice import NEAREST
from scanrender.measure.prep_bench import write_rows
from scanrender.measure.render_bench import HEAD_MM, VIEWS
from scanrender.measure.trade import DIFFUSE_ALONE, measured, truth_of
from scanrender.render.device import device
from scanrender.scan.prepare import prepare
from scanrender.settings.loading import load_pipeline
from scanrender.settings.pipeline import Pipeline
from scanrender.settings.prep import PrepSettings

TRIANGLES = (5_000, 20_000, 50_000)
MAP_PX = (1024, 2048, 4096)
FINEST = (100_000, 4096)


def run_prep_trade(
    pipeline: str,
    scan: Path,
    views: Sequence[str],
    out: Path,
    say: Callable[[str], None],
    changes: Sequence[str] = (),
) -> list[dict[str, Any]]:
    """One row a view and preparation; writes OUT/preparation.json, .csv and .md.

    Preparations are kept in OUT/assets, and their seconds in asset.json. Raises ScanrenderError's
    kinds.
    """
    make_folder(out)
    settings = load_pipeline(pipeline, changes)
    ways = [*product(TRIANGLES, MAP_PX), FINEST]
    spent = {way: _prepared(scan, settings, *way, out, say) for way in ways}
    finest = load_asset(_folder(out, scan, *FINEST))
    rows: list[dict[str, Any]] = []
    for view in views:
        framing = (f"camera.height_mm={HEAD_MM / VIEWS[view]:.1f}", *changes, *DIFFUSE_ALONE)
        file = out / "truth" / f"{view}_{scan.stem}_finest.npz"
        truth = truth_of(device(), finest, pipeline, framing, file, say)
        shot = NEAREST.applied(load_pipeline(pipeline, framing))
        for triangles, map_px in ways:
            asset = load_asset(_folder(out, scan, triangles, map_px))
            rows.append({
                "case": f"{view}: {triangles} triangles, {map_px} px",
                "view": view,
                "triangles": len(asset.mesh.faces),
                "map_px": map_px,
                "prep_s": spent[triangles, map_px],
                **measured(device(), asset, shot, truth),
                "renderer": device().renderer,
            })  # fmt: skip
            say(f"{rows[-1]['case']}: dE2000 {rows[-1]['dE2000']['mean']:.3f}")
            write_rows(out, "preparation", rows)
    write_text(out / "preparation.md", _page(rows, scan))
    return rows


def _folder(out: Path, scan: Path, triangles: int, map_px: int) -> Path:
    return out / "assets" / f"{scan.stem}_{triangles}_{map_px}"


def _prepared(
    scan: Path,
    settings: Pipeline,
    triangles: int,
    map_px: int,
    out: Path,
    say: Callable[[str], None],
) -> float:
    """Seconds of this preparation, done now or found done."""
    folder = _folder(out, scan, triangles, map_px)
    if not folder.exists():
        say(f"preparing {triangles} triangles, maps of {map_px} px")
        how = settings.prep.model_dump()
        how["simplify"] = {**how["simplify"], "triangles": triangles}
        sizes = {"albedo_px": map_px, "normal_px": map_px, "data_px": min(map_px, 1024)}
        how["bake"] = {**how["bake"], **sizes}
        how["report"] = "short"
        began = time.perf_counter()
        prepare(scan, settings.scan, PrepSettings.model_validate(how), folder, maps=())
        seconds = time.perf_counter() - began
        write_text(folder.with_suffix(".seconds"), f"{seconds:.2f}\n")
    return float(folder.with_suffix(".seconds").read_text(encoding="utf-8"))


def _page(rows: Sequence[Mapping[str, Any]], scan: Path) -> str:
    head = ["view", "triangles", "maps, px", "preparation, s", "frame, ms", "dE2000 mean", "95 %"]
    body = [
        [
            row["view"], f"{row['triangles']:,}", str(row["map_px"]), f"{row['prep_s']:.1f}",
            f"{row['frame_ms']:.0f}", f"{row['dE2000']['mean']:.3f}", f"{row['dE2000']['p95']:.3f}",
        ]
        for row in rows
    ]  # fmt: skip
    return (
        "# What triangles and maps buy\n\n"
        f"{scan.stem}, each preparation rendered by {NEAREST.name} and compared with the truth of "
        f"the finest.\n\n{tables.markdown([head, *body])}\n"
    )
