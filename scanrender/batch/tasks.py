"""A task: a job, or its preparation alone, as whoever gives out work sees it, and as plain data for
whoever does it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from scanrender import errors
from scanrender.batch.jobs import Job
from scanrender.batch.keys import Recipe
from scanrender.errors import CrashError, ScanrenderError, StageError
from scanrender.settings.pipeline import Pipeline

Event = Callable[[Job, str, float], None]
Say = Callable[[str], None]


@dataclass
class Task:
    """A job, or its preparation alone; `after` is a task that has to be done before."""

    job: Job
    only: str | None = None
    after: Task | None = None
    mib: int = 0
    tries: int = 0
    error: ScanrenderError | None = None
    is_done: bool = False
    result: dict[str, Any] = field(default_factory=dict)
    seconds: float = 0.0

    @property
    def is_ready(self) -> bool:
        return self.after is None or self.after.is_done

    @property
    def needs_gl(self) -> bool:
        return self.only != "prep" and "render" in self.job.stages


@dataclass(frozen=True)
class PoolOptions:
    """`retries` beyond the first try; `timeout_s` without a sign of life is a hang."""

    workers: int
    verify: bool = False
    retries: int = 2
    timeout_s: float = 3600.0


def patience_s(task: Task, options: PoolOptions) -> float:
    """A preparation bounds its stages itself, and explains better."""
    own = task.job.pipeline.prep.timeout_s + 60.0
    return max(options.timeout_s, own) if task.only == "prep" else options.timeout_s


def another_try(task: Task, error: CrashError, options: PoolOptions, say: Say) -> bool:
    """Whether a task whose try ended with `error` gets one more; otherwise the error is its end."""
    if task.tries <= options.retries:
        left = options.retries + 1 - task.tries
        say(f"{task.job.label}: {error.what}; trying again ({left} left)")
        return True
    tries = "" if task.tries == 1 else f", {task.tries} times"
    task.error = CrashError(f"{error.what}{tries}", error.where, error.fix)
    return False


def as_task(task: Task, verify: bool) -> dict[str, Any]:
    """A task as plain data. What the pipeline does not say stays unsaid: panels of a figure differ
    by what they set. `opens_gl`, `wait_s`: as for `job.do_job`."""
    job = task.job
    return {
        "scan": str(job.scan),
        "name": job.name,
        "pipeline": job.pipeline.model_dump(mode="json", exclude_unset=True),
        "folder": str(job.folder),
        "asset": str(job.asset),
        "part": None if job.part is None else list(job.part),
        "variant": job.variant,
        "only": task.only,
        "verify": verify,
        "opens_gl": True,
        "wait_s": 0.0,
    }


def job_of(task: dict[str, Any]) -> Job:
    """The job that `as_task` was given."""
    return Job(
        Path(task["scan"]),
        task["name"],
        Recipe(Pipeline.model_validate(task["pipeline"])),
        Path(task["folder"]),
        Path(task["asset"]),
        None if task["part"] is None else tuple(task["part"]),
        task["variant"],
    )


def as_event(error: ScanrenderError) -> dict[str, Any]:
    """An error as plain data, kind included."""
    said = {"kind": type(error).__name__, "what": error.what}
    return {"error": {**said, "where": error.where, "fix": error.fix}}


def error_of(event: dict[str, Any]) -> ScanrenderError:
    """The error that `as_event` was given."""
    error = event["error"]
    kind = getattr(errors, str(error.get("kind")), StageError)
    if not (isinstance(kind, type) and issubclass(kind, ScanrenderError)):
        kind = StageError
    return kind(str(error.get("what")), error.get("where"), error.get("fix"))
