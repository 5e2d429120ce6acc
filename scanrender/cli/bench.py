"""`scanrender bench prep`, `bench fidelity`, `bench render`, `bench flicker`, `bench plan`,
`bench choice`, `bench truth`, `bench published`"""

from __future__ import annotations

import json
from pathlib import Path

import click

from scanrender.cli import options

CASES = {
    "prep": "1m,head,chain",
    "fidelity": "noise_0,noise_0.1",
    "render": "all",
    "flicker": "none,gaussian_sum",
    "plan": "48",
    "choice": "all",
    "truth": "all",
    "published": "all",
}


@click.command("bench")
@click.argument("target", type=click.Choice(list(CASES)))
@click.option(
    "--cases",
    help="Which to run, separated by commas, or all. prep: small, 1m, head, chain, 5m, 20m, pages "
    f"[default: {CASES['prep']}]. fidelity: noise_0, noise_0.02, noise_0.05, noise_0.1, phantom "
    f"[default: {CASES['fidelity']}]. render: close, mid, far, empty "
    "[default: all]. flicker: none, gaussian_sum, separable_preintegrated, jitter "
    f"[default: {CASES['flicker']}]. plan: how many random shots [default: {CASES['plan']}]. "
    "choice: side, front, half [default: all]. truth and published have one case.",
)
@click.option(
    "--scans",
    type=click.Path(path_type=Path),
    default=Path("../shared/scans"),
    show_default=True,
    help="Folder of the real scans; cases that need one fail without it.",
)
@click.option(
    "--asset",
    type=click.Path(path_type=Path),
    help="render, flicker, plan, truth, published: a prepared folder, instead of our own head with "
    "50 k triangles, or of the real ones.",
)
@click.option(
    "--repeats",
    type=click.IntRange(1, 1000),
    default=5,
    show_default=True,
    help="render: frames of which the median counts.",
)
@click.option("--plain", is_flag=True, help="prep: beside each stage, time a plain library call.")
@options.out("out/bench")
@options.as_json
@options.debug
def command(
    target: str,
    cases: str | None,
    scans: Path,
    asset: Path | None,
    repeats: int,
    plain: bool,
    out: Path,
    as_json: bool,
) -> None:
    """Measure TARGET.

    prep: seconds and memory of each stage. fidelity: what 50 k triangles lose of a dense scan, in
    shape, colour and picture. render: milliseconds of a 1080p frame by method and by pass.
    flicker: what changes on the same point of the skin from frame to frame of the turntable.
    plan: how far planned frames are from everything on, and how much faster, on random shots.
    choice: whether what quality.max_delta_e and budget_ms pick is as near and fast as they promise.
    truth: each method against the truth, and what a frame of 512 px takes.
    published: what a planned frame gains on the method as published, at equal error.
    A table, OUT/TARGET.json and OUT/TARGET.csv; pictures in OUT.
    """
    from scanrender.measure import (
        choice_bench,
        fidelity,
        flicker,
        plan_bench,
        prep_bench,
        published_bench,
        render_bench,
        truth_bench,
    )
    from scanrender.measure.chosen import chosen
    from scanrender.measure.limits import missed_limits

    named = cases or CASES[target]

    def say(words: str) -> None:
        click.echo(words, err=True)

    if target == "prep":
        rows = prep_bench.bench_prep(prep_bench.case_list(named), out, scans, say, plain)
        table = prep_bench.table_text(rows)
    elif target == "render":
        views = chosen(named, render_bench.VIEWS)
        rows = render_bench.bench_render(views, out, say, asset, repeats)
        table = render_bench.render_text(rows)
    elif target == "flicker":
        rows = flicker.bench_flicker(chosen(named, flicker.WAYS), out, say, asset)
        table = flicker.flicker_text(rows)
    elif target == "plan":
        rows = plan_bench.bench_plan(out, scans, say, asset, options.count(named, "--cases"))
        table = plan_bench.plan_text(rows)
    elif target == "choice":
        views = chosen(named, choice_bench.VIEWS)
        rows = choice_bench.bench_choice(views, out, scans, say)
        table = choice_bench.choice_text(rows)
    elif target == "truth":
        rows = truth_bench.bench_truth(out, scans, say, asset)
        table = truth_bench.truth_text(rows)
    elif target == "published":
        rows = published_bench.bench_published(out, scans, say, asset)
        table = published_bench.published_text(rows)
    else:
        rows = fidelity.bench_fidelity(fidelity.fidelity_list(named), out, scans, say)
        table = fidelity.fidelity_text(rows)
    click.echo(json.dumps(rows, indent=2) if as_json else table)
    for sentence in missed_limits(rows):
        click.echo(f"over its limit: {sentence}", err=True)
