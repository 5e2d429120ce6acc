"""What a batch would do, for how long and with how much disk: `run --dry-run`."""

from __future__ import annotations

import shutil
import statistics
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from scanrender.batch.jobs import Job
from scanrender.batch.memory import samples_of
from scanrender.batch.run import Todo
from scanrender.batch.state import Records
from scanrender.scan.parallel import all_cores

# Bytes: of a pixel of a PNG frame and of H.264, of a texel of all maps, of a buffer's pixel.
_FRAME_BYTES, _VIDEO_BYTES, _BUFFER_BYTES = 1.5, 0.15, 12.0
_ALBEDO_BYTES, _NORMAL_BYTES, _DATA_BYTES, _TRIANGLE_BYTES = 2.0, 6.0, 30.0, 45.0


@dataclass(frozen=True)
class Estimate:
    """Seconds are None where no earlier run in this folder says how long a stage takes."""

    seconds: float | None
    measured_on: int
    disk_bytes: float
    free_bytes: int


@dataclass
class Pace:
    """What earlier runs took: seconds for each byte of a scan, milliseconds for each sample, and
    whether idle cores took part in a turn (`turn_crew`)."""

    prep: list[float] = field(default_factory=list)
    frame: list[float] = field(default_factory=list)
    jobs: int = 0
    is_shared: bool = False

    def learn(self, job: Job, records: Records) -> None:
        stage = records.prep.stages.get(job.prep_stage) if job.prepares else None
        size = None if stage is None else stage.inputs.get(job.scan.name)
        if stage is not None and size is not None and size.size:
            self.prep.append(stage.seconds / size.size)
        frames = records.job.stages.get("frames")
        times = {} if frames is None else frames.notes.get("ms", {})
        if frames is not None and times:
            samples = samples_of(frames.reads["settings"])
            self.frame.append(statistics.median(times.values()) / samples)
            self.is_shared |= frames.notes.get("processes", 1) > 1
        self.jobs += bool(times) or stage is not None


def estimate(todo: Sequence[Todo], pace: Pace, out: Path, workers: int) -> Estimate:
    """Workers are taken to share the work evenly, each as quick as the one that was measured."""
    prepared: set[Path] = set()
    at_work = max(1, min(workers, len(todo)))
    crew = max(1, all_cores() // at_work) if pace.is_shared else 1
    spent = [_seconds(item, pace, prepared, crew) for item in todo]
    prepared.clear()
    disk = sum(_disk(item, prepared) for item in todo)
    known = [seconds for seconds in spent if seconds is not None]
    total = sum(known) / at_work if len(known) == len(spent) else None
    return Estimate(total, pace.jobs, disk, _free(out))


def _seconds(item: Todo, pace: Pace, prepared: set[Path], crew: int) -> float | None:
    total, job = 0.0, item.job
    if "prep" in item.work.reasons and job.asset not in prepared:
        prepared.add(job.asset)
        if not pace.prep:
            return None
        total += statistics.median(pace.prep) * _size(job.scan)
    frames = len({*item.work.render, *item.work.dump})
    if frames:
        if not pace.frame:
            return None
        total += frames * statistics.median(pace.frame) * samples_of(job.recipe.shot) / 1e3 / crew
    return total


def _disk(item: Todo, prepared: set[Path]) -> float:
    job, total = item.job, 0.0
    pixels = job.pipeline.camera.width_px * job.pipeline.camera.height_px
    if "prep" in item.work.reasons and job.asset not in prepared:
        prepared.add(job.asset)
        bake, triangles = job.pipeline.prep.bake, job.pipeline.prep.simplify.triangles
        total += _ALBEDO_BYTES * bake.albedo_px**2 + _NORMAL_BYTES * bake.normal_px**2
        total += _DATA_BYTES * bake.data_px**2 + _TRIANGLE_BYTES * triangles
    # Frames that only wait for their video are on the disk too, for a while.
    total += len(item.work.render) * pixels * (_FRAME_BYTES + _VIDEO_BYTES)
    names = job.pipeline.outputs.buffers
    count = 30 if "all" in names else len(names)
    return total + len(item.work.dump) * pixels * _BUFFER_BYTES * count


def _size(path: Path) -> int:
    try:
        return path.stat().st_size
    except OSError:
        return 0


def _free(out: Path) -> int:
    for folder in (out, *out.absolute().parents):
        if folder.is_dir():
            return shutil.disk_usage(folder).free
    return 0
