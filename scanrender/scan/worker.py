"""The program that runs inside the child processes: `python -m scanrender.scan.worker TASK FOLDER`.

Only here are pymeshlab, xatlas, libigl's solvers and fast-simplification called: they can crash,
hang, hold the interpreter lock for minutes, or carry the GPL (pymeshlab). The parent is `child`.
"""

from __future__ import annotations

import contextlib
import json
import os
import signal
import sys
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from scanrender.errors import ScanrenderError

Table = dict[str, Any]
# (arrays, parameters) -> (arrays, report)
Task = Callable[[Table, Table], tuple[Table, Table]]


def _simplify(arrays: Table, params: Table) -> tuple[Table, Table]:
    from scanrender.scan.simplify import quadric_simplify

    return quadric_simplify(arrays, params)


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


def _fail(arrays: Table, params: Table) -> tuple[Table, Table]:
    """For tests: die or hang as native libraries do."""
    import time

    if params["how"] == "hang":
        time.sleep(params.get("seconds", 60.0))
    elif params["how"] == "raise":
        raise ValueError("asked to fail")
    else:
        os.kill(os.getpid(), getattr(signal, params["how"]))
    return {}, {}


TASKS: dict[str, Task] = {
    "simplify": _simplify,
    "charts": _charts,
    "xatlas": _xatlas,
    "pack": _pack,
    "self_intersections": _self_intersections,
    "fail": _fail,
}


def main(arguments: list[str]) -> int:
    task, folder = arguments[0], Path(arguments[1])
    # The protocol keeps the real standard output; whatever libraries print joins standard error.
    protocol = os.fdopen(os.dup(1), "w", buffering=1, encoding="utf-8")
    os.dup2(2, 1)
    try:
        if task == "prepare":
            _prepare(folder, protocol)
        else:
            _run(task, folder)
        protocol.flush()
    except ScanrenderError as error:
        document = {"what": error.what, "where": error.where, "fix": error.fix}
        protocol.write(json.dumps({"error": {"kind": type(error).__name__, **document}}) + "\n")
        return error.exit_code
    except MemoryError:
        _write_error(protocol, f"the stage '{task}' ran out of memory")
        return 5
    except Exception as error:  # noqa: BLE001  the parent must get a sentence, whatever a library raised
        traceback.print_exc()
        _write_error(protocol, f"the stage '{task}' failed: {type(error).__name__}: {error}")
        return 5
    return 0


def _write_error(protocol: Any, what: str) -> None:
    with contextlib.suppress(OSError):
        protocol.write(json.dumps({"error": {"kind": "StageError", "what": what}}) + "\n")


def _run(task: str, folder: Path) -> None:
    params = json.loads((folder / "params.json").read_text(encoding="utf-8"))
    with np.load(folder / "in.npz", allow_pickle=False) as stored:
        arrays = {key: stored[key] for key in stored.files}
    result, report = TASKS[task](arrays, params)
    np.savez(folder / "out.npz", **result)
    (folder / "report.json").write_text(json.dumps(report), encoding="utf-8")


def _prepare(folder: Path, protocol: Any) -> None:
    from scanrender.asset import save_asset
    from scanrender.scan.pipeline import prepare_here
    from scanrender.settings.prep import PrepSettings
    from scanrender.settings.scan import ScanSettings

    job = json.loads((folder / "job.json").read_text(encoding="utf-8"))

    def progress(stage: str, fraction: float) -> None:
        protocol.write(json.dumps({"stage": stage, "fraction": fraction}) + "\n")

    asset = prepare_here(
        Path(job["scan_path"]),
        ScanSettings.model_validate(job["scan"]),
        PrepSettings.model_validate(job["prep"]),
        progress=progress,
        as_is=job["as_is"],
    )
    progress("save", 0.97)
    save_asset(asset, Path(job["asset"]))


if __name__ == "__main__":
    code = main(sys.argv[1:])
    sys.stderr.flush()
    # Without interpreter teardown: native libraries crash or wait for their threads there, when
    # the result is written and complete already.
    os._exit(code)
