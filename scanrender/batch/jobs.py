"""A job: one scan, one pipeline without a matrix, one folder. Known before anything is opened."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from scanrender.batch.identity import scan_ids
from scanrender.batch.keys import Recipe, described
from scanrender.batch.needed import with_needed_maps
from scanrender.batch.record import digest
from scanrender.batch.stages import is_asset, stages_for
from scanrender.errors import UsageError
from scanrender.settings.matrix import variants
from scanrender.settings.pipeline import Pipeline

ASSET, FRAMES, RESUME_FRAMES = "asset", "frames", ".frames"


@dataclass(frozen=True)
class Job:
    """`asset` is the prepared scan's folder: the scan itself when that is one. `part` are the
    frames asked for, None for the whole turn with video and sheet."""

    scan: Path
    name: str
    recipe: Recipe
    folder: Path
    asset: Path
    part: tuple[int, ...] | None = None
    variant: str = ""

    @cached_property
    def stages(self) -> list[str]:
        """What the pipeline does to this scan. Raises UsageError when that is nothing."""
        return stages_for(self.scan, self.recipe.pipeline)

    @property
    def prepares(self) -> bool:
        return "prep" in self.stages

    @property
    def prep_stage(self) -> str:
        """What the record of the asset's folder calls it: variants may need several."""
        return "prep" if self.asset.name == ASSET else f"prep {self.asset.name}"

    @property
    def pipeline(self) -> Pipeline:
        return self.recipe.pipeline

    @cached_property
    def subject(self) -> str:
        """The scan's name, also where the job is given its asset's folder."""
        if self.prepares:
            return self.scan.stem
        source = described(self.asset).get("source")
        file = source.get("file", "") if isinstance(source, dict) else ""
        return Path(str(file)).stem or self.name

    @property
    def label(self) -> str:
        return f"{self.name} {self.variant}".strip()

    @property
    def indices(self) -> range | tuple[int, ...]:
        return range(self.pipeline.turntable.frames) if self.part is None else self.part

    @property
    def keeps_frames(self) -> bool:
        """Whether PNG frames are asked for, or only wait for their video and sheet."""
        return self.pipeline.outputs.frames or self.part is not None

    def frame_file(self, index: int) -> str:
        return f"{FRAMES if self.keeps_frames else RESUME_FRAMES}/frame_{index:04d}.png"

    @property
    def dumped_frames(self) -> list[int]:
        """Frames whose buffers are written."""
        outputs = self.pipeline.outputs
        return [i for i in self.indices if i in outputs.buffer_frames] if outputs.buffers else []

    @property
    def sheet_frames(self) -> list[int]:
        """Frames on the contact sheet, spread over a closed turn (the last is not the first)."""
        outputs, indices = self.pipeline.outputs, self.indices
        if self.part is not None or not outputs.contact_sheet:
            return []
        count = min(outputs.contact_frames, len(indices))
        return sorted({indices[int(i * len(indices) / count)] for i in range(count)})

    @property
    def writes_video(self) -> bool:
        return self.part is None and self.pipeline.outputs.video


def single_job(
    scan: Path, pipeline: Pipeline, folder: Path, part: Sequence[int] | None = None
) -> Job:
    """The job of one scan whose results go straight into `folder`."""
    asset = scan if is_asset(scan) else folder / ASSET
    frames = None if part is None else tuple(part)
    return Job(scan, scan.stem, Recipe(with_needed_maps([pipeline])[0]), folder, asset, frames)


def make_jobs(
    scans: Sequence[Path],
    pipeline: Pipeline,
    source: str,
    out: Path,
    part: Sequence[int] | None = None,
) -> list[Job]:
    """Every scan with every variant of the pipeline's matrix.

    One scan's results go straight into `out`, several into a folder each, and variants into folders
    of their own below that, where those with the same preparation share one asset. Raises
    UsageError when a scan is named twice, ConfigError for a matrix that cannot be.
    """
    real = Counter(os.path.realpath(scan) for scan in scans)
    if twice := next((path for path, count in real.items() if count > 1), None):
        raise UsageError(f"the same scan is named twice: {twice}")
    made = variants(pipeline, source)
    needed = with_needed_maps([v.pipeline for v in made])
    recipes = [(v.name, Recipe(each)) for v, each in zip(made, needed, strict=True)]
    shares: dict[str, str] = {}
    for name, recipe in recipes:
        shares.setdefault(digest(recipe.prep), name)
    jobs = []
    for scan, scan_id in zip(scans, scan_ids(scans), strict=True):
        base, prepared = out if len(scans) == 1 else out / scan_id, is_asset(scan)
        for name, recipe in recipes:
            own = ASSET if len(shares) == 1 else f"{ASSET}-{shares[digest(recipe.prep)]}"
            asset = scan if prepared else base / own
            folder, frames = base / name if name else base, None if part is None else tuple(part)
            jobs.append(Job(scan, scan_id, recipe, folder, asset, frames, name))
    return jobs
