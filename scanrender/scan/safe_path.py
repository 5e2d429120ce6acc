"""Files that a scan names: only those in the scan's own folder are ever opened.

An MTL or a glTF can name any path or URL; opening it would let a downloaded scan read the disk.
"""

from __future__ import annotations

import re
from pathlib import Path, PurePosixPath
from urllib.parse import unquote

from scanrender.errors import ScanError


def inside(folder: Path, reference: str, named_by: Path) -> Path:
    """The file that `reference` names, inside `folder`.

    Raises ScanError for URLs, absolute paths, `..`, and symbolic links that lead outside. The file
    may be missing: the caller decides. Case and percent-encoding are forgiven, as exporters differ.
    """
    text = reference.strip().replace("\\", "/")
    pure = PurePosixPath(text)
    scheme = re.match(r"^[A-Za-z][A-Za-z0-9+.-]*:", text)
    if scheme or pure.is_absolute() or ".." in pure.parts:
        raise ScanError(
            f"{named_by.name} names {reference!r}, which is outside the scan's folder",
            str(named_by),
            "copy that file beside the scan and name it without a folder",
        )
    for name in dict.fromkeys((text, unquote(text))):
        found = _find(folder, name)
        if found is None:
            continue
        if not found.resolve().is_relative_to(folder.resolve()):
            raise ScanError(
                f"{named_by.name} names {reference!r}, a link that leaves the scan's folder",
                str(named_by),
                "copy that file beside the scan",
            )
        return found
    return folder / unquote(text)


def _find(folder: Path, name: str) -> Path | None:
    path = folder / name
    try:
        if path.is_file():
            return path
        if path.parent.is_dir():
            wanted = path.name.lower()
            for other in sorted(path.parent.iterdir()):
                if other.name.lower() == wanted and other.is_file():
                    return other
    except (OSError, ValueError):  # a name too long, or with a NUL in it
        return None
    return None
