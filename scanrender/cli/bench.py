"""`scanrender bench prep` and `scanrender bench fidelity`"""

from __future__ import annotations

import json
from pathlib import Path

import click

from scanrender.cli import options

CASES = {"prep": "1m,head,chain", "fidelity": "noise_0,noise_0.1"}


@click.command("bench")
@click.argument("target", type=click.Choice(list(CASES)))
@click.option(
    "--cases",
    help="Which to run, separated by commas, or all. prep: small, 1m, head, chain, 5m, 20m, pages "
    f"[default: {CASES['prep']}]. fidelity: noise_0, noise_0.02, noise_0.05, noise_0.1, phantom "
    f"[default: {CASES['fidelity']}].",
)
@click.option(
    "--scans",
    type=click.Path(path_type=Path),
    default=Path("../shared/scans"),
    show_default=True,
    help="Folder of the real scans; cases that need one fail without it.",
)
@click.option("--plain", is_flag=True, help="prep: beside each stage, time a plain library call.")
@options.out("out/bench")
@options.as_json
@options.debug
def command(
    target: str, cases: str | None, scans: Path, plain: bool, out: Path, as_json: bool
) -> None:
    """Measure TARGET.

    prep: seconds and memory of each stage. fidelity: what 50 k triangles lose of a dense scan, in
    shape, colour and picture. A table, OUT/TARGET.json and OUT/TARGET.csv; pictures in OUT.
    """
    from scanrender.measure import fidelity, prep_bench
    from scanrender.measure.limits import missed_limits

    chosen = cases or CASES[target]

    def say(words: str) -> None:
        click.echo(words, err=True)

    if target == "prep":
        rows = prep_bench.bench_prep(prep_bench.case_list(chosen), out, scans, say, plain)
        table = prep_bench.table_text(rows)
    else:
        rows = fidelity.bench_fidelity(fidelity.fidelity_list(chosen), out, scans, say)
        table = fidelity.fidelity_text(rows)
    click.echo(json.dumps(rows, indent=2) if as_json else table)
    for sentence in missed_limits(rows):
        click.echo(f"over its limit: {sentence}", err=True)
