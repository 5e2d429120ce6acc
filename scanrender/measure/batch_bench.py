"""`scanrender bench batch`: what a batch costs beyond the work itself.

turn: frames a second of a whole job against rendering alone. workers: preparation of several scans
by two workers against one on a single core. memory: the parent while its workers render. jobs:
a thousand jobs that are done, or of which a light changed.

All but rendering alone are runs of the command itself, in processes of their own.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from scanrender import errors
from scanrender.asset import load_asset, save_asset
from scanrender.errors import StageError
from scanrender.files import make_folder, write_text
from scanrender.measure import tables
from scanrender.measure.own_head import own_head
from scanrender.measure.prep_bench import write_rows
from scanrender.scan.parallel import THREADS
from scanrender.settings.loading import load_pipeline

Say = Callable[[str], None]
Row = dict[str, Any]

TURN_FRAMES = 96
SCANS, SCAN_TRIANGLES = 4, 400_000
MEMORY_FRAMES = 500
JOBS_A_SIDE = 10  # of a matrix of three axes
_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", THREADS)
ONE_THREAD = dict.fromkeys(_THREADS, "1")
SMALL = """
version: 1
stages: [render]
camera: {width_px: 32, height_px: 32}
quality: {supersampling: 1}
lights: [{type: directional, shadow_px: 64}]
outputs: {video: false, contact_sheet: false, frames: true}
"""
MANY = """
turntable: {frames: 1}
matrix:
"""


def bench_batch(cases: Sequence[str], out: Path, say: Say) -> list[Row]:
    """One row a case; writes OUT/batch.json and OUT/batch.csv. Raises ScanrenderError's kinds."""
    make_folder(out)
    rows: list[Row] = []
    for name in cases:
        say(f"{name}: {MEANING[name]}")
        figures = CASES[name](out, say)
        rows.append({"case": name, "meaning": MEANING[name], **figures})
        write_rows(out, "batch", rows)
    return rows


def _turn(out: Path, say: Say) -> Row:
    """A job from a prepared head to video, sheet and buffers, by one process and by as many as
    there are cores; then its frames alone."""
    asset = own_head(out, say)
    words = ["--set", f"turntable.frames={TURN_FRAMES}"]
    command = ["turntable", asset, *words]
    shared = _run(command, _fresh(out / "turn_shared"))
    whole = _run(command, _fresh(out / "turn"), {THREADS: "1"})
    alone = _frames_alone(asset, ["stages=[render]", words[1]])
    return {
        "frames": TURN_FRAMES,
        "job_s": whole,
        "job_shared_s": shared,
        "frames_alone_s": alone,
        "share": alone / whole,
        "shared_gain": whole / shared,
        "limits": {"share": (">=", 0.9)},
    }


def _frames_alone(asset: Path, overrides: Sequence[str]) -> float:
    from scanrender.render.device import device
    from scanrender.render.frame import Renderer

    renderer = Renderer(device(), load_asset(asset), load_pipeline("turntable", overrides))
    renderer.render(renderer.view(0))  # compiles
    started = time.perf_counter()
    for index in range(renderer.pipeline.turntable.frames):
        renderer.render(renderer.view(index))
    return time.perf_counter() - started


def _workers(out: Path, say: Say) -> Row:
    """The same scans, prepared by one worker on one core, and by two."""
    from scanrender.measure import prep_inputs

    scans = []
    for number in range(SCANS):
        scan = out / "inputs" / "several" / f"head_{number}.ply"
        if not scan.exists():
            prep_inputs.phantom_scan(scan, SCAN_TRIANGLES, number)
        scans.append(scan)
    one = _run(["prep_only", *scans, "--jobs", "1"], _fresh(out / "one"), ONE_THREAD, cores=1)
    two = _run(["prep_only", *scans, "--jobs", "2"], _fresh(out / "two"))
    return {
        "scans": SCANS,
        "one_worker_s": one,
        "two_workers_s": two,
        "gain": one / two,
        "limits": {"gain": (">=", 1.7)},
    }


def _memory(out: Path, say: Say) -> Row:
    """The parent's memory while two workers render many small frames."""
    folder = _fresh(out / "memory")
    pipeline = write_text(folder / "small.yaml", SMALL)
    heads = _small_heads(folder, 2)
    words = ["--set", f"turntable.frames={MEMORY_FRAMES}", "--jobs", "2"]
    seen: list[float] = []
    _run([pipeline, *heads, *words], folder / "out", watch=seen.append)
    # At its end the report is written, which has its own libraries: the middle tells of frames.
    quarter = max(1, len(seen) // 4)
    early, middle = max(seen[:quarter]), max(seen[quarter : 3 * quarter] or seen)
    return {
        "frames": 2 * MEMORY_FRAMES,
        "parent_mib": max(seen),
        "growth_mib": middle - early,
        "limits": {"parent_mib": ("<=", 400), "growth_mib": ("<=", 5)},
    }


def _jobs(out: Path, say: Say) -> Row:
    """A thousand jobs: done once, then found done; then one setting of all is another."""
    folder = _fresh(out / "jobs")
    axes = [f"  {axis}: {{{_choices(key)}}}" for axis, key in (
        ("bright", "lights.0.irradiance"), ("side", "lights.0.azimuth_deg"),
        ("height", "lights.0.elevation_deg"))]  # fmt: skip
    pipeline = write_text(folder / "many.yaml", SMALL + MANY + "\n".join(axes) + "\n")
    words = [pipeline, *_small_heads(folder, 1), "--jobs", "2"]
    first = _run(words, folder / "out")
    again = _run(words, folder / "out")
    dry = _run([*words, "--dry-run", "--set", "skin.scale=0.5"], folder / "out")
    return {
        "jobs": JOBS_A_SIDE**3,
        "first_run_s": first,
        "again_s": again,
        "dry_run_s": dry,
        "limits": {"again_s": ("<=", 3), "dry_run_s": ("<=", 3)},
    }


def _choices(key: str) -> str:
    return ", ".join(f"c{n}: {{{key}: {1.0 + n}}}" for n in range(JOBS_A_SIDE))


CASES: Mapping[str, Callable[[Path, Say], Row]] = {
    "turn": _turn, "workers": _workers, "memory": _memory, "jobs": _jobs,
}  # fmt: skip
MEANING = {
    "turn": f"a turn of {TURN_FRAMES} frames of a prepared head, as `turntable` has it",
    "workers": f"preparation of {SCANS} scans of {SCAN_TRIANGLES:,} triangles",
    "memory": f"the parent while two workers render {2 * MEMORY_FRAMES:,} frames of 32 px",
    "jobs": f"{JOBS_A_SIDE**3:,} jobs: run again, and a dry run of all of them",
}


def _small_heads(folder: Path, count: int) -> list[Path]:
    """Prepared folders of a tiny subject: what is measured is not the picture."""
    from scanrender.measure.extreme_meshes import asset_of

    return [save_asset(asset_of("ball", 200.0), folder / f"head_{n}") for n in range(count)]


def _fresh(folder: Path) -> Path:
    """A folder of an earlier measurement would be found complete."""
    import shutil

    shutil.rmtree(folder, ignore_errors=True)
    return make_folder(folder)


def _run(
    words: Sequence[Any],
    out: Path,
    environment: Mapping[str, str] | None = None,
    watch: Callable[[float], None] | None = None,
    cores: int | None = None,
) -> float:
    """Seconds of `scanrender run`, on so many cores. Raises StageError when it fails."""
    command = [sys.executable, "-m", "scanrender", "run", *map(str, words), "--out", str(out)]
    root = str(Path(errors.__file__).resolve().parents[1])
    paths = [root, *filter(None, os.environ.get("PYTHONPATH", "").split(os.pathsep))]
    own = {**os.environ, "PYTHONPATH": os.pathsep.join(paths), **(environment or {})}
    started = time.perf_counter()
    log = out.with_name(f"{out.name}.log")
    with log.open("wb") as stream:
        process = subprocess.Popen(command, env=own, stdout=stream, stderr=stream)
        if cores is not None and hasattr(os, "sched_setaffinity"):
            # A worker has processes of its own, which threads alone do not bound. It has not
            # started any yet, and what it starts inherits this.
            os.sched_setaffinity(process.pid, sorted(os.sched_getaffinity(0))[:cores])
        while process.poll() is None:
            if watch is not None and (mib := _resident_mib(process.pid)):
                watch(mib)
            time.sleep(0.02)
    if process.returncode:
        raise StageError(f"scanrender run ended with {process.returncode}", str(log), "see the log")
    return time.perf_counter() - started


def _resident_mib(process: int) -> float:
    try:
        lines = Path(f"/proc/{process}/status").read_text(encoding="ascii").splitlines()
    except OSError:
        return 0.0
    return next((int(x.split()[1]) / 1024 for x in lines if x.startswith("VmRSS:")), 0.0)


LINES = (
    ("case", "case"), ("frames", "frames"),
    ("job_s", "whole job s"), ("frames_alone_s", "frames alone s"),
    ("share", "rendering alone / whole job"), ("job_shared_s", "whole job on all cores s"),
    ("shared_gain", "one process / all cores"), ("scans", "scans"),
    ("one_worker_s", "one worker on one core s"), ("two_workers_s", "two workers s"),
    ("gain", "one / two"), ("parent_mib", "parent's memory, most, MiB"),
    ("growth_mib", "grown from the first to the third quarter by MiB"), ("jobs", "jobs"),
    ("first_run_s", "first run s"), ("again_s", "run again s"), ("dry_run_s", "dry run s"),
)  # fmt: skip


def batch_text(rows: Sequence[Mapping[str, Any]]) -> str:
    """A column a case."""
    return tables.text(tables.case_table(rows, LINES))
