"""What happened during one preparation: seconds, notes, peak memory, warnings."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from threading import Lock
from typing import Any

Progress = Callable[[str, float], None]

# Share of the whole preparation that has passed when a stage begins, for progress bars.
_FRACTIONS = {
    "ingest": 0.0,
    "clean": 0.05,
    "simplify": 0.2,
    "raw surface": 0.25,
    "unwrap": 0.3,
    "search trees": 0.33,
    "occlusion, thickness": 0.36,
    "distance": 0.4,
    "levels of detail": 0.42,
    "project": 0.45,
    "albedo": 0.6,
    "normals": 0.7,
    "geometry": 0.8,
    "skin": 0.85,
    "report": 0.9,
}


@dataclass
class Journal:
    """Stages as they end. Some run beside others: their seconds may add up to more than the wall
    clock's. `at` is when a stage began, in seconds since the start.

    A stage is announced as it begins, and again when another that ran beside it ends: so the last
    one announced is one that runs. The first that fails is the last one announced.
    """

    progress: Progress | None
    stages: list[dict[str, Any]] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    _start: float = field(default_factory=time.perf_counter)
    _running: list[str] = field(default_factory=list)
    _reached: float = 0.0
    _failed: bool = False
    _lock: Any = field(default_factory=Lock)

    @contextmanager
    def stage(self, name: str) -> Iterator[dict[str, Any]]:
        """Announce a stage and time it."""
        notes: dict[str, Any] = {}
        start = time.perf_counter()
        with self._lock:
            self._running.append(name)
            self._announce(name)
        try:
            yield notes
        except BaseException:
            with self._lock:
                self._announce(name)
                self._failed = True
            raise
        with self._lock:
            self._running.remove(name)
            if self._running:
                self._announce(self._running[-1])
        self.stages.append(
            {
                "name": name,
                "at": round(start - self._start, 3),
                "seconds": round(time.perf_counter() - start, 3),
                "peak_memory_mib": peak_mib(),
                "notes": notes,
            }
        )

    def _announce(self, name: str) -> None:
        self._reached = max(self._reached, _FRACTIONS.get(name, 0.0))
        if self.progress is not None and not self._failed:
            self.progress(name, self._reached)


def peak_mib() -> int | None:
    """The largest memory of this process so far.

    Linux counts in VmHWM what belongs to this program alone; in `ru_maxrss` it keeps the memory
    of whoever started it, however large (the record of a process survives exec).
    """
    with contextlib.suppress(OSError):
        for line in Path("/proc/self/status").read_text(encoding="ascii").splitlines():
            if line.startswith("VmHWM:"):
                return int(line.split()[1]) // 1024
    try:
        import resource
    except ImportError:  # Windows
        return None
    return int(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024)
