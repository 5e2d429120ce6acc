"""What a finished command prints on stdout."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from scanrender.batch.result import Result
    from scanrender.batch.run import Batch
    from scanrender.batch.summary import Failure

MOST_BLOCKS = 20
SUMMARY_NAME = "batch.json"


def print_results(results: Sequence[Result], as_json: bool) -> None:
    """Where things are, one block a scan; or one JSON document."""
    if as_json:
        click.echo(json.dumps([result.as_json() for result in results], indent=2))
        return
    for result in results:
        _print_result(result)


def print_batch(batch: Batch, out: Path, as_json: bool) -> None:
    """Failures first, then where things are; a thousand finished jobs are one line."""
    results, failures = batch.results, batch.failures
    if as_json:
        rows = [_failure_as_json(failure) for failure in failures]
        click.echo(json.dumps([*rows, *(result.as_json() for result in results)], indent=2))
        return
    if len(results) + len(failures) == 1:
        print_results(results, False)
        return
    for failure in failures:
        click.echo(f"failed: {failure.job.label}: {failure.error}")
    done = [result for result in results if not result.cached]
    for result in done[:MOST_BLOCKS]:
        _print_result(result)
    if len(done) > MOST_BLOCKS:
        click.echo(f"and {len(done) - MOST_BLOCKS:,} more in {out}/")
    complete = len(results) - len(done)
    click.echo(
        f"{len(done):,} done, {complete:,} complete before, {len(failures):,} failed; "
        f"all in {out / SUMMARY_NAME}"
    )


def _failure_as_json(failure: Failure) -> dict[str, Any]:
    error = failure.error
    said = {"what": error.what, "where": error.where, "fix": error.fix}
    return {
        "scan": failure.job.label,
        "folder": str(failure.job.folder),
        "status": "failed",
        "error": {**said, "exit_code": error.exit_code},
    }


def _print_result(result: Result) -> None:
    click.echo(f"{result.name}: {result.folder}/")
    for name in _collapsed(result.files):
        click.echo(f"  {name}")
    if result.cached:
        click.echo("  nothing to do: it is complete")
    else:
        spent = ", ".join(f"{name} {seconds:.1f} s" for name, seconds in result.stages.items())
        click.echo(f"  time: {spent}")
    for line in _quality(result.quality):
        click.echo(f"  {line}")
    for sentence in result.warnings:
        click.echo(f"  warning: {sentence}")
    for sentence in result.decisions:
        click.echo(f"  not run: {sentence}")


def _quality(found: Mapping[str, Any]) -> list[str]:
    """What was picked for the quality that was asked for, predicted and measured."""
    if not found:
        return []
    short = "" if found["satisfies"] else " (the nearest there is: it does not satisfy the wish)"
    took = "" if found["measured_ms"] is None else f", took {found['measured_ms']:.0f} ms"
    return [
        f"quality: {found['picked']}{short}",
        f"  predicted dE2000 {found['predicted_delta_e']:.2f} to truth and "
        f"{found['predicted_ms']:.0f} ms a frame{took}",
    ]


def _collapsed(files: Sequence[str]) -> list[str]:
    """Many files of one folder become one line."""
    folders: dict[str, int] = {}
    lines = []
    for name in files:
        folder, slash, rest = name.partition("/")
        if slash and rest:
            folders[folder] = folders.get(folder, 0) + 1
        else:
            lines.append(name)
    return [*lines, *(f"{folder}/ ({count} files)" for folder, count in folders.items())]


def leave_report(out: Path, batch: Batch) -> None:
    """report.html. Results that are complete do not fail for the want of a page about them."""
    from scanrender.batch.report import report_of_run
    from scanrender.errors import ScanrenderError

    try:
        page = report_of_run(out, batch)
    except ScanrenderError as error:
        click.echo(f"no report: {error}", err=True)
        return
    if page is not None:
        click.echo(f"report: {page}", err=True)
