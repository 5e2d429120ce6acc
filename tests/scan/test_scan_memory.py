"""The bound on memory holds in the process that states it and in all that it starts."""

from __future__ import annotations

import signal
import subprocess
import sys

import pytest
from scan_shapes import sphere, write_ply

from scanrender.errors import CrashError
from scanrender.scan.memory import OUT_OF_MEMORY
from scanrender.scan.prepare import prepare
from scanrender.settings.prep import PrepSettings
from scanrender.settings.scan import ScanSettings

pytest.importorskip("resource", reason="this system has no such limits")

NESTED = """
import subprocess, sys
from scanrender.scan.memory import limit_memory
limit_memory(400)
inner = "from scanrender.scan.memory import limit_memory; limit_memory(); import numpy as np; "
for mib in sys.argv[1:]:
    code = inner + f"np.ones({mib} << 17)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    print(done.returncode, "MemoryError" in done.stderr)
"""


def test_children_cannot_lift_a_stated_limit():
    done = subprocess.run(
        [sys.executable, "-c", NESTED, "50", "600"], capture_output=True, text=True, check=True
    )
    assert done.stdout.splitlines() == ["0 False", "1 True"]


CRASH = """
from scanrender.errors import StageError
from scanrender.scan.child import child_for, run_task
from scanrender.scan.memory import limit_memory
def said(run):
    try:
        run()
    except StageError as error:
        print(error.what, error.fix, sep=" | ")
def stated(how):
    with child_for("fail") as one:
        (one.folder / "in").mkdir()
        (one.folder / "params.json").write_text('{"how": "%s"}' % how)
        one.run(30.0, limited=True)
said(lambda: run_task("fail", {}, {"how": "SIGSEGV"}, 30.0))
said(lambda: stated("SIGABRT"))
said(lambda: stated("SIGTERM"))
limit_memory(1000)
said(lambda: run_task("fail", {}, {"how": "SIGSEGV"}, 30.0))
"""


def test_a_crash_under_a_stated_limit_may_be_a_failed_allocation():
    done = subprocess.run([sys.executable, "-c", CRASH], capture_output=True, text=True, check=True)
    perhaps = f"perhaps because memory ran out | {OUT_OF_MEMORY}"
    assert done.stdout.splitlines() == [
        "the stage 'fail' crashed (SIGSEGV) | None",
        f"the stage 'fail' crashed (SIGABRT), {perhaps}",
        "the stage 'fail' crashed (SIGTERM) | None",
        f"the stage 'fail' crashed (SIGSEGV), {perhaps}",
    ]


@pytest.mark.parametrize(("mib", "fix"), [(4000, OUT_OF_MEMORY), (None, None)])
def test_so_may_that_of_a_preparation_with_memory_mib(mib, fix, tmp_path, children):
    positions, faces, _ = sphere(100.0, 6, 12)
    scan = write_ply(tmp_path / "a.ply", positions, faces)

    def crash(stage, _):
        if stage == "ingest":
            children[0].send_signal(signal.SIGSEGV)

    settings = PrepSettings(memory_mib=mib)
    with pytest.raises(CrashError, match=r"crashed \(SIGSEGV\)") as caught:
        prepare(scan, ScanSettings(), settings, tmp_path / "out", progress=crash)
    assert caught.value.fix == fix


LARGE_PARENT = """
import subprocess, sys
held = bytearray(b"x" * (500 << 20))
child = "from scanrender.scan.journal import peak_mib; print(peak_mib())"
print(subprocess.run([sys.executable, "-c", child], capture_output=True, text=True).stdout)
"""


@pytest.mark.skipif(sys.platform != "linux", reason="/proc")
def test_peak_memory_does_not_count_the_parents():
    done = subprocess.run(
        [sys.executable, "-c", LARGE_PARENT], capture_output=True, text=True, check=True
    )
    assert 0 < int(done.stdout) < 300
