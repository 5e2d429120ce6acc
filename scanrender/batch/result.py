"""What a job tells when it is done: to people, to the manifest, to the batch's summary."""

from __future__ import annotations

import json
import statistics
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from scanrender import __version__
from scanrender.batch.jobs import Job
from scanrender.batch.record import Record, Stage
from scanrender.batch.state import Records
from scanrender.outputs.manifest import MANIFEST_NAME, package_versions, platform_info

RENDERED_ORDER = ("video", "sheet", "figure", "frames", "buffers", "settings")


@dataclass
class Result:
    """What a finished job tells: its folder, files, seconds per stage of this run, and sentences of
    warning. `cached`: everything was there."""

    name: str
    folder: Path
    files: list[str] = field(default_factory=list)
    stages: dict[str, float] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)
    decisions: list[str] = field(default_factory=list)
    plan: dict[str, Any] = field(default_factory=dict)
    quality: dict[str, Any] = field(default_factory=dict)
    cached: bool = False

    def as_json(self) -> dict[str, Any]:
        return {
            "scan": self.name,
            "folder": str(self.folder),
            "status": "cached" if self.cached else "done",
            "files": self.files,
            "seconds": {name: round(value, 3) for name, value in self.stages.items()},
            "warnings": self.warnings,
            "not_run": self.decisions,
            "plan": self.plan,
            "quality": self.quality,
        }


def result_of(
    job: Job, records: Records, seconds: Mapping[str, float] | None = None, cached: bool = False
) -> Result:
    """The result as the records tell it; `seconds` are those of this run."""
    prep = records.prep.stages.get(job.prep_stage) if job.prepares else None
    files = ["asset/"] if prep is not None and job.asset.parent == job.folder else []
    files += _own_files(records.job)
    files += [MANIFEST_NAME] if (job.folder / MANIFEST_NAME).exists() else []
    planned = _stage(records.job, "plan") if job.recipe.is_planned else Stage("", {})
    return Result(
        job.label,
        job.folder,
        files,
        dict(seconds or {}),
        [] if prep is None else list(prep.notes.get("warnings", [])),
        _not_run(job, records.job, planned),
        dict(planned.notes.get("measured", {})),
        _quality(records.job, planned),
        cached,
    )


def manifest(job: Job, records: Records) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """The manifest's document and its list of files: enough to make the same again."""
    result = result_of(job, records)
    prep = records.prep.stages.get(job.prep_stage) if job.prepares else None
    shown = _stage(records.job, "figure") if job.pipeline.figure.panels else None
    shown = shown or _stage(records.job, "frames")
    document = {
        "scanrender": __version__,
        "versions": package_versions(),
        "platform": platform_info(),
        "gl": shown.notes.get("gl", {}),
        "source": _source(job, prep),
        "frames": None if job.part is None else list(job.part),
        "settings": job.pipeline.model_dump(mode="json"),
        "seconds": _all_seconds(prep, shown),
        "warnings": result.warnings,
        "not_run": result.decisions,
        "plan": result.plan,
        "quality": result.quality,
    }
    entries = {
        name: {"path": name, "bytes": entry.size, "sha256": entry.sha256}
        for record in (records.prep, records.job)
        if record.folder == job.folder
        for stage in record.stages.values()
        for name, entry in stage.files.items()
    }
    return document, [entries[name] for name in sorted(entries)]


def _own_files(record: Record) -> list[str]:
    return [name for stage in RENDERED_ORDER for name in sorted(_stage(record, stage).files)]


def _stage(record: Record, name: str) -> Stage:
    return record.stages.get(name) or Stage("", {})


def _not_run(job: Job, record: Record, planned: Stage) -> list[str]:
    shown = planned if planned.notes else _stage(record, "frames")
    decisions = list(shown.notes.get("not_run", []))
    if not job.prepares and "prep" in job.pipeline.stages:
        decisions.insert(0, "prep: the scan is a prepared asset already")
    return decisions


def _quality(record: Record, planned: Stage) -> dict[str, Any]:
    predicted = planned.notes.get("predicted", {})
    if not predicted:
        return {}
    times = list(_stage(record, "frames").notes.get("ms", {}).values())
    measured = round(statistics.median(times), 1) if times else None
    return {**predicted, "measured_ms": measured}


def _source(job: Job, prep: Stage | None) -> dict[str, Any]:
    path = str(job.scan.resolve())
    if prep is None:
        try:
            info = json.loads((job.scan / "asset.json").read_text(encoding="utf-8"))
            source = dict(info.get("source", {}))
        except (OSError, ValueError, AttributeError):
            source = {}
        return {**source, "asset": path}
    beside = {name: entry.sha256 for name, entry in prep.inputs.items() if name != job.scan.name}
    return {**prep.notes.get("source", {}), "path": path, "beside": beside}


def _all_seconds(prep: Stage | None, shown: Stage) -> dict[str, float]:
    """Of all runs that made what is there."""
    own = {} if prep is None else {"prep": round(prep.seconds, 3)}
    return {**own, **shown.notes.get("seconds", {})}
