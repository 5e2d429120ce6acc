"""How much memory a task may take, and how much there is: no more workers than that holds."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from scanrender.batch.jobs import Job
from scanrender.batch.record import Record

# Bytes of a file for each triangle, as scanners write them: 1 M triangles are 90 MB of OBJ.
_BYTES_A_TRIANGLE = {".obj": 90, ".off": 60, ".ply": 25, ".stl": 50, ".glb": 30, ".gltf": 1}
_CGROUP = Path("/sys/fs/cgroup")
_CLEAR_REFS = Path("/proc/self/clear_refs")
_SPARE = 1.3  # what was measured once is exceeded a little the next time


def prep_mib(job: Job, record: Record) -> int:
    """Peak of a preparation: what an earlier one took, or from docs/preparation.md by triangles
    (2.4 GiB for one million, 13 GiB for twenty)."""
    stage = record.stages.get(job.prep_stage)
    if stage is not None and stage.notes.get("peak_mib"):
        return int(_SPARE * float(stage.notes["peak_mib"])) + 300
    try:
        size = job.scan.stat().st_size
    except OSError:
        size = 0
    triangles = size / _BYTES_A_TRIANGLE.get(job.scan.suffix.lower(), 30)
    return int(min(700 + triangles * 17e-4, 1800 + triangles * 56e-5))


def render_mib(job: Job, record: Record) -> int:
    """Peak of rendering: what earlier frames with as many samples took, or a guess: a worker with
    its libraries and maps, and some thirty buffers of the picture."""
    frames = record.stages.get("frames")
    samples = samples_of(job.recipe.shot)
    peak = None if frames is None else frames.notes.get("peak_mib")
    if frames is not None and peak and samples_of(frames.reads["settings"]) == samples:
        return int(_SPARE * float(peak))
    return int(800 + samples * 480 / 2**20)


def samples_of(settings: Mapping[str, Any]) -> int:
    """Samples of a frame of these settings, before what a plan makes of them."""
    camera, quality = settings["camera"], settings["quality"]
    return int(camera["width_px"] * camera["height_px"] * quality["supersampling"] ** 2)


def forget_peak() -> None:
    """From here on `peak_mib` counts anew. Linux only; elsewhere it counts from the start."""
    with suppress(OSError):
        _CLEAR_REFS.write_text("5", encoding="ascii")


def peak_mib() -> int | None:
    """Most memory of this process since `forget_peak`; None where nobody says."""
    with suppress(OSError, ValueError, IndexError):
        for line in Path("/proc/self/status").read_text(encoding="ascii").splitlines():
            if line.startswith("VmHWM:"):
                return int(line.split()[1]) // 1024
    return None


def free_mib() -> int | None:
    """Memory that can be taken now, of the machine or of its container; None where nobody says."""
    found = []
    with suppress(OSError, ValueError, IndexError):
        for line in Path("/proc/meminfo").read_text(encoding="ascii").splitlines():
            if line.startswith("MemAvailable:"):
                found.append(int(line.split()[1]) // 1024)
    with suppress(OSError, ValueError):
        limit = int((_CGROUP / "memory.max").read_text(encoding="ascii"))
        used = int((_CGROUP / "memory.current").read_text(encoding="ascii"))
        cached = _cached_bytes()
        found.append((limit - used + cached) >> 20)
    return min(found, default=None)


def _cached_bytes() -> int:
    """File pages count as used and go when memory is needed."""
    with suppress(OSError, ValueError, IndexError):
        for line in (_CGROUP / "memory.stat").read_text(encoding="ascii").splitlines():
            if line.startswith("inactive_file "):
                return int(line.split()[1])
    return 0
