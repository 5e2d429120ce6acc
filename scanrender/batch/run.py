"""Several jobs: what is done already is left alone, the rest is done here or by workers, failures
are collected, one summary is written."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from scanrender.batch.jobs import Job, make_jobs
from scanrender.batch.lock import locked
from scanrender.batch.memory import prep_mib, render_mib
from scanrender.batch.result import Result, result_of
from scanrender.batch.state import Records, Trust, Work, look, records_of
from scanrender.batch.summary import SUMMARY_NAME, Failure, write_summary
from scanrender.errors import BatchError, OutputError, ScanrenderError
from scanrender.scan.beside import forget
from scanrender.settings.pipeline import Pipeline

ENDING_S = 5.0  # for the tasks of a command that was killed to end elsewhere

Progress = Callable[[str, float], None]
Show = Callable[[Job, str, float], None]
Say = Callable[[str], None]


@dataclass(frozen=True)
class Options:
    """`workers` processes, or 0 to do everything in this one. Without `verify` sizes and times are
    believed; `retries` and `timeout_s` are for workers (`tasks.PoolOptions`). With a `scheduler`
    (`dask_link`) they are Dask's, `workers` at most at once; 0: all."""

    workers: int = 0
    verify: bool = False
    retries: int = 2
    timeout_s: float = 3600.0
    scheduler: str | None = None


@dataclass
class Batch:
    """Results in the order of the jobs, and those that failed."""

    results: list[Result] = field(default_factory=list)
    failures: list[Failure] = field(default_factory=list)

    def raise_if_failed(self) -> None:
        """One job ends with its own error, several with BatchError (exit code 8)."""
        if not self.failures:
            return
        total = len(self.results) + len(self.failures)
        if total == 1:
            raise self.failures[0].error
        failed = ", ".join(f"{_named(x.job)} ({x.error.what})" for x in self.failures)
        what = "jobs" if any(x.job.variant for x in self.failures) else "scans"
        raise BatchError(
            f"{len(self.failures)} of {total} {what} failed",
            where=failed,
            fix="the others are complete; mend or leave out these and run again",
        )


def _named(job: Job) -> str:
    return f"{job.scan.name} {job.variant}".rstrip()


@dataclass
class Todo:
    """A job that is not done, what of it is not, and memory that each half may take."""

    job: Job
    work: Work
    prep_mib: int
    render_mib: int


def run_batch(
    scans: Sequence[Path],
    pipeline: Pipeline,
    out: Path,
    progress: Progress,
    say: Say,
    frames: Sequence[int] | None = None,
) -> Batch:
    """Run every scan in this process; a scan that fails is told and left behind.

    Raises UsageError when a scan is named twice; nothing else that a single scan can cause.
    """
    jobs = make_jobs(scans, pipeline, "the pipeline", out, frames)
    return run_jobs(jobs, out, lambda _, stage, fraction: progress(stage, fraction), say)


def run_jobs(
    jobs: Sequence[Job], out: Path, show: Show, say: Say, options: Options | None = None
) -> Batch:
    """Do what is not done of the jobs, whose folders lie in `out`. A job that fails is told and
    left behind. Raises OutputError when another run works in `out`."""
    options, started = options or Options(), time.perf_counter()
    found, todo = sort_out(jobs, options.verify)
    if len(jobs) > 1:
        for job in jobs:
            if isinstance(found.get(id(job)), Result):
                show(job, "cached", 1.0)
    if todo:
        if options.workers or options.scheduler:
            alone = len(jobs) == 1
            with _held(out, any(item.job.folder == out for item in todo)):
                _run_by_workers(todo, found, show, say, options, out, alone)
        else:
            _run_here(todo, found, show, say, options, len(jobs) == 1)
    batch = Batch(
        [found[id(job)] for job in jobs if isinstance(found[id(job)], Result)],  # type: ignore[misc]
        [found[id(job)] for job in jobs if isinstance(found[id(job)], Failure)],  # type: ignore[misc]
    )
    new = todo or batch.failures or not (out / SUMMARY_NAME).exists()
    if len(jobs) > 1 and new and out.is_dir():
        write_summary(out, jobs, found, time.perf_counter() - started)
    return batch


def sort_out(
    jobs: Sequence[Job],
    verify: bool = False,
    seen: Callable[[Job, Records], None] = lambda job, records: None,
) -> tuple[dict[int, Result | Failure], list[Todo]]:
    """What is complete, or cannot be, by the job's id(); and what is to be done. `seen` gets every
    job's records: they are too large to keep those of thousands."""
    forget()
    found: dict[int, Result | Failure] = {}
    todo: list[Todo] = []
    for job in jobs:
        try:
            records = records_of(job)
            work = look(job, records, Trust(verify))
            seen(job, records)
        except ScanrenderError as error:
            found[id(job)] = Failure(job, error)
            continue
        if work.reasons:
            need = prep_mib(job, records.prep) if "prep" in work.reasons else 0
            todo.append(Todo(job, work, need, render_mib(job, records.job)))
            continue
        with contextlib.suppress(OutputError):
            records.save()
        found[id(job)] = result_of(job, records, cached=True)
    return found, todo


@contextlib.contextmanager
def _held(out: Path, is_a_jobs: bool) -> Iterator[None]:
    """`out` is this run's. Where it is a job's own folder, whoever does the job has to hold it."""
    from scanrender.files import check_writable

    check_writable(out)
    with locked(out, wait_s=ENDING_S if is_a_jobs else 0.0):
        if not is_a_jobs:
            yield
            return
    yield


def _run_here(
    todo: Sequence[Todo],
    found: dict[int, Result | Failure],
    show: Show,
    say: Say,
    options: Options,
    alone: bool,
) -> None:
    from scanrender.batch.job import do_job

    for number, job in enumerate((item.job for item in todo), 1):
        if not alone:
            what = "job" if job.variant else "scan"
            say(f"{what} {number} of {len(todo)}: {_named(job)}")

        def progress(stage: str, fraction: float, job: Job = job) -> None:
            show(job, stage, fraction)

        started = time.perf_counter()
        try:
            found[id(job)] = do_job(job, progress, options.verify)
            continue
        except ScanrenderError as error:
            failure: ScanrenderError = error
        except Exception as error:
            if alone:
                raise
            # A bug that one scan brings to light must not cost the others either.
            what = f"this is a bug in scanrender: {type(error).__name__}: {error}"
            failure = ScanrenderError(what, str(job.scan), "run it alone, --debug")
        found[id(job)] = Failure(job, failure, time.perf_counter() - started)
        if not alone:
            say(str(failure))


def _run_by_workers(
    todo: Sequence[Todo],
    found: dict[int, Result | Failure],
    show: Show,
    say: Say,
    options: Options,
    out: Path,
    alone: bool,
) -> None:
    from scanrender.batch.tasks import PoolOptions, Task

    tasks: list[Task] = []
    prepared: dict[Path, Task] = {}
    for item in todo:
        job, first = item.job, None
        if "prep" in item.work.reasons:
            if job.asset not in prepared:
                need = max(item.prep_mib, item.render_mib)
                prepared[job.asset] = Task(job, "prep", mib=need)
                tasks.append(prepared[job.asset])
            first = prepared[job.asset]
        tasks.append(Task(job, after=first, mib=item.render_mib))

    def ended(task: Task) -> None:
        if task.error is not None:
            if task.only is None:
                found[id(task.job)] = Failure(task.job, task.error, task.seconds)
                if not alone:
                    say(f"{task.job.label}: {task.error}")
                show(task.job, "failed", 1.0)
        elif task.only is None:
            found[id(task.job)] = _result(task, prepared.get(task.job.asset))
            show(task.job, "done", 1.0)

    workers = min(options.workers, len(tasks))
    shares = PoolOptions(workers, options.verify, options.retries, options.timeout_s)
    if options.scheduler is not None:
        from scanrender.batch.dask_pool import run_on_dask

        run_on_dask(options.scheduler, out, tasks, shares, show, say, ended)
        return
    from scanrender.batch.pool import Pool

    Pool(shares, show, say, ended).run(tasks)


def _result(task: object, prepared: object) -> Result:
    """A worker's result; seconds of the preparation are those of the one that many may share."""
    from scanrender.batch.tasks import Task

    assert isinstance(task, Task)
    # Its folder is the job's: a worker elsewhere has named it absolutely.
    result = Result(**{**task.result, "folder": task.job.folder})
    if isinstance(prepared, Task) and prepared.job is task.job:
        result.stages = {**prepared.result.get("stages", {}), **result.stages}
        result.cached = False
    return result
