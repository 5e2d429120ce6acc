"""How much memory a task may take, and how much there is: no more workers than that holds."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

from scanrender.batch.jobs import Job
from scanrender.batch.record import Record

# Bytes of a file for each triangle, as scanners write them: 1 M triangles are 90 MB of OBJ.
_BYTES_A_TRIANGLE = {".obj": 90, ".off": 60, ".ply": 25, ".stl": 50, ".glb": 30, ".gltf": 1}
_CGROUP = Path("/sys/fs/cgroup")
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


def render_mib(job: Job) -> int:
    """A worker with its libraries and maps, and some thirty buffers of the picture."""
    camera = job.pipeline.camera
    return int(800 + camera.width_px * camera.height_px * 480 / 2**20)


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
