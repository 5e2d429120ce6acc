"""Preparations that are killed: no half-written asset, no process or folder left behind."""

from __future__ import annotations

import hashlib
import os
import random
import signal
import subprocess
import sys
import tempfile
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


def contents(asset: Path) -> dict[str, str]:
    """Digests, since two dictionaries of whole files would be what a failure prints."""
    files = sorted(file for file in asset.iterdir() if file.suffix != ".json")
    return {file.name: hashlib.sha256(file.read_bytes()).hexdigest() for file in files}


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


class Killer:
    """Sends SIGKILL to preparation children: each to one in turn, when it has come so far.

    Also a progress callback, so that a moment is a stage of the child and not a time of the clock,
    which a busy machine stretches.
    """

    def __init__(self) -> None:
        self.children: list[subprocess.Popen[bytes]] = []
        self.plan: dict[int, tuple[str, float]] = {}  # by number of the child: stage, delay in s
        self.began: list[tuple[str, float]] = []

    def start(self, *arguments, **keywords):
        self.children.append(POPEN(*arguments, **keywords))
        return self.children[-1]

    def __call__(self, stage: str, _fraction: float) -> None:
        if not self.began or self.began[-1][0] != stage:
            self.began.append((stage, time.monotonic()))
        wanted, delay = self.plan.get(len(self.children), ("", 0.0))
        if stage == wanted:
            del self.plan[len(self.children)]
            # send_signal looks first whether the process has ended: its number may be another's.
            kill = self.children[-1].send_signal
            threading.Timer(delay, kill, [signal.SIGKILL]).start() if delay else kill(
                signal.SIGKILL
            )

    def stages(self) -> dict[str, float]:
        """Seconds of each stage of what has run since the last call, in their order."""
        ends = [*(start for _, start in self.began[1:]), time.monotonic()]
        found = {name: end - start for (name, start), end in zip(self.began, ends, strict=True)}
        self.began.clear()
        return found


POPEN = subprocess.Popen


@pytest.fixture
def killer(monkeypatch):
    made = Killer()
    monkeypatch.setattr(child.subprocess, "Popen", made.start)
    return made


@linux_only
def test_twenty_kills_in_every_stage_never_stop_the_batch_nor_leave_half_an_asset(
    tmp_path, killer, marker, monkeypatch
):
    """One batch of 23: twenty are killed, as each stage begins and at random moments after that."""
    scans = [small_scan(tmp_path / f"{number:02}.ply") for number in range(24)]
    keys = ("albedo_px", "normal_px", "data_px", "ao_rays", "thickness_rays")
    tiny = [f"prep.bake.{key}={getattr(TINY.bake, key)}" for key in keys]
    pipeline = load_pipeline("prep_only", [*tiny, "prep.report=short"])
    out, temporary = tmp_path / "out", tmp_path / "tmp"
    temporary.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(temporary))
    run_batch(scans[:1], pipeline, tmp_path / "first", killer, lambda _: None)
    stages = killer.stages()
    assert list(stages)[-1] == "save"
    assert len(stages) >= 8
    moments = random.Random(3)
    victims = [n for n in range(1, 24) if n not in (5, 14, 23)]
    for trial, victim in enumerate(victims):
        begin = trial < len(stages)
        stage = list(stages)[trial] if begin else moments.choice(list(stages))
        killer.plan[victim + 1] = stage, 0.0 if begin else moments.uniform(0.001, stages[stage])
    batch = run_batch(scans[1:], pipeline, out, killer, lambda _: None)
    finished = {result.name for result in batch.results}
    killed = {failed.job.scan.stem: failed.error for failed in batch.failures}
    assert {"05", "14", "23"} <= finished
    assert len(finished) + len(killed) == 23
    assert len(killed) >= len(stages), "each stage was killed as it began"
    for error in killed.values():
        assert error.exit_code == 5
        assert "was killed" in error.what
        assert error.fix
    assert any("'save'" in error.what for error in killed.values())
    for name in finished:
        assert len(load_asset(out / name / "asset").mesh.faces)
    for name in killed:
        assert not (out / name / "asset").exists()
    assert not list(out.rglob(f"{TEMPORARY_PREFIX}*"))
    assert all_gone(marker)
    assert names(temporary) == []


@linux_only
def test_kills_while_saving_leave_the_earlier_asset_whole(tmp_path, killer, marker):
    """As is: without the unwrapper, whose time would be most of the trial."""
    scan = textured_scan(tmp_path / "a.obj")
    asset = tmp_path / "asset"
    prepare(scan, ScanSettings(), TINY, asset, as_is=True, progress=killer)
    duration = killer.stages()["save"]
    before = contents(asset)
    moments = random.Random(4)
    said = []
    for trial in range(4):
        killer.plan[trial + 2] = "save", 0.0 if trial == 0 else moments.uniform(0.0, duration)
        try:
            prepare(scan, ScanSettings(), TINY, asset, as_is=True, progress=killer)
        except StageError as error:
            said.append(error.what)
        assert names(tmp_path) == ["a.obj", "asset"]
        now = contents(asset)
        assert now == before
        load_asset(asset)
    assert said
    assert all("'save' was killed" in what for what in said)
    assert all_gone(marker)


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
    here, dead = files.machine(), dead_process()
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


def test_leftovers_of_a_machine_that_was_lost_are_removed(tmp_path):
    lost, other = "1" * 8, "2" * 8
    for machine, name in ((lost, "asset"), (lost, "asset-dim"), (other, "asset")):
        (tmp_path / f"{TEMPORARY_PREFIX}{machine}-77-0123abcd-{name}").mkdir()
    (tmp_path / f"{TEMPORARY_PREFIX}{lost}-77-89abcdefold-kept").mkdir()
    clean_stale(tmp_path, lost=lost, named="asset")
    assert len(names(tmp_path)) == 3, "beside it another one is at work"
    clean_stale(tmp_path, lost=lost)
    assert names(tmp_path) == [f"{TEMPORARY_PREFIX}{other}-77-0123abcd-asset", "kept"]


@pytest.mark.skipif(os.name != "posix", reason="process numbers cannot be asked about")
def test_a_process_that_died_between_its_two_renames_costs_nobody_the_old_asset(tmp_path):
    owner = f"{TEMPORARY_PREFIX}{files.machine()}-{dead_process()}-0123abcd"
    (tmp_path / f"{owner}old-asset").mkdir()
    (tmp_path / f"{owner}old-asset" / "old.txt").write_text("whole")
    (tmp_path / f"{owner}-asset").mkdir()
    clean_stale(tmp_path)
    assert names(tmp_path) == ["asset"]
    assert names(tmp_path / "asset") == ["old.txt"]
