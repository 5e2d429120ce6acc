"""Peak memory of a process and all its descendants, and the processor seconds they took."""

from __future__ import annotations

import contextlib
import os
import threading
import time
from dataclasses import dataclass
from pathlib import Path

PROC = Path("/proc")
SUDDEN, AGAIN_S = 1.1, 0.02
INTERVAL_S = 0.25
COST = 0.02  # of the time may go into looking, where no interval is asked for


@dataclass(frozen=True)
class Usage:
    """seconds: wall clock; cpu_seconds: of the children; peak_tree_mib: this process and all its
    descendants at one moment, None without /proc; peak_child_mib: the largest single child, None
    where an earlier one of this process was larger: the kernel keeps no more than that."""

    seconds: float
    cpu_seconds: float
    peak_tree_mib: int | None
    peak_child_mib: int | None


class Watch:
    """`with Watch() as watch: ...; watch.usage` measures what ran inside.

    Memory is the proportional set size, so that pages shared between processes count once. It is
    sampled: a peak shorter than `interval_s` may be missed, which peak_child_mib bounds from below.
    Each sample holds up what it looks at, for as long as it has pages: four a second took 4 % of a
    preparation's processor time, so the next one waits until they cost COST. A sudden rise is
    looked at twice: between vfork and exec a child is counted with all of its parent's memory.
    """

    def __init__(self, interval_s: float | None = None) -> None:
        self.interval_s = interval_s
        self.samples: list[tuple[float, int]] = []  # time.perf_counter() and KiB
        self.usage = Usage(0.0, 0.0, None, None)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._poll, daemon=True)

    def __enter__(self) -> Watch:
        self._start = time.perf_counter()
        self._cpu, self._largest = _children()
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        seconds = time.perf_counter() - self._start
        self._stop.set()
        self._thread.join()
        cpu, largest = _children()
        peak = self.peak_mib(self._start, self._start + seconds)
        new = largest if largest > self._largest else None
        self.usage = Usage(seconds, cpu - self._cpu, peak, new)

    def peak_mib(self, start: float, stop: float) -> int | None:
        """Peak between two moments of time.perf_counter(); None when nothing was sampled."""
        # Nothing may fall between the samples of a short stage: the next one after it counts too.
        soon = stop + (self.interval_s or INTERVAL_S)
        near = [kib for at, kib in self.samples if start <= at <= soon]
        return max(near) // 1024 if near else None

    def _poll(self) -> None:
        while True:
            begun = time.perf_counter()
            now = tree_kib(os.getpid())
            spent = time.perf_counter() - begun
            known = self.samples[-1][1] if self.samples else 0
            if now is not None and now > SUDDEN * known:
                time.sleep(AGAIN_S)
                now = min(now, tree_kib(os.getpid()) or now)
            if now is not None:
                self.samples.append((time.perf_counter(), now))
            if self._stop.wait(self.interval_s or max(INTERVAL_S, spent / COST)):
                return


def tree_kib(root: int) -> int | None:
    """Memory in KiB of process `root` and its descendants now; None where /proc does not say."""
    if not (PROC / "self" / "smaps_rollup").exists():
        return None
    parent = {}
    for folder in PROC.iterdir():
        if folder.name.isdigit():
            # A process may end between the listing and the reading: it no longer counts.
            with contextlib.suppress(OSError, ValueError, IndexError):
                # The name in brackets may hold spaces: the fields start after the last bracket.
                fields = (folder / "stat").read_text().rpartition(")")[2].split()
                parent[int(folder.name)] = int(fields[1])
    family = {root}
    while grown := {pid for pid, above in parent.items() if above in family} - family:
        family |= grown
    return sum(_proportional_kib(pid) for pid in family)


def _proportional_kib(pid: int) -> int:
    with contextlib.suppress(OSError):
        for line in (PROC / str(pid) / "smaps_rollup").read_text().splitlines():
            if line.startswith("Pss:"):
                return int(line.split()[1])
    return 0


def _children() -> tuple[float, int]:
    """Processor seconds of all children that ever ended, and the largest one's MiB."""
    try:
        import resource
    except ImportError:  # Windows
        return 0.0, 0
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime, int(used.ru_maxrss // 1024)
