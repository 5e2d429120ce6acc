"""`scanrender cache list|why|verify|prune`: what a folder of results holds, and if it is whole."""

from __future__ import annotations

import json
from pathlib import Path

import click

from scanrender.cli import options


@click.group("cache")
@options.debug
def command() -> None:
    """Results are the cache: a record beside each job's files says what they were made from. These
    commands look into it."""


def _folder(command: options.F) -> options.F:
    return click.argument("out", type=click.Path(path_type=Path))(command)


@command.command("list")
@_folder
@options.as_json
@options.debug
def list_(out: Path, as_json: bool) -> None:
    """What lies below OUT: the stages of each job, their files and bytes."""
    from scanrender.batch.upkeep import list_jobs

    rows = list_jobs(options.existing(out, "folder"))
    if as_json:
        click.echo(json.dumps(rows, indent=2))
        return
    for row in rows:
        state = "complete" if row["complete"] else "not complete"
        stages = ", ".join(
            f"{name} ({stage['files']} files, {stage['bytes'] / 1e6:,.1f} MB)"
            for name, stage in row["stages"].items()
        )
        click.echo(f"{row['folder']}: {state}: {stages or 'nothing'}")
    total = sum(stage["bytes"] for row in rows for stage in row["stages"].values())
    click.echo(f"{len(rows):,} folders, {total / 1e6:,.1f} MB")


@command.command("why")
@click.argument("pipeline")
@click.argument("scans", nargs=-1, required=True, type=click.Path(path_type=Path))
@options.overrides
@options.out("out")
@click.option("--frames", metavar="A-B", help="Only these frames, as for run.")
@options.as_json
@options.debug
def why(
    pipeline: str,
    scans: tuple[Path, ...],
    overrides: tuple[str, ...],
    out: Path,
    frames: str | None,
    as_json: bool,
) -> None:
    """Why `scanrender run PIPELINE SCANS --out OUT` would do what it would do: for each stage of
    each scan that is not there any more, what differs."""
    from scanrender.batch.jobs import make_jobs
    from scanrender.batch.run import sort_out
    from scanrender.batch.scans import find_scans
    from scanrender.batch.summary import Failure
    from scanrender.settings.loading import load_pipeline

    settings = load_pipeline(pipeline, overrides)
    part = options.frame_range(frames, settings.turntable.frames)
    jobs = make_jobs(find_scans(scans, out), settings, pipeline, out, part)
    found, todo = sort_out(jobs)
    work = {id(item.job): item.work for item in todo}
    rows = []
    for job in jobs:
        result = found.get(id(job))
        reasons = {} if id(job) not in work else work[id(job)].reasons
        if isinstance(result, Failure):
            reasons = {"fails": result.error.what}
        rows.append({"scan": job.label, "folder": str(job.folder), "reasons": reasons})
    if as_json:
        click.echo(json.dumps(rows, indent=2))
        return
    for row in rows:
        click.echo(f"{row['scan']}: {'' if row['reasons'] else 'complete, nothing would be done'}")
        for stage, reason in row["reasons"].items():  # type: ignore[attr-defined]
            click.echo(f"  {stage}: {reason}")


@command.command("verify")
@_folder
@options.as_json
@options.debug
def verify(out: Path, as_json: bool) -> None:
    """Read every file below OUT and hold it to its hash. What is damaged is forgotten, so that the
    next run makes it again; then the exit code is 5."""
    from scanrender.batch.upkeep import verify_jobs
    from scanrender.errors import StageError

    checked, damaged = verify_jobs(options.existing(out, "folder"))
    if as_json:
        click.echo(json.dumps({"checked": checked, "damaged": damaged}, indent=2))
    for name in [] if as_json else damaged:
        click.echo(f"damaged: {name}")
    if damaged:
        raise StageError(
            f"{len(damaged)} of {checked} files are missing or not what was written",
            str(out),
            "run the same command again: what is damaged is made again",
        )
    if not as_json:
        click.echo(f"{checked:,} files are what was written")


@command.command("prune")
@_folder
@click.option("--dry-run", is_flag=True, help="Say what would be removed.")
@options.debug
def prune(out: Path, dry_run: bool) -> None:
    """Remove below OUT what only unfinished runs left: half-written files of processes that are
    gone, and frames that waited for their video (they are rendered again when it is wanted)."""
    from scanrender.batch.upkeep import prune_jobs

    removed, freed = prune_jobs(options.existing(out, "folder"), dry_run)
    for path in removed:
        click.echo(f"{'would remove' if dry_run else 'removed'} {path}")
    click.echo(f"{len(removed):,} leftovers, {freed / 1e6:,.1f} MB")
