"""A worker of a batch: `python -m scanrender.batch.worker`, one GL context, task after task.

Standard input brings one task a line, standard output carries one event a line: `{"stage": ...,
"fraction": ...}`, then `{"done": ...}` or `{"error": ...}`. What libraries print goes to the scan's
log. The worker ends with its parent, however that ends. The parent sees it as a `process`.
"""

from __future__ import annotations

import contextlib
import json
import os
import queue
import signal
import sys
import threading
import traceback
from collections.abc import Iterator
from dataclasses import asdict
from pathlib import Path
from typing import IO, Any

from scanrender.batch.job import do_job
from scanrender.batch.log import LOG_NAME
from scanrender.batch.tasks import as_event, job_of
from scanrender.errors import CrashError, ScanrenderError
from scanrender.scan.worker import tie_to_parent


def main() -> int:
    tie_to_parent()
    signal.signal(signal.SIGTERM, _stop)
    with contextlib.suppress(AttributeError):  # Ctrl-C is the parent's to answer
        signal.signal(signal.SIGINT, signal.SIG_IGN)
    protocol = os.fdopen(os.dup(1), "w", buffering=1, encoding="utf-8")
    os.dup2(2, 1)
    for line in _lines():
        _do(json.loads(line), protocol)
    return 0


def _stop(*_: object) -> None:
    raise SystemExit(0)


def _lines() -> Iterator[str]:
    """Lines of standard input. A thread reads them, so that its end, which is the parent's, ends
    this process in the middle of a task."""
    lines: queue.Queue[str | None] = queue.Queue()
    busy = threading.Event()

    def read() -> None:
        for line in sys.stdin:
            busy.set()
            lines.put(line)
        if busy.is_set():
            os._exit(1)
        lines.put(None)

    threading.Thread(target=read, daemon=True).start()
    while (line := lines.get()) is not None:
        yield line
        busy.clear()


def _do(task: dict[str, Any], protocol: IO[str]) -> None:
    def tell(event: dict[str, Any]) -> None:
        protocol.write(json.dumps(event) + "\n")

    def progress(stage: str, fraction: float) -> None:
        tell({"stage": stage, "fraction": round(fraction, 4)})

    progress("start", 0.0)
    job = job_of(task)
    try:
        with _printing_into(job.folder / LOG_NAME):
            how = {name: task[name] for name in ("verify", "only", "opens_gl", "wait_s")}
            result = do_job(job, progress, **how)
        tell({"done": {**asdict(result), "folder": str(result.folder)}})
    except ScanrenderError as error:
        tell(as_event(error))
    except MemoryError:
        what, fix = "memory ran out", "use fewer --jobs, smaller pictures, or a larger machine"
        tell(as_event(CrashError(what, fix=fix)))
    except Exception as error:  # noqa: BLE001  a bug that one scan brings to light stops no other
        with _printing_into(job.folder / LOG_NAME):
            traceback.print_exc()
        what = f"this is a bug in scanrender: {type(error).__name__}: {error}"
        where, fix = str(job.folder / LOG_NAME), "run this scan alone with --debug and report it"
        tell(as_event(ScanrenderError(what, where, fix)))


@contextlib.contextmanager
def _printing_into(path: Path) -> Iterator[None]:
    """Standard output and error, those of native libraries too, go to the end of the file."""
    kept = os.dup(2)
    try:
        with contextlib.suppress(OSError):
            path.parent.mkdir(parents=True, exist_ok=True)
            file = os.open(path, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o666)
            os.dup2(file, 1)
            os.dup2(file, 2)
            os.close(file)
        yield
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os.dup2(kept, 1)
        os.dup2(kept, 2)
        os.close(kept)


if __name__ == "__main__":
    code = main()
    # Without interpreter teardown: drivers wait for their threads there, and nothing is unwritten.
    sys.stderr.flush()
    os._exit(code)
