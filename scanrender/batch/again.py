"""The jobs of an earlier run, from its batch.json or manifest.json: `run --from-manifest`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from scanrender import __version__
from scanrender.asset import is_asset
from scanrender.batch.jobs import ASSET, Job
from scanrender.batch.keys import Recipe
from scanrender.batch.record import read_entry
from scanrender.batch.summary import read_summary
from scanrender.errors import ConfigError, ScanrenderError, UsageError
from scanrender.settings.layers import Layer
from scanrender.settings.validation import validated


def jobs_of_manifest(path: Path, out: Path) -> tuple[list[Job], list[str]]:
    """The same scans with the same settings into `out`, and sentences about what differs here.

    Raises ConfigError when it is no manifest, UsageError for a scan that is gone or is not what it
    was.
    """
    try:
        document = read_summary(path)
        jobs = _of_batch(document, out) if "variants" in document else [_of_job(document, out)]
    except (OSError, ValueError, LookupError, TypeError, AttributeError) as error:
        if isinstance(error, ScanrenderError):
            raise
        what = f"{path} is no manifest of a batch or a scan ({type(error).__name__}: {error})"
        raise ConfigError(what, str(path), "name a batch.json or manifest.json") from error
    made_by = document.get("scanrender")
    notes = []
    if made_by != __version__:
        notes.append(f"made by scanrender {made_by}, run by {__version__}: results may differ")
    return jobs, notes


def _of_batch(document: dict[str, Any], out: Path) -> list[Job]:
    recipes = {name: _recipe(data) for name, data in document["variants"].items()}
    jobs = []
    for entry in document["jobs"]:
        scan = _scan(entry["scan"], entry.get("sha256"))
        folder, asset = Path(entry["folder"]), Path(entry["asset"])
        if folder.is_absolute() or ".." in folder.parts:
            raise ValueError(f"the folder {folder} is outside of the batch")
        prepared = is_asset(scan)
        own = scan if prepared else out / folder / ASSET if asset.is_absolute() else out / asset
        recipe = recipes[entry["variant"]]
        part = _part(document.get("frames"))
        jobs.append(Job(scan, entry["name"], recipe, out / folder, own, part, entry["variant"]))
    return jobs


def _of_job(document: dict[str, Any], out: Path) -> Job:
    source = document["source"]
    hashed = None if "asset" in source else source.get("sha256")
    scan = _scan(source.get("asset") or source["path"], hashed)
    asset = scan if is_asset(scan) else out / ASSET
    recipe, part = _recipe(document["settings"]), _part(document.get("frames"))
    return Job(scan, scan.stem, recipe, out, asset, part)


def _recipe(settings: dict[str, Any]) -> Recipe:
    return Recipe(validated(Layer(settings, {}), "the manifest"))


def _part(frames: list[int] | None) -> tuple[int, ...] | None:
    return None if frames is None else tuple(int(frame) for frame in frames)


def _scan(name: str, sha256: str | None) -> Path:
    path = Path(name)
    if not path.exists():
        raise UsageError(f"the scan {path} of the manifest is not there any more")
    if sha256 is not None and read_entry(path).sha256 != sha256:
        raise UsageError(
            f"the scan {path} is not the one of the manifest: its content is another",
            str(path),
            "put the scan of then there, or run the pipeline on this one",
        )
    return path
