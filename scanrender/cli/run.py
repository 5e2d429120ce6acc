"""`scanrender run PIPELINE SCAN…`"""

from __future__ import annotations

from pathlib import Path

import click

from scanrender.cli import options

OWN_HEAD_TRIANGLES = 400_000


@click.command("run")
@click.argument("pipeline")
@click.argument("scans", nargs=-1, type=click.Path(path_type=Path))
@options.overrides
@options.check
@options.out("out")
@click.option("--frames", metavar="A-B", help="Only these frames (0-based, inclusive), as PNG.")
@click.option("--dry-run", is_flag=True, help="Check everything and say what would be done.")
@options.progress
@options.as_json
@options.debug
def command(
    pipeline: str,
    scans: tuple[Path, ...],
    overrides: tuple[str, ...],
    check: bool,
    out: Path,
    frames: str | None,
    dry_run: bool,
    progress_kind: str,
    as_json: bool,
) -> None:
    """Run PIPELINE (a file, or the name of a shipped one) on each SCAN.

    One scan's results go straight into --out, several into a folder each. A SCAN may be the asset
    folder of an earlier preparation, which is then not done again. A figure's pipeline
    (figures/fig1 …) without a scan shows our own procedural head.
    """
    from scanrender.cli.progress import progress
    from scanrender.cli.report import print_results
    from scanrender.errors import UsageError
    from scanrender.settings.loading import load_pipeline

    checked = (options.CHECK,) if check else ()
    settings = load_pipeline(pipeline, (*overrides, *checked))
    if not scans and settings.figure.panels:
        scans = (_own_head(out),)
    if not scans:
        raise UsageError(
            "run needs at least one scan", fix="scanrender run PIPELINE SCAN --out OUT"
        )
    for scan in scans:
        options.existing(scan, "scan")
    chosen = options.frame_range(frames, settings.turntable.frames)
    if dry_run:
        from scanrender.batch.stages import stages_for

        count = len(chosen) if chosen is not None else settings.turntable.frames
        for scan in scans:
            click.echo(f"{scan}: {' + '.join(stages_for(scan, settings))}, {count} frames -> {out}")
        return
    from scanrender.batch.run import run_batch

    with progress(progress_kind) as show:
        batch = run_batch(
            scans, settings, out, show, lambda line: click.echo(line, err=True), chosen
        )
    print_results(batch.results, as_json)
    batch.raise_if_failed()


def _own_head(out: Path) -> Path:
    """The demo's raw head, made once."""
    from scanrender.files import check_writable
    from scanrender.phantom import Damage, make_head, scan_head, write_ply

    scan = out / "raw_scan" / "head.ply"
    if not scan.exists():
        check_writable(out)
        write_ply(scan, scan_head(make_head(OWN_HEAD_TRIANGLES, 0), Damage(), 0))
    return scan
