"""Several jobs: each scan in its own folder, failures collected, one summary."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from scanrender.batch.identity import scan_ids
from scanrender.batch.job import Result, run_job
from scanrender.batch.turntable import Progress
from scanrender.errors import BatchError, ScanrenderError, UsageError
from scanrender.settings.pipeline import Pipeline


@dataclass
class Batch:
    """Results in the order of the scans, and (scan, error) of those that failed."""

    results: list[Result] = field(default_factory=list)
    failures: list[tuple[Path, ScanrenderError]] = field(default_factory=list)

    def raise_if_failed(self) -> None:
        """One job ends with its own error, several with BatchError (exit code 8)."""
        if not self.failures:
            return
        total = len(self.results) + len(self.failures)
        if total == 1:
            raise self.failures[0][1]
        failed = ", ".join(f"{path.name} ({error.what})" for path, error in self.failures)
        raise BatchError(
            f"{len(self.failures)} of {total} scans failed",
            where=failed,
            fix="the others are complete; mend or leave out these and run again",
        )


def run_batch(
    scans: Sequence[Path],
    pipeline: Pipeline,
    out: Path,
    progress: Progress,
    say: Callable[[str], None],
    frames: Sequence[int] | None = None,
) -> Batch:
    """Run every scan; a scan that fails is told and left behind.

    Raises UsageError when a scan is named twice; nothing else that a single scan can cause.
    """
    twice = [path for path, count in Counter(scan.resolve() for scan in scans).items() if count > 1]
    if twice:
        raise UsageError(f"the same scan is named twice: {twice[0]}")
    batch = Batch()
    for number, (scan, name) in enumerate(zip(scans, scan_ids(scans), strict=True)):
        folder = out if len(scans) == 1 else out / name
        if len(scans) > 1:
            say(f"scan {number + 1} of {len(scans)}: {scan.name}")
        try:
            batch.results.append(run_job(scan, pipeline, folder, progress, frames))
        except ScanrenderError as error:
            batch.failures.append((scan, error))
        except Exception as error:
            if len(scans) == 1:
                raise
            # A bug that one scan brings to light must not cost the others either.
            what = f"this is a bug in scanrender: {type(error).__name__}: {error}"
            batch.failures.append((scan, ScanrenderError(what, str(scan), "run it alone, --debug")))
        else:
            continue
        if len(scans) > 1:
            say(str(batch.failures[-1][1]))
    return batch
