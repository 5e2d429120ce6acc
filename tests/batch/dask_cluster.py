"""A scheduler and workers as a user starts them: processes of their own, known by a mark."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
import uuid
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from batch.killing import KILL

PATIENCE_S = 60.0


class Cluster:
    """`dask scheduler`, and `dask worker` as often as `start_worker` is called."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.mark = folder, uuid.uuid4().hex
        self.temporary = folder / "tmp"
        self.temporary.mkdir(parents=True)
        self.workers: list[subprocess.Popen[bytes]] = []
        file = folder / "scheduler.json"
        words = ["scheduler", "--host", "127.0.0.1", "--port", "0", "--no-dashboard"]
        self.scheduler = self._start([*words, "--scheduler-file", str(file)], "scheduler.log")
        until(lambda: file.exists() and file.read_text().endswith("}"))
        self.address = str(json.loads(file.read_text())["address"])

    def _start(
        self, words: Sequence[str], log: str, before: Sequence[str] = ()
    ) -> subprocess.Popen[bytes]:
        own = {KILL.MARK: self.mark, "TMPDIR": str(self.temporary)}
        with (self.folder / log).open("ab") as stream:
            return subprocess.Popen(
                [*before, sys.executable, "-m", "dask", *words],
                env={**os.environ, **own},
                cwd=self.folder,  # not where the batch is started
                stdout=stream,
                stderr=stream,
            )

    def start_worker(self, *words: str, before: Sequence[str] = ()) -> subprocess.Popen[bytes]:
        log = self.folder / f"worker{len(self.workers)}.log"
        plain = ["worker", self.address, "--nthreads", "1", "--no-nanny", "--no-dashboard"]
        worker = self._start([*plain, "--death-timeout", "30", *words], log.name, before)
        self.workers.append(worker)
        until(lambda: b"Registered to" in log.read_bytes())
        return worker

    def alive(self) -> list[subprocess.Popen[bytes]]:
        return [worker for worker in self.workers if worker.poll() is None]

    def at_least(self, count: int) -> list[subprocess.Popen[bytes]]:
        while len(self.alive()) < count:
            self.start_worker()
        return self.alive()

    def children(self) -> list[int]:
        """Processes that do tasks, and their own children."""
        return [*KILL.marked(self.mark, "scanrender.batch"), *KILL.marked(self.mark, "scan.worker")]

    def scratch(self) -> list[Path]:
        """Temporary files of ours; Dask keeps its own folder while it lives."""
        return list(self.temporary.glob("scanrender-*"))

    def stop(self) -> None:
        """Workers first: without a scheduler to say goodbye to, Dask's wait for it."""
        for process in self.alive():
            process.send_signal(signal.SIGTERM)
        for process in [*self.workers, self.scheduler]:
            if process is self.scheduler:
                process.send_signal(signal.SIGTERM)
            try:
                process.wait(timeout=20)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()


def until(happened: Any, process: subprocess.Popen[bytes] | None = None) -> None:
    """Wait for it. Fails when the process ends first, or after a long time."""
    end = time.monotonic() + PATIENCE_S
    while not happened():
        assert process is None or process.poll() is None, "it ended before"
        assert time.monotonic() < end, "it did not happen"
        time.sleep(0.01)
