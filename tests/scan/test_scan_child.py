"""Children started early: copies of this process do what new ones do, and die like them."""

from __future__ import annotations

import os
import subprocess
import sys
import time

import numpy as np
import pytest
from scan_shapes import grid

from scanrender.batch.process import WorkerProcess
from scanrender.errors import StageError
from scanrender.scan import child
from scanrender.scan.child import run_task, started_early
from scanrender.scan.collapse import collapsed, make_room
from scanrender.scan.mend import plain_surface
from scanrender.scan.unwrap_charts import unwrap_by_charts


def hills(side):
    return grid(lambda x, y: np.sin(0.3 * x) * np.cos(0.2 * y), side)


@pytest.mark.parametrize("copied", [True, False])
def test_a_child_started_early_does_the_work_and_leaves_nothing(copied):
    positions, faces = hills(12)
    arrays, params = {"positions": positions, "faces": faces}, {"padding": 0.01}
    with started_early({"charts": {}}, copied=copied):
        early = child._early["charts"]
        result, report = run_task("charts", arrays, params, 60.0)
        assert early.process.returncode == 0
    assert not early.folder.exists()
    expected, same = unwrap_by_charts(arrays, params)
    assert report == same
    np.testing.assert_allclose(result["packed"], expected["packed"], atol=1e-12)


def test_no_module_is_imported_from_the_folder_that_one_stands_in(tmp_path, monkeypatch):
    """Nothing beside a scan can run code, whatever it is called."""
    for name in ("json", "numpy", "sitecustomize"):
        (tmp_path / f"{name}.py").write_text("raise SystemExit('imported from beside the scan')")
    monkeypatch.chdir(tmp_path)
    positions, faces = hills(6)
    arrays = {"positions": positions, "faces": faces}
    result, _ = run_task("charts", arrays, {"padding": 0.01}, 60.0)
    assert len(result["chart"]) == len(faces)
    worker = WorkerProcess(1)
    worker.let_go()  # it ends when nobody asks for more
    assert worker.process.wait(60.0) == 0
    worker.end()


@pytest.mark.skipif(not hasattr(os, "fork"), reason="this system has no copies")
@pytest.mark.parametrize(
    ("params", "sentence"),
    [
        ({"how": "SIGSEGV"}, "crashed .SIGSEGV"),
        ({"how": "SIGKILL"}, "memory ran out"),
        ({"how": "raise"}, "asked to fail"),
        ({"how": "allocate", "mib": 1 << 30}, "'fail' ran out of memory"),
    ],
)
def test_a_dying_copy_is_a_stage_error(params, sentence):
    with started_early({"fail": {}}, copied=True), pytest.raises(StageError, match=sentence):
        run_task("fail", {}, params, 30.0)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="this system has no copies")
def test_a_hanging_copy_is_stopped_and_an_idle_one_ends():
    start = time.monotonic()
    with started_early({"fail": {}, "charts": {}}, copied=True):
        idle = child._early["charts"].process
        with pytest.raises(StageError, match="longer than 1 s"):
            run_task("fail", {}, {"how": "hang"}, 1.0)
        assert idle.poll() is None
    assert idle.returncode is not None
    assert time.monotonic() - start < 15.0


def test_stages_that_take_turns_to_be_announced_do_not_run_for_ever():
    """Each has its own deadline, from when it was first announced."""
    program = (
        "import time\n"
        "for turn in range(200):\n"
        """    print('{"stage": "%s"}' % "ab"[turn % 2], flush=True)\n"""
        "    time.sleep(0.05)\n"
    )
    with subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE) as process:
        with pytest.raises(StageError, match=r"'[ab]' took longer than 0.5 s"):
            child._follow(process, "a", 0.5, 0.0, None)
        process.kill()


def test_grace_lets_an_inner_child_end_first():
    with child.child_for("fail") as one:
        (one.folder / "in").mkdir()
        (one.folder / "params.json").write_text('{"how": "hang", "seconds": 1.0}')
        one.run(0.5, grace_s=60.0)
        assert (one.folder / "report.json").exists()


def test_room_changes_no_collapse():
    surface = plain_surface(*hills(30))
    before = collapsed(surface, 400, 7.0)
    make_room(5000, 2500)
    for one, other in zip(before, collapsed(surface, 400, 7.0), strict=True):
        np.testing.assert_array_equal(one, other)
