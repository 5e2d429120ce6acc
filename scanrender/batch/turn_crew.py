"""Processes that render frames of a turn beside this one, where the software rasteriser would leave
cores idle: it has no threads (decision 34).

This process plans, records, and renders too. A process of the crew that fails costs nothing but
time: its frames are rendered by the others.
"""

from __future__ import annotations

import math
import os
import selectors
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from scanrender.batch.memory import free_mib, peak_mib
from scanrender.batch.process import STOP_S, WorkerProcess
from scanrender.files import clean_stale
from scanrender.render.device import RASTER_THREADS, Device
from scanrender.scan.parallel import all_cores, cores

START_S = 5.0  # what a process takes until it has libraries, asset and shaders
PATIENCE_S, PATIENCE_FRAMES = 120.0, 20.0  # without a sign of life, plus so many frames' time
ASIDE = 2  # frames given to a process at a time: it need not wait for this one
_SPARE = 1.3  # a process may take a little more memory than this one has
_MODULE = "scanrender.batch.turn_worker"


def worth(device: Device, frame_s: float, frames: int) -> int:
    """How many processes to start for `frames` more of which each takes `frame_s` here: no more
    than cores are idle, than frames pay for, and than half of the free memory holds."""
    threads = os.environ.get(RASTER_THREADS, "")
    idle = cores() // max(1, int(threads) if threads.isdigit() else 1) - 1
    if not device.is_software or idle < 1:
        return 0
    # The n-th brings the time from T / n to T / (n + 1): that has to be START_S at least.
    paid = math.floor(math.sqrt(frames * frame_s / START_S + 0.25) - 0.5)
    return max(0, int(min(idle, paid, frames - 1, _held())))


def _held() -> float:
    """As many processes like this one as half of the free memory holds, shared with the workers of
    a batch that have the other cores."""
    free, need = free_mib(), peak_mib()
    if free is None or need is None:
        return math.inf
    return 0.5 * free * cores() / all_cores() / (_SPARE * max(need, 1))


@dataclass
class _Mate:
    process: WorkerProcess
    frames: list[int] = field(default_factory=list)  # given and not done


class TurnCrew:
    """`file` says where a frame goes and with which compression; `say` gets sentences for the log.

    A context manager: on the way out no process is left, and nothing half-written.
    """

    def __init__(self, file: Callable[[int], tuple[Path, int]], say: Callable[[str], None]) -> None:
        self._file, self._say = file, say
        self._mates: list[_Mate] = []
        self._selector = selectors.DefaultSelector()
        self._patience_s = PATIENCE_S
        self.size = 0

    def __enter__(self) -> TurnCrew:
        return self

    def __exit__(self, *_: object) -> None:
        for mate in self._mates:
            if mate.frames:
                mate.process.ask_to_stop()
            else:
                mate.process.let_go()
        for mate in list(self._mates):
            self._forget(mate, STOP_S)
        self._selector.close()

    def start(self, count: int, frame_s: float, asset: Path, pipeline: dict[str, Any]) -> None:
        """`count` processes that render `asset` with the settings `pipeline`."""
        self.size, self._patience_s = count, PATIENCE_S + PATIENCE_FRAMES * frame_s
        self._say(f"{count + 1} processes share the frames that are left")
        for _ in range(count):
            mate = _Mate(WorkerProcess(cores(), _MODULE))
            mate.process.send({"asset": str(asset.resolve()), "pipeline": pipeline})
            self._selector.register(mate.process.output, selectors.EVENT_READ, mate)
            self._mates.append(mate)

    def give(self, waiting: list[int]) -> None:
        """Frames from the front of `waiting`: one for this process stays, one goes to each that has
        none, and a further one to each as long as all the others find one too."""
        for depth in range(ASIDE):
            kept = 1 + depth * len(self._mates)
            for mate in self._mates:
                if len(mate.frames) == depth and len(waiting) > kept:
                    index = waiting.pop(0)
                    path, level = self._file(index)
                    task = {"frame": index, "file": str(path.resolve()), "compression": level}
                    mate.process.send(task)
                    mate.frames.append(index)

    def done(self, wait: bool) -> tuple[dict[int, float], list[int]]:
        """Frames that were rendered since, with milliseconds, and frames that will not be: of a
        process that failed, or with `wait` gives no sign of life."""
        made: dict[int, float] = {}
        lost: list[int] = []
        busy = [mate for mate in self._mates if mate.frames]
        if not busy:
            return made, lost
        ready = self._selector.select(self._patience_s if wait else 0)
        for key, _ in ready:
            mate: _Mate = key.data
            events = mate.process.events()
            for event in events or ():
                if "frame" in event:
                    mate.frames.remove(event["frame"])
                    made[event["frame"]] = event["ms"]
            said = [str(event["error"]) for event in events or () if "error" in event]
            if events is None or said:
                lost += self._fail(mate, said[0] if said else "it ended")
        if wait and not ready:
            for mate in busy:
                lost += self._fail(mate, f"no sign of life for {self._patience_s:.0f} s")
        return made, lost

    def _fail(self, mate: _Mate, why: str) -> list[int]:
        """The frames that it leaves behind."""
        left = list(mate.frames)
        self._say(f"a process that shared the frames failed: {why}; the others render its frames")
        self._forget(mate)
        for index in left:
            clean_stale(self._file(index)[0].parent)
        return left

    def _forget(self, mate: _Mate, within_s: float = 0.0) -> None:
        self._mates.remove(mate)
        self._selector.unregister(mate.process.output)
        mate.process.end(within_s)
