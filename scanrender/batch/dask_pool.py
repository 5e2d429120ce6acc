"""A pool whose workers are a Dask cluster's: the same tasks, tries, sentences and errors as `pool`.

Which task begins, where, and how often it is tried again is decided here, as on one machine: Dask
is told the worker with every task, and carries tasks there and results and events back (decision
28). What happens on the worker is in `dask_worker`.
"""

from __future__ import annotations

import contextlib
import os
import queue
import time
import uuid
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from scanrender.batch import dask_worker
from scanrender.batch.dask_crew import Crew, Mate
from scanrender.batch.dask_link import Link, LinkLostError, connected
from scanrender.batch.log import LOG_NAME
from scanrender.batch.process import clean_after
from scanrender.batch.seen import evidence
from scanrender.batch.tasks import (
    Event,
    PoolOptions,
    Say,
    Task,
    another_try,
    as_task,
    error_of,
    patience_s,
)
from scanrender.errors import CrashError, ScanrenderError, StageError, UsageError

TICK_S = 0.5
RESULT_S = 30.0
END_S = 10.0  # for workers to stop what they do
# How long a file server may keep the lock of a machine that was lost (NFS 4: a lease of 90 s). The
# tasks of a command that was killed end a moment later too, when the next one may have begun.
LEASE_S = 150.0


def run_on_dask(
    scheduler: str,
    out: Path,
    tasks: Sequence[Task],
    options: PoolOptions,
    show: Event,
    say: Say,
    ended: Callable[[Task], None],
) -> None:
    """Run the tasks, whose folders lie in `out`, on the workers of a scheduler; `local` starts and
    ends one. Raises UsageError for a scheduler, or a worker of it, that will not do."""
    jobs = [task.job for task in tasks]
    with connected(scheduler, options.workers) as link, evidence(jobs, out) as question:
        crew = Crew(link, dask_worker.made_here(), question, say)
        try:
            crew.gather()
        except LinkLostError as error:
            what = f"the Dask scheduler {link.address} {error}"
            raise UsageError(what, fix="see to it and run again") from error
        DaskPool(link, crew, options, show, say, ended).run(tasks)


@dataclass
class _Try:
    """A task at work with a mate of the crew."""

    task: Task
    mate: Mate
    future: Any
    stage: str
    began: float


class DaskPool:
    """Runs tasks as `pool.Pool` does. `options.workers` bounds how many at once; 0: by the crew."""

    def __init__(
        self,
        link: Link,
        crew: Crew,
        options: PoolOptions,
        show: Event,
        say: Say,
        ended: Callable[[Task], None],
    ) -> None:
        self.link, self.crew, self.options = link, crew, options
        self.show, self.say, self.ended = show, say, ended
        self.running: dict[str, _Try] = {}
        self._topic = f"scanrender-{uuid.uuid4().hex}"
        self._said_memory = False
        self._alone_since: float | None = None
        self._gave_out = 0.0
        self._heard: queue.SimpleQueue[tuple[str, dict[str, Any]]] = queue.SimpleQueue()

    def run(self, tasks: Sequence[Task]) -> None:
        """Until every task is done or has failed. What is interrupted leaves nothing running and
        nothing half-written behind."""
        waiting = list(tasks)
        # Dask calls on its own thread: a queue brings it to this one.
        self.link.subscribe(self._topic, self._hear)
        try:
            while waiting or self.running:
                self._look(waiting)
                self._give_out(waiting)
                self._listen(waiting)
        except LinkLostError as error:
            self._scheduler_lost(waiting, error)
        finally:
            self._stop()

    def _hear(self, said: dict[str, Any]) -> None:
        self._heard.put((said["attempt"], said))

    def _look(self, waiting: list[Task]) -> None:
        """Workers come and go."""
        for mate in self.crew.look():
            for attempt in [key for key, each in self.running.items() if each.mate is mate]:
                each = self.running[attempt]
                what = f"the Dask worker {mate} was lost in the stage '{each.stage}'"
                fix = "see its own log: its machine, its memory or the network gave way"
                where = str(each.task.job.folder / LOG_NAME)
                self._lost(attempt, CrashError(what, where, fix), waiting)

    def _wait_for_workers(self, waiting: Sequence[Task]) -> None:
        """Nothing runs, and nobody can do what is to be done: that cannot go on for ever."""
        if self.running or not waiting:
            self._alone_since = None
            return
        who = "no worker" if not self.crew.mates else "no worker that can do what is left"
        if any(self.crew.wants_gpu(task) for task in waiting) and self.crew.mates:
            who = "no worker with a GPU"
        now = time.monotonic()
        if self._alone_since is None:
            self._alone_since = now
            self.say(f"{who} is left at {self.link.address}; waiting for one")
        elif now - self._alone_since > self.options.timeout_s:
            raise LinkLostError(f"has had {who} for {self.options.timeout_s:g} s")

    def _give_out(self, waiting: list[Task]) -> None:
        """Tasks that can begin, to workers that are free for them."""
        now = time.monotonic()
        if now - self._gave_out < TICK_S:  # every event brings us here, of many workers many
            return
        self._gave_out = now
        self._hand_out(waiting)
        self._wait_for_workers(waiting)

    def _hand_out(self, waiting: list[Task]) -> None:
        for task in list(waiting):
            if task.after is not None and task.after.error is not None:
                waiting.remove(task)
                task.error = task.after.error
                self.ended(task)
            elif task.is_ready:
                if self.options.workers and len(self.running) >= self.options.workers:
                    return
                free = self.crew.free_for(task)
                mate = next((mate for mate in free if self.crew.fits(task, mate)), None)
                if mate is not None:
                    waiting.remove(task)
                    self._begin(task, mate)
                elif free:  # what is large would wait for ever if small ones went first
                    self._say_memory(task)
                    return

    def _say_memory(self, task: Task) -> None:
        if not self._said_memory:
            self._said_memory = True
            self.say(
                f"{len(self.running)} tasks at once for now: the next scan ({task.job.label}) may "
                f"need {task.mib:,} MiB, which no machine with a free worker has left"
            )

    def _begin(self, task: Task, mate: Mate) -> None:
        task.tries += 1
        attempt = f"scanrender-{task.only or 'job'}-{task.job.label}-{uuid.uuid4().hex}"
        data = as_task(task, self.options.verify)
        for name in ("scan", "folder", "asset"):  # a worker stands in a folder of its own
            data[name] = os.path.abspath(data[name])
        data["opens_gl"] = task.needs_gl or not self.crew.has_gpus
        data["wait_s"] = LEASE_S
        future = self.link.submit(
            dask_worker.run_task, data, attempt, self._topic,
            patience_s(task, self.options), self.crew.sharers(mate),
            key=attempt, seat=mate.seat, gpu=self.crew.wants_gpu(task),
        )  # fmt: skip
        began = time.monotonic()
        self.running[attempt] = _Try(task, mate, future, task.only or "start", began)
        self.crew.take(task, mate)
        future.add_done_callback(lambda _: self._heard.put((attempt, {})))

    def _listen(self, waiting: list[Task]) -> None:
        with contextlib.suppress(queue.Empty):
            attempt, said = self._heard.get(timeout=TICK_S)
            while True:
                if attempt in self.running:
                    self._heard_of(attempt, said, waiting)
                attempt, said = self._heard.get_nowait()

    def _heard_of(self, attempt: str, said: dict[str, Any], waiting: list[Task]) -> None:
        each = self.running[attempt]
        if said:
            each.stage = said["stage"]
            self.show(each.task.job, said["stage"], said["fraction"])
            return
        event = self._outcome(each)
        error = error_of(event) if "error" in event else None
        if isinstance(error, CrashError):
            self._lost(attempt, error, waiting)
            return
        task = self._forget(attempt)
        task.error = error
        if error is None:
            task.is_done, task.result = True, event["done"]
        self.ended(task)

    def _outcome(self, each: _Try) -> dict[str, Any]:
        """What the future holds; Dask's own misfortunes are a crash's."""
        try:
            found: dict[str, Any] = each.future.result(timeout=RESULT_S)
        except Exception as error:  # noqa: BLE001  whatever a worker, a network or a pickle raised
            self.link.wait_until_up()
            what = f"the Dask worker {each.mate} lost the stage '{each.stage}'"
            raised = f"{type(error).__name__}: {error}".split("\n")[0][:300]
            return _crash(what, f"{each.task.job.folder / LOG_NAME} ({raised})")
        if "stopped" in found:
            what = f"the Dask worker {each.mate} gave up the stage '{each.stage}'"
            return _crash(what, str(each.task.job.folder / LOG_NAME))
        return found

    def _lost(self, attempt: str, error: CrashError, waiting: list[Task]) -> None:
        each = self.running[attempt]
        task = self._forget(attempt)
        clean_after(task.job, each.mate.machine)
        if another_try(task, error, self.options, self.say):
            waiting.insert(0, task)
        else:
            self.ended(task)

    def _forget(self, attempt: str) -> Task:
        each = self.running.pop(attempt)
        each.task.seconds += time.monotonic() - each.began
        self.crew.leave(each.task, each.mate)
        self._gave_out = 0.0
        each.future.cancel(force=True)
        return each.task

    def _scheduler_lost(self, waiting: Sequence[Task], error: LinkLostError) -> None:
        """What is not done fails, so that the summary says so."""
        what = f"the Dask scheduler {self.link.address} {error}"
        fix = "see to it and run the same command again: what is complete stays"
        lost: ScanrenderError = StageError(what, fix=fix)
        tasks = [each.task for each in self.running.values()] + list(waiting)
        for task in tasks:
            if task.error is None and not task.is_done:
                task.error = lost
                self.ended(task)

    def _stop(self) -> None:
        """Nothing of this run goes on, on any worker."""
        tries, self.running = dict(self.running), {}
        with contextlib.suppress(LinkLostError):
            at = sorted({each.mate.address for each in tries.values()} & set(self.crew.mates))
            self.link.ask(dask_worker.stop, list(tries), workers=at, within_s=END_S)
            for each in tries.values():
                each.future.cancel(force=True)
            self.link.unsubscribe(self._topic)
            self.link.ask(dask_worker.rest, workers=sorted(self.crew.mates), within_s=END_S)
        for each in tries.values():
            clean_after(each.task.job, each.mate.machine)


def _crash(what: str, where: str) -> dict[str, Any]:
    fix = "see the log, and that of the Dask worker"
    return {"error": {"kind": "CrashError", "what": what, "where": where, "fix": fix}}
