"""Files that a scan names: only those in the scan's own folder are ever opened.

An MTL or a glTF can name any path or URL; opening it would let a downloaded scan read the disk.
"""

from __future__ import annotations

import posixpath
import re
from pathlib import Path, PurePosixPath
from urllib.parse import unquote

from scanrender.errors import ScanError
from scanrender.scan.beside import NOTES

Listings = dict[Path, dict[str, Path]]  # of each folder its files by their names in lower case


def inside(
    folder: Path,
    reference: str,
    named_by: Path,
    below: str = "",
    listings: Listings | None = None,
) -> Path | None:
    """The file that `reference` names, inside `folder`; None when there is none of that name.

    below: the folder within `folder` of the file that says so, where it is looked for first.
    listings: kept by a caller that asks often, so that each folder is listed once.

    Raises ScanError for URLs, and for absolute paths, `..` and symbolic links that lead outside.
    Case and percent-encoding are forgiven, as exporters differ; so is the folder of the machine
    that wrote the scan, when a file of the same name lies beside it here.
    """
    text = reference.strip().strip('"').replace("\\", "/")
    near = posixpath.normpath(f"{below}/{text}") if below and text[:1] != "/" else text
    listings = {} if listings is None else listings
    found = _inside(folder, reference, named_by, text, near, listings)
    NOTES.note(reference, found)
    if found is None and near != text:
        NOTES.note(near, None)
    return found


def _inside(
    folder: Path, reference: str, named_by: Path, text: str, near: str, listings: Listings
) -> Path | None:
    drive = re.match(r"^[A-Za-z]:/", text)
    scheme = re.match(r"^[A-Za-z][A-Za-z0-9+.-]*:", text) and not drive
    pure = PurePosixPath(text)
    leaves = bool(scheme or drive or _leaves(near))
    whole = () if leaves else (near, unquote(near), text, unquote(text))
    # A colon is a letter of names, too.
    names = (near, text) if scheme else (*whole, pure.name, unquote(pure.name))
    for name in dict.fromkeys(names):
        found = None if _leaves(name) else _find(folder, name, listings)
        if found is None:
            continue
        if not found.resolve().is_relative_to(folder.resolve()):
            raise ScanError(
                f"{named_by.name} names {_short(reference)}, a link that leaves the scan's folder",
                str(named_by),
                "copy that file beside the scan",
            )
        return found
    if leaves or _leaves(unquote(near)):
        raise ScanError(
            f"{named_by.name} names {_short(reference)}, which is outside the scan's folder",
            str(named_by),
            "copy that file beside the scan and name it without a folder",
        )
    return None


def _leaves(name: str) -> bool:
    return name.startswith("/") or ".." in PurePosixPath(name).parts


def _short(reference: str) -> str:
    return repr(reference if len(reference) <= 120 else reference[:117] + "...")


def _find(folder: Path, name: str, listings: Listings) -> Path | None:
    """The file of that name below `folder`, in any case; no other folder is ever listed."""
    path, root = folder, folder.resolve()
    try:
        for part in PurePosixPath(name).parts:
            found = path / part
            if not found.exists():
                if not (path.is_dir() and path.resolve().is_relative_to(root)):
                    return None
                if path not in listings:
                    files = sorted(path.iterdir(), reverse=True)  # of two alike the first stays
                    listings[path] = {file.name.lower(): file for file in files}
                if part.lower() not in listings[path]:
                    return None
                found = listings[path][part.lower()]
            path = found
        return path if path.is_file() else None
    except (OSError, ValueError):  # a name too long, or with a NUL in it
        return None
