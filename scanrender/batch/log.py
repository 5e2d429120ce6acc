"""log.txt of a job: what was done and why, when each stage began, what was warned of and failed."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

LOG_NAME = "log.txt"
MOST_BYTES = 1 << 20  # then it begins anew: a log is for the last few runs


class JobLog:
    """Appends lines with the time; a log that cannot be written stops nothing."""

    def __init__(self, folder: Path) -> None:
        self.path = folder / LOG_NAME
        self._stage = ""
        with suppress(OSError):
            if self.path.stat().st_size > MOST_BYTES:
                self.path.unlink()

    def write(self, text: str) -> None:
        with suppress(OSError), self.path.open("a", encoding="utf-8") as file:
            file.write(f"{time.strftime('%Y-%m-%d %H:%M:%S')}  {text}\n")

    def following(self, progress: Callable[[str, float], None]) -> Callable[[str, float], None]:
        """`progress`, with a line for each stage that begins."""

        def show(stage: str, fraction: float) -> None:
            if stage != self._stage:
                self._stage = stage
                self.write(stage)
            progress(stage, fraction)

        return show
