"""Frames that several processes share: the same files, whoever renders them, and whoever fails."""

from __future__ import annotations

import contextlib
import errno
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from statistics import median
from types import SimpleNamespace
from typing import Any

import pytest
from batch.jobs import contents
from render.synthetic import pipeline, sphere

from scanrender.asset import save_asset
from scanrender.batch import turn_crew, turntable
from scanrender.batch.estimate import Pace, estimate
from scanrender.batch.job import do_job, run_job
from scanrender.batch.jobs import single_job
from scanrender.batch.record import load_record
from scanrender.batch.run import Todo
from scanrender.batch.state import Work, records_of
from scanrender.batch.turn_crew import worth
from scanrender.scan.parallel import THREADS

linux_only = pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
FRAMES = 9
TINY = {
    "stages": ["render"],
    "camera": {"width_px": 32, "height_px": 32},
    "turntable": {"frames": FRAMES},
    "quality": {"supersampling": 1},
    "lights": [{"type": "directional", "shadow_px": 64}],
    "outputs": {"frames": True, "buffers": ["albedo"], "buffer_frames": [5]},
}
# What stands in for `scanrender.batch.turn_worker`: each does one frame as it should, or none.
SOUND = """
import json, os, signal, sys, time
from scanrender.batch import turn_worker
def told(count):
    turn = sys.stdin.readline()
    return turn + "".join(sys.stdin.readline() for _ in range(count))
"""
FAULTS = {
    "dies at once": "os._exit(3)",
    "crashes with a frame": "told(1); os.kill(os.getpid(), signal.SIGSEGV)",
    "leaves half a frame": (
        "task = json.loads(told(1).splitlines()[1])\n"
        "from scanrender.files import atomic_path\n"
        "with atomic_path(task['file']) as path:\n"
        "    path.write_bytes(b'half')\n"
        "    os.kill(os.getpid(), signal.SIGKILL)\n"
    ),
    "prints what is no answer": "print('hello', flush=True); told(9)",
    "says an error": "told(1); print(json.dumps({'error': 'memory ran out'}), flush=True)",
    "has a bug": (
        "def bad(*_):\n    told(1)\n    raise KeyError('a bug')\n"
        "turn_worker._serve = bad\nsys.exit(turn_worker.main())"
    ),
    "hangs": "told(1); time.sleep(600)",
}

SAID = {
    "dies at once": "exit code 3",
    "crashes with a frame": "SIGSEGV",
    "says an error": "memory ran out",
    "has a bug": "KeyError: 'a bug'",
    "hangs": "no sign of life",
}


@pytest.fixture(scope="module")
def asset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return save_asset(sphere(20.0, (0.6, 0.3, 0.2), rings=10), tmp_path_factory.mktemp("a") / "a")


@pytest.fixture
def eager(monkeypatch: pytest.MonkeyPatch) -> None:
    """Three cores, and frames that always pay for a process."""
    monkeypatch.setenv(THREADS, "3")
    monkeypatch.setattr(turn_crew, "cores", lambda: 3)
    monkeypatch.setattr(turn_crew, "all_cores", lambda: 3)
    monkeypatch.setattr(turn_crew, "START_S", 1e-9)
    monkeypatch.delenv("LP_NUM_THREADS", raising=False)


def alone(
    asset: Path, out: Path, monkeypatch: pytest.MonkeyPatch, **changes: Any
) -> dict[str, str]:
    with monkeypatch.context() as patch:
        patch.setattr(turntable, "worth", lambda *_: 0)
        run_job(asset, pipeline(TINY, **changes), out, lambda *_: None)
    return contents(out)


class Delivered:
    """Which frames the crew has rendered."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.frames: list[int] = []
        done = turn_crew.TurnCrew.done

        def counted(crew, wait):
            made, lost = done(crew, wait)
            self.frames += made
            return made, lost

        monkeypatch.setattr(turn_crew.TurnCrew, "done", counted)


def needs_software(gl: Any) -> None:
    if not gl.is_software:
        pytest.skip("frames are shared on the software rasteriser alone")


def crew_of(parent: int) -> list[int]:
    found = []
    for entry in Path("/proc").iterdir():
        with contextlib.suppress(OSError, ValueError):
            above = int((entry / "stat").read_text().rsplit(")", 1)[1].split()[1])
            if above == parent and b"turn_worker" in (entry / "cmdline").read_bytes():
                found.append(int(entry.name))
    return found


@pytest.mark.gl
@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"outputs": {**TINY["outputs"], "frames": False}},  # type: ignore[dict-item]
        {"outputs": {**TINY["outputs"], "video": False, "contact_sheet": False}},  # type: ignore[dict-item]
        # Whose kernel is not its profile, and is planned as another method (decision 26).
        {"diffusion": {"method": "separable_artistic"}, "skin": {"scale": 20.0}},
        {"quality": {"supersampling": 2, "sampling": "contrast"}},
    ],
    ids=["frames", "video", "frames alone", "planned", "contrast"],
)
def test_shared_frames_are_what_one_process_makes(gl, asset, tmp_path, monkeypatch, eager, changes):
    needs_software(gl)
    expected = alone(asset, tmp_path / "alone", monkeypatch, **changes)
    shares: list[float] = []
    delivered = Delivered(monkeypatch)
    job = single_job(asset, pipeline(TINY, **changes), tmp_path / "shared")
    do_job(job, lambda stage, share: shares.append(share) if stage == "render" else None)
    assert contents(tmp_path / "shared") == expected
    assert len(set(delivered.frames)) == len(delivered.frames) > 1
    said = (tmp_path / "shared" / "log.txt").read_text()
    assert "3 processes share the frames" in said
    assert "failed" not in said
    assert shares == sorted(shares)
    assert shares[-1] == 1.0
    notes = load_record(tmp_path / "shared").stages["frames"].notes
    assert notes["processes"] == 3
    # Frame 5 is rendered with its buffers, which only this process does.
    assert set(notes["ms"]) == {str(i) for i in range(FRAMES)} - {"5"}
    assert list(tmp_path.rglob(".*")) == []


@pytest.mark.gl
def test_a_dry_run_knows_of_the_crew(gl, asset, tmp_path, monkeypatch, eager):
    needs_software(gl)
    job = single_job(asset, pipeline(TINY), tmp_path)
    do_job(job, lambda *_: None)
    times = load_record(tmp_path).stages["frames"].notes["ms"].values()
    pace = Pace()
    pace.learn(job, records_of(job))
    assert pace.is_shared
    monkeypatch.setattr("scanrender.batch.estimate.all_cores", lambda: 8)
    todo = [Todo(job, Work(render=[*range(FRAMES)]), 0, 0)]
    alone_s, eight_s = (
        estimate(todo, replace(pace, is_shared=shared), tmp_path, 1).seconds
        for shared in (False, True)
    )
    assert alone_s == pytest.approx(FRAMES * median(times) / 1e3)
    assert eight_s == pytest.approx(alone_s / 8)


@pytest.mark.gl
def test_no_process_to_be_had_costs_no_frame(gl, asset, tmp_path, monkeypatch, eager):
    needs_software(gl)
    expected = alone(asset, tmp_path / "alone", monkeypatch)

    def refused(*_: object) -> None:
        raise BlockingIOError(errno.EAGAIN, "Resource temporarily unavailable")

    monkeypatch.setattr(turn_crew, "WorkerProcess", refused)
    run_job(asset, pipeline(TINY), tmp_path / "shared", lambda *_: None)
    assert contents(tmp_path / "shared") == expected
    assert load_record(tmp_path / "shared").stages["frames"].notes["processes"] == 1
    said = (tmp_path / "shared" / "log.txt").read_text()
    assert said.count("no process to share the frames could be started") == 1


@pytest.mark.gl
def test_frames_of_another_driver_are_not_taken(gl, asset, tmp_path, monkeypatch, eager):
    needs_software(gl)
    delivered = Delivered(monkeypatch)
    monkeypatch.setattr(gl, "driver", "a GPU | 4.6")
    run_job(asset, pipeline(TINY), tmp_path, lambda *_: None)
    assert delivered.frames == []
    assert "the GL driver is another one here: llvmpipe" in (tmp_path / "log.txt").read_text()


@pytest.mark.gl
@pytest.mark.parametrize("fault", FAULTS)
def test_who_fails_costs_no_frame(gl, asset, tmp_path, monkeypatch, eager, fault):
    needs_software(gl)
    expected = alone(asset, tmp_path / "alone", monkeypatch)
    (tmp_path / "bad_worker.py").write_text(SOUND + FAULTS[fault])
    monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=os.pathsep)
    monkeypatch.setattr(turn_crew, "_MODULE", "bad_worker")
    monkeypatch.setattr(turn_crew, "PATIENCE_S", 1.0)
    run_job(asset, pipeline(TINY), tmp_path / "shared", lambda *_: None)
    assert contents(tmp_path / "shared") == expected
    said = (tmp_path / "shared" / "log.txt").read_text()
    assert said.count("a process that shared the frames failed") >= 1
    assert SAID.get(fault, "") in said
    assert list((tmp_path / "shared").rglob(".*")) == []


@pytest.mark.gl
def test_a_turn_goes_on_with_a_crew(gl, asset, tmp_path: Path, monkeypatch, eager):
    """What is there already is read in its turn, not while others are waited for: it can be more
    than memory holds."""
    needs_software(gl)
    expected = alone(asset, tmp_path, monkeypatch)
    for name in ("turntable.mp4", "frames/frame_0001.png", "frames/frame_0002.png",
                 "frames/frame_0003.png", "frames/frame_0004.png"):  # fmt: skip
        (tmp_path / name).unlink()
    reads, begun = [], []
    read, done = turntable.Turntable._read, turn_crew.TurnCrew.done

    def counted(self, index, writing):
        reads.append(index)
        return read(self, index, writing)

    def waited(self, wait):
        begun.extend(frame for mate in self._mates for frame in mate.frames)
        assert not begun or max(reads, default=0) <= max(begun)
        return done(self, wait)

    monkeypatch.setattr(turntable.Turntable, "_read", counted)
    monkeypatch.setattr(turn_crew.TurnCrew, "done", waited)
    shares: list[float] = []
    run_job(asset, pipeline(TINY), tmp_path,
            lambda stage, share: shares.append(share) if stage == "render" else None)  # fmt: skip
    assert begun
    assert contents(tmp_path) == expected
    assert shares == sorted(shares)
    assert shares[-1] == 1.0


@pytest.mark.gl
@linux_only
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGINT])
def test_the_crew_ends_with_whoever_started_it(gl, asset, tmp_path: Path, number: int):
    needs_software(gl)
    program = (
        "from scanrender.batch import turn_crew\n"
        "turn_crew.START_S = 1e-9\nturn_crew.cores = lambda: 3\n"
        "from scanrender.cli.main import main\nmain()\n"
    )
    settings = [
        "turntable.frames=4000",
        "stages=[render]",
        "camera.width_px=64",
        "camera.height_px=64",
        "quality.supersampling=1",
    ]
    words = [x for setting in settings for x in ("--set", setting)]
    run = subprocess.Popen(
        [sys.executable, "-c", program, "run", "turntable", str(asset),
         "--out", str(tmp_path / "o"), *words, "--progress", "none"],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE,
    )  # fmt: skip
    try:
        # By then processes of the crew render and write, too.
        until(lambda: len(list((tmp_path / "o").rglob("frame_*.png"))) > 100)
        assert len(crew_of(run.pid)) == 2
        mates = crew_of(run.pid)
        run.send_signal(number)
        run.communicate(timeout=60)
    finally:
        run.kill()
    until(lambda: not any(Path(f"/proc/{mate}/stat").exists() for mate in mates))
    if number == signal.SIGINT:
        assert run.returncode == 130
        assert list((tmp_path / "o").rglob(".writing-*")) == []


def until(true: Any, within_s: float = 60.0) -> None:
    end = time.monotonic() + within_s
    while not true():
        assert time.monotonic() < end
        time.sleep(0.02)


SOFTWARE: Any = SimpleNamespace(is_software=True)
GPU: Any = SimpleNamespace(is_software=False)


@pytest.mark.parametrize(
    ("device", "cores", "threads", "frame_s", "frames", "free", "need", "count"),
    [
        (SOFTWARE, 8, None, 2.0, 96, 64_000, 800, 5),  # 192 s: a sixth saves 4.6 s
        (SOFTWARE, 4, None, 2.0, 96, 64_000, 800, 3),
        (SOFTWARE, 8, "0", 2.0, 96, 64_000, 800, 5),
        (SOFTWARE, 8, "2", 2.0, 96, 64_000, 800, 3),
        (SOFTWARE, 8, "8", 2.0, 96, 64_000, 800, 0),
        (SOFTWARE, 8, "", 2.0, 96, 64_000, 800, 5),
        (SOFTWARE, 8, "many", 2.0, 96, 64_000, 800, 0),  # Mesa takes as many as there are cores
        (SOFTWARE, 1, None, 2.0, 96, 64_000, 800, 0),
        (GPU, 8, None, 2.0, 96, 64_000, 800, 0),
        (SOFTWARE, 8, None, 0.01, 96, 64_000, 800, 0),
        (SOFTWARE, 8, None, 60.0, 3, 64_000, 800, 2),
        (SOFTWARE, 8, None, 60.0, 1, 64_000, 800, 0),
        (SOFTWARE, 8, None, 60.0, 0, 64_000, 800, 0),
        (SOFTWARE, 8, None, 2.0, 96, 4_200, 800, 2),
        (SOFTWARE, 8, None, 2.0, 96, 1_000, 800, 0),
        (SOFTWARE, 8, None, 2.0, 96, None, 800, 5),
        (SOFTWARE, 64, None, 60.0, 960, 640_000, 800, 63),
        # A batch of two workers: half of the cores, and half of the memory.
        (SOFTWARE, (8, 16), None, 2.0, 96, 64_000, 800, 5),
        (SOFTWARE, (8, 16), None, 2.0, 96, 4_200, 800, 1),
    ],
)
def test_as_many_as_cores_memory_and_work_are_there_for(
    monkeypatch, device, cores, threads, frame_s, frames, free, need, count
):
    own, every = cores if isinstance(cores, tuple) else (cores, cores)
    monkeypatch.setattr(turn_crew, "cores", lambda: own)
    monkeypatch.setattr(turn_crew, "all_cores", lambda: every)
    monkeypatch.setattr(turn_crew, "free_mib", lambda: free)
    monkeypatch.setattr(turn_crew, "peak_mib", lambda: need)
    monkeypatch.delenv("LP_NUM_THREADS", raising=False)
    if threads is not None:
        monkeypatch.setenv("LP_NUM_THREADS", threads)
    assert worth(device, frame_s, frames) == count
