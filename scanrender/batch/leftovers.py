"""What runs that were killed left in a job's folder, and what results of other settings left."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path

from scanrender.batch.jobs import RESUME_FRAMES
from scanrender.batch.record import Record
from scanrender.files import TEMPORARY_PREFIX, clean_stale

RENDERED = ("frames", "buffers", "video", "sheet", "figure")


def clean_leftovers(folder: Path, lost: str | None = None) -> None:
    """Remove half-written files of processes that are gone, in the folder and its own folders;
    `lost` is a machine that is (`files.machine`)."""
    for parent, folders, _ in os.walk(folder):
        folders[:] = [name for name in folders if not name.startswith(TEMPORARY_PREFIX)]
        clean_stale(Path(parent), lost=lost)


def remove_stale(record: Record, current: dict[str, str]) -> None:
    """Remove files of rendering stages whose key is not the current one: they are of other settings
    and would pass for these. The record forgets them after the files are gone."""
    for name in RENDERED:
        stage = record.stages.get(name)
        if stage is not None and stage.key != current.get(name):
            remove_files(record.folder, stage.files)
            record.drop(name)
    record.save()


def remove_files(folder: Path, names: Iterable[str]) -> None:
    """Files of the folder, and folders of theirs that become empty."""
    for name in names:
        path = folder / name
        path.unlink(missing_ok=True)
        with suppress(OSError):
            for parent in path.relative_to(folder).parents[:-1]:
                (folder / parent).rmdir()


def drop_resume_frames(record: Record) -> None:
    """Frames that only waited for their video and sheet, which are complete."""
    stage = record.stages.get("frames")
    if stage is not None:
        for name in [n for n in stage.files if n.startswith(f"{RESUME_FRAMES}/")]:
            del stage.files[name]
            record.changed = True
    record.save()
    shutil.rmtree(record.folder / RESUME_FRAMES, ignore_errors=True)
