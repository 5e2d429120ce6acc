"""`scanrender demo`"""

from __future__ import annotations

from pathlib import Path

import click

from scanrender.cli import options


@click.command("demo")
@options.out("out/demo")
@click.option(
    "--triangles",
    default=400_000,
    show_default=True,
    help="Size of the raw scan (50,000 to 5,000,000).",
)
@click.option("--seed", default=0, show_default=True, help="Another seed is another scan.")
@options.overrides
@options.check
@options.progress
@options.as_json
@options.debug
def command(
    out: Path,
    triangles: int,
    seed: int,
    overrides: tuple[str, ...],
    check: bool,
    progress_kind: str,
    as_json: bool,
) -> None:
    """Make our own raw head, scan it with all a scanner's faults, and run the demo pipeline."""
    from scanrender.cli.progress import progress
    from scanrender.cli.report import leave_report, print_results
    from scanrender.settings.loading import load_pipeline

    checked = (options.CHECK,) if check else ()
    settings = load_pipeline("demo", (*overrides, *checked))
    from scanrender.batch.job import run_job
    from scanrender.batch.run import Batch
    from scanrender.files import check_writable
    from scanrender.phantom import Damage, make_head, scan_head, write_ply

    check_writable(out)
    with progress(progress_kind) as show:
        show("raw head", 0.0)
        raw = scan_head(make_head(triangles, seed), Damage(), seed)
        scan = out / "raw_scan" / "head.ply"
        write_ply(scan, raw)
        show("raw head", 1.0)
        result = run_job(scan, settings, out, show)
    result.files.insert(0, "raw_scan/head.ply")
    print_results([result], as_json)
    leave_report(out, Batch([result]))
    if not as_json:
        click.echo(f"\nopen {out / 'contact_sheet.png'} or {out / 'turntable.mp4'}")
