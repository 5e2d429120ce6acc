"""`scanrender bench prep`"""

from __future__ import annotations

import json
from pathlib import Path

import click

from scanrender.cli import options


@click.command("bench")
@click.argument("target", type=click.Choice(["prep"]))
@click.option(
    "--cases",
    default="1m,head,chain",
    show_default=True,
    help="Which to run, separated by commas: small, 1m, head, chain, 5m, 20m, pages; or all.",
)
@click.option(
    "--scans",
    type=click.Path(path_type=Path),
    default=Path("../shared/scans"),
    show_default=True,
    help="Folder of the real scans; cases that need one fail without it.",
)
@click.option("--plain", is_flag=True, help="Also time the bare library calls.")
@options.out("out/bench")
@options.as_json
@options.debug
def command(target: str, cases: str, scans: Path, plain: bool, out: Path, as_json: bool) -> None:
    """Measure TARGET: seconds, memory and fidelity, in a table, OUT/prep.json and OUT/prep.csv."""
    from scanrender.measure.prep_bench import bench_prep, case_list, missed_limits, table_text

    chosen = case_list(cases)
    rows = bench_prep(chosen, out, scans, lambda words: click.echo(words, err=True), plain)
    if as_json:
        click.echo(json.dumps(rows, indent=2))
    else:
        click.echo(table_text(rows))
    for sentence in missed_limits(rows):
        click.echo(f"over its limit: {sentence}", err=True)
