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
# (name of the job, stage, fraction in [0, 1]); its last stage is `done`, `failed` or `cached`.
BatchProgress = Callable[[str, str, float], None]

# Plain lines at most this often, so that a log of a night stays readable.
PLAIN_EVERY_S = 2.0
BATCH_EVERY_S = 10.0
ENDS = ("done", "failed", "cached")


@contextmanager
def progress(kind: str) -> Iterator[Progress]:
    """A function (stage, fraction in [0, 1]) that shows progress in the way asked for."""
    kind = _resolved(kind)
    if kind == "bars":
        with _bars() as show:
            yield show
    else:
        yield {"plain": _plain(), "json": _json, "openjd": _openjd, "none": _none}[kind]


@contextmanager
def batch_progress(kind: str, total: int) -> Iterator[BatchProgress]:
    """The same for a batch of `total` jobs."""
    kind = _resolved(kind)
    if kind == "bars":
        with _batch_bars(total) as show:
            yield show
        return
    count = _Count(total)
    tell = {
        "plain": _batch_plain(count),
        "json": _batch_json,
        "openjd": _batch_openjd,
        "none": _batch_none,
    }[kind]

    def counted(name: str, stage: str, fraction: float) -> None:
        count.see(name, stage, fraction)
        if stage != "cached":  # a thousand lines that say nothing
            tell(count, name, stage, fraction)

    yield counted


def _resolved(kind: str) -> str:
    if kind == "auto":
        return "bars" if sys.stderr.isatty() else "plain"
    return kind


class _Count:
    """How far a batch is: jobs that ended, and shares of those that run."""

    def __init__(self, total: int) -> None:
        self.total, self.ended, self.failed = total, 0, 0
        self.running: dict[str, tuple[str, float]] = {}

    def see(self, name: str, stage: str, fraction: float) -> None:
        if stage in ENDS:
            self.running.pop(name, None)
            self.ended += 1
            self.failed += stage == "failed"
        else:
            self.running[name] = stage, fraction

    @property
    def fraction(self) -> float:
        return (self.ended + sum(share for _, share in self.running.values()) / 2.0) / self.total


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


@contextmanager
def _batch_bars(total: int) -> Iterator[BatchProgress]:
    """One bar for the batch, one for each scan that is being worked on."""
    from rich.console import Console
    from rich.progress import BarColumn, TaskID, TextColumn, TimeElapsedColumn, TimeRemainingColumn
    from rich.progress import Progress as Bars

    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.fields[stage]}"),
        TimeElapsedColumn(),
        TimeRemainingColumn(),
    )
    with Bars(*columns, console=Console(stderr=True)) as bars:
        whole = bars.add_task("all", total=total, stage="")
        running: dict[str, TaskID] = {}
        count = _Count(total)

        def show(name: str, stage: str, fraction: float) -> None:
            count.see(name, stage, fraction)
            failed = f", {count.failed} failed" if count.failed else ""
            said = f"{count.ended} of {total}{failed}"
            bars.update(whole, completed=total * count.fraction, stage=said)
            if stage in ENDS:
                if name in running:
                    bars.remove_task(running.pop(name))
                return
            if name not in running:
                running[name] = bars.add_task(name, total=1.0, stage=stage)
            bars.update(running[name], completed=fraction, stage=stage)

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


def _batch_plain(_: _Count) -> Callable[[_Count, str, str, float], None]:
    """A line for each job that begins, ends, or has been at work for a while."""
    last: dict[str, float] = {}
    started = time.monotonic()

    def show(count: _Count, name: str, stage: str, fraction: float) -> None:
        now = time.monotonic()
        if stage in ENDS or name not in last or now - last[name] > BATCH_EVERY_S:
            share = "" if stage in ENDS else f": {fraction:4.0%}"
            where = f"{count.ended} of {count.total}"
            click.echo(f"[{now - started:7.1f} s] {where} | {name}: {stage}{share}", err=True)
            last[name] = now
        if stage in ENDS:
            last.pop(name, None)

    return show


def _json(stage: str, fraction: float) -> None:
    click.echo(json.dumps({"stage": stage, "fraction": round(fraction, 4)}), err=True)


def _batch_json(count: _Count, name: str, stage: str, fraction: float) -> None:
    said = {"scan": name, "stage": stage, "fraction": round(fraction, 4)}
    whole = {"ended": count.ended, "failed": count.failed, "total": count.total}
    click.echo(json.dumps({**said, **whole}), err=True)


def _openjd(stage: str, fraction: float) -> None:
    # Open Job Description reads these from stdout; a stage counts as the whole.
    click.echo(f"openjd_status: {stage}")
    click.echo(f"openjd_progress: {100.0 * fraction:.1f}")


def _batch_openjd(count: _Count, name: str, stage: str, _: float) -> None:
    click.echo(f"openjd_status: {name}: {stage}")
    click.echo(f"openjd_progress: {100.0 * count.fraction:.1f}")


def _none(stage: str, fraction: float) -> None:
    return None


def _batch_none(count: _Count, name: str, stage: str, fraction: float) -> None:
    return None
