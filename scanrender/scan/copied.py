"""A copy of this process as a child, with what `subprocess.Popen` offers of one.

It has all libraries loaded that this process has: a Python with NumPy and SciPy takes a second to
start. Only where nothing but the calling thread is at work, as in `parallel`.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import time
import traceback
from collections.abc import Callable, Mapping
from typing import IO

from scanrender.scan.parallel import fork

POLL_S = 0.002
_ALL_DESCRIPTORS = 1 << 16


class Copy:
    """Runs `main`, whose result is the exit code, with these environment variables changed."""

    def __init__(
        self, main: Callable[[], int], stderr: IO[bytes], environment: Mapping[str, str]
    ) -> None:
        theirs_in, ours_in = os.pipe()
        ours_out, theirs_out = os.pipe()
        self.returncode: int | None = None
        self.pid = fork()
        if not self.pid:
            _become(main, (theirs_in, theirs_out, stderr.fileno()), environment)
        os.close(theirs_in)
        os.close(theirs_out)
        self.stdin, self.stdout = os.fdopen(ours_in, "wb"), os.fdopen(ours_out, "rb")

    def poll(self) -> int | None:
        if self.returncode is None:
            pid, status = os.waitpid(self.pid, os.WNOHANG)
            if pid:
                self.returncode = os.waitstatus_to_exitcode(status)
        return self.returncode

    def wait(self, timeout: float | None = None) -> int:
        end = None if timeout is None else time.monotonic() + timeout
        while self.poll() is None:
            if end is not None and time.monotonic() > end:
                raise subprocess.TimeoutExpired("a copy of this process", timeout or 0.0)
            time.sleep(POLL_S)
        assert self.returncode is not None
        return self.returncode

    def kill(self) -> None:
        if self.poll() is None:
            os.kill(self.pid, signal.SIGKILL)


def _become(
    main: Callable[[], int], streams: tuple[int, int, int], environment: Mapping[str, str]
) -> None:
    """Never returns: what the caller would do next is not this copy's to do."""
    code = 1
    try:
        for number, descriptor in enumerate(streams):
            os.dup2(descriptor, number)
        # The ends of other children's pipes: they would not learn that their parent has closed its.
        os.closerange(3, _ALL_DESCRIPTORS)
        sys.stderr = os.fdopen(2, "w", closefd=False)  # whatever it was: a test's, say
        os.environ.update(environment)
        tempfile.tempdir = None  # that of the environment
        code = main()
    except BaseException:  # noqa: BLE001  the parent's stack must not be unwound here
        traceback.print_exc()
    finally:
        sys.stderr.flush()
        os._exit(code)
