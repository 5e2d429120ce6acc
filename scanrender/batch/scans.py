"""Which scans a command line means: files, prepared folders, folders of either, and patterns."""

from __future__ import annotations

import glob
import os
from collections.abc import Iterator, Sequence
from pathlib import Path

from scanrender.asset import is_asset
from scanrender.errors import UsageError
from scanrender.scan.header import FORMATS


def find_scans(named: Sequence[Path], out: Path) -> list[Path]:
    """Scans in the order named; those of a folder or of a pattern by name, each once.

    A folder stands for all scans and prepared assets below it, results in `out` and hidden folders
    left out. Raises UsageError for what is not there, and where there is nothing.
    """
    found: list[Path] = []
    explicit: list[Path] = []
    for path in named:
        if path.is_dir() and not is_asset(path):
            found += _told(list(_below(path, out)), f"no scan lies in {path}")
        elif path.exists():
            explicit.append(path)
            found.append(path)
        elif glob.has_magic(str(path)):
            found += _told(_matching(str(path), out), f"nothing matches {path}")
        else:
            raise UsageError(f"no such scan: {path}")
    unique = {os.path.realpath(path): path for path in reversed(found)}
    # What is named twice by hand is a slip, and told later; what a folder holds too is not.
    kept = {id(path) for path in unique.values()} | {id(path) for path in explicit}
    return [path for path in found if id(path) in kept]


def _told(found: list[Path], otherwise: str) -> list[Path]:
    if not found:
        kinds = ", ".join(FORMATS)
        raise UsageError(otherwise, fix=f"scans are files ending in {kinds}, or prepared folders")
    return found


def _below(folder: Path, out: Path) -> Iterator[Path]:
    for parent, folders, files in os.walk(folder):
        here = Path(parent)
        assets = [name for name in sorted(folders) if is_asset(here / name)]
        folders[:] = [
            name
            for name in sorted(folders)
            if name not in assets and not name.startswith(".") and not _same(here / name, out)
        ]
        yield from (here / name for name in sorted(files) if _is_scan(name))
        yield from (here / name for name in assets)


def _matching(pattern: str, out: Path) -> list[Path]:
    """Files and assets that match; a folder that matches stands for what is below it."""
    found: list[Path] = []
    for name in sorted(glob.glob(pattern, recursive=True)):
        path = Path(name)
        if is_asset(path) or (path.is_file() and _is_scan(name)):
            found.append(path)
        elif path.is_dir() and not pattern.endswith("**"):
            found += _below(path, out)
    return found


def _is_scan(name: str) -> bool:
    return name.lower().endswith(FORMATS) and not os.path.basename(name).startswith(".")


def _same(path: Path, other: Path) -> bool:
    return os.path.realpath(path) == os.path.realpath(other)
