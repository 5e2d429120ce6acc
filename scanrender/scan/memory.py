"""A bound on this process's memory: a MemoryError beats the machine's out-of-memory killer."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path

OUT_OF_MEMORY = "raise prep.memory_mib, close other programs, or use a larger machine"
_CGROUP_LIMITS = ("/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory/memory.limit_in_bytes")


def limit_memory(most_mib: int | None = None) -> None:
    """No more data than the machine or its container has, or than most_mib.

    The processes that this one starts inherit a stated limit and cannot lift it. Does nothing on
    Windows.
    """
    try:
        import resource
    except ImportError:
        return
    limits = [] if most_mib is None else [most_mib << 20]
    with contextlib.suppress(OSError, ValueError, AttributeError):
        limits.append(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"))
    for file in _CGROUP_LIMITS:
        with contextlib.suppress(OSError, ValueError):
            limits.append(int(Path(file).read_text(encoding="ascii")))
    _, hard = resource.getrlimit(resource.RLIMIT_DATA)
    if hard != resource.RLIM_INFINITY:
        limits.append(hard)
    if limits:
        limit = min(limits)
        with contextlib.suppress(OSError, ValueError):
            resource.setrlimit(resource.RLIMIT_DATA, (limit, limit if most_mib else hard))


def limit_is_stated() -> bool:
    """Whether `limit_memory` was told one in this process or in one that started it."""
    try:
        import resource
    except ImportError:
        return False
    return resource.getrlimit(resource.RLIMIT_DATA)[1] != resource.RLIM_INFINITY
