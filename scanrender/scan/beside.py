"""What lies beside a scan and belongs to it: images, materials, buffers, and what was not there.

A preparation depends on each file it read beside the scan, on each that it looked for in vain, and
on the image that it took because the scan names none. `safe_path.inside` and `lone_image` note all
three; `answers` makes plain data of them, and `changed` asks again later, without reading the scan.
"""

from __future__ import annotations

import hashlib
import os
from collections import Counter
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path, PurePosixPath
from typing import Any
from urllib.parse import unquote

from scanrender.errors import ScanError

IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".tga", ".exr", ".webp")
_BLOCK = 1 << 22


@dataclass
class Notes:
    """What this process found and missed; a process prepares one scan."""

    found: dict[Path, os.stat_result] = field(default_factory=dict)
    missing: set[str] = field(default_factory=set)
    lone: dict[Path, str | None] = field(default_factory=dict)

    def note(self, reference: str, file: Path | None) -> None:
        if file is None:
            self.missing.add(reference)
        else:
            self.found.setdefault(file, file.stat())


NOTES = Notes()


@dataclass(frozen=True)
class _Listing:
    """Images of one folder, also those whose name is not UTF-8, which nobody opens; how many files
    it has of each suffix, and all names in lower case."""

    images: tuple[Path, ...]
    misnamed: tuple[str, ...]
    suffixes: Counter[str]
    names: frozenset[str]


def _listed(folder: Path) -> _Listing:
    files = [folder / entry.name for entry in os.scandir(folder) if entry.is_file()]
    images = sorted(f for f in files if f.suffix.lower() in IMAGE_SUFFIXES)
    inside = tuple(f for f in images if f.resolve().is_relative_to(folder.resolve()))
    misnamed = tuple(f.name for f in inside if not _is_utf8(f.name))
    usable = tuple(f for f in inside if f.name not in misnamed)
    names = frozenset(f.name.lower() for f in files)
    return _Listing(usable, misnamed, Counter(f.suffix.lower() for f in files), names)


def _is_utf8(name: str) -> bool:
    try:
        name.encode()
    except UnicodeEncodeError:  # Python keeps the byte as half of a surrogate pair
        return False
    return True


# A thousand scans of one folder ask the same; only `changed` may remember, within one command.
_remembered = lru_cache(maxsize=64)(_listed)


def lone_image(path: Path, notes: list[str] | None = None) -> Path | None:
    """The image that obviously belongs to a scan whose file names none, or None. notes: takes a
    sentence about each that cannot be opened."""
    listing = _listed(path.parent)
    if notes is not None:
        notes += [f"the image {x!a} is ignored: its name is not UTF-8" for x in listing.misnamed]
    found = _lone_image(path, listing)
    NOTES.lone[path] = None if found is None else found.name
    if found is not None:
        NOTES.note(found.name, found)
    return found


def _lone_image(path: Path, listing: _Listing) -> Path | None:
    same = [f for f in listing.images if f.stem.lower() == path.stem.lower()]
    if same:
        return same[0]
    color = [
        f for f in listing.images if not any(word in f.name.lower() for word in ("norm", "mask"))
    ]
    return color[0] if len(color) == 1 and listing.suffixes[path.suffix.lower()] == 1 else None


def answers(path: Path) -> dict[str, Any]:
    """What was asked about files beside the scan at `path`, with a hash of each that was read.

    Raises ScanError when one of them changed meanwhile.
    """
    return {
        "files": [_entry(path, file, then) for file, then in sorted(NOTES.found.items())],
        "missing": sorted(NOTES.missing),
        "lone_image": NOTES.lone.get(path),
        "lone_image_asked": path in NOTES.lone,
    }


def _entry(path: Path, file: Path, then: os.stat_result) -> dict[str, Any]:
    with file.open("rb") as stream:
        digest = hashlib.file_digest(stream, "sha256").hexdigest()
    now = file.stat()
    if (now.st_size, now.st_mtime_ns, now.st_ino) != (then.st_size, then.st_mtime_ns, then.st_ino):
        raise ScanError(
            f"{file.name} changed while the scan was prepared", str(file), "run it again"
        )
    name = file.relative_to(path.parent).as_posix()
    return {"file": name, "sha256": digest, "bytes": now.st_size}


def changed(path: Path, said: Mapping[str, Any]) -> str | None:
    """What has another answer than `said`, in a few words; None where all is as it was.

    The content of the files is not looked at: that is for whoever keeps their hashes.
    """
    listing = _remembered(path.parent)
    for name in said.get("missing", ()):
        if _is_there(path.parent, str(name), listing):
            return f"{name} is there now"
    if said.get("lone_image_asked"):
        found = _lone_image(path, listing)
        now = None if found is None else found.name
        if now != said.get("lone_image"):
            return f"the image beside it is {now or 'gone'} instead of {said.get('lone_image')}"
    return None


def _is_there(folder: Path, name: str, listing: _Listing) -> bool:
    text = name.strip().strip('"').replace("\\", "/")
    for spelling in dict.fromkeys((text, unquote(text))):
        pure = PurePosixPath(spelling)
        # Its last part alone too: `safe_path` takes a file of that name beside the scan.
        if pure.name.lower() in listing.names:
            return True
        if len(pure.parts) > 1 and not pure.is_absolute() and ".." not in pure.parts:
            with suppress(OSError, ValueError):  # a name too long, or with a NUL in it
                if (folder / spelling).is_file():
                    return True
    return False


def forget() -> None:
    """Folders are listed anew by the next `changed`."""
    _remembered.cache_clear()
