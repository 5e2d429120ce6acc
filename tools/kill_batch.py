"""Kills a batch again and again, runs it to its end, and compares: nobody may be able to tell.

    python tools/kill_batch.py PIPELINE SCAN... --kills 20 --out FOLDER
    python tools/kill_batch.py --kills 20 --out FOLDER -- PIPELINE SCAN... --scheduler local

One run is left alone. Then, for each kill, a fresh run is started, and at a random moment its
parent or one of its workers gets SIGKILL; run again, it must end with the same frames, videos, EXRs
and maps, with no process, lock or temporary file left behind. Prints a line a kill; exits with 1
when one of them left a trace.
"""

from __future__ import annotations

import argparse
import hashlib
import os
import random
import signal
import subprocess
import sys
import time
import uuid
from pathlib import Path
from typing import Any

MARK = "SCANRENDER_KILL_TEST"
# What tells times, and so differs from run to run.
TELLING = {"record.json", "log.txt", "manifest.json", "batch.json", "asset.json",
           "prep_report.json", "prep_sheet.png", "report.html"}  # fmt: skip
REPORT = ".report"  # what report.html shows; its names say when the files were written


def digest(path: Path) -> str:
    """Not the bytes: whoever compares two folders wants to be told which files differ."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


def contents(folder: Path) -> dict[str, str]:
    files = [path for path in folder.rglob("*") if path.is_file() and path.name not in TELLING]
    files = [path for path in files if path.parent.name != REPORT]
    return {path.relative_to(folder).as_posix(): digest(path) for path in sorted(files)}


def marked(mark: str, program: str = "") -> list[int]:
    """Living processes that inherited the mark, whose command line holds `program`."""
    found = []
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit() and int(entry.name) != os.getpid():
            try:
                environment = (entry / "environ").read_bytes()
                command = (entry / "cmdline").read_bytes().decode("utf-8", "replace")
                state = (entry / "stat").read_text().rsplit(")", 1)[1].split()[0]
            except OSError:
                continue
            if f"{MARK}={mark}".encode() in environment and state != "Z" and program in command:
                found.append(int(entry.name))
    return found


class Batch:
    """`scanrender run` of the same scans into one folder, with temporary files in another."""

    def __init__(self, arguments: list[str], out: Path) -> None:
        self.arguments, self.out = arguments, out
        self.mark = uuid.uuid4().hex
        self.temporary = out.with_name(f"{out.name}.tmp")
        self.temporary.mkdir(parents=True, exist_ok=True)

    def start(self, **how: Any) -> subprocess.Popen[bytes]:
        command = [sys.executable, "-m", "scanrender", "run", *self.arguments, "--out", self.out]
        environment = {**os.environ, MARK: self.mark, "TMPDIR": str(self.temporary)}
        log = self.out.with_name(f"{self.out.name}.log").open("ab")
        with log:
            return subprocess.Popen(
                [str(word) for word in command], env=environment, stdout=log, stderr=log, **how
            )

    def run(self) -> float:
        """To its end; returns seconds. Raises AssertionError when it fails."""
        started = time.monotonic()
        code = self.start().wait()
        assert code == 0, f"exit code {code}, see {self.out}.log"
        return time.monotonic() - started

    def traces(self) -> list[str]:
        """What must not be there once a run has ended."""
        end = time.monotonic() + 20.0  # killed processes need a moment
        while marked(self.mark) and time.monotonic() < end:
            time.sleep(0.05)
        found = [f"process {process}" for process in marked(self.mark)]
        hidden = [path for path in self.out.rglob(".*") if path.name != REPORT]
        return found + [str(path) for path in [*hidden, *self.temporary.iterdir()]]


def kill_once(batch: Batch, after_s: float, victim: str, chance: random.Random) -> str:
    """Start, wait, kill; returns what happened. A worker's death is the batch's to mend."""
    parent = batch.start()
    time.sleep(after_s)
    if victim == "worker":
        while parent.poll() is None:
            workers = marked(batch.mark, "scanrender.batch.worker")
            if workers:
                os.kill(chance.choice(workers), signal.SIGKILL)
                code = parent.wait()
                assert code == 0, f"a worker's death ended the batch with exit code {code}"
                return "worker killed"
            time.sleep(0.01)
        return "it had ended"
    if parent.poll() is not None:
        return "it had ended"
    parent.kill()
    parent.wait()
    end = time.monotonic() + 20.0
    while marked(batch.mark) and time.monotonic() < end:
        time.sleep(0.02)
    assert not marked(batch.mark), f"orphans: {marked(batch.mark)}"
    return "parent killed"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0] if __doc__ else "")
    parser.add_argument("arguments", nargs="+", help="PIPELINE SCAN..., as for scanrender run")
    parser.add_argument("--kills", type=int, default=20)
    parser.add_argument("--jobs", default="2")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, required=True)
    options = parser.parse_args()
    arguments = [*options.arguments, "--jobs", options.jobs]
    alone = Batch(arguments, options.out / "alone")
    duration = alone.run()
    expected, traces = contents(alone.out), alone.traces()
    print(f"left alone: {duration:.1f} s, {len(expected)} files, traces: {traces or 'none'}")
    chance, bad = random.Random(options.seed), len(traces)
    for number in range(options.kills):
        victim = chance.choice(["parent", "worker"])
        after_s = chance.uniform(0.0, duration)
        batch = Batch(arguments, options.out / f"kill_{number:02}")
        said = kill_once(batch, after_s, victim, chance)
        batch.run()
        found = contents(batch.out)
        differ = sorted(n for n in {*found, *expected} if found.get(n) != expected.get(n))
        traces = batch.traces()
        bad += bool(differ) + bool(traces)
        print(f"{number:3} {after_s:5.1f} s {said}: differ: {differ[:5] or 'none'}, "
              f"traces: {traces or 'none'}", flush=True)  # fmt: skip
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
