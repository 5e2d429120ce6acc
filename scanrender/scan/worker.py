"""The program inside the child processes: `python -m scanrender.scan.worker TASK FOLDER EXPECTED`.

Only here are pymeshlab, xatlas, libigl's solvers and fast-simplification called: they can crash,
hang, hold the interpreter lock for minutes, or carry the GPL (pymeshlab). The parent is `child`.
"""

from __future__ import annotations

import contextlib
import importlib
import json
import os
import signal
import sys
import threading
import traceback
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from scanrender.errors import ScanrenderError
from scanrender.scan.child import GO, PARENT, mapped_arrays, save_arrays
from scanrender.scan.memory import OUT_OF_MEMORY, limit_memory

Table = dict[str, Any]
_PR_SET_PDEATHSIG = 1  # linux/prctl.h
_kept: list[Any] = []  # until this process ends
# (arrays, parameters) -> (arrays, report)
Task = Callable[[Table, Table], tuple[Table, Table]]


def _simplify(arrays: Table, params: Table) -> tuple[Table, Table]:
    from scanrender.scan.collapse import collapse_task

    return collapse_task(arrays, params)


def _lods(arrays: Table, params: Table) -> tuple[Table, Table]:
    from scanrender.scan.lods import lods_task

    return lods_task(arrays, params)


def _charts(arrays: Table, params: Table) -> tuple[Table, Table]:
    from scanrender.scan.unwrap_charts import unwrap_by_charts

    return unwrap_by_charts(arrays, params)


def _xatlas(arrays: Table, params: Table) -> tuple[Table, Table]:
    from scanrender.scan.unwrap_xatlas import unwrap_by_xatlas

    return unwrap_by_xatlas(arrays, params)


def _pack(arrays: Table, params: Table) -> tuple[Table, Table]:
    from scanrender.scan.unwrap_xatlas import pack

    return pack(arrays, params)


def _self_intersections(arrays: Table, params: Table) -> tuple[Table, Table]:
    from scanrender.scan.meshlab import self_intersections

    return self_intersections(arrays, params)


def _plain(arrays: Table, params: Table) -> tuple[Table, Table]:
    from scanrender.scan.plain import plain_call

    return plain_call(arrays, params)


def _fail(arrays: Table, params: Table) -> tuple[Table, Table]:
    """For tests: die or hang as native libraries do."""
    import time

    if params["how"] == "hang":
        time.sleep(params.get("seconds", 60.0))
    elif params["how"] == "raise":
        raise ValueError("asked to fail")
    elif params["how"] == "allocate":
        np.ones(params["mib"] << 17)
    else:
        os.kill(os.getpid(), getattr(signal, params["how"]))
    return {}, {}


TASKS: dict[str, Task] = {
    "simplify": _simplify,
    "lods": _lods,
    "charts": _charts,
    "xatlas": _xatlas,
    "pack": _pack,
    "self_intersections": _self_intersections,
    "plain": _plain,
    "fail": _fail,
}


# What a child loads while it waits.
LIBRARIES = {
    "prepare": ("scanrender.scan.pipeline",),
    "simplify": ("scanrender.scan.collapse", "fast_simplification", "igl"),
    "charts": ("scanrender.scan.unwrap_charts", "scipy.cluster.vq", "igl"),
}


def _room_to_simplify(faces: int, vertices: int) -> None:
    from scanrender.scan.collapse import make_room

    make_room(faces, vertices)


# What it does then, with what is known of its input.
ROOM: dict[str, Callable[..., None]] = {"simplify": _room_to_simplify}


def main(arguments: list[str]) -> int:
    """TASK FOLDER, and a JSON object for ROOM; returns the exit code."""
    task, folder = arguments[0], Path(arguments[1])
    tie_to_parent()
    limit_memory()
    if PARENT in os.environ and not _told_to_go(task, json.loads(arguments[2])):
        return 0
    watch_parent()
    stage = [task]
    # The protocol keeps the real standard output; whatever libraries print joins standard error.
    protocol = os.fdopen(os.dup(1), "w", buffering=1, encoding="utf-8")
    os.dup2(2, 1)
    try:
        if task == "prepare":
            _prepare(folder, protocol, stage)
        else:
            _run(task, folder)
        protocol.flush()
    except ScanrenderError as error:
        document = {"what": error.what, "where": error.where, "fix": error.fix}
        protocol.write(json.dumps({"error": {"kind": type(error).__name__, **document}}) + "\n")
        return error.exit_code
    except MemoryError:
        _write_error(protocol, f"the stage '{stage[0]}' ran out of memory", OUT_OF_MEMORY)
        return 5
    except Exception as error:  # noqa: BLE001  the parent must get a sentence, whatever a library raised
        traceback.print_exc()
        what = f"the stage '{stage[0]}' failed: {type(error).__name__}: {error}"
        _write_error(protocol, " ".join(what.split()))
        return 5
    return 0


def _told_to_go(task: str, expected: Mapping[str, int]) -> bool:
    """Load what the task needs, and wait; false when the parent has no work after all."""
    for module in LIBRARIES.get(task, ()):
        importlib.import_module(module)
    if task in ROOM and expected:
        ROOM[task](**expected)
    return os.read(0, len(GO)) == GO


def tie_to_parent() -> None:
    """End this process when its parent ends, however that happens.

    Linux does it at once, even inside a library that holds the interpreter lock. Elsewhere
    `watch_parent` does, when it can.
    """
    parent = os.environ.get(PARENT)
    if parent is None:  # started by hand
        return
    if sys.platform == "linux":
        import ctypes

        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, int(signal.SIGKILL))
        if os.getppid() != int(parent):  # it ended before we asked
            os._exit(1)


def watch_parent() -> None:
    """End this process with its standard input: a thread waits, and has to wait for the
    interpreter's lock too."""
    if PARENT not in os.environ:  # started by hand
        return

    def wait() -> None:
        with contextlib.suppress(OSError):
            while os.read(0, 1):
                pass
        os._exit(1)

    threading.Thread(target=wait, daemon=True).start()


def _write_error(protocol: Any, what: str, fix: str | None = None) -> None:
    error = {"kind": "StageError", "what": what, "fix": fix}
    with contextlib.suppress(OSError):
        protocol.write(json.dumps({"error": error}) + "\n")


def _run(task: str, folder: Path) -> None:
    params = json.loads((folder / "params.json").read_text(encoding="utf-8"))
    result, report = TASKS[task](mapped_arrays(folder / "in"), params)
    save_arrays(folder / "out", result)
    (folder / "report.json").write_text(json.dumps(report), encoding="utf-8")


def _prepare(folder: Path, protocol: Any, current: list[str]) -> None:
    """Prepare the scan of job.json; current[0] is kept at the stage that runs."""
    from scanrender.asset import save_asset
    from scanrender.scan.pipeline import prepare_here
    from scanrender.scan.report import write_report
    from scanrender.settings.prep import PrepSettings
    from scanrender.settings.scan import ScanSettings

    job = json.loads((folder / "job.json").read_text(encoding="utf-8"))
    prep = PrepSettings.model_validate(job["prep"])
    limit_memory(prep.memory_mib)

    def progress(stage: str, fraction: float) -> None:
        current[0] = stage
        protocol.write(json.dumps({"stage": stage, "fraction": fraction}) + "\n")

    asset = prepare_here(
        Path(job["scan_path"]),
        ScanSettings.model_validate(job["scan"]),
        prep,
        progress=progress,
        as_is=job["as_is"],
        views=folder / "views.npz",
        keep=_kept,
    )
    progress("save", 0.97)
    save_asset(asset, Path(job["asset"]))
    write_report(asset.info, folder / "views.npz", Path(job["asset"]))


if __name__ == "__main__":
    code = main(sys.argv[1:])
    sys.stderr.flush()
    # Without interpreter teardown: native libraries crash or wait for their threads there, when
    # the result is written and complete already.
    os._exit(code)
