"""`scanrender bench TARGET`"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

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
    "batch": "all",
}


@dataclass(frozen=True)
class Asked:
    """What the command line says; a target reads what concerns it."""

    cases: str
    scans: Path
    asset: Path | None
    repeats: int
    plain: bool
    out: Path


Found = tuple[list[dict[str, Any]], str]  # rows, and what a person reads


@click.command("bench")
@click.argument("target", type=click.Choice(list(CASES)))
@click.option(
    "--cases",
    help="Which to run, separated by commas, or all. prep: small, 1m, head, chain, 5m, 20m, pages "
    f"[default: {CASES['prep']}]. fidelity: noise_0, noise_0.02, noise_0.05, noise_0.1, phantom "
    f"[default: {CASES['fidelity']}]. render: close, mid, far, empty "
    "[default: all]. flicker: none, gaussian_sum, separable_preintegrated, jitter "
    f"[default: {CASES['flicker']}]. plan: how many random shots [default: {CASES['plan']}]. "
    "choice: side, front, half [default: all]. truth and published have one case. batch: turn, "
    "workers, memory, jobs [default: all].",
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
    batch: frames a second against rendering alone, two workers against one, the parent's memory, a
    thousand jobs.
    A table, OUT/TARGET.json and OUT/TARGET.csv; pictures in OUT.
    """
    from scanrender.measure.limits import missed_limits

    asked = Asked(cases or CASES[target], scans, asset, repeats, plain, out)
    rows, table = MEASURE[target](asked)
    click.echo(json.dumps(rows, indent=2) if as_json else table)
    for sentence in missed_limits(rows):
        click.echo(f"over its limit: {sentence}", err=True)


def _say(words: str) -> None:
    click.echo(words, err=True)


def _prep(asked: Asked) -> Found:
    from scanrender.measure.prep_bench import bench_prep, case_list, table_text

    rows = bench_prep(case_list(asked.cases), asked.out, asked.scans, _say, asked.plain)
    return rows, table_text(rows)


def _fidelity(asked: Asked) -> Found:
    from scanrender.measure.fidelity import bench_fidelity, fidelity_list, fidelity_text

    rows = bench_fidelity(fidelity_list(asked.cases), asked.out, asked.scans, _say)
    return rows, fidelity_text(rows)


def _render(asked: Asked) -> Found:
    from scanrender.measure.chosen import chosen
    from scanrender.measure.render_bench import VIEWS, bench_render, render_text

    views = chosen(asked.cases, VIEWS)
    rows = bench_render(views, asked.out, _say, asked.asset, asked.repeats)
    return rows, render_text(rows)


def _flicker(asked: Asked) -> Found:
    from scanrender.measure.chosen import chosen
    from scanrender.measure.flicker import WAYS, bench_flicker, flicker_text

    rows = bench_flicker(chosen(asked.cases, WAYS), asked.out, _say, asked.asset)
    return rows, flicker_text(rows)


def _plan(asked: Asked) -> Found:
    from scanrender.measure.plan_bench import bench_plan, plan_text

    count = options.count(asked.cases, "--cases")
    rows = bench_plan(asked.out, asked.scans, _say, asked.asset, count)
    return rows, plan_text(rows)


def _choice(asked: Asked) -> Found:
    from scanrender.measure.choice_bench import VIEWS, bench_choice, choice_text
    from scanrender.measure.chosen import chosen

    rows = bench_choice(chosen(asked.cases, VIEWS), asked.out, asked.scans, _say)
    return rows, choice_text(rows)


def _truth(asked: Asked) -> Found:
    from scanrender.measure.truth_bench import bench_truth, truth_text

    rows = bench_truth(asked.out, asked.scans, _say, asked.asset)
    return rows, truth_text(rows)


def _published(asked: Asked) -> Found:
    from scanrender.measure.published_bench import bench_published, published_text

    rows = bench_published(asked.out, asked.scans, _say, asked.asset)
    return rows, published_text(rows)


def _batch(asked: Asked) -> Found:
    from scanrender.measure.batch_bench import CASES as KNOWN
    from scanrender.measure.batch_bench import batch_text, bench_batch
    from scanrender.measure.chosen import chosen

    rows = bench_batch(chosen(asked.cases, KNOWN), asked.out, _say)
    return rows, batch_text(rows)


MEASURE: Mapping[str, Callable[[Asked], Found]] = {
    "prep": _prep, "fidelity": _fidelity, "render": _render, "flicker": _flicker, "plan": _plan,
    "choice": _choice, "truth": _truth, "published": _published, "batch": _batch,
}  # fmt: skip
