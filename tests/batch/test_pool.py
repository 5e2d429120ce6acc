"""Workers that die, hang, run out of memory or are stopped cost tries, never results."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from batch.killing import KILL
from render.synthetic import pipeline, sphere

from scanrender.asset import save_asset
from scanrender.batch import pool
from scanrender.batch.jobs import Job, make_jobs
from scanrender.batch.lock import LOCK_NAME, drop_unheld, locked
from scanrender.batch.run import Batch, Options, run_jobs
from scanrender.errors import CrashError, OutputError
from scanrender.render.device import Device

linux_only = pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
pytestmark = [pytest.mark.gl, linux_only]

TINY = {
    "stages": ["render"],
    "camera": {"width_px": 32, "height_px": 32},
    "turntable": {"frames": 4},
    "quality": {"supersampling": 1},
    "lights": [{"type": "directional", "shadow_px": 64}],
    "outputs": {"frames": True},
}


@pytest.fixture(scope="module")
def assets(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    folder = tmp_path_factory.mktemp("assets")
    ball = sphere(20.0, (0.6, 0.3, 0.2), rings=10)
    return [save_asset(ball, folder / name / "asset") for name in ("anna", "bert")]


@pytest.fixture(scope="module")
def expected(assets: list[Path], tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    out = tmp_path_factory.mktemp("expected")
    batch = run(make(assets, out), out)
    assert len(batch.results) == 2
    found: dict[str, str] = KILL.contents(out)
    return found


def make(assets: list[Path], out: Path, **changes: Any) -> list[Job]:
    return make_jobs(assets, pipeline(TINY, **changes), "the test", out)


def run(jobs: list[Job], out: Path, show=lambda *_: None, say=print, **options: Any) -> Batch:
    return run_jobs(jobs, out, show, say, Options(**{"workers": 1, **options}))


def workers() -> list[int]:
    """Our children that run the worker's program."""
    found = []
    for entry in Path("/proc").iterdir():
        with contextlib.suppress(OSError, ValueError):
            parent = int((entry / "stat").read_text().rsplit(")", 1)[1].split()[1])
            if (
                parent == os.getpid()
                and b"scanrender.batch.worker" in (entry / "cmdline").read_bytes()
            ):
                found.append(int(entry.name))
    return found


class Sends:
    """A signal to the worker whenever the first scan has a frame, at most `most` times."""

    def __init__(self, number: int, most: int) -> None:
        self.number, self.left = number, most

    def __call__(self, job: Job, stage: str, fraction: float) -> None:
        if job.name.startswith("anna") and stage == "render" and self.left:
            self.left -= 1
            for process in workers():
                os.kill(process, self.number)


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSEGV])
def test_a_worker_that_dies_costs_one_try(assets, tmp_path: Path, expected, number: int):
    said: list[str] = []
    batch = run(make(assets, tmp_path), tmp_path, Sends(number, 1), said.append)
    assert batch.failures == []
    assert len(batch.results) == 2
    assert KILL.contents(tmp_path) == expected
    assert any("trying again" in line and signal.Signals(number).name in line for line in said)
    assert workers() == []
    assert list(tmp_path.rglob(".*")) == []


def test_tries_are_bounded_and_the_others_complete(assets, tmp_path: Path):
    batch = run(make(assets, tmp_path), tmp_path, Sends(signal.SIGKILL, 9), retries=1)
    [failure] = batch.failures
    assert failure.error.exit_code == 5
    assert "SIGKILL" in failure.error.what
    assert "2 times" in failure.error.what
    assert "log.txt" in str(failure.error.where)
    assert "memory" in str(failure.error.fix)
    [result] = batch.results
    assert result.name.startswith("bert")
    assert not (failure.job.folder / "manifest.json").exists()
    assert workers() == []


def test_a_worker_that_hangs_is_stopped(assets, tmp_path: Path, monkeypatch):
    """While one is stopped the pool's clock races, so that a slow machine is no hang."""
    clock = SimpleNamespace(ahead=0.0, races=False)

    def monotonic() -> float:
        clock.ahead += 300.0 * clock.races
        return time.monotonic() + clock.ahead

    stop = Sends(signal.SIGSTOP, 1)

    def show(job: Job, stage: str, fraction: float) -> None:
        stop(job, stage, fraction)
        clock.races = stop.left == 0 and job.name.startswith("anna") and stage != "failed"

    monkeypatch.setattr(pool, "time", SimpleNamespace(monotonic=monotonic))
    batch = run(make(assets, tmp_path), tmp_path, show, retries=0, timeout_s=600.0)
    [failure] = batch.failures
    assert "no sign of life for 600 s" in failure.error.what
    assert "'render'" in failure.error.what
    assert "--timeout" in str(failure.error.fix)
    assert len(batch.results) == 1
    assert workers() == []


def test_no_more_workers_than_memory_holds(assets, tmp_path: Path, monkeypatch):
    monkeypatch.setattr(pool, "free_mib", lambda: 1000)
    at_work: list[set[str]] = []
    running: set[str] = set()

    def show(job: Job, stage: str, fraction: float) -> None:
        (running.discard if stage in ("done", "failed") else running.add)(job.name)
        at_work.append(set(running))

    said: list[str] = []
    batch = run(make(assets, tmp_path), tmp_path, show, said.append, workers=2)
    assert len(batch.results) == 2
    assert max(len(names) for names in at_work) == 1
    assert sum("MiB" in line for line in said) == 1, "said once"


def test_two_workers_make_what_one_makes(assets, tmp_path: Path, expected):
    run(make(assets, tmp_path), tmp_path, workers=2)
    assert KILL.contents(tmp_path) == expected


def test_a_device_that_reports_an_error_is_lost():
    context = SimpleNamespace(error="GL_NO_ERROR")
    device: Any = SimpleNamespace(context=context, renderer="a GPU")
    Device.check(device)
    context.error = "GL_UNKNOWN_ERROR"
    with pytest.raises(CrashError, match="a GPU"):
        Device.check(device)


def test_two_runs_in_one_folder(assets, tmp_path: Path, expected):
    with locked(tmp_path):
        command = [sys.executable, "-m", "scanrender", "run", tiny_file(tmp_path.parent), *assets]
        second = subprocess.run(
            [str(word) for word in [*command, "--out", tmp_path]],
            capture_output=True, text=True, check=False,
        )  # fmt: skip
    assert second.returncode == 7, second.stderr
    assert "another run works in" in second.stderr
    assert f"process {os.getpid()} " in second.stderr
    assert not (tmp_path / LOCK_NAME).exists()
    run(make(assets, tmp_path), tmp_path)
    assert KILL.contents(tmp_path) == expected


def test_a_lock_ends_with_its_process(tmp_path: Path):
    program = (
        "from pathlib import Path\nfrom scanrender.batch.lock import locked\n"
        f"with locked(Path({str(tmp_path)!r})):\n    print('held', flush=True)\n    input()\n"
    )
    holder = subprocess.Popen(
        [sys.executable, "-c", program], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    )
    assert holder.stdout is not None
    assert holder.stdin is not None
    assert holder.stdout.readline() == b"held\n"
    with pytest.raises(OutputError, match=f"process {holder.pid} "), locked(tmp_path):
        pass
    holder.kill()
    holder.wait()
    holder.stdout.close()
    holder.stdin.close()
    with locked(tmp_path):
        pass
    assert list(tmp_path.iterdir()) == []


# --- from outside --------------------------------------------------------------------------------


def tiny_file(folder: Path) -> Path:
    path = folder / "tiny.yaml"
    path.write_text("version: 1\n" + "".join(f"{key}: {value}\n" for key, value in TINY.items()))
    return path


def batch_of(assets: list[Path], tmp_path: Path, name: str) -> Any:
    words = [str(tiny_file(tmp_path)), *map(str, assets), "--jobs", "2", "--progress", "json"]
    return KILL.Batch(words, tmp_path / name)


def test_ctrl_c_stops_everything_and_leaves_what_is_complete(assets, tmp_path: Path, expected):
    batch = batch_of(assets, tmp_path, "out")
    running = batch.start()
    log = tmp_path / "out.log"
    while b'"render"' not in log.read_bytes():
        assert running.poll() is None, log.read_text()
        time.sleep(0.01)
    running.send_signal(signal.SIGINT)
    assert running.wait() == 130, log.read_text()
    assert "Traceback" not in log.read_text()
    left = [name for name in batch.traces() if ".frames" not in name]
    assert left == []
    batch.run()
    assert KILL.contents(batch.out) == expected
    assert batch.traces() == []


@pytest.mark.parametrize("victim", ["parent", "worker"])
def test_nobody_can_tell_that_a_batch_was_killed(assets, tmp_path: Path, expected, victim: str):
    """Two moments each; `tools/kill_batch.py` tries as many as are asked for."""
    chance = KILL.random.Random(victim)
    for number in range(2):
        batch = batch_of(assets, tmp_path, f"out{number}")
        KILL.kill_once(batch, chance.uniform(0.5, 2.5), victim, chance)
        batch.run()
        assert KILL.contents(batch.out) == expected
        assert batch.traces() == []


def test_a_disk_that_fills_and_is_freed(assets, tmp_path: Path, expected):
    disk = tmp_path / "disk"
    disk.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=96k", "tmpfs", str(disk)]
    if os.getuid() or subprocess.run(mount, capture_output=True, check=False).returncode:
        pytest.skip("mounting a small disk takes rights that are not there")
    try:
        out = disk / "out"
        batch = run(make(assets, out), out)
        assert batch.failures
        for failure in batch.failures:
            assert failure.error.exit_code == 7
            assert "No space left" in failure.error.what
            assert "free space" in str(failure.error.fix)
            assert not (failure.job.folder / "manifest.json").exists()
        assert not [path for path in out.rglob(".*") if path.name.startswith(".writing")]
        subprocess.run(["mount", "-o", "remount,size=8m", str(disk)], check=True)
        assert run(make(assets, out), out).failures == []
        assert KILL.contents(out) == expected
        assert list(out.rglob(".*")) == []
    finally:
        subprocess.run(["umount", str(disk)], check=True)


def test_the_lock_of_a_killed_process_goes_and_a_held_one_stays(tmp_path: Path):
    """A worker that Ctrl-C's end killed left its lock's file, which locks nothing."""
    left = tmp_path / LOCK_NAME
    left.write_text("process 1 on nowhere")
    drop_unheld(tmp_path)
    assert not left.exists()
    with locked(tmp_path):
        drop_unheld(tmp_path)
        assert left.exists()


def test_a_lock_that_ends_is_waited_for(tmp_path: Path):
    """A file server keeps the lock of a lost machine for a while."""
    program = (
        "import time\nfrom pathlib import Path\nfrom scanrender.batch.lock import locked\n"
        f"with locked(Path({str(tmp_path)!r})):\n    print('held', flush=True)\n    time.sleep(1)\n"
    )
    with subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE) as holder:
        assert holder.stdout is not None
        assert holder.stdout.readline() == b"held\n"
        with pytest.raises(OutputError, match="another run works in"), locked(tmp_path):
            pass
        with locked(tmp_path, wait_s=60.0):
            assert f"process {os.getpid()} " in (tmp_path / LOCK_NAME).read_text()
