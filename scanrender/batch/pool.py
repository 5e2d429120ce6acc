"""Workers and their tasks, seen from the parent: one thread, one loop, no locks.

A worker that dies, hangs or loses its GPU costs one try of its task, which another worker repeats;
what a scan itself causes is not tried again. Workers are started by the main thread, to whose life
Linux ties them (`worker.tie_to_parent`).
"""

from __future__ import annotations

import selectors
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from scanrender.batch.memory import free_mib
from scanrender.batch.process import START_S, STOP_S, WorkerProcess, clean_after, hang
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
from scanrender.errors import CrashError

TICK_S = 0.5


@dataclass
class Worker:
    process: WorkerProcess
    task: Task | None = None
    stage: str = ""
    deadline: float = 0.0
    began: float = 0.0


class Pool:
    """Runs tasks. `show` is told how each goes on, `say` gets sentences for people, `ended` each
    task that will not be touched again."""

    def __init__(
        self,
        options: PoolOptions,
        show: Event,
        say: Say,
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
        worker.deadline = worker.began + max(START_S, patience_s(task, self.options))
        worker.process.send(as_task(task, self.options.verify))

    def _listen(self, waiting: list[Task]) -> None:
        for key, _ in self._selector.select(TICK_S):
            worker: Worker = key.data
            events = worker.process.events()
            if events is None:
                self._died(worker, waiting)
                continue
            for event in events:
                self._event(worker, event, waiting)
        now = time.monotonic()
        for worker in list(self.workers):
            if worker.task is not None and now > worker.deadline:
                error = hang(worker.stage, patience_s(worker.task, self.options))
                self._lost(worker, error, waiting)

    def _event(self, worker: Worker, event: dict[str, Any], waiting: list[Task]) -> None:
        task = worker.task
        if task is None:
            return
        if "stage" in event:
            worker.stage = event["stage"]
            worker.deadline = time.monotonic() + patience_s(task, self.options)
            self.show(task.job, event["stage"], event["fraction"])
            return
        if "error" in event:
            error = error_of(event)
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
        if worker.task is None:
            self._forget(worker)
            return
        self._lost(worker, worker.process.death(worker.stage, worker.task.job.folder), waiting)

    def _lost(self, worker: Worker, error: CrashError, waiting: list[Task]) -> None:
        """The task of a worker that is no good any more gets another one, if it has tries left."""
        task = worker.task
        assert task is not None
        task.seconds += time.monotonic() - worker.began
        self._forget(worker)
        clean_after(task.job)
        if another_try(task, error, self.options, self.say):
            waiting.insert(0, task)
        else:
            self.ended(task)

    def _start(self) -> Worker:
        worker = Worker(WorkerProcess(self.options.workers))
        self._selector.register(worker.process.output, selectors.EVENT_READ, worker)
        self.workers.append(worker)
        return worker

    def _forget(self, worker: Worker, within_s: float = 0.0) -> None:
        self.workers.remove(worker)
        self._selector.unregister(worker.process.output)
        worker.process.end(within_s)

    def _stop(self) -> None:
        """Idle workers end by themselves; what is at work is asked to, and then made to."""
        busy = [worker.task.job for worker in self.workers if worker.task]
        for worker in self.workers:
            if worker.task is not None:
                worker.process.ask_to_stop()
            else:
                worker.process.let_go()
        end = time.monotonic() + STOP_S
        for worker in list(self.workers):
            self._forget(worker, max(0.0, end - time.monotonic()))
        for job in busy:
            clean_after(job)
        self._selector.close()
