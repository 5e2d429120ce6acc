"""One job: a scan through a pipeline into a folder, doing what is not done yet, manifest last.

What is done is in record.json (`record`), what is not is found by `state.look`. The order matters
for whoever is killed in between: the manifest goes first, files come, then the record that names
them, and the manifest again when nothing is missing.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from scanrender.asset import Asset, check_replaceable, load_asset
from scanrender.batch.jobs import Job, single_job
from scanrender.batch.keys import RENDERED_MAPS, curvature_scale_mm, prep_reads
from scanrender.batch.leftovers import clean_leftovers, drop_resume_frames, remove_stale
from scanrender.batch.lock import locked
from scanrender.batch.log import JobLog
from scanrender.batch.memory import forget_peak, peak_mib
from scanrender.batch.parts import PARTS, adopt_parts
from scanrender.batch.record import Record, Stage, digest, read_entry
from scanrender.batch.result import Result, manifest, result_of
from scanrender.batch.state import FIGURE_FILES, SETTINGS, Records, Trust, Work, look, records_of
from scanrender.errors import OutputError, StageError
from scanrender.files import check_writable, write_text
from scanrender.outputs.manifest import MANIFEST_NAME, write_manifest
from scanrender.scan.beside import forget
from scanrender.settings.loading import resolved_yaml
from scanrender.settings.pipeline import Pipeline

if TYPE_CHECKING:
    from scanrender.batch.shot import PreparedShot
    from scanrender.render.frame import Renderer

Progress = Callable[[str, float], None]

__all__ = ["RENDERED_MAPS", "Result", "do_job", "run_job"]


def run_job(
    scan: Path,
    pipeline: Pipeline,
    folder: Path,
    progress: Progress,
    frames: Sequence[int] | None = None,
) -> Result:
    """Prepare and render one scan, or render one that is prepared already (an asset folder).

    What an earlier run left complete is not done again. Raises any ScanrenderError; what is
    complete by then stays.
    """
    return do_job(single_job(scan, pipeline, folder, frames), progress)


def do_job(
    job: Job,
    progress: Progress,
    verify: bool = False,
    only: str | None = None,
    opens_gl: bool = True,
    wait_s: float = 0.0,
) -> Result:
    """Do what is to be done of the job, or only of its stage `prep`. Nothing is believed with
    `verify`: contents are looked at. Without `opens_gl` another process will render what is
    prepared here. `wait_s`: for a lock (`lock.locked`). Raises any ScanrenderError."""
    forget()
    records = records_of(job)
    if not look(job, records, Trust(verify)).reasons:
        with suppress(OutputError):  # a folder that is only read is as good
            records.save()
        return result_of(job, records, cached=True)
    check_writable(job.folder)
    log = JobLog(job.folder)
    with locked(job.folder, wait_s):
        try:
            return _Run(job, log.following(progress), log, verify).run(only, opens_gl)
        except BaseException as error:
            log.write(f"failed: {error if str(error) else type(error).__name__}")
            raise


@dataclass
class _Run:
    """One go at a job, whose folder this process holds."""

    job: Job
    progress: Progress
    log: JobLog
    verify: bool
    seconds: dict[str, float] = field(default_factory=dict)

    def run(self, only: str | None, opens_gl: bool = True) -> Result:
        job = self.job
        clean_leftovers(job.folder)
        records = records_of(job)
        work = look(job, records, Trust(self.verify))
        if opens_gl and (work.needs_gl or "render" in work.reasons):
            from scanrender.render.device import device

            device()  # no GL is said now, not after a minute of preparation
        if set(work.reasons) - {"prep", "render", "manifest"}:
            # What is read from here on is looked at: a damaged map is found before it is shown.
            work = look(job, records, Trust(self.verify, reading=True))
        for stage, reason in work.reasons.items():
            self.log.write(f"to do: {stage} ({reason})")
        if "prep" in work.reasons:
            check_replaceable(job.asset)
        # A manifest means complete: an earlier run's must not vouch for what is written now.
        (job.folder / MANIFEST_NAME).unlink(missing_ok=True)
        if "prep" in work.reasons:
            self._prepare(records.prep)
            forget()
            work = look(job, records, Trust(self.verify, reading=True))
        if count := adopt_parts(job, records.job, work):
            self.log.write(f"{count} frames of {PARTS}/ were taken over")
            work = look(job, records, Trust(self.verify, reading=True))
        if only == "prep":
            return result_of(job, records, self.seconds)
        self._render(records, work)
        return self._finish(records)

    def _prepare(self, record: Record) -> None:
        from scanrender.batch.prep_report import draw_prep_sheet
        from scanrender.scan.prepare import prepare

        job, started = self.job, time.perf_counter()
        settings = job.pipeline
        asset = prepare(
            job.scan, settings.scan, settings.prep, job.asset, progress=self.progress, maps=()
        )
        draw_prep_sheet(job.asset)
        self.seconds["prep"] = time.perf_counter() - started
        record.put(job.prep_stage, _prepared(job, asset, record, self.seconds["prep"]))
        record.save()
        for sentence in asset.info.get("warnings", []):
            self.log.write(f"warning: {sentence}")

    def _render(self, records: Records, work: Work) -> None:
        job, record = self.job, records.job
        if not {"plan", "frames", "buffers", "figure", "video", "sheet"} & set(work.reasons):
            return
        shown = _Shown(job, records)
        forget_peak()
        if work.needs_gl:
            work = self._ready(shown, records, work)
        remove_stale(record, {name: work.key(name) for name in work.reads})
        if job.pipeline.figure.panels:
            self._write_figure(shown, record, work)
            return
        from scanrender.batch.turntable import Turntable

        frames = record.stages.get("frames")
        if frames is None:
            frames = record.put("frames", Stage(work.key("frames"), work.reads["frames"]))
        if work.needs_gl:
            shown.describe(frames)
        if work.dump and "buffers" not in record.stages:
            record.put("buffers", Stage(work.key("buffers"), work.reads["buffers"]))
        turntable = Turntable(job, record, work, frames, shown.renderer, self.log.write)
        try:
            turntable.write(self.progress)
        finally:
            self.seconds.update(turntable.seconds)
            spent = frames.notes.setdefault("seconds", {})
            ready = {k: v for k, v in self.seconds.items() if k in ("plan", "upload")}
            for name, value in {**ready, **turntable.seconds}.items():
                spent[name] = round(spent.get(name, 0.0) + value, 3)
            if work.needs_gl:
                frames.notes["peak_mib"] = max(peak_mib() or 0, frames.notes.get("peak_mib", 0))
            record.changed = True
            record.save()
        drop_resume_frames(record)

    def _ready(self, shown: _Shown, records: Records, work: Work) -> Work:
        """Open GL, load the asset, plan: now all settings and the driver are known for good."""
        from scanrender.render.device import device

        self.progress("load", 0.0)
        gl = device()
        trust = Trust(self.verify, reading=True, gl=gl.driver)
        work = look(self.job, records, trust)
        if "plan" in work.reasons:
            started = time.perf_counter()
            shown.plan(work)
            self.seconds["plan"] = time.perf_counter() - started
            work = look(self.job, records, trust)
        elif work.needs_gl and not self.job.pipeline.figure.panels:
            started = time.perf_counter()
            shown.renderer()
            self.seconds["upload"] = time.perf_counter() - started
        return work

    def _write_figure(self, shown: _Shown, record: Record, work: Work) -> None:
        from scanrender.batch.figure import write_figure
        from scanrender.render.device import device

        started = time.perf_counter()
        asset = shown.asset
        names = write_figure(
            device(), asset, self.job.pipeline, self.job.folder, self.job.subject,
            self.progress,
        )  # fmt: skip
        self.seconds["render"] = time.perf_counter() - started
        stage = Stage(work.key("figure"), work.reads["figure"], seconds=self.seconds["render"])
        stage.notes["gl"] = _gl(self.job.pipeline)
        stage.notes["seconds"] = {"render": round(self.seconds["render"], 3)}
        assert set(names) == set(FIGURE_FILES)
        record.put("figure", stage)
        for name in names:
            record.add(stage, name)
        record.save()

    def _finish(self, records: Records) -> Result:
        """pipeline.yaml, then the manifest: with it the folder is complete."""
        job, record = self.job, records.job
        write_text(job.folder / SETTINGS, resolved_yaml(job.pipeline))
        part = None if job.part is None else list(job.part)
        reads = {"settings": job.recipe.written, "frames": part}
        record.add(record.put("settings", Stage(digest(reads), reads)), SETTINGS)
        records.save()
        document, files = manifest(job, records)
        write_manifest(job.folder, document, files)
        self.log.write("complete")
        return result_of(job, records, self.seconds)


class _Shown:
    """The asset and its renderer, made when they are first needed."""

    def __init__(self, job: Job, records: Records) -> None:
        self.job, self.records = job, records
        self._asset: Asset | None = None
        self._renderer: Renderer | None = None
        self._shot: PreparedShot | None = None

    @property
    def asset(self) -> Asset:
        if self._asset is None:
            self._asset = load_asset(self.job.asset, RENDERED_MAPS)
        return self._asset

    def plan(self, work: Work) -> None:
        """Choose and measure; the record keeps what was found, so that a run that is interrupted
        goes on with the same settings."""
        from scanrender.batch.shot import prepare_shot
        from scanrender.render.device import device

        shot = prepare_shot(device(), self.asset, self.job.pipeline, self.job.indices)
        notes = {
            "settings": shot.pipeline.model_dump(mode="json"),
            "not_run": shot.not_run,
            "measured": shot.measured,
            "predicted": shot.predicted,
        }
        self._renderer = shot.renderer
        record = self.records.job
        record.put("plan", Stage(work.key("plan"), work.reads["plan"], notes=notes))
        record.save()

    def renderer(self) -> Renderer:
        if self._renderer is None:
            from scanrender.render.device import device
            from scanrender.render.frame import Renderer

            planned = self.records.job.stages.get("plan") if self.job.recipe.is_planned else None
            settings = self.job.pipeline
            if planned is not None:
                settings = Pipeline.model_validate(planned.notes["settings"])
            self._renderer = Renderer(device(), self.asset, settings)
        return self._renderer

    def describe(self, frames: Stage) -> None:
        """What sheet and manifest say of the frames, for when they are made without a renderer."""
        from scanrender.batch.turntable import subtitle

        renderer = self.renderer()
        frames.notes["not_run"] = [f"{d.what}: {d.reason}" for d in renderer.decisions]
        frames.notes["title"] = self.job.subject
        frames.notes["subtitle"] = subtitle(renderer)
        frames.notes["gl"] = _gl(self.job.pipeline)


def _prepared(job: Job, asset: Asset, record: Record, seconds: float) -> Stage:
    """The record's entry of a preparation. Raises StageError when the scan changed meanwhile."""
    source = asset.info.get("source", {})
    beside = source.get("beside", {})
    hashes = {job.scan.name: source.get("sha256")}
    hashes |= {entry["file"]: entry["sha256"] for entry in beside.get("files", ())}
    inputs = {name: read_entry(job.scan.parent / name) for name in hashes}
    for name, entry in inputs.items():
        if entry.sha256 != hashes[name]:
            where = str(job.scan.parent / name)
            raise StageError(f"{name} changed while it was prepared", where, "run it again")
    reads = prep_reads(job.recipe, {name: entry.sha256 for name, entry in inputs.items()})
    stages = asset.info.get("stages", ())
    notes = {
        "beside": {k: v for k, v in beside.items() if k != "files"},
        "source": {k: v for k, v in source.items() if k != "beside"},
        "warnings": [str(sentence) for sentence in asset.info.get("warnings", [])],
        "curvature_scale_mm": curvature_scale_mm(asset.info),
        "peak_mib": max((x.get("peak_memory_mib") or 0 for x in stages), default=0),
        **{name: asset.info.get(name) for name in ("lost", "counts", "units")},
    }
    stage = Stage(digest(reads), reads, inputs=inputs, seconds=seconds, notes=notes)
    for file in sorted(job.asset.iterdir()):
        if file.is_file():
            record.add(stage, f"{job.asset.name}/{file.name}")
    return stage


def _gl(pipeline: Pipeline) -> dict[str, Any]:
    from scanrender.render.device import device
    from scanrender.render.view import describe

    gl = device()
    return {
        "renderer": gl.renderer,
        "version": gl.version,
        "vendor": gl.vendor,
        "view": describe(pipeline.view),
    }
