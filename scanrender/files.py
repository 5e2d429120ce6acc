"""Files and folders that appear complete or not at all: written beside, then renamed.

A reader (or a killed run) never sees a half-written file, because `os.replace` within one folder is
atomic on every system we support. The temporary name keeps the suffix, since image and mesh
libraries choose their format by it. It also names the process that writes it, so that what a killed
one left behind is recognised and removed by the next (`clean_stale`).
"""

from __future__ import annotations

import errno
import hashlib
import json
import os
import platform
import re
import shutil
import tempfile
import uuid
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import Any

from scanrender.errors import OutputError

TEMPORARY_PREFIX = ".writing-"
SCRATCH_PREFIX = "scanrender-"
# PREFIX machine - process - random [old] - final name; `old` is a folder that was moved aside.
_OWNED = re.compile(r"(?:\.writing-|scanrender-)([0-9a-f]{8})-(\d+)-\w+?(old)?-(.*)$")


def make_folder(folder: Path) -> Path:
    """Create `folder` and its parents. Raises OutputError when that is not possible."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise _cannot_write(folder, error) from error
    return folder


def check_writable(folder: Path) -> None:
    """Say that nothing can be written there before the work, not after it. Raises OutputError."""
    make_folder(folder)
    probe = folder / ".writing-probe"
    try:
        probe.write_bytes(b"")
        probe.unlink(missing_ok=True)  # another job may have looked at the same moment
    except OSError as error:
        raise OutputError(
            f"cannot write into {folder}: {error.strerror}", str(folder), "choose another --out"
        ) from error


@contextmanager
def atomic_path(path: Path | str) -> Iterator[Path]:
    """Yield a temporary path beside `path`; on success it becomes `path`, on failure it is gone."""
    path = Path(path)
    make_folder(path.parent)
    temporary = path.with_name(f"{_owned(TEMPORARY_PREFIX)}-{path.name}")
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
    clean_stale(folder.parent)
    owned = _owned(TEMPORARY_PREFIX)
    temporary = folder.with_name(f"{owned}-{folder.name}")
    retired = folder.with_name(f"{owned}old-{folder.name}")
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


@contextmanager
def scratch_folder() -> Iterator[Path]:
    """Yield an empty folder for large intermediate files in the system's temporary folder."""
    clean_stale(Path(tempfile.gettempdir()), SCRATCH_PREFIX)
    folder = Path(tempfile.mkdtemp(prefix=f"{_owned(SCRATCH_PREFIX)}-"))
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def clean_stale(
    folder: Path, prefix: str = TEMPORARY_PREFIX, lost: str | None = None, named: str | None = None
) -> None:
    """Remove from `folder` what killed processes of this machine left half-written, and what is of
    the machine `lost`, none of whose processes writes there any more (or none the file `named`).

    A process that died between its two renames left the earlier folder aside: it comes back.
    """
    with suppress(OSError):
        for path in folder.iterdir():
            owner = _stale_owner(path, prefix, lost)
            if owner is None or (named is not None and owner[4] != named):
                continue
            with suppress(OSError):
                if path.is_symlink():
                    continue
                if owner[3] and not (folder / owner[4]).exists():
                    os.replace(path, folder / owner[4])
                elif path.is_dir():
                    shutil.rmtree(path, ignore_errors=True)
                else:
                    path.unlink()


def is_stale(path: Path, prefix: str = TEMPORARY_PREFIX) -> bool:
    """Whether a killed process of this machine left the path half-written."""
    return _stale_owner(path, prefix) is not None


def _stale_owner(path: Path, prefix: str, lost: str | None = None) -> re.Match[str] | None:
    owner = _OWNED.match(path.name) if path.name.startswith(prefix) else None
    if owner is None:
        return None
    gone = owner[1] == machine() and not _is_alive(int(owner[2]))
    return owner if gone or (owner[1] == lost != machine()) else None


def temporary_name(name: str) -> str:
    """Of a file that is no result, and that `clean_stale` removes once this process is gone."""
    return f"{_owned(TEMPORARY_PREFIX)}-{name}"


def _owned(prefix: str) -> str:
    return f"{prefix}{machine()}-{os.getpid()}-{uuid.uuid4().hex[:8]}"


@cache
def machine() -> str:
    """Where process numbers mean the same: output folders are shared by hosts and containers."""
    space = ""
    with suppress(OSError):
        space = os.readlink("/proc/self/ns/pid")
    return hashlib.sha256(f"{platform.node()} {space}".encode()).hexdigest()[:8]


def _is_alive(process: int) -> bool:
    if os.name != "posix":
        return True  # signal 0 is not a question on Windows: nothing is removed there
    try:
        os.kill(process, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except OSError:
        return True
    return not _is_zombie(process)


def _is_zombie(process: int) -> bool:
    """Killed, but nobody has asked yet how it ended: it still takes signals, and writes nothing."""
    try:
        stat = Path(f"/proc/{process}/stat").read_text(encoding="utf-8", errors="replace")
    except OSError:
        return False
    return stat.rpartition(")")[2].split()[:1] == ["Z"]


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
