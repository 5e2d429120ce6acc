"""What a Dask worker does for a batch. All of this runs inside `dask worker`; `dask_pool` calls it.

Tasks are done by a process of their own (`worker`), as on one machine: what crashes, hangs or holds
the interpreter's lock there is told as it is told here, and the Dask worker answers meanwhile. The
process ends with the Dask worker, however that ends. It is kept for the next task for a while: GL
and libraries take a second or two to start.
"""

from __future__ import annotations

import asyncio
import platform
import select
import threading
import time
from collections.abc import Collection
from importlib import metadata
from pathlib import Path
from typing import Any

from scanrender import files
from scanrender.batch.memory import free_mib
from scanrender.batch.process import START_S, STOP_S, WorkerProcess, clean_after, hang
from scanrender.batch.seen import made_by, unseen
from scanrender.batch.tasks import as_event, error_of, job_of
from scanrender.errors import CrashError, OutputError, ScanError, ScanrenderError
from scanrender.files import check_writable

Json = dict[str, Any]

IDLE_S = 30.0  # then a process without a task ends
TICK_S = 0.25
TELL_EVERY_S = 0.2  # within one stage: a scheduler may have hundreds of workers to listen to

_idle: list[WorkerProcess] = []
_at_work: set[str] = set()
_unwanted: set[str] = set()
_lock = threading.Lock()


def about() -> Json:
    """What this worker is."""
    return {
        "host": platform.node(),
        "machine": files.machine(),
        "free_mib": free_mib(),
        "made_by": made_here(),
    }


def made_here() -> dict[str, str]:
    """`seen.made_by`, and the library that this module's functions travel with."""
    return {**made_by(), "distributed": metadata.version("distributed")}


async def sees(question: Json) -> tuple[str, str] | None:
    """`seen.unseen`, beside the worker's own talk with its scheduler."""
    return await asyncio.to_thread(unseen, question)


async def stop(attempts: Collection[str]) -> None:
    """End these attempts, and return when nothing of them runs any more."""
    _unwanted.update(_at_work & set(attempts))
    end = time.monotonic() + STOP_S + 2.0
    while _at_work & set(attempts) and time.monotonic() < end:
        await asyncio.sleep(0.05)


async def rest() -> None:
    """The run is over: processes without a task end."""
    with _lock:
        idle, _idle[:] = list(_idle), []
    for process in idle:
        process.let_go()
        await asyncio.to_thread(process.end, STOP_S)


def run_task(task: Json, attempt: str, topic: str, patience_s: float, sharers: int) -> Json:
    """Do a task; returns the last event of its process, or {"stopped": true}. `attempt` is its key
    in Dask, `topic` the one that its events go to, `sharers` how many workers share the cores."""
    from distributed import get_worker

    dask = get_worker()
    try:
        _look_anew(task)
    except OutputError as unwritable:
        return _placed(unwritable)
    process, keep = _taken(sharers), False
    folder, stage, told = Path(task["folder"]), task["only"] or "start", ("", 0.0)
    now = time.monotonic()
    deadline = now + max(START_S, patience_s)
    _at_work.add(attempt)
    try:
        process.send(task)
        while _is_wanted(dask, attempt):
            if not select.select([process.output], [], [], TICK_S)[0]:
                if time.monotonic() > deadline:
                    return _placed(hang(stage, patience_s))
                continue
            events = process.events()
            if events is None:
                return _placed(process.death(stage, folder))
            for event in events:
                now = time.monotonic()
                if "stage" not in event:
                    error = error_of(event) if "error" in event else None
                    keep = not isinstance(error, CrashError)
                    return event if error is None else _placed(error)
                stage, deadline = event["stage"], now + patience_s
                if stage != told[0] or event["fraction"] >= 1.0 or now - told[1] > TELL_EVERY_S:
                    told = stage, now
                    dask.log_event(topic, {"attempt": attempt, **event})
        process.ask_to_stop()
        process.end(STOP_S)
        return {"stopped": True}
    finally:
        if keep:
            _put_back(process)
        else:
            process.end()
            clean_after(job_of(task))
        _at_work.discard(attempt)
        _unwanted.discard(attempt)


def _look_anew(task: Json) -> None:
    """A client of NFS believes what it knows of a folder for up to a minute, unless it writes
    there: what another machine has just prepared would be missing. Raises OutputError."""
    check_writable(Path(task["folder"]))
    if task["asset"] != task["scan"]:
        check_writable(Path(task["asset"]).parent)


def _is_wanted(dask: Any, attempt: str) -> bool:
    """Whether somebody waits for the result. Dask never interrupts a task that is cancelled, by its
    client or by its client's death, nor one whose worker has lost its scheduler."""
    known = dask.state.tasks.get(attempt)
    cancelled = known is None or known.state == "cancelled"
    return not cancelled and attempt not in _unwanted and dask.status.name in ("running", "paused")


def _placed(error: ScanrenderError) -> Json:
    """With the machine's name, unless it is the scan's fault, who is the same everywhere."""
    if isinstance(error, ScanError):
        return as_event(error)
    host = platform.node()
    where = f"{error.where}, on {host}" if error.where else host
    return as_event(type(error)(error.what, where, error.fix))


def _taken(sharers: int) -> WorkerProcess:
    with _lock:
        while _idle:
            process = _idle.pop()
            if process.process.poll() is None:
                return process
            process.end()
    return WorkerProcess(sharers)


def _put_back(process: WorkerProcess) -> None:
    with _lock:
        _idle.append(process)
    timer = threading.Timer(IDLE_S, _let_go, [process, process.tasks])
    timer.daemon = True
    timer.start()


def _let_go(process: WorkerProcess, tasks: int) -> None:
    """If it has had no other task since."""
    with _lock:
        if process not in _idle or process.tasks != tasks:
            return
        _idle.remove(process)
    process.let_go()
    process.end(STOP_S)
