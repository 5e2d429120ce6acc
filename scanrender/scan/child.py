"""Child processes that may crash, hang or be killed without taking the parent along.

A child never outlives its parent (`worker.tie_to_parent`). It is `python -m scanrender.scan.worker`
or a copy of the parent, and waits until the parent has written arrays into a scratch folder; the
parent reads others back. Standard output of the child carries one JSON line per event:
`{"stage": name, "fraction": x}`, `{"error": {...}}`; anything else that a library prints goes to
the child's standard error, whose tail is quoted when the child dies.
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
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, TypeAlias

from scanrender import errors
from scanrender.errors import CrashError, ScanrenderError, StageError
from scanrender.files import scratch_folder
from scanrender.scan.copied import Copy
from scanrender.scan.memory import OUT_OF_MEMORY, limit_is_stated

if TYPE_CHECKING:  # NumPy takes a fifth of a second that the child's own start can use
    import numpy.typing as npt

Arrays: TypeAlias = "Mapping[str, npt.NDArray[Any]]"
Expected: TypeAlias = Mapping[str, int]
Progress = Callable[[str, float], None]
# glibc: temporary arrays up to 32 MiB come from memory that was used before, without a page fault
# for each 4 KiB, a sixth of the time of cleaning; at most 256 MiB of it is kept. What is new comes
# in pages of 4 KiB. Those of 2 MiB make the collapse a tenth faster, but a virtual machine gives
# its free ones back to the host, and waits for each: 400 MiB took 1.4 s, where small ones take 0.3.
_DEFAULTS = {
    "MALLOC_MMAP_THRESHOLD_": str(32 << 20),
    "MALLOC_TRIM_THRESHOLD_": str(256 << 20),
    "NUMPY_MADVISE_HUGEPAGE": "0",
    # The work is shared among processes: threads of BLAS' own wait beside them in busy loops.
    "OPENBLAS_NUM_THREADS": "1",
}
# Signals that native libraries die of when they get no memory.
FAILED_ALLOCATION = {"SIGSEGV", "SIGABRT", "SIGBUS", "SIGILL", "SIGTRAP"}
GO = b"go\n"  # what a child waits for
PARENT = "SCANRENDER_PARENT"  # environment variable: the process a worker must not outlive


def run_task(
    task: str,
    arrays: Arrays,
    params: Mapping[str, Any],
    timeout_s: float,
    handed_over: Callable[[], None] = lambda: None,
) -> tuple[dict[str, npt.NDArray[Any]], dict[str, Any]]:
    """Run one native task (`worker.TASKS`) in a child. Returns its arrays and its report.

    A child that `started_early` holds for it is used. `handed_over` is called once it has its
    input. Raises StageError when the child crashes or takes longer than timeout_s.
    """
    with child_for(task) as child:
        save_arrays(child.folder / "in", arrays)
        (child.folder / "params.json").write_text(json.dumps(dict(params)), encoding="utf-8")
        handed_over()
        child.run(timeout_s)
        result = load_arrays(child.folder / "out")
        report = json.loads((child.folder / "report.json").read_text(encoding="utf-8"))
    return result, report


def save_arrays(folder: Path, arrays: Arrays) -> None:
    """One .npy each: an .npz is written in small blocks with a checksum, many times slower beside
    a thread that holds the interpreter's lock."""
    import numpy as np

    folder.mkdir()
    for key, values in arrays.items():
        np.save(folder / f"{key}.npy", values, allow_pickle=False)


def load_arrays(folder: Path) -> dict[str, npt.NDArray[Any]]:
    """What `save_arrays` wrote."""
    import numpy as np

    return {path.stem: np.load(path, allow_pickle=False) for path in sorted(folder.glob("*.npy"))}


def mapped_arrays(folder: Path) -> dict[str, npt.NDArray[Any]]:
    """The same without a copy, as long as the files are there; changes stay in this process."""
    import numpy as np

    paths = sorted(folder.glob("*.npy"))
    return {path.stem: np.asarray(np.load(path, "c", allow_pickle=False)) for path in paths}


@dataclass(frozen=True)
class Child:
    """A process that waits for the input of its task in `folder`. With own_group it leads a process
    group, so that killing it also kills its children."""

    task: str
    folder: Path
    process: subprocess.Popen[bytes] | Copy
    stderr: IO[bytes]
    own_group: bool

    def run(
        self,
        timeout_s: float,
        progress: Progress | None = None,
        grace_s: float = 0.0,
        limited: bool = False,
    ) -> None:
        """Let it work; each stage has the timeout, from when it is first announced, and grace_s for
        children of its own to reach theirs first. `limited`: it limits its memory as stated.

        Raises what the child raised, or StageError for a crash or a timeout.
        """
        process, stage = self.process, self.task
        assert process.stdin is not None
        try:
            with contextlib.suppress(OSError):  # it is dead already: its exit code will tell
                process.stdin.write(GO)
                process.stdin.flush()
            stage = _follow(process, stage, timeout_s, grace_s, progress)
        finally:
            _close(process, self.own_group)
        if process.returncode:
            limited = limited or limit_is_stated()
            raise _crash(process.returncode, stage, _tail(self.stderr), limited)


_early: dict[str, Child] = {}


@contextlib.contextmanager
def child_for(task: str, own_group: bool = False) -> Iterator[Child]:
    """The child that was started early for the task, or a new one."""
    early = _early.pop(task, None)
    if early:
        yield early
        return
    with _begun(task, {}, False, own_group) as child:
        yield child


@contextlib.contextmanager
def started_early(
    tasks: Mapping[str, Expected], copied: bool = False, own_group: bool = False
) -> Iterator[None]:
    """Children for the first use of each of the tasks load their libraries, and make room for what
    is to be expected (`worker.ROOM`), while this process still makes their input. `copied` from
    this process they have those that it has: a second less."""
    with ExitStack() as stack:
        for task, expected in tasks.items():
            _early[task] = stack.enter_context(_begun(task, expected, copied, own_group))
        try:
            yield
        finally:
            for task in tasks:
                _early.pop(task, None)


@contextlib.contextmanager
def _begun(task: str, expected: Expected, copied: bool, own_group: bool) -> Iterator[Child]:
    with scratch_folder() as folder, tempfile.TemporaryFile() as stderr:
        arguments = [task, str(folder), json.dumps(dict(expected))]
        if copied and hasattr(os, "fork"):
            process: subprocess.Popen[bytes] | Copy = _copied(arguments, stderr)
        else:
            process = _started(arguments, stderr, own_group)
        try:
            yield Child(task, folder, process, stderr, own_group)
        finally:
            _close(process, own_group)


def _copied(arguments: list[str], stderr: IO[bytes]) -> Copy:
    from scanrender.scan.worker import main

    return Copy(lambda: main(arguments), stderr, _environment(arguments[1]))


def _started(arguments: list[str], stderr: IO[bytes], own_group: bool) -> subprocess.Popen[bytes]:
    return subprocess.Popen(
        # -P: a json.py in the folder that one stands in, of scans perhaps, is not imported.
        [sys.executable, "-P", "-m", "scanrender.scan.worker", *arguments],
        stdin=subprocess.PIPE,  # its end tells the child that we are gone
        stdout=subprocess.PIPE,
        stderr=stderr,
        env=_environment(arguments[1]),
        start_new_session=own_group,
    )


def _close(process: subprocess.Popen[bytes] | Copy, own_group: bool) -> None:
    if process.poll() is None:
        _kill(process, own_group)
    for stream in (process.stdin, process.stdout):
        if stream is not None:
            with contextlib.suppress(OSError):
                stream.close()


def _follow(
    process: subprocess.Popen[bytes] | Copy,
    stage: str,
    timeout_s: float,
    grace_s: float,
    progress: Progress | None,
) -> str:
    """Read events until the child closes its output; returns the last stage announced."""
    lines: queue.Queue[bytes | None] = queue.Queue()
    assert process.stdout is not None
    reader = threading.Thread(target=_pump, args=(process.stdout, lines), daemon=True)
    reader.start()
    deadlines = {stage: time.monotonic() + timeout_s + grace_s}
    while True:
        try:
            line = lines.get(timeout=max(0.0, deadlines[stage] - time.monotonic()))
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
            stage = event["stage"]
            deadlines.setdefault(stage, time.monotonic() + timeout_s + grace_s)
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


def _crash(code: int, stage: str, tail: str, limited: bool) -> StageError:
    """A child's exit code as a sentence. Negative codes are POSIX signals."""
    where = tail or None
    if code == -signal.SIGKILL:
        what = f"the stage '{stage}' was killed, most likely because memory ran out"
        return CrashError(what, fix="lower prep.simplify.triangles, or use a larger machine")
    if code < 0:
        with contextlib.suppress(ValueError):
            name = signal.Signals(-code).name
            what = f"the stage '{stage}' crashed ({name})"
            if limited and name in FAILED_ALLOCATION:
                what = f"{what}, perhaps because memory ran out"
                return CrashError(what, where, OUT_OF_MEMORY)
            return CrashError(what, where)
    return StageError(f"the stage '{stage}' failed with exit code {code}", where)


def _tail(stream: Any) -> str:
    stream.seek(0, os.SEEK_END)
    stream.seek(max(0, stream.tell() - 4000))
    lines = [x for x in stream.read().decode("utf-8", "replace").splitlines() if x.strip()]
    return lines[-1][:300] if lines else ""


def _kill(process: subprocess.Popen[bytes] | Copy, own_group: bool) -> None:
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
    return {**_DEFAULTS, **os.environ, **own, "TMPDIR": folder, PARENT: str(os.getpid())}
