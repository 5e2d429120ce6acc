"""Independent pieces of work among the cores, in forked copies that see all arrays unsent.

Embree's binding holds the interpreter lock, so threads would not help. What a piece returns must
not depend on how many copies there are: results are the same on any machine.
"""

from __future__ import annotations

import multiprocessing
import os
import warnings
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from typing import Any, TypeVar

from scanrender.errors import StageError

T = TypeVar("T")
MAX_WORKERS = 8
# What forked copies inherit; a closure cannot be sent to them.
_work: Callable[[int], Any] | None = None


def workers() -> int:
    """How many copies share the work: the cores that this process may use, at most 8."""
    if "fork" not in multiprocessing.get_all_start_methods():
        return 1
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return max(1, min(cores or 1, MAX_WORKERS))


def each(count: int, work: Callable[[int], T]) -> list[T]:
    """[work(0), ..., work(count - 1)]. Raises StageError when a copy dies (memory, mostly)."""
    global _work
    shares = min(workers(), count)
    if shares <= 1 or _work is not None:
        return [work(index) for index in range(count)]
    _work = work
    try:
        with warnings.catch_warnings():
            # Python 3.12 warns of other threads: BLAS' sleep, and no copy touches the device's.
            warnings.simplefilter("ignore", DeprecationWarning)
            context = multiprocessing.get_context("fork")
            with ProcessPoolExecutor(shares, mp_context=context) as pool:
                return list(pool.map(_call, range(count)))
    except BrokenProcessPool as error:
        raise StageError(
            "a process that computed the reference died",
            fix="free memory, or ask for a coarser spacing_mm",
        ) from error
    finally:
        _work = None


def _call(index: int) -> Any:
    assert _work is not None
    return _work(index)
