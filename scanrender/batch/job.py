"""One job: a scan through a pipeline into a folder, with a manifest written last."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from scanrender import __version__
from scanrender.asset import Asset, check_replaceable, load_asset
from scanrender.batch.prep_report import draw_prep_sheet
from scanrender.batch.stages import stages_for
from scanrender.batch.turntable import Progress, write_turntable
from scanrender.files import check_writable, write_text
from scanrender.outputs.manifest import (
    MANIFEST_NAME,
    hash_file,
    package_versions,
    platform_info,
    write_manifest,
)
from scanrender.settings.loading import resolved_yaml
from scanrender.settings.pipeline import Pipeline

# The maps that some pass of today's renderer reads.
RENDERED_MAPS = ("albedo", "normal_ts", "ao", "skin", "curvature", "thickness_mm")


@dataclass
class Result:
    """What a finished job tells: its folder, files, seconds per stage, and sentences of warning."""

    name: str
    folder: Path
    files: list[str] = field(default_factory=list)
    stages: dict[str, float] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)
    decisions: list[str] = field(default_factory=list)
    plan: dict[str, Any] = field(default_factory=dict)
    quality: dict[str, Any] = field(default_factory=dict)

    def as_json(self) -> dict[str, Any]:
        return {
            "scan": self.name,
            "folder": str(self.folder),
            "files": self.files,
            "seconds": {name: round(value, 3) for name, value in self.stages.items()},
            "warnings": self.warnings,
            "not_run": self.decisions,
            "plan": self.plan,
            "quality": self.quality,
        }


def run_job(
    scan: Path,
    pipeline: Pipeline,
    folder: Path,
    progress: Progress,
    frames: Sequence[int] | None = None,
) -> Result:
    """Prepare and render one scan, or render one that is prepared already (an asset folder).

    Raises any ScanrenderError; what is complete by then stays.
    """
    stages = stages_for(scan, pipeline)
    check_writable(folder)
    if "render" in stages:
        from scanrender.render.device import device

        device()  # no GL is said now, not after a minute of preparation
    result = Result(scan.stem, folder)
    asset_folder = folder / "asset"
    if "prep" in stages:
        check_replaceable(asset_folder)
    # A manifest means complete: an earlier run's must not vouch for what is written now.
    (folder / MANIFEST_NAME).unlink(missing_ok=True)
    if "prep" in stages:
        asset = _prepare(scan, pipeline, asset_folder, progress, result)
        source: dict[str, Any] = {"file": scan.name, "sha256": hash_file(scan)}
    else:
        asset = load_asset(scan, RENDERED_MAPS)
        source = dict(asset.info.get("source", {}))
        if "prep" in pipeline.stages:
            result.decisions.append("prep: the scan is a prepared asset already")
    gl: dict[str, Any] = {}
    if "render" in stages:
        gl = _render(asset, pipeline, folder, progress, frames, result)
    write_text(folder / "pipeline.yaml", resolved_yaml(pipeline))
    result.files.append("pipeline.yaml")
    write_manifest(folder, _manifest(pipeline, source, gl, result))
    result.files.append("manifest.json")
    return result


def _prepare(
    scan: Path, pipeline: Pipeline, folder: Path, progress: Progress, result: Result
) -> Asset:
    from scanrender.scan.prepare import prepare

    started = time.perf_counter()
    asset = prepare(scan, pipeline.scan, pipeline.prep, folder, progress=progress)
    draw_prep_sheet(folder)
    result.stages["prep"] = time.perf_counter() - started
    result.warnings += [str(sentence) for sentence in asset.info.get("warnings", [])]
    result.files.append("asset/")
    return asset


def _render(
    asset: Asset,
    pipeline: Pipeline,
    folder: Path,
    progress: Progress,
    frames: Sequence[int] | None,
    result: Result,
) -> dict[str, Any]:
    from scanrender.batch.figure import write_figure
    from scanrender.batch.shot import prepare_shot
    from scanrender.render.device import device

    started = time.perf_counter()
    if pipeline.figure.panels:
        result.files += write_figure(
            device(), asset, pipeline, folder, _subject(asset, result.name), progress
        )
        result.stages["render"] = time.perf_counter() - started
        return _gl(device(), pipeline)
    asked = range(pipeline.turntable.frames) if frames is None else frames
    shot = prepare_shot(device(), asset, pipeline, asked)
    result.stages["plan" if shot.measured or shot.choice else "upload"] = (
        time.perf_counter() - started
    )
    subject = _subject(asset, result.name)
    written = write_turntable(shot.renderer, folder, subject, progress, frames)
    result.files += written.files
    result.stages.update(written.seconds)
    result.decisions += shot.not_run
    result.plan, result.quality = shot.measured, shot.outcome(written.frame_ms)
    return _gl(device(), pipeline)


def _subject(asset: Asset, name: str) -> str:
    """The scan's name, also where the job is given its asset's folder."""
    return Path(str(asset.info.get("source", {}).get("file", ""))).stem or name


def _gl(device: Any, pipeline: Pipeline) -> dict[str, Any]:
    from scanrender.render.view import describe

    return {
        "renderer": device.renderer,
        "version": device.version,
        "vendor": device.vendor,
        "view": describe(pipeline.view),
    }


def _manifest(
    pipeline: Pipeline, source: dict[str, Any], gl: dict[str, Any], result: Result
) -> dict[str, Any]:
    return {
        "scanrender": __version__,
        "versions": package_versions(),
        "platform": platform_info(),
        "gl": gl,
        "source": source,
        "settings": pipeline.model_dump(mode="json"),
        "seconds": {name: round(value, 3) for name, value in result.stages.items()},
        "warnings": result.warnings,
        "not_run": result.decisions,
        "plan": result.plan,
        "quality": result.quality,
    }
