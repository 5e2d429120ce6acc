"""`scanrender prep SCAN`"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from scanrender.cli import options

if TYPE_CHECKING:
    from scanrender.asset import Asset


@click.command("prep")
@click.argument("scan", type=click.Path(path_type=Path))
@click.option(
    "--pipeline",
    default="prep_only",
    show_default=True,
    help="Pipeline file or shipped name that holds the settings.",
)
@options.overrides
@options.out("out/asset")
@click.option(
    "--as-is",
    is_flag=True,
    help="Keep the raw triangles, and texture coordinates if they fit one map.",
)
@options.progress
@options.as_json
@options.debug
def command(
    scan: Path,
    pipeline: str,
    overrides: tuple[str, ...],
    out: Path,
    as_is: bool,
    progress_kind: str,
    as_json: bool,
) -> None:
    """Prepare SCAN into the asset folder --out, which Blender or any glTF viewer opens too."""
    from scanrender.scan.child import started_early

    with started_early(
        {"prepare": {}}, own_group=True
    ):  # it loads its libraries beside this process
        asset, sheet = _prepared(scan, pipeline, overrides, out, as_is, progress_kind)
    if as_json:
        click.echo(json.dumps({"asset": str(out), **asset.info}, indent=2))
        return
    low, high = asset.mesh.bounds_mm
    size = " x ".join(f"{side:.0f}" for side in high - low)
    maps = ", ".join(asset.info["maps"])
    click.echo(f"{out}/: {len(asset.mesh.faces):,} triangles, {size} mm, maps: {maps}")
    for sentence in _what_was_done(asset.info["stages"]):
        click.echo(f"  {sentence}")
    if sheet is not None:
        click.echo(f"  what was done and lost: {sheet}")
    for sentence in asset.info.get("warnings", []):
        click.echo(f"  warning: {sentence}")


def _prepared(
    scan: Path,
    pipeline: str,
    overrides: tuple[str, ...],
    out: Path,
    as_is: bool,
    progress_kind: str,
) -> tuple[Asset, Path | None]:
    """The asset without its maps, and where the picture sheet is, if there is one."""
    from scanrender.cli.progress import progress
    from scanrender.settings.loading import load_pipeline

    settings = load_pipeline(pipeline, overrides)
    options.existing(scan, "scan")
    from scanrender.asset import check_replaceable
    from scanrender.batch.prep_report import draw_prep_sheet
    from scanrender.files import check_writable
    from scanrender.scan.prepare import prepare

    check_writable(out.parent)
    check_replaceable(out)
    with progress(progress_kind) as show:
        asset = prepare(
            scan, settings.scan, settings.prep, out, progress=show, as_is=as_is, maps=()
        )
        return asset, draw_prep_sheet(out)


def _what_was_done(stages: Iterable[Mapping[str, Any]]) -> Iterator[str]:
    """The cleaning steps that changed something, and what stopped the simplification."""
    notes = {stage["name"]: stage["notes"] for stage in stages}
    changes = []
    for step in notes.get("clean", {}).get("steps", ()):
        counts = [
            f"{kind} {before:,} → {after:,}"
            for kind in ("faces", "vertices")
            for before, after in (step[kind],)
            if before != after
        ]
        others = [
            f"{count:,} {key.replace('_', ' ')}"
            for key, count in step.items()
            if isinstance(count, int) and count
        ]
        if counts or others:
            changes.append(f"{step['step']}: {', '.join(counts + others)}")
    yield f"cleaned: {'; '.join(changes) or 'nothing to do'}"
    if "stopped_by" in notes.get("simplify", {}):
        yield f"simplified: {notes['simplify']['stopped_by']}"
