"""Everything scanrender raises on purpose, and the exit code each one ends with.

    ScanrenderError
    ├── UsageError        2   the command line is wrong (or names a path that is not there)
    ├── ConfigError       3   a YAML file or a --set is wrong
    ├── ScanError         4   this scan cannot be used
    ├── StageError        5   a stage failed, crashed, timed out, or made non-finite pixels
    │   └── CrashError    5   its process died: a batch tries once more
    ├── DeviceError       6   no usable GL
    ├── OutputError       7   the output cannot be written
    └── BatchError        8   several jobs, and some of them failed

1 is a bug in scanrender, 130 an interruption. An error is three short lines: what happened, where
(file, key, line), and what to do about it; the `where` and `fix` lines may be absent.
"""

from __future__ import annotations


class ScanrenderError(Exception):
    """Base of all deliberate errors: `what`, then optionally `where` and what to do (`fix`)."""

    exit_code = 1

    def __init__(self, what: str, where: str | None = None, fix: str | None = None) -> None:
        super().__init__(what, where, fix)
        self.what = what
        self.where = where
        self.fix = fix

    def __str__(self) -> str:
        lines = [self.what]
        if self.where:
            lines.append(f"  where: {self.where}")
        if self.fix:
            lines.append(f"  to do: {self.fix}")
        return "\n".join(lines)


class UsageError(ScanrenderError):
    exit_code = 2


class ConfigError(ScanrenderError):
    exit_code = 3


class ScanError(ScanrenderError):
    exit_code = 4


class StageError(ScanrenderError):
    exit_code = 5


class CrashError(StageError):
    """A process died, hung or lost its GPU: nothing is known to be wrong with the scan, and another
    try may succeed."""


class DeviceError(ScanrenderError):
    exit_code = 6


class OutputError(ScanrenderError):
    exit_code = 7


class BatchError(ScanrenderError):
    exit_code = 8
