"""manifest.json: what was produced, by what, with which hashes; its presence means complete."""

from __future__ import annotations

import hashlib
import os
import platform
import re
from collections.abc import Mapping, Sequence
from importlib import metadata
from pathlib import Path
from typing import Any

import scanrender
from scanrender.errors import OutputError
from scanrender.files import TEMPORARY_PREFIX, write_json

MANIFEST_NAME = "manifest.json"


def write_manifest(
    folder: Path | str,
    document: Mapping[str, Any],
    files: Sequence[Mapping[str, Any]] | None = None,
) -> Path:
    """Write `folder`/manifest.json: `document` plus `files`, by default what lies there now.

    Call it last, after everything else was written and verified: a folder without a manifest is
    unfinished. Raises OutputError; ValueError for NaN or Inf in `document` (JSON has no such word).
    """
    folder = Path(folder)
    entries = file_entries(folder) if files is None else list(files)
    return write_json(folder / MANIFEST_NAME, {**document, "files": entries})


def hash_file(path: Path | str) -> str:
    """SHA-256 of the file's bytes as 64 hexadecimal digits. Raises OutputError if unreadable."""
    try:
        with open(path, "rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise OutputError(f"cannot read {path}: {error.strerror}", where=str(path)) from error


def file_entries(folder: Path | str) -> list[dict[str, Any]]:
    """`path` (relative, with /), `bytes` and `sha256` of each file under `folder`, sorted by path.

    The manifest itself and files that are still being written are left out; links are not followed.
    """
    folder = Path(folder)
    found: list[Path] = []
    for parent, folders, files in os.walk(folder):
        folders[:] = [name for name in folders if not name.startswith(TEMPORARY_PREFIX)]
        found += [Path(parent, name) for name in files if not name.startswith(TEMPORARY_PREFIX)]
    by_name = {path.relative_to(folder).as_posix(): path for path in found}
    by_name.pop(MANIFEST_NAME, None)
    return [
        {"path": name, "bytes": path.stat().st_size, "sha256": hash_file(path)}
        for name, path in sorted(by_name.items())
        if path.is_file() and not path.is_symlink()
    ]


def package_versions() -> dict[str, str]:
    """scanrender and each of its installed run-time dependencies -> version, sorted by name."""
    versions = {"scanrender": scanrender.__version__}
    try:
        requirements = metadata.requires("scanrender") or []
    except metadata.PackageNotFoundError:  # run from a source tree that was not installed
        requirements = []
    for requirement in requirements:
        name = re.split(r"[^A-Za-z0-9._-]", requirement, maxsplit=1)[0]
        try:
            versions[name] = metadata.version(name)
        except metadata.PackageNotFoundError:  # an extra that this machine does without
            continue
    return dict(sorted(versions.items(), key=lambda item: item[0].lower()))


def platform_info() -> dict[str, Any]:
    """The machine in plain words: Python, system, processor, its number of usable cores."""
    return {
        "python": platform.python_version(),
        "implementation": platform.python_implementation(),
        "system": f"{platform.system()} {platform.release()}",
        "machine": platform.machine(),
        "cores": os.cpu_count() or 1,
    }
