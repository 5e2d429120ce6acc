"""`scanrender trade PIPELINE [SCAN]`"""

from __future__ import annotations

import json
import os
from pathlib import Path

import click

from scanrender.cli import options


@click.command("trade")
@click.argument("pipeline", default="trade")
@click.argument("scan", required=False, type=click.Path(path_type=Path))
@click.option(
    "--views",
    default="close,mid,far",
    show_default=True,
    help="Which of close, mid and far: a head of 90, 45 or 15 % of the picture's height.",
)
@click.option(
    "--prepare",
    "prepares",
    is_flag=True,
    help="Study triangles and map sizes of SCAN, a raw scan, instead.",
)
@options.overrides
@options.out("out/trade")
@options.as_json
@options.debug
def command(
    pipeline: str,
    scan: Path | None,
    views: str,
    prepares: bool,
    overrides: tuple[str, ...],
    out: Path,
    as_json: bool,
) -> None:
    """Measure what each setting of PIPELINE costs in time and in error against the truth.

    SCAN is a scan or a prepared folder; without it our own head. A study that was stopped goes on
    where it was. Lamps only: the truth of environment maps is not integrated.
    """
    # Before NumPy: the truth shares its work among forked processes, and a BLAS with threads of its
    # own would take every core twice.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    from scanrender.measure.chosen import chosen
    from scanrender.measure.own_head import own_head
    from scanrender.measure.trade import run_trade
    from scanrender.measure.trade_page import write_page
    from scanrender.settings.loading import load_pipeline

    def say(text: str) -> None:
        click.echo(text, err=True)

    names = chosen(views, ("close", "mid", "far"))
    settings = load_pipeline(pipeline, overrides)
    if prepares:
        _study_preparation(pipeline, scan, names, out, overrides, as_json)
        return
    asset = own_head(out, say) if scan is None else options.existing(scan, "scan")
    if not (asset / "asset.json").exists():
        from scanrender.scan.prepare import prepare

        asset = out / "assets" / asset.stem
        if not asset.exists():
            say(f"preparing {scan}")
            assert scan is not None
            prepare(scan, settings.scan, settings.prep, asset)
    rows = run_trade(pipeline, asset, names, out, say, overrides)
    words = ["scanrender trade", pipeline, *([scan.name] if scan else []), "--views", views]
    files = write_page(out, rows, " ".join([*words, *(f"--set {text}" for text in overrides)]))
    if as_json:
        click.echo(json.dumps(rows, indent=2))
    else:
        click.echo("\n".join(str(file) for file in files))


def _study_preparation(
    pipeline: str,
    scan: Path | None,
    views: list[str],
    out: Path,
    overrides: tuple[str, ...],
    as_json: bool,
) -> None:
    from scanrender.asset import is_asset
    from scanrender.errors import UsageError
    from scanrender.measure.trade_prep import run_prep_trade

    if scan is None or is_asset(options.existing(scan, "scan")):
        raise UsageError(
            "--prepare needs a raw scan", fix="scanrender trade --prepare PIPELINE SCAN"
        )
    rows = run_prep_trade(
        pipeline, scan, views, out, lambda text: click.echo(text, err=True), overrides
    )
    click.echo(json.dumps(rows, indent=2) if as_json else str(out / "preparation.md"))
