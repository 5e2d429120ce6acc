"""A worker's process (`worker`), seen from whoever started it: the pool here, or a Dask worker."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import IO, Any

from scanrender import errors
from scanrender.batch.jobs import Job
from scanrender.batch.leftovers import clean_leftovers
from scanrender.batch.lock import drop_unheld
from scanrender.batch.log import LOG_NAME
from scanrender.errors import CrashError
from scanrender.files import SCRATCH_PREFIX, clean_stale
from scanrender.scan.child import PARENT
from scanrender.scan.parallel import THREADS, all_cores

START_S = 120.0  # until the first sign of life: libraries load, from a busy disk perhaps
STOP_S = 5.0  # for a worker to remove what it has half-written


class WorkerProcess:
    """Takes one task at a time. Linux ends it with the thread that starts it (prctl(2))."""

    def __init__(self, sharers: int, module: str = "scanrender.batch.worker") -> None:
        """`sharers`: workers among whom this machine's cores are shared."""
        self.stderr: IO[bytes] = tempfile.TemporaryFile()  # noqa: SIM115  as long as its worker
        self.process = subprocess.Popen(
            # -P: as in scan/child.py, nothing is imported from the folder that one stands in.
            [sys.executable, "-P", "-m", module],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self.stderr,
            env=_environment(sharers),
            start_new_session=True,  # Ctrl-C is answered by the parent
        )
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        self._input, self.output = self.process.stdin, self.process.stdout
        self._rest = b""
        self.tasks = 0

    def send(self, task: dict[str, Any]) -> None:
        self.tasks += 1
        with contextlib.suppress(OSError):  # it is dead already: `events` will tell
            self._input.write((json.dumps(task) + "\n").encode())
            self._input.flush()

    def events(self) -> list[dict[str, Any]] | None:
        """What it said since, waiting for something; None when it has ended."""
        data = os.read(self.output.fileno(), 1 << 16)
        if not data:
            return None
        *lines, self._rest = (self._rest + data).split(b"\n")
        return [json.loads(line) for line in lines]

    def death(self, stage: str, folder: Path) -> CrashError:
        """Why it ended in the middle of a task, in words."""
        code = self.process.wait()
        how = f"exit code {code}"
        if code < 0:
            with contextlib.suppress(ValueError):
                how = signal.Signals(-code).name
        fix = "see the log; run this scan alone to find out"
        if code == -signal.SIGKILL:
            fix = "most likely memory ran out: use fewer --jobs, or a larger machine"
        where = str(folder / LOG_NAME)
        if tail := _tail(self.stderr):
            where = f"{where} ({tail})"
        return CrashError(f"the worker died ({how}) in the stage '{stage}'", where, fix)

    def ask_to_stop(self) -> None:
        """At work: remove what is half-written, and end."""
        self.process.terminate()

    def let_go(self) -> None:
        """Idle: it ends by itself."""
        with contextlib.suppress(OSError):
            self._input.close()

    def end(self, within_s: float = 0.0) -> None:
        """Wait for its end, then make it end, and its children with it."""
        with contextlib.suppress(subprocess.TimeoutExpired):
            self.process.wait(timeout=within_s)
        if self.process.poll() is None:
            with contextlib.suppress(OSError):
                os.killpg(self.process.pid, signal.SIGKILL)
            self.process.kill()
            self.process.wait()
        self.output.close()
        self.let_go()
        self.stderr.close()


def hang(stage: str, waited_s: float) -> CrashError:
    what = f"the stage '{stage}' gave no sign of life for {waited_s:g} s and was stopped"
    return CrashError(what, fix="raise --timeout if it needs longer")


def clean_after(job: Job, lost: str | None = None) -> None:
    """Remove what a killed worker, or its children, left half-written; `lost` is the machine that
    it ran on where that is another one (`files.machine`)."""
    clean_leftovers(job.folder, lost)
    drop_unheld(job.folder)
    if job.asset.parent != job.folder and job.prepares:
        clean_stale(job.asset.parent)
        # That machine may be preparing another asset beside this one.
        clean_stale(job.asset.parent, lost=lost, named=job.asset.name)
    clean_stale(Path(tempfile.gettempdir()), SCRATCH_PREFIX)


def _environment(sharers: int) -> dict[str, str]:
    """The parent's, with this very package importable, and each worker's share of the cores."""
    root = str(Path(errors.__file__).resolve().parents[1])
    paths = [root, *filter(None, os.environ.get("PYTHONPATH", "").split(os.pathsep))]
    own = {"PYTHONPATH": os.pathsep.join(paths), PARENT: str(os.getpid())}
    if sharers == 1:
        return {**os.environ, **own}
    share = str(max(1, all_cores() // sharers))
    shares = {"OMP_NUM_THREADS": share, THREADS: share}
    return {**shares, "OPENBLAS_NUM_THREADS": "1", **os.environ, **own}


def _tail(stream: IO[bytes]) -> str:
    stream.seek(0, os.SEEK_END)
    stream.seek(max(0, stream.tell() - 4000))
    lines = [x for x in stream.read().decode("utf-8", "replace").splitlines() if x.strip()]
    return lines[-1][:300] if lines else ""
