"""Preparations that are killed: no half-written asset, no process or folder left behind."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import threading
import time
import uuid
from pathlib import Path

import pytest
from scan_shapes import sphere, write_obj, write_ply

from scanrender import files
from scanrender.asset import load_asset
from scanrender.batch.run import run_batch
from scanrender.errors import StageError
from scanrender.files import TEMPORARY_PREFIX, clean_stale
from scanrender.scan import child
from scanrender.scan.prepare import prepare
from scanrender.settings.loading import load_pipeline
from scanrender.settings.prep import BakeSettings, PrepSettings, SimplifySettings
from scanrender.settings.scan import ScanSettings

TINY = PrepSettings(
    simplify=SimplifySettings(triangles=400),
    bake=BakeSettings(albedo_px=32, normal_px=32, data_px=32, ao_rays=4, thickness_rays=1),
)
linux_only = pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")


def textured_scan(path):
    positions, faces, uv = sphere(100.0, 6, 12)
    return write_obj(path, positions, faces, uv)


def small_scan(path):
    positions, faces, _ = sphere(100.0, 6, 12)
    return write_ply(path, positions, faces)


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def living(marker: str) -> list[int]:
    """Processes, other than this one, that inherited the environment variable SCANRENDER_TEST."""
    found = []
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit() and int(entry.name) != os.getpid():
            try:
                environment = (entry / "environ").read_bytes()
                state = (entry / "stat").read_text().rsplit(")", 1)[1].split()[0]
            except OSError:
                continue
            if f"SCANRENDER_TEST={marker}".encode() in environment and state != "Z":
                found.append(int(entry.name))
    return found


def all_gone(marker: str) -> bool:
    """Killed processes need a moment: at most 30 s, and none where they die as they should."""
    for _ in range(300):
        if not living(marker):
            return True
        time.sleep(0.1)
    return False


@pytest.fixture
def marker(monkeypatch):
    value = uuid.uuid4().hex
    monkeypatch.setenv("SCANRENDER_TEST", value)
    return value


@pytest.fixture
def killer(monkeypatch):
    """killer(delay): the next preparation's child gets SIGKILL after so many seconds."""
    pending: list[float] = []
    popen = subprocess.Popen

    def start(*arguments, **keywords):
        process = popen(*arguments, **keywords)
        delay = pending.pop(0) if pending else None
        if delay is not None:
            # send_signal looks first whether the process has ended: its number may be another's.
            threading.Timer(delay, process.send_signal, [signal.SIGKILL]).start()
        return process

    monkeypatch.setattr(child.subprocess, "Popen", start)
    return pending.append


@linux_only
def test_twenty_kills_at_random_moments_never_leave_half_an_asset(tmp_path, killer, marker):
    """The asset of an earlier run stays whole until a new one is; nothing else lies beside it.

    As is: without the unwrapper, whose time would be most of the trial. The tests below kill that.
    """
    scan = textured_scan(tmp_path / "a.obj")
    started = time.monotonic()
    prepare(scan, ScanSettings(), TINY, tmp_path / "asset", as_is=True)
    duration = time.monotonic() - started
    before = load_asset(tmp_path / "asset").mesh.faces.tolist()
    moments = random.Random(3)
    ended = {"killed": 0, "finished": 0}
    for _ in range(20):
        killer(moments.uniform(0.0, duration))
        try:
            prepare(scan, ScanSettings(), TINY, tmp_path / "asset", as_is=True)
            ended["finished"] += 1
        except StageError as error:
            ended["killed"] += "was killed" in error.what
        assert names(tmp_path) == ["a.obj", "asset"]
        assert load_asset(tmp_path / "asset").mesh.faces.tolist() == before
    assert sum(ended.values()) == 20, "each ended as an asset, or as killed"
    assert ended["killed"] >= 10, ended
    assert all_gone(marker)


def test_a_killed_child_does_not_stop_the_batch(tmp_path, monkeypatch):
    scans = [small_scan(tmp_path / f"{name}.ply") for name in "abc"]
    keys = ("albedo_px", "normal_px", "data_px", "ao_rays", "thickness_rays")
    tiny = [f"prep.bake.{key}={getattr(TINY.bake, key)}" for key in keys]
    started: list[subprocess.Popen[bytes]] = []
    popen = subprocess.Popen

    def remember(*arguments, **keywords):
        started.append(popen(*arguments, **keywords))
        return started[-1]

    monkeypatch.setattr(child.subprocess, "Popen", remember)

    def kill_second(stage, fraction):
        if len(started) == 2 and stage == "unwrap":
            started[1].send_signal(signal.SIGKILL)

    batch = run_batch(
        scans, load_pipeline("prep_only", tiny), tmp_path / "out", kill_second, lambda _: None
    )
    assert [result.name for result in batch.results] == ["a", "c"]
    [(failed, error)] = batch.failures
    assert failed == scans[1]
    assert error.exit_code == 5
    assert "'unwrap' was killed" in error.what
    for name in "ac":
        assert len(load_asset(tmp_path / "out" / name / "asset").mesh.faces)
    assert not (tmp_path / "out" / "b" / "asset").exists()
    assert not list((tmp_path / "out").rglob(f"{TEMPORARY_PREFIX}*"))


@linux_only
def test_children_end_with_a_killed_parent_and_the_next_run_cleans_up(tmp_path, marker):
    scan, temporary = small_scan(tmp_path / "a.ply"), tmp_path / "tmp"
    temporary.mkdir()
    program = (
        "from scanrender.scan.prepare import prepare\n"
        "from scanrender.settings.prep import PrepSettings\n"
        "from scanrender.settings.scan import ScanSettings\n"
        f"prep = PrepSettings.model_validate({TINY.model_dump()!r})\n"
        f"prepare({str(scan)!r}, ScanSettings(), prep, {str(tmp_path / 'out' / 'asset')!r},\n"
        "        progress=lambda stage, _: print(stage, flush=True))\n"
    )
    command = [sys.executable, "-c", program]
    environment = {**os.environ, "TMPDIR": str(temporary)}
    parent = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=environment)
    assert parent.stdout is not None
    for line in parent.stdout:
        if line.strip() == "unwrap":  # a native library runs in a grandchild now, or very soon
            break
    assert len(living(marker)) >= 2
    parent.kill()
    parent.wait()
    parent.stdout.close()
    assert all_gone(marker)
    [left] = names(tmp_path / "out")
    assert left.startswith(TEMPORARY_PREFIX)
    assert names(temporary)
    subprocess.run(command, check=True, env=environment, stdout=subprocess.DEVNULL)
    assert names(tmp_path / "out") == ["asset"]
    assert names(temporary) == []
    assert len(load_asset(tmp_path / "out" / "asset").mesh.faces)


def dead_process() -> int:
    process = subprocess.Popen([sys.executable, "-c", ""])
    process.wait()
    return process.pid


@pytest.mark.skipif(os.name != "posix", reason="process numbers cannot be asked about")
def test_only_leftovers_of_dead_processes_of_this_machine_are_removed(tmp_path):
    here, dead = files._machine(), dead_process()
    stale = tmp_path / f"{TEMPORARY_PREFIX}{here}-{dead}-0123abcd-asset"
    stale.mkdir()
    (stale / "mesh.glb").write_bytes(b"half")
    (tmp_path / f"{TEMPORARY_PREFIX}{here}-{dead}-0123abcd-beauty.exr").write_bytes(b"half")
    kept = [
        f"{TEMPORARY_PREFIX}{here}-{os.getpid()}-0123abcd-asset",  # alive
        f"{TEMPORARY_PREFIX}{'0' * 8}-{dead}-0123abcd-asset",  # another machine's
        f"{TEMPORARY_PREFIX}mine",  # of nobody we know
        "asset",
    ]
    for name in kept:
        (tmp_path / name).mkdir()
    clean_stale(tmp_path)
    assert names(tmp_path) == sorted(kept)


@pytest.mark.skipif(os.name != "posix", reason="process numbers cannot be asked about")
def test_a_process_that_died_between_its_two_renames_costs_nobody_the_old_asset(tmp_path):
    owner = f"{TEMPORARY_PREFIX}{files._machine()}-{dead_process()}-0123abcd"
    (tmp_path / f"{owner}old-asset").mkdir()
    (tmp_path / f"{owner}old-asset" / "old.txt").write_text("whole")
    (tmp_path / f"{owner}-asset").mkdir()
    clean_stale(tmp_path)
    assert names(tmp_path) == ["asset"]
    assert names(tmp_path / "asset") == ["old.txt"]
