"""How progress reaches a person or a render farm. Results go to stdout, narration to stderr."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import click

KINDS = ("auto", "plain", "json", "openjd", "none")
Progress = Callable[[str, float], None]

# Plain lines at most this often, so that a log of a night stays readable.
PLAIN_EVERY_S = 2.0


@contextmanager
def progress(kind: str) -> Iterator[Progress]:
    """A function (stage, fraction in [0, 1]) that shows progress in the way asked for."""
    if kind == "auto":
        kind = "bars" if sys.stderr.isatty() else "plain"
    if kind == "bars":
        with _bars() as show:
            yield show
    else:
        yield {"plain": _plain(), "json": _json, "openjd": _openjd, "none": _none}[kind]


@contextmanager
def _bars() -> Iterator[Progress]:
    from rich.console import Console
    from rich.progress import BarColumn, TaskID, TextColumn, TimeElapsedColumn, TimeRemainingColumn
    from rich.progress import Progress as Bars

    columns = (
        TextColumn("{task.description:>12}"),
        BarColumn(),
        TextColumn("{task.percentage:>3.0f} %"),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    with Bars(*columns, console=Console(stderr=True)) as bars:
        tasks: dict[str, TaskID] = {}

        def show(stage: str, fraction: float) -> None:
            if stage not in tasks:
                tasks[stage] = bars.add_task(stage, total=1.0)
            bars.update(tasks[stage], completed=fraction)

        yield show


def _plain() -> Progress:
    last_stage, last_at = "", 0.0
    started = time.monotonic()

    def show(stage: str, fraction: float) -> None:
        nonlocal last_stage, last_at
        now = time.monotonic()
        if stage != last_stage or fraction >= 1.0 or now - last_at > PLAIN_EVERY_S:
            click.echo(f"[{now - started:6.1f} s] {stage}: {fraction:4.0%}", err=True)
            last_stage, last_at = stage, now

    return show


def _json(stage: str, fraction: float) -> None:
    click.echo(json.dumps({"stage": stage, "fraction": round(fraction, 4)}), err=True)


def _openjd(stage: str, fraction: float) -> None:
    # Open Job Description reads these from stdout; a stage counts as the whole.
    click.echo(f"openjd_status: {stage}")
    click.echo(f"openjd_progress: {100.0 * fraction:.1f}")


def _none(stage: str, fraction: float) -> None:
    return None
