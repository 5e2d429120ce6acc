"""Two runs in one folder: the second is told so. A lock ends with its process in any case."""

from __future__ import annotations

import contextlib
import os
import platform
import time
from collections.abc import Iterator
from pathlib import Path

from scanrender.errors import OutputError

LOCK_NAME = ".scanrender.lock"
LOOK_EVERY_S = 0.2
_held: set[Path] = set()


@contextlib.contextmanager
def locked(folder: Path, wait_s: float = 0.0) -> Iterator[None]:
    """Hold the folder for this process. Raises OutputError when another one holds it, for longer
    than `wait_s` from now: a file server keeps a lock for a while after its machine was lost.

    Where the system has no such locks (Windows, some network file systems) nothing is held.
    """
    path = folder.resolve() / LOCK_NAME
    if path in _held:
        yield
        return
    descriptor = _acquired(path, time.monotonic() + wait_s)
    if descriptor is None:
        yield
        return
    _held.add(path)
    try:
        os.ftruncate(descriptor, 0)
        os.write(descriptor, f"process {os.getpid()} on {platform.node()}".encode())
        yield
    finally:
        _held.discard(path)
        path.unlink(missing_ok=True)  # while it is held: nobody can hold the next one of that name
        os.close(descriptor)


def _acquired(path: Path, until: float) -> int | None:
    try:
        import fcntl
    except ImportError:
        return None
    while True:
        try:
            descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666)
        except OSError as error:
            what = f"cannot write into {path.parent}: {error.strerror}"
            raise OutputError(what, str(path.parent), "choose another --out") from error
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            said = os.pread(descriptor, 200, 0).decode("utf-8", "replace") or "another run"
            os.close(descriptor)
            if time.monotonic() < until:
                time.sleep(LOOK_EVERY_S)
                continue
            raise OutputError(
                f"another run works in {path.parent} ({said})",
                str(path),
                "wait until it has ended, or choose another --out",
            ) from None
        except OSError:
            os.close(descriptor)
            return None
        # The one who held it may have removed it between our two calls: then this is no lock.
        with contextlib.suppress(OSError):
            if os.fstat(descriptor).st_ino == path.stat().st_ino:
                return descriptor
        os.close(descriptor)


def drop_unheld(folder: Path) -> None:
    """Remove the lock's file that a killed process left: it locks nothing, and looks as if."""
    if (folder / LOCK_NAME).exists():
        with contextlib.suppress(OutputError), locked(folder):
            pass  # leaving removes it
