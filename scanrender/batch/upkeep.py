"""Looking after folders of results: what is in them, whether it is whole, what can go."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from scanrender.batch.jobs import RESUME_FRAMES
from scanrender.batch.leftovers import drop_resume_frames
from scanrender.batch.lock import locked
from scanrender.batch.record import RECORD_NAME, checked, load_record
from scanrender.files import TEMPORARY_PREFIX, clean_stale, is_stale
from scanrender.outputs.manifest import MANIFEST_NAME


def job_folders(out: Path) -> list[Path]:
    """Folders with a record, `out` among them, sorted."""
    return sorted(parent for parent, _, files in _walk(out) if RECORD_NAME in files)


def _walk(out: Path) -> Iterator[tuple[Path, list[str], list[str]]]:
    for parent, folders, files in os.walk(out):
        folders[:] = [name for name in folders if not name.startswith(TEMPORARY_PREFIX)]
        yield Path(parent), folders, files


def list_jobs(out: Path) -> list[dict[str, Any]]:
    rows = []
    for folder in job_folders(out):
        stages = {
            name: {
                "files": len(stage.files),
                "bytes": sum(entry.size for entry in stage.files.values()),
                "key": stage.key,
                "seconds": stage.seconds,
            }
            for name, stage in load_record(folder).stages.items()
            if stage.files
        }
        complete = (folder / MANIFEST_NAME).exists()
        rows.append({"folder": str(folder), "complete": complete, "stages": stages})
    return rows


def verify_jobs(out: Path) -> tuple[int, list[str]]:
    """How many files were read, and the paths of those that are not what was written. Those are
    forgotten by their record. Raises OutputError where a run is at work."""
    count, damaged = 0, []
    for folder in job_folders(out):
        with locked(folder):
            record = load_record(folder)
            for stage in record.stages.values():
                groups: dict[int | None, list[str]] = {}
                for name, entry in stage.files.items():
                    groups.setdefault(entry.part, []).append(name)
                count += len(stage.files)
                for names in groups.values():
                    entries = [(name, stage.files[name]) for name in names]
                    bad = [n for n, e in entries if checked(folder / n, e, verify=True) is None]
                    damaged += [str(folder / name) for name in bad]
                    if bad:
                        stage.forget(names)
                        record.changed = True
            record.save()
    return count, damaged


def prune_jobs(out: Path, dry_run: bool) -> tuple[list[Path], int]:
    """Paths of leftovers, and their bytes. Raises OutputError where a run is at work."""
    found: list[Path] = []
    for parent, folders, files in _walk(out):
        found += [path for path in sorted(parent.iterdir()) if is_stale(path)]
        if RESUME_FRAMES in folders and RECORD_NAME in files:
            folders.remove(RESUME_FRAMES)
            found.append(parent / RESUME_FRAMES)
    freed = sum(_size(path) for path in found)
    for folder in [] if dry_run else sorted({path.parent for path in found}):
        with locked(folder):
            clean_stale(folder)
            if folder / RESUME_FRAMES in found:
                drop_resume_frames(load_record(folder))
    return found, freed


def _size(path: Path) -> int:
    files = path.rglob("*") if path.is_dir() else [path]
    return sum(file.lstat().st_size for file in files if file.is_file())
