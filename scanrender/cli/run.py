"""`scanrender run PIPELINE SCAN…`"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click
from click.core import ParameterSource

from scanrender.cli import options

if TYPE_CHECKING:
    from scanrender.batch.jobs import Job
    from scanrender.batch.run import Batch, Options
    from scanrender.settings.pipeline import Pipeline

OWN_HEAD_TRIANGLES = 400_000


@click.command("run")
@click.argument("pipeline", required=False)
@click.argument("scans", nargs=-1, type=click.Path(path_type=Path))
@options.overrides
@options.check
@options.out("out")
@options.jobs
@click.option("--frames", metavar="A-B", help="Only these frames (0-based, inclusive), as PNG.")
@click.option("--dry-run", is_flag=True, help="Check everything and say what would be done.")
@click.option(
    "--verify", is_flag=True, help="Believe no date: read every file of earlier runs again."
)
@click.option(
    "--from-manifest",
    type=click.Path(path_type=Path),
    help="Run again what this batch.json or manifest.json says, instead of PIPELINE and SCANS.",
)
@click.option(
    "--retries",
    default=2,
    show_default=True,
    type=click.IntRange(0, 100),
    help="Further tries for a scan whose worker died, hung or lost the GPU.",
)
@click.option(
    "--timeout",
    default=3600.0,
    show_default=True,
    type=click.FloatRange(1.0),
    help="Seconds without a sign of life after which a worker is taken to hang.",
)
@click.option(
    "--scheduler",
    metavar="ADDRESS",
    help="Work on the workers of this Dask scheduler (tcp://HOST:8786), at most --jobs at once if "
    "that is given; or `local`: on --jobs Dask workers of this machine.",
)
@options.progress
@options.as_json
@options.debug
@click.pass_context
def command(
    context: click.Context,
    pipeline: str | None,
    scans: tuple[Path, ...],
    overrides: tuple[str, ...],
    check: bool,
    out: Path,
    jobs: int,
    frames: str | None,
    dry_run: bool,
    verify: bool,
    from_manifest: Path | None,
    retries: int,
    timeout: float,
    scheduler: str | None,
    progress_kind: str,
    as_json: bool,
) -> None:
    """Run PIPELINE (a file, or the name of a shipped one) on each SCAN.

    A SCAN is a file, a folder of scans, a pattern in quotes ('scans/**/*.obj'), or the asset folder
    of an earlier preparation, which is then not done again. One scan's results go straight into
    --out, several into a folder each, and each combination of a pipeline's matrix into one below
    that. What an earlier run into --out left complete is not done again. A figure's pipeline
    (figures/fig1 …) without a scan shows our own procedural head.
    """
    from scanrender.batch.run import Options

    overrides = (*overrides, options.CHECK) if check else overrides
    if scheduler is not None:
        from scanrender.batch.dask_link import check_address

        check_address(scheduler)
    if from_manifest is not None:
        todo = _from_manifest(from_manifest, pipeline, overrides, out, frames)
    else:
        todo = _from_command_line(pipeline, scans, overrides, out, frames)
    if dry_run:
        from scanrender.cli.dry_run import say_what_would_be_done

        say_what_would_be_done(todo, out, jobs, verify, as_json)
        return
    workers = _workers(jobs, len(todo), scheduler, context)
    chosen = Options(workers, verify, retries, timeout, scheduler)
    batch = _run(todo, out, chosen, progress_kind)
    from scanrender.cli.report import leave_report, print_batch

    print_batch(batch, out, as_json)
    leave_report(out, batch)
    batch.raise_if_failed()


def _workers(jobs: int, count: int, scheduler: str | None, context: click.Context) -> int:
    """Several jobs have workers that may die without the others; one has this process to itself,
    unless it is to be tried again or stopped. A cluster has as many as it has."""
    given = {
        name
        for name in ("jobs", "retries", "timeout")
        if context.get_parameter_source(name) is not ParameterSource.DEFAULT
    }
    if scheduler is not None:
        return jobs if scheduler == "local" or "jobs" in given else 0
    return jobs if count > 1 else int(bool(given & {"retries", "timeout"}))


def _from_command_line(
    pipeline: str | None,
    scans: tuple[Path, ...],
    overrides: tuple[str, ...],
    out: Path,
    frames: str | None,
) -> list[Job]:
    from scanrender.batch.jobs import make_jobs
    from scanrender.batch.scans import find_scans
    from scanrender.errors import UsageError
    from scanrender.settings.loading import load_pipeline

    usage = "scanrender run PIPELINE SCAN --out OUT"
    if pipeline is None:
        raise UsageError("run needs a pipeline and at least one scan", fix=usage)
    settings = load_pipeline(pipeline, overrides)
    if not scans and settings.figure.panels:
        scans = (_own_head(out),)
    if not scans:
        raise UsageError("run needs at least one scan", fix=usage)
    found = find_scans(scans, out)
    return make_jobs(found, settings, pipeline, out, _part(frames, settings))


def _from_manifest(
    path: Path, pipeline: str | None, overrides: tuple[str, ...], out: Path, frames: str | None
) -> list[Job]:
    from scanrender.batch.again import jobs_of_manifest
    from scanrender.errors import UsageError

    if pipeline is not None or overrides or frames is not None:
        raise UsageError(
            "--from-manifest says pipeline, scans, settings and frames itself",
            fix="leave those out, or run the pipeline.yaml beside the manifest",
        )
    options.existing(path, "manifest")
    jobs, notes = jobs_of_manifest(path, out)
    for note in notes:
        click.echo(note, err=True)
    return jobs


def _part(frames: str | None, settings: Pipeline) -> list[int] | None:
    return options.frame_range(frames, settings.turntable.frames)


def _run(jobs: list[Job], out: Path, chosen: Options, progress_kind: str) -> Batch:
    from scanrender.batch.run import run_jobs
    from scanrender.cli.progress import batch_progress, progress

    def say(line: str) -> None:
        click.echo(line, err=True)

    if len(jobs) == 1 and chosen.scheduler is None:
        with progress(progress_kind) as show:
            return run_jobs(jobs, out, lambda _, stage, share: show(stage, share), say, chosen)
    with batch_progress(progress_kind, len(jobs)) as show_job:
        return run_jobs(
            jobs, out, lambda job, stage, share: show_job(job.label, stage, share), say, chosen
        )


def _own_head(out: Path) -> Path:
    """The demo's raw head, made once."""
    from scanrender.files import check_writable
    from scanrender.phantom import Damage, make_head, scan_head, write_ply

    scan = out / "raw_scan" / "head.ply"
    if not scan.exists():
        check_writable(out)
        write_ply(scan, scan_head(make_head(OWN_HEAD_TRIANGLES, 0), Damage(), 0))
    return scan
