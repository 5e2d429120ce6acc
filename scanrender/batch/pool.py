"""Workers and their tasks, seen from the parent: one thread, one loop, no locks.

A worker that dies, hangs or loses its GPU costs one try of its task, which another worker repeats;
what a scan itself causes is not tried again. Workers are started by the main thread, to whose life
Linux ties them (`worker.tie_to_parent`).
"""

from __future__ import annotations

import contextlib
import json
import os
import selectors
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO, Any

from scanrender import errors
from scanrender.batch.jobs import Job
from scanrender.batch.leftovers import clean_leftovers
from scanrender.batch.lock import drop_unheld
from scanrender.batch.log import LOG_NAME
from scanrender.batch.memory import free_mib
from scanrender.batch.worker import as_task
from scanrender.errors import CrashError, ScanrenderError, StageError
from scanrender.files import SCRATCH_PREFIX, clean_stale
from scanrender.scan.child import PARENT
from scanrender.scan.parallel import THREADS

STOP_S = 5.0  # for a worker to remove what it has half-written
TICK_S = 0.5
START_S = 120.0

Event = Callable[[Job, str, float], None]


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


@dataclass
class Worker:
    process: subprocess.Popen[bytes]
    stderr: IO[bytes]
    task: Task | None = None
    stage: str = ""
    deadline: float = 0.0
    began: float = 0.0
    rest: bytes = b""


@dataclass(frozen=True)
class PoolOptions:
    """`retries` beyond the first try; `timeout_s` without a sign of life is a hang."""

    workers: int
    verify: bool = False
    retries: int = 2
    timeout_s: float = 3600.0


class Pool:
    """Runs tasks. `show` is told how each goes on, `say` gets sentences for people, `ended` each
    task that will not be touched again."""

    def __init__(
        self,
        options: PoolOptions,
        show: Event,
        say: Callable[[str], None],
        ended: Callable[[Task], None],
    ) -> None:
        self.options, self.show, self.say, self.ended = options, show, say, ended
        self.workers: list[Worker] = []
        self.free_mib = free_mib()
        self._said_memory = False
        self._selector = selectors.DefaultSelector()

    def run(self, tasks: Sequence[Task]) -> None:
        """Until every task is done or has failed. What is interrupted leaves nothing running and
        nothing half-written behind."""
        waiting = list(tasks)
        try:
            while waiting or any(worker.task for worker in self.workers):
                self._give_out(waiting)
                self._listen(waiting)
        finally:
            self._stop()

    def _give_out(self, waiting: list[Task]) -> None:
        """Tasks that can begin, to workers that have none."""
        for task in list(waiting):
            if task.after is not None and task.after.error is not None:
                waiting.remove(task)
                task.error = task.after.error
                self.ended(task)
            elif task.is_ready:
                running = [worker for worker in self.workers if worker.task]
                if len(running) >= self.options.workers or not self._fits(task, running):
                    return
                waiting.remove(task)
                self._begin(task)

    def _fits(self, task: Task, running: Sequence[Worker]) -> bool:
        used = sum(worker.task.mib for worker in running if worker.task)
        if not running or self.free_mib is None or used + task.mib <= self.free_mib:
            return True
        if not self._said_memory:
            self._said_memory = True
            self.say(
                f"{len(running)} of {self.options.workers} workers for now: the next scan "
                f"({task.job.label}) may need {task.mib:,} MiB, and of {self.free_mib:,} MiB that "
                f"were free {used:,} are taken"
            )
        return False

    def _begin(self, task: Task) -> None:
        worker = next((w for w in self.workers if w.task is None), None) or self._start()
        task.tries += 1
        worker.task, worker.stage, worker.began = task, task.only or "start", time.monotonic()
        # Until the first sign of life Python starts and libraries load, from a busy disk perhaps.
        worker.deadline = worker.began + max(START_S, self._patience(task))
        line = json.dumps(as_task(task.job, task.only, self.options.verify)) + "\n"
        assert worker.process.stdin is not None
        with contextlib.suppress(OSError):  # it is dead already: listening will tell
            worker.process.stdin.write(line.encode())
            worker.process.stdin.flush()

    def _patience(self, task: Task) -> float:
        """A preparation bounds its stages itself, and explains better."""
        own = task.job.pipeline.prep.timeout_s + 60.0
        return max(self.options.timeout_s, own) if task.only == "prep" else self.options.timeout_s

    def _listen(self, waiting: list[Task]) -> None:
        for key, _ in self._selector.select(TICK_S):
            worker: Worker = key.data
            data = os.read(key.fd, 1 << 16)
            if not data:
                self._died(worker, waiting)
                continue
            *lines, worker.rest = (worker.rest + data).split(b"\n")
            for line in lines:
                self._event(worker, json.loads(line), waiting)
        now = time.monotonic()
        for worker in list(self.workers):
            if worker.task is not None and now > worker.deadline:
                stage, waited = worker.stage, self._patience(worker.task)
                what = f"the stage '{stage}' gave no sign of life for {waited:g} s and was stopped"
                self._lost(
                    worker, CrashError(what, fix="raise --timeout if it needs longer"), waiting
                )

    def _event(self, worker: Worker, event: dict[str, Any], waiting: list[Task]) -> None:
        task = worker.task
        if task is None:
            return
        if "stage" in event:
            worker.stage = event["stage"]
            worker.deadline = time.monotonic() + self._patience(task)
            self.show(task.job, event["stage"], event["fraction"])
            return
        if "error" in event:
            error = _rebuilt(event["error"])
            if isinstance(error, CrashError):
                self._lost(worker, error, waiting)
                return
            task.error = error
        else:
            task.is_done, task.result = True, event["done"]
        task.seconds += time.monotonic() - worker.began
        worker.task = None
        self.ended(task)

    def _died(self, worker: Worker, waiting: list[Task]) -> None:
        code = worker.process.wait()
        if worker.task is None:
            self._forget(worker)
            return
        how = f"exit code {code}"
        if code < 0:
            with contextlib.suppress(ValueError):
                how = signal.Signals(-code).name
        what = f"the worker died ({how}) in the stage '{worker.stage}'"
        fix = "see the log; run this scan alone to find out"
        if code == -signal.SIGKILL:
            fix = "most likely memory ran out: use fewer --jobs, or a larger machine"
        where = str(worker.task.job.folder / LOG_NAME)
        if tail := _tail(worker.stderr):
            where = f"{where} ({tail})"
        self._lost(worker, CrashError(what, where, fix), waiting)

    def _lost(self, worker: Worker, error: CrashError, waiting: list[Task]) -> None:
        """The task of a worker that is no good any more gets another one, if it has tries left."""
        task = worker.task
        assert task is not None
        task.seconds += time.monotonic() - worker.began
        self._kill(worker)
        _clean(task.job)
        if task.tries <= self.options.retries:
            left = self.options.retries + 1 - task.tries
            self.say(f"{task.job.label}: {error.what}; trying again ({left} left)")
            waiting.insert(0, task)
            return
        tries = "" if task.tries == 1 else f", {task.tries} times"
        task.error = CrashError(f"{error.what}{tries}", error.where, error.fix)
        self.ended(task)

    def _start(self) -> Worker:
        stderr = tempfile.TemporaryFile()  # noqa: SIM115  as long as its worker
        process = subprocess.Popen(
            [sys.executable, "-m", "scanrender.batch.worker"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=stderr,
            env=_environment(self.options.workers),
            start_new_session=True,  # Ctrl-C is answered here
        )
        worker = Worker(process, stderr)
        assert process.stdout is not None
        self._selector.register(process.stdout, selectors.EVENT_READ, worker)
        self.workers.append(worker)
        return worker

    def _kill(self, worker: Worker) -> None:
        if worker.process.poll() is None:
            with contextlib.suppress(OSError):
                os.killpg(worker.process.pid, signal.SIGKILL)
            worker.process.kill()
            worker.process.wait()
        self._forget(worker)

    def _forget(self, worker: Worker) -> None:
        self.workers.remove(worker)
        assert worker.process.stdout is not None
        assert worker.process.stdin is not None
        self._selector.unregister(worker.process.stdout)
        worker.process.stdout.close()
        with contextlib.suppress(OSError):
            worker.process.stdin.close()
        worker.stderr.close()

    def _stop(self) -> None:
        """Idle workers end by themselves; what is at work is asked to, and then made to."""
        busy = [worker.task.job for worker in self.workers if worker.task]
        for worker in self.workers:
            assert worker.process.stdin is not None
            if worker.task is not None:
                worker.process.terminate()
                continue
            with contextlib.suppress(OSError):
                worker.process.stdin.close()
        end = time.monotonic() + STOP_S
        for worker in list(self.workers):
            with contextlib.suppress(subprocess.TimeoutExpired):
                worker.process.wait(timeout=max(0.0, end - time.monotonic()))
            self._kill(worker)
        for job in busy:
            _clean(job)
        self._selector.close()


def _clean(job: Job) -> None:
    """What a killed worker, or its children, left half-written."""
    clean_leftovers(job.folder)
    drop_unheld(job.folder)
    if job.asset.parent != job.folder and job.prepares:
        clean_stale(job.asset.parent)
    clean_stale(Path(tempfile.gettempdir()), SCRATCH_PREFIX)


def _environment(workers: int) -> dict[str, str]:
    """The parent's, with this very package importable, and each worker's share of the cores."""
    root = str(Path(errors.__file__).resolve().parents[1])
    paths = [root, *filter(None, os.environ.get("PYTHONPATH", "").split(os.pathsep))]
    own = {"PYTHONPATH": os.pathsep.join(paths), PARENT: str(os.getpid())}
    if workers == 1:
        return {**os.environ, **own}
    affinity = getattr(os, "sched_getaffinity", None)
    cores = len(affinity(0)) if affinity else os.cpu_count() or 1
    share = str(max(1, cores // workers))
    shares = {"LP_NUM_THREADS": share, "OMP_NUM_THREADS": share, THREADS: share}
    return {**shares, "OPENBLAS_NUM_THREADS": "1", **os.environ, **own}


def _rebuilt(error: dict[str, Any]) -> ScanrenderError:
    kind = getattr(errors, str(error.get("kind")), StageError)
    if not (isinstance(kind, type) and issubclass(kind, ScanrenderError)):
        kind = StageError
    return kind(str(error.get("what")), error.get("where"), error.get("fix"))


def _tail(stream: IO[bytes]) -> str:
    stream.seek(0, os.SEEK_END)
    stream.seek(max(0, stream.tell() - 4000))
    lines = [x for x in stream.read().decode("utf-8", "replace").splitlines() if x.strip()]
    return lines[-1][:300] if lines else ""
