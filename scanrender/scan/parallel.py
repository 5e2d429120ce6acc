"""Work on rows shared among the cores: forked copies of this process fill shared arrays.

Embree's Python binding holds the interpreter lock, so threads do not help. A forked copy sees all
meshes without a transfer, and a copy that dies is replaced by doing its rows here. Where a process
cannot fork (Windows), or has one core, everything runs here. Only called in a child of the program,
with no other thread at work.
"""

from __future__ import annotations

import math
import mmap
import os
import pickle
import signal
import sys
import warnings
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, Generic, TypeVar, cast

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[Any]
Shape = tuple[tuple[int, ...], Any]  # of one row, and the dtype
T = TypeVar("T")
THREADS = "SCANRENDER_THREADS"  # environment variable: cores that this process may use
CGROUP_CPU = Path("/sys/fs/cgroup/cpu.max")
MAX_WORKERS = 8  # each has its own temporary arrays
_PR_SET_PDEATHSIG = 1  # linux/prctl.h


def all_cores() -> int:
    """How many cores there are for this process and those that work beside it: of the machine, or
    as many as its container has the time of."""
    found = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    with suppress(OSError, ValueError):  # "max 100000", or "150000 100000": microseconds
        quota, period = CGROUP_CPU.read_text(encoding="ascii").split()
        found = min(found or 1, math.ceil(int(quota) / int(period)))
    return max(1, found or 1)


def cores() -> int:
    """How many of them this process may use: what a batch of several workers leaves to each."""
    with suppress(ValueError):
        return max(1, min(all_cores(), int(os.environ.get(THREADS, ""))))
    return all_cores()


def workers() -> int:
    """How many processes share the work."""
    return min(cores(), MAX_WORKERS) if hasattr(os, "fork") else 1


def fill_rows(
    count: int, shapes: Sequence[Shape], work: Callable[[int, int], Sequence[Array]], step: int
) -> list[Array]:
    """Arrays of `count` rows with the given row shapes; work(start, stop) returns those rows."""
    outputs = [_shared((count, *row), dtype) for row, dtype in shapes]
    starts = list(range(0, count, step))

    def do(mine: Sequence[int]) -> None:
        for start in mine:
            stop = min(start + step, count)
            for output, rows in zip(outputs, work(start, stop), strict=True):
                output[start:stop] = rows

    shares = min(workers(), len(starts))
    run([lambda mine=starts[i::shares]: do(mine) for i in range(shares)])  # type: ignore[misc]
    return outputs


def run(jobs: Sequence[Callable[[], T]]) -> list[T]:
    """The results of all jobs, the first done here and each other in a forked copy."""
    started = [Aside(job) for job in jobs[1:]]
    results = [job() for job in jobs[:1]]
    return results + [aside.result() for aside in started]


class Aside(Generic[T]):
    """A job begun in a forked copy of this process, which ends with it."""

    def __init__(self, job: Callable[[], T]) -> None:
        self._job, self._pid, self._reader = job, 0, -1
        if hasattr(os, "fork"):
            self._pid, self._reader = _fork(job)

    def result(self) -> T:
        """What the job returned; it is done here where no copy did it."""
        if self._reader < 0:
            return self._job()
        with os.fdopen(self._reader, "rb") as stream:
            data = stream.read()
        _, status = os.waitpid(self._pid, 0)
        self._reader = -1
        # A copy that crashed or ran out of memory: here, its error is told.
        return cast(T, pickle.loads(data)) if status == 0 else self._job()


def fork() -> int:
    """os.fork without Python 3.12's warning of other threads: those of BLAS sleep, and no lock of
    theirs is held."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        return os.fork()


def _fork(job: Callable[[], Any]) -> tuple[int, int]:
    reader, writer = os.pipe()
    parent = os.getpid()
    pid = fork()
    if pid:
        os.close(writer)
        return pid, reader
    code = 1
    try:
        _end_with(parent)
        os.close(reader)
        with os.fdopen(writer, "wb") as stream:
            pickle.dump(job(), stream, protocol=pickle.HIGHEST_PROTOCOL)
        code = 0
    finally:
        # Without teardown: the parent's buffers and temporary files are not this copy's to end.
        os._exit(code)


def _end_with(parent: int) -> None:
    """Linux: be killed when the parent is; elsewhere the copy ends with its few seconds of work."""
    if sys.platform == "linux":
        import ctypes

        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, int(signal.SIGKILL))
        if os.getppid() != parent:
            os._exit(1)


def _shared(shape: tuple[int, ...], dtype: Any) -> Array:
    """Zeros that forked copies write into."""
    size = math.prod(shape) * np.dtype(dtype).itemsize
    if size == 0 or workers() == 1:
        return np.zeros(shape, dtype)
    return np.frombuffer(mmap.mmap(-1, size), dtype).reshape(shape)
