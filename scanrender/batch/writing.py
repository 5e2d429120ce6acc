"""Files on their way to the disk, written by threads and noted in the record as they are there."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

import numpy as np
import numpy.typing as npt

from scanrender.batch.record import FileEntry, Record, Stage, read_entry
from scanrender.scan.parallel import workers

Bytes = npt.NDArray[np.uint8]

SAVE_EVERY_S = 1.0  # what a killed run has to do again


class Writing:
    """Files on their way, a bounded number, noted in the record as they are complete.

    On the way out everything that was begun is finished and noted, also after an error.
    """

    def __init__(self, record: Record) -> None:
        self.record = record
        threads = max(2, workers())
        self._pool = ThreadPoolExecutor(threads)
        self._most = 2 * threads
        self._waiting: deque[Future[Any]] = deque()
        self._saved = time.monotonic()

    def __enter__(self) -> Writing:
        return self

    def __exit__(self, kind: object, *_: object) -> None:
        try:
            while self._waiting:
                try:
                    self._finish(self._waiting.popleft())
                except Exception:
                    if kind is None:  # otherwise the first error is the one to tell
                        raise
        finally:
            self._pool.shutdown()
            self.record.save()

    def begin(self, make: Callable[[], Bytes]) -> Future[Bytes]:
        """Pixels that others wait for: begun before those, so that nobody waits for a thread."""
        return self._pool.submit(make)

    def write(self, stage: Stage, part: int, make: Callable[[], list[str]]) -> None:
        """Call `make`, which writes files and returns their names, in a thread."""
        folder = self.record.folder

        def written() -> tuple[Stage, dict[str, FileEntry]]:
            return stage, {name: read_entry(folder / name, part) for name in make()}

        self.add(self._pool.submit(written))

    def add(self, future: Future[Any]) -> None:
        self._waiting.append(future)
        while len(self._waiting) > self._most or (self._waiting and self._waiting[0].done()):
            self._finish(self._waiting.popleft())
        if time.monotonic() - self._saved > SAVE_EVERY_S:
            self.record.save()
            self._saved = time.monotonic()

    def _finish(self, future: Future[Any]) -> None:
        result = future.result()
        if result is not None:
            stage, entries = result
            stage.files.update(entries)
            self.record.changed = True
