"""`scanrender render ASSET`"""

from __future__ import annotations

import json
from pathlib import Path

import click

from scanrender.cli import options


@click.command("render")
@click.argument("asset", type=click.Path(path_type=Path))
@click.option(
    "--pipeline",
    default="turntable",
    show_default=True,
    help="Pipeline file or shipped name that holds the settings.",
)
@options.overrides
@options.check
@options.out("out/render")
@click.option(
    "--frames",
    metavar="A-B",
    default="0",
    show_default=True,
    help="Frames of the turntable (0-based, inclusive); `all` adds video and sheet.",
)
@click.option("--buffers", metavar="NAMES", help="list, all, or names: a,b,c.")
@options.progress
@options.as_json
@options.debug
def command(
    asset: Path,
    pipeline: str,
    overrides: tuple[str, ...],
    check: bool,
    out: Path,
    frames: str,
    buffers: str | None,
    progress_kind: str,
    as_json: bool,
) -> None:
    """Render frames of ASSET (a folder made by prep), and dump buffers of each."""
    from scanrender.cli.progress import progress
    from scanrender.settings.loading import load_pipeline

    checked = (options.CHECK,) if check else ()
    settings = load_pipeline(pipeline, (*overrides, *checked, "stages=[render]"))
    options.existing(asset, "asset")
    count = settings.turntable.frames
    chosen = None if frames == "all" else options.frame_range(frames, count)
    dumped = list(range(count)) if chosen is None else chosen
    outputs: dict[str, object] = {"buffer_frames": tuple(dumped)}
    if buffers not in (None, "list"):
        outputs["buffers"] = options.buffer_list(buffers)
    settings = settings.model_copy(update={"outputs": settings.outputs.model_copy(update=outputs)})
    if buffers == "list":
        _list_buffers(asset, settings, as_json)
        return
    from scanrender.batch.job import run_job
    from scanrender.cli.report import print_results

    with progress(progress_kind) as show:
        result = run_job(asset, settings, out, show, chosen)
    print_results([result], as_json)


def _list_buffers(asset: Path, settings: object, as_json: bool) -> None:
    from scanrender.asset import load_asset
    from scanrender.batch.job import RENDERED_MAPS
    from scanrender.buffers import buffer_spec
    from scanrender.render.device import device
    from scanrender.render.frame import Renderer
    from scanrender.settings.pipeline import Pipeline

    assert isinstance(settings, Pipeline)
    renderer = Renderer(device(), load_asset(asset, RENDERED_MAPS), settings)
    specs = [buffer_spec(name) for name in renderer.buffer_names]
    if as_json:
        rows = [
            {"name": s.name, "unit": s.unit, "space": s.space, "meaning": s.meaning} for s in specs
        ]
        click.echo(json.dumps(rows, indent=2))
        return
    for spec in specs:
        click.echo(f"{spec.name:20} {spec.unit:12.12} {spec.meaning}")
