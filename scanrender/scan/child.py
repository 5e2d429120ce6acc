"""Child processes that may crash, hang or be killed without taking the parent along.

A child never outlives its parent (`worker.tie_to_parent`). The parent writes arrays to an .npz in a
scratch folder, starts `python -m scanrender.scan.worker` and reads another .npz back. Standard
output of the child carries one JSON line per event: `{"stage": name, "fraction": x}`,
`{"error": {...}}`; anything else that a library prints goes to the child's standard error, whose
tail is quoted when the child dies.
"""

from __future__ import annotations

import contextlib
import json
import os
import queue
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from scanrender import errors
from scanrender.errors import ScanrenderError, StageError
from scanrender.files import scratch_folder

Arrays = Mapping[str, npt.NDArray[Any]]
Progress = Callable[[str, float], None]
PARENT = "SCANRENDER_PARENT"  # environment variable: the process a worker must not outlive


def run_task(
    task: str, arrays: Arrays, params: Mapping[str, Any], timeout_s: float
) -> tuple[dict[str, npt.NDArray[Any]], dict[str, Any]]:
    """Run one native task (`worker.TASKS`) in a child. Returns its arrays and its report.

    Raises StageError when the child crashes or takes longer than timeout_s.
    """
    with scratch_folder() as folder:
        np.savez(folder / "in.npz", **arrays)  # type: ignore[arg-type]
        (folder / "params.json").write_text(json.dumps(dict(params)), encoding="utf-8")
        run_worker([task, str(folder)], timeout_s)
        with np.load(folder / "out.npz", allow_pickle=False) as stored:
            result = {key: stored[key] for key in stored.files}
        report = json.loads((folder / "report.json").read_text(encoding="utf-8"))
    return result, report


def run_worker(
    arguments: list[str],
    timeout_s: float,
    progress: Progress | None = None,
    own_group: bool = False,
) -> None:
    """Run the worker module; each stage it announces starts the timeout anew.

    With `own_group` the child leads a process group, so that killing it also kills its children.
    Raises what the child raised, or StageError for a crash or a timeout.
    """
    command = [sys.executable, "-m", "scanrender.scan.worker", *arguments]
    with tempfile.TemporaryFile() as stderr:
        process = subprocess.Popen(
            command,
            stdin=subprocess.PIPE,  # never written: its end tells the child that we are gone
            stdout=subprocess.PIPE,
            stderr=stderr,
            env=_environment(arguments[1]),
            start_new_session=own_group,
        )
        stage = arguments[0]
        try:
            stage = _follow(process, stage, timeout_s, progress)
        finally:
            if process.poll() is None:
                _kill(process, own_group)
            for stream in (process.stdin, process.stdout):
                if stream is not None:
                    stream.close()
        if process.returncode != 0:
            raise _crash(process.returncode, stage, _tail(stderr))


def _follow(
    process: subprocess.Popen[bytes], stage: str, timeout_s: float, progress: Progress | None
) -> str:
    """Read events until the child closes its output; returns the last stage announced."""
    lines: queue.Queue[bytes | None] = queue.Queue()
    assert process.stdout is not None
    reader = threading.Thread(target=_pump, args=(process.stdout, lines), daemon=True)
    reader.start()
    deadline = time.monotonic() + timeout_s
    while True:
        try:
            line = lines.get(timeout=max(0.0, deadline - time.monotonic()))
        except queue.Empty:
            raise StageError(
                f"the stage '{stage}' took longer than {timeout_s:g} s and was stopped",
                fix="raise prep.timeout_s, or lower prep.simplify.triangles",
            ) from None
        if line is None:
            break
        event = _event(line)
        if "error" in event:
            process.wait()
            raise _rebuilt(event["error"])
        if "stage" in event:
            if event["stage"] != stage:
                stage, deadline = event["stage"], time.monotonic() + timeout_s
            if progress is not None:
                progress(stage, float(event.get("fraction", 0.0)))
    with contextlib.suppress(subprocess.TimeoutExpired):
        process.wait(timeout=30)
    return stage


def _pump(stream: Any, lines: queue.Queue[bytes | None]) -> None:
    with contextlib.suppress(OSError, ValueError):
        for line in stream:
            lines.put(line)
    lines.put(None)


def _event(line: bytes) -> dict[str, Any]:
    try:
        event = json.loads(line)
    except ValueError:
        return {}
    return event if isinstance(event, dict) else {}


def _rebuilt(error: Mapping[str, Any]) -> ScanrenderError:
    kind = getattr(errors, str(error.get("kind")), StageError)
    if not (isinstance(kind, type) and issubclass(kind, ScanrenderError)):
        kind = StageError
    return kind(str(error.get("what")), error.get("where"), error.get("fix"))


def _crash(code: int, stage: str, tail: str) -> StageError:
    """A child's exit code as a sentence. Negative codes are POSIX signals."""
    if code == -signal.SIGKILL:
        what = f"the stage '{stage}' was killed, most likely because memory ran out"
        return StageError(what, fix="lower prep.simplify.triangles, or use a larger machine")
    if code < 0:
        with contextlib.suppress(ValueError):
            name = signal.Signals(-code).name
            return StageError(f"the stage '{stage}' crashed ({name})", where=tail or None)
    return StageError(f"the stage '{stage}' failed with exit code {code}", where=tail or None)


def _tail(stream: Any) -> str:
    stream.seek(0, os.SEEK_END)
    stream.seek(max(0, stream.tell() - 4000))
    lines = [x for x in stream.read().decode("utf-8", "replace").splitlines() if x.strip()]
    return lines[-1][:300] if lines else ""


def _kill(process: subprocess.Popen[bytes], own_group: bool) -> None:
    if own_group and hasattr(os, "killpg"):
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(process.pid, signal.SIGKILL)
    process.kill()
    process.wait()


def _environment(folder: str) -> dict[str, str]:
    """The parent's environment, with this very package importable and hashing fixed.

    The child's temporary files lie in `folder`, which the parent removes even if the child dies.
    """
    root = str(Path(errors.__file__).resolve().parents[1])
    paths = [root, *filter(None, os.environ.get("PYTHONPATH", "").split(os.pathsep))]
    own = {"PYTHONPATH": os.pathsep.join(paths), "PYTHONHASHSEED": "0"}
    return {**os.environ, **own, "TMPDIR": folder, PARENT: str(os.getpid())}
