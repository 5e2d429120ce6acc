"""Files and folders that appear complete or not at all: written beside, then renamed.

A reader (or a killed run) never sees a half-written file, because `os.replace` within one folder is
atomic on every system we support. The temporary name keeps the suffix, since image and mesh
libraries choose their format by it.
"""

from __future__ import annotations

import errno
import json
import os
import shutil
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from scanrender.errors import OutputError

TEMPORARY_PREFIX = ".writing-"


def make_folder(folder: Path) -> Path:
    """Create `folder` and its parents. Raises OutputError when that is not possible."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise _cannot_write(folder, error) from error
    return folder


@contextmanager
def atomic_path(path: Path | str) -> Iterator[Path]:
    """Yield a temporary path beside `path`; on success it becomes `path`, on failure it is gone."""
    path = Path(path)
    make_folder(path.parent)
    temporary = path.with_name(f"{TEMPORARY_PREFIX}{uuid.uuid4().hex[:8]}-{path.name}")
    try:
        yield temporary
        os.replace(temporary, path)
    except OSError as error:
        raise _cannot_write(path, error) from error
    finally:
        temporary.unlink(missing_ok=True)


@contextmanager
def atomic_folder(folder: Path | str) -> Iterator[Path]:
    """Yield an empty folder beside `folder`; on success it replaces `folder`, else it is gone.

    An existing `folder` is moved aside first and removed after the rename, so that there is no
    moment at which a half-written folder carries the final name; it comes back when the rename
    fails. A file of that name is never replaced. Raises OutputError.
    """
    folder = Path(folder)
    make_folder(folder.parent)
    temporary = folder.with_name(f"{TEMPORARY_PREFIX}{uuid.uuid4().hex[:8]}-{folder.name}")
    retired = temporary.with_name(temporary.name + "-old")
    try:
        if folder.exists() and not folder.is_dir():
            raise FileExistsError(errno.EEXIST, "a file has that name")
        temporary.mkdir()
        yield temporary
        if folder.exists():
            os.replace(folder, retired)
        os.replace(temporary, folder)
    except OSError as error:
        raise _cannot_write(folder, error) from error
    finally:
        if retired.exists() and not folder.exists():
            os.replace(retired, folder)
        shutil.rmtree(temporary, ignore_errors=True)
        shutil.rmtree(retired, ignore_errors=True)


def write_text(path: Path | str, text: str) -> Path:
    with atomic_path(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
    return Path(path)


def write_json(path: Path | str, document: Any) -> Path:
    """Write `document` as indented JSON; NaN and Inf are refused, since JSON has no such words."""
    return write_text(path, json.dumps(document, indent=2, allow_nan=False) + "\n")


def _cannot_write(path: Path, error: OSError) -> OutputError:
    return OutputError(
        f"cannot write {path}: {error.strerror or error}",
        where=str(path),
        fix="choose another folder with --out, or free space and permissions there",
    )
