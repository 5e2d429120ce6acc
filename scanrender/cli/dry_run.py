"""`scanrender run --dry-run`: what would be done, why, for how long, with how much disk."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import click

from scanrender.batch.estimate import Estimate, Pace, estimate
from scanrender.batch.jobs import Job
from scanrender.batch.run import Todo, sort_out
from scanrender.batch.summary import Failure

MOST_LINES = 40


def say_what_would_be_done(
    jobs: Sequence[Job], out: Path, workers: int, verify: bool, as_json: bool
) -> None:
    """Print it; nothing is written and no GL opened."""
    pace = Pace()
    found, todo = sort_out(jobs, verify, pace.learn)
    failures = [item for item in found.values() if isinstance(item, Failure)]
    work = {id(item.job): item for item in todo}
    guess = estimate(todo, pace, out, workers)
    if as_json:
        rows = [_row(job, work.get(id(job)), found.get(id(job))) for job in jobs]
        click.echo(json.dumps({"jobs": rows, **_totals(jobs, todo, guess)}, indent=2))
    else:
        _print(jobs, work, failures, guess, out, workers)
    if failures:
        raise failures[0].error


def _print(
    jobs: Sequence[Job],
    work: Mapping[int, Todo],
    failures: Sequence[Failure],
    guess: Estimate,
    out: Path,
    workers: int,
) -> None:
    cannot = {id(item.job): item.error for item in failures}
    for job in jobs[:MOST_LINES]:
        error = cannot.get(id(job))
        said = _sentence(job, work.get(id(job))) if error is None else f"fails: {error.what}"
        click.echo(f"{job.label}: {said}")
    if len(jobs) > MOST_LINES:
        click.echo(f"and {len(jobs) - MOST_LINES:,} more (--json names all)")
    todo = list(work.values())
    totals = _totals(jobs, todo, guess)
    click.echo(
        f"{len(jobs):,} jobs into {out}: {totals['complete']:,} complete, {len(todo):,} to do "
        f"({totals['to_prepare']:,} preparations, {totals['to_render']:,} frames; "
        f"{totals['cached_frames']:,} frames are there)"
    )
    if todo:
        click.echo(f"time: {_time(guess, workers)}")
        free = guess.free_bytes / 1e9
        click.echo(f"disk: about {_bytes(guess.disk_bytes)}, of {free:,.1f} GB that are free")


def _sentence(job: Job, item: Todo | None) -> str:
    stages = " + ".join(job.stages)
    if item is None:
        return f"{stages}, complete -> {job.folder}"
    frames = f"{len({*item.work.render, *item.work.dump}):,} frames"
    reasons = "; ".join(f"{stage}: {reason}" for stage, reason in item.work.reasons.items())
    return f"{stages}, {frames} -> {job.folder} ({reasons})"


def _time(guess: Estimate, workers: int) -> str:
    by = f", by {workers} workers" if workers > 1 else ""
    if guess.seconds is None:
        return "unknown: no earlier run in this folder says how long its stages take"
    jobs = f"{guess.measured_on} earlier job{'s' if guess.measured_on != 1 else ''}"
    return f"about {_duration(guess.seconds)}{by}, from the times of {jobs} in this folder"


def _duration(seconds: float) -> str:
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"


def _bytes(count: float) -> str:
    return f"{count / 1e9:,.1f} GB" if count >= 1e9 else f"{count / 1e6:,.1f} MB"


def _totals(jobs: Sequence[Job], todo: Sequence[Todo], guess: Estimate) -> dict[str, Any]:
    prepared = {item.job.asset for item in todo if "prep" in item.work.reasons}
    return {
        "complete": len(jobs) - len(todo),
        "to_prepare": len(prepared),
        "to_render": sum(len({*item.work.render, *item.work.dump}) for item in todo),
        "cached_frames": sum(item.work.cached_frames for item in todo),
        "seconds": None if guess.seconds is None else round(guess.seconds, 1),
        "measured_on": guess.measured_on,
        "disk_bytes": round(guess.disk_bytes),
        "free_bytes": guess.free_bytes,
    }


def _row(job: Job, item: Todo | None, found: Any) -> dict[str, Any]:
    named = {"scan": str(job.scan), "variant": job.variant, "folder": str(job.folder)}
    if isinstance(found, Failure):
        return {**named, "status": "fails", "what": found.error.what}
    if item is None:
        return {**named, "status": "complete"}
    frames = sorted({*item.work.render, *item.work.dump})
    return {**named, "status": "to do", "reasons": item.work.reasons, "frames": len(frames)}
