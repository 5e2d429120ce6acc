"""What is still to be done for a job, and why: read from its record, without GL and in no time.

run, its --dry-run and `cache why` all ask here, so that they cannot disagree.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from scanrender.batch import keys
from scanrender.batch.jobs import Job
from scanrender.batch.record import Record, Stage, differences, digest, load_record
from scanrender.errors import OutputError
from scanrender.outputs.manifest import MANIFEST_NAME
from scanrender.scan.beside import changed as changed_beside

VIDEO, SHEET, SETTINGS = "turntable.mp4", "contact_sheet.png", "pipeline.yaml"
FIGURE_FILES = ("figure.png", "figure.json")
NEVER = "not made yet"


@dataclass
class Work:
    """Reasons by stage, in words, and for frames and buffers which; nothing to do: no reasons.

    `reads` are what each stage would be made from now.
    """

    reasons: dict[str, str] = field(default_factory=dict)
    render: list[int] = field(default_factory=list)
    dump: list[int] = field(default_factory=list)
    reads: dict[str, dict[str, Any]] = field(default_factory=dict)
    cached_frames: int = 0

    @property
    def needs_gl(self) -> bool:
        return bool({"plan", "frames", "buffers", "figure"} & set(self.reasons))

    def key(self, stage: str) -> str:
        return digest(self.reads[stage])


@dataclass
class Records:
    """The record of the asset's folder and that of the job's: one and the same where they are."""

    prep: Record
    job: Record

    def save(self) -> None:
        self.job.save()
        if self.prep is not self.job:
            self.prep.save()


def records_of(job: Job) -> Records:
    own = load_record(job.folder)
    if not job.prepares or job.asset.parent == job.folder:
        return Records(own, own)
    return Records(load_record(job.asset.parent), own)


@dataclass(frozen=True)
class Trust:
    """What is believed by size, time and inode: everything, or with `verify` nothing. `reading`
    looks at the content of what the next stage is about to read. `gl` is the driver that will
    render, where that is known; otherwise the one that rendered before."""

    verify: bool = False
    reading: bool = False
    gl: str | None = None

    def driver(self, record: Record, name: str) -> str:
        stage = record.stages.get(name)
        return self.gl or ("" if stage is None else str(stage.reads.get("gl", "")))


def look(job: Job, records: Records, trust: Trust | None = None) -> Work:
    """What is to be done. Raises UsageError when the pipeline does nothing to this scan."""
    work, trust = Work(), trust or Trust()
    if job.prepares:
        reason = prep_reason(job, records.prep, trust)
        if reason:
            work.reasons["prep"] = reason
    if "render" in job.stages:
        if "prep" in work.reasons:
            # What follows is decided when its maps are known: they may turn out the same.
            work.reasons["render"] = "after prep"
            work.render = list(job.indices)
        else:
            _look_at_render(job, records, work, trust)
    _look_at_settings(job, records.job, work)
    return work


def prep_reason(job: Job, record: Record, trust: Trust) -> str:
    """Why the scan has to be prepared (again); empty when it has not."""
    stage = record.stages.get(job.prep_stage)
    if stage is None:
        return NEVER
    if job.scan.name not in stage.inputs:
        return f"it was made from {next(iter(stage.inputs), 'another scan')}"
    try:
        files = record.hashes(stage, job.scan.parent, list(stage.inputs), trust.verify)
        beside = changed_beside(job.scan, stage.notes.get("beside", {}))
    except (OutputError, OSError) as error:
        return str(error).split("\n")[0]
    if beside is not None:
        return beside
    reads = keys.prep_reads(job.recipe, files)
    if digest(reads) != stage.key:
        return _why(stage, reads)
    by_content = trust.verify or (trust.reading and "render" in job.stages)
    damaged = record.damaged(stage, list(stage.files), by_content)
    return "" if damaged is None else f"{damaged} is missing or not what was written"


def _look_at_render(job: Job, records: Records, work: Work, trust: Trust) -> None:
    record = records.job
    try:
        asset = asset_reads(job, records, trust.verify or trust.reading)
        pictures = _pictures(job, record, trust.verify or trust.reading)
    except OutputError as error:
        work.reasons["frames"] = str(error).split("\n")[0]
        work.render = list(job.indices)
        return
    if job.pipeline.figure.panels:
        _look_at_figure(job, record, work, asset, pictures, trust)
        return
    shot = _shot(job, record, work, asset, pictures)
    if shot is None:
        work.render, work.dump = list(job.indices), job.dumped_frames
        return
    reads = keys.frames_reads(shot, asset, pictures, trust.driver(record, "frames"))
    key = digest(reads)
    work.reads.update(
        frames=reads,
        buffers=keys.buffers_reads(job.recipe, key),
        video=keys.video_reads(job.recipe, key),
        sheet=keys.sheet_reads(job.recipe, key, job.subject),
    )
    _look_at_products(job, record, work, trust)
    _look_at_buffers(job, record, work, trust)


def asset_reads(job: Job, records: Records, verify: bool = False) -> dict[str, Any]:
    """What identifies a prepared scan to whoever renders it: its maps' bytes, not their dates."""
    if job.prepares:
        stage = records.prep.stages[job.prep_stage]
        names = keys.asset_files({"maps": keys.RENDERED_MAPS})
        entries = {name: stage.files.get(f"{job.asset.name}/{name}") for name in names}
        hashes = {name: entry.sha256 for name, entry in entries.items() if entry is not None}
        return {**hashes, "curvature_scale_mm": stage.notes.get("curvature_scale_mm")}
    info = keys.described(job.asset)
    hashes = _inputs(records.job, job.asset, keys.asset_files(info), verify)
    return {**hashes, "curvature_scale_mm": keys.curvature_scale_mm(info)}


def _pictures(job: Job, record: Record, verify: bool) -> dict[str, str]:
    hashes = _inputs(record, job.folder.resolve(), job.recipe.pictures, verify)
    return {name: hashes[name] for name in job.recipe.pictures}


def _inputs(record: Record, base: Any, names: list[str], verify: bool) -> dict[str, str]:
    """Hashes of files that others wrote, kept in the record so that they are not read again."""
    if not names:
        return {}
    stage = record.stages.get("inputs") or record.put("inputs", Stage("", {}))
    return record.hashes(stage, base, names, verify)


def _shot(
    job: Job, record: Record, work: Work, asset: dict[str, Any], pictures: dict[str, str]
) -> dict[str, Any] | None:
    """The settings that frames are rendered with; None when a plan has to find them first."""
    if not job.recipe.is_planned:
        return job.recipe.shot
    work.reads["plan"] = keys.plan_reads(job.recipe, asset, pictures, job.indices)
    stage = record.stages.get("plan")
    if stage is not None and stage.key == work.key("plan"):
        return keys.shot_settings(stage.notes["settings"])
    work.reasons["plan"] = _why(stage, work.reads["plan"])
    return None


def _look_at_products(job: Job, record: Record, work: Work, trust: Trust) -> None:
    """Video, sheet, and the frames that they or the user still need."""
    needed = set(job.indices) if job.keeps_frames else set()
    for name, file, frames in (
        ("video", VIDEO, list(job.indices) if job.writes_video else []),
        ("sheet", SHEET, job.sheet_frames),
    ):
        if frames and (reason := _reason(record, work, name, [file], trust.verify)):
            work.reasons[name] = reason
            needed |= set(frames)
    stage = record.current("frames", work.key("frames"))
    parts = {} if stage is None else stage.parts()
    damaged = None
    by_content = trust.verify or (trust.reading and bool({"video", "sheet"} & set(work.reasons)))
    for index in sorted(needed):
        name = job.frame_file(index)
        if stage is None or name not in parts.get(index, ()):
            work.render.append(index)
        elif record.damaged(stage, [name], by_content):
            damaged = damaged or f"{name} is missing or not what was written"
            work.render.append(index)
    work.cached_frames = len(needed) - len(work.render)
    if not work.render:
        return
    if stage is None:
        work.reasons["frames"] = _why(record.stages.get("frames"), work.reads["frames"])
    else:
        work.reasons["frames"] = damaged or NEVER


def _look_at_buffers(job: Job, record: Record, work: Work, trust: Trust) -> None:
    if not job.dumped_frames:
        return
    stage = record.current("buffers", work.key("buffers"))
    if stage is None:
        work.dump = job.dumped_frames
        work.reasons["buffers"] = _why(record.stages.get("buffers"), work.reads["buffers"])
        return
    for index in job.dumped_frames:
        names = stage.parts().get(index)
        if names is None:
            work.reasons.setdefault("buffers", NEVER)
        elif damaged := record.damaged(stage, names, trust.verify):
            work.reasons.setdefault("buffers", f"{damaged} is missing or not what was written")
        else:
            continue
        work.dump.append(index)


def _look_at_figure(
    job: Job,
    record: Record,
    work: Work,
    asset: dict[str, Any],
    pictures: dict[str, str],
    trust: Trust,
) -> None:
    gl = trust.driver(record, "figure")
    work.reads["figure"] = keys.figure_reads(job.recipe, asset, pictures, gl)
    if reason := _reason(record, work, "figure", list(FIGURE_FILES), trust.verify):
        work.reasons["figure"] = reason


def _look_at_settings(job: Job, record: Record, work: Work) -> None:
    """pipeline.yaml and the manifest, which repeat all settings: written last, whatever changed."""
    stage = record.stages.get("settings")
    part = None if job.part is None else list(job.part)
    work.reads["settings"] = {"settings": job.recipe.written, "frames": part}
    if not (job.folder / MANIFEST_NAME).exists():
        work.reasons["manifest"] = NEVER if stage is None else "the last run did not finish"
    elif stage is None or stage.key != work.key("settings"):
        work.reasons["manifest"] = "settings that are only written down differ"
    elif record.damaged(stage, list(stage.files)):
        work.reasons["manifest"] = f"{SETTINGS} is missing or not what was written"


def _reason(record: Record, work: Work, name: str, files: list[str], verify: bool) -> str:
    """Why these files of a stage have to be made; empty when they are there."""
    stage = record.current(name, work.key(name))
    if stage is None:
        return _why(record.stages.get(name), work.reads[name])
    damaged = record.damaged(stage, files, verify)
    return "" if damaged is None else f"{damaged} is missing or not what was written"


def _why(stage: Stage | None, reads: Mapping[str, Any]) -> str:
    if stage is None:
        return NEVER
    found = [_in_words(text) for text in differences(stage.reads, reads)]
    shown = "; ".join(found[:3]) or "a file of it is missing or not what was written"
    return shown if len(found) <= 3 else f"{shown}; and {len(found) - 3} more"


def _in_words(difference: str) -> str:
    """Digests say that something changed, and what they are of."""
    name = difference.partition(":")[0]
    return {
        "frames": "its frames change",
        "code": "scanrender's code for it changed",
        "render": "scanrender's code for rendering changed",
    }.get(name, difference)
