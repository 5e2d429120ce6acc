"""batch.json: how every job of a batch ended, failures first. A report is made from this alone.

It is the batch's manifest too: scans with their hashes, all settings, versions; `scanrender run
--from-manifest` makes the same again.
"""

from __future__ import annotations

import json
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from scanrender import __version__
from scanrender.batch.jobs import Job
from scanrender.batch.log import LOG_NAME
from scanrender.batch.record import Record, Stage, load_record
from scanrender.batch.result import Result
from scanrender.errors import ScanrenderError
from scanrender.files import write_json
from scanrender.outputs.manifest import package_versions, platform_info

SUMMARY_NAME = "batch.json"


@dataclass(frozen=True)
class Failure:
    """A job that failed, and how long it took to."""

    job: Job
    error: ScanrenderError
    seconds: float = 0.0


def write_summary(
    out: Path, jobs: Sequence[Job], found: Mapping[int, Result | Failure], seconds: float
) -> Path:
    """OUT/batch.json. Settings that jobs share are written once."""
    entries = [_entry(out, job, found[id(job)]) for job in jobs]
    entries.sort(key=lambda entry: entry["status"] != "failed")
    recipes = {job.variant: job.recipe.settings for job in jobs}
    count = sum(entry["status"] == "failed" for entry in entries)
    document = {
        "scanrender": __version__,
        "finished": time.strftime("%Y-%m-%dT%H:%M:%S%z"),
        "seconds": round(seconds, 3),
        "versions": package_versions(),
        "platform": platform_info(),
        "counts": {"jobs": len(entries), "failed": count, "complete": len(entries) - count},
        "variants": recipes,
        "frames": None if jobs[0].part is None else list(jobs[0].part),
        "jobs": entries,
    }
    return write_json(out / SUMMARY_NAME, document)


def _entry(out: Path, job: Job, found: Result | Failure) -> dict[str, Any]:
    named = {
        "scan": str(job.scan.resolve()),
        "name": job.name,
        "variant": job.variant,
        "folder": _inside(out, job.folder),
        "asset": _inside(out, job.asset),
        "log": LOG_NAME if (job.folder / LOG_NAME).exists() else None,
    }
    if isinstance(found, Failure):
        error = found.error
        said = {"what": error.what, "where": error.where, "fix": error.fix}
        failed = {**said, "exit_code": error.exit_code, "seconds": round(found.seconds, 3)}
        return {**named, "status": "failed", "error": failed}
    own = load_record(job.folder)
    prepared = own if job.asset.parent == job.folder else load_record(job.asset.parent)
    prep = _stage(prepared, job.prep_stage) if job.prepares else Stage("", {})
    frames = _stage(own, "frames")
    return {
        **named,
        "status": "cached" if found.cached else "done",
        "sha256": prep.inputs[job.scan.name].sha256 if job.scan.name in prep.inputs else None,
        "seconds": {name: round(value, 3) for name, value in found.stages.items()},
        "frame_ms": frames.notes.get("ms", {}),
        "peak_mib": {"prep": prep.notes.get("peak_mib"), "render": frames.notes.get("peak_mib")},
        "files": found.files,
        "warnings": found.warnings,
        "not_run": found.decisions,
        "plan": found.plan,
        "quality": found.quality,
        "prep": {name: prep.notes.get(name) for name in ("counts", "lost", "units")},
        "gl": frames.notes.get("gl", {}),
    }


def _stage(record: Record, name: str) -> Stage:
    return record.stages.get(name) or Stage("", {})


def _inside(out: Path, path: Path) -> str:
    """Relative to OUT where it is in there: a folder of results may be moved."""
    try:
        return path.resolve().relative_to(out.resolve()).as_posix()
    except ValueError:
        return str(path.resolve())


def read_summary(path: Path) -> dict[str, Any]:
    """What `write_summary` wrote, or a job's manifest. Raises OSError, ValueError."""
    document = json.loads(path.read_text(encoding="utf-8"))
    if not isinstance(document, dict):
        raise ValueError("it is no JSON object")
    return document
