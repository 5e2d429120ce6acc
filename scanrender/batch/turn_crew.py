"""Processes that render frames of a turn beside this one, where the software rasteriser would leave
cores idle: it has no threads (decision 34).

This process plans, records, and renders too. A process of the crew that fails costs nothing but
time: its frames are rendered by the others.
"""

from __future__ import annotations

import math
import os
import selectors
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from scanrender.batch.memory import free_mib, peak_mib
from scanrender.batch.process import WorkerProcess
from scanrender.files import clean_stale
from scanrender.render.device import RASTER_THREADS, Device
from scanrender.render.frame import Renderer
from scanrender.scan.parallel import all_cores, cores

START_S = 5.0  # what a process takes until it has libraries, asset and shaders
PATIENCE_S, PATIENCE_FRAMES = 120.0, 20.0  # without a sign of life, plus so many frames' time
TICK_S = 1.0  # at most between two signs of life of this process, which may be waited for, too
ASIDE = 2  # frames given to a process at a time: it need not wait for this one
END_S = 2.0  # for all processes to remove what is half-written; a pool gives a worker 5
_SPARE = 1.3  # a process may take a little more memory than this one has
_MODULE = "scanrender.batch.turn_worker"


def worth(device: Device, frame_s: float, frames: int) -> int:
    """How many processes to start for `frames` more of which each takes `frame_s` here: no more
    than cores are idle, than frames pay for, and than half of the free memory holds."""
    threads = os.environ.get(RASTER_THREADS) or "0"
    idle = cores() // max(1, int(threads) if threads.isdigit() else cores()) - 1
    # Elsewhere processes would outlive this one, and pipes cannot be waited for.
    if not device.is_software or idle < 1 or sys.platform != "linux":
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
    alive: float  # when it gave a sign of life, or had nothing to do
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
        self.was_started, self.size = False, 0

    def __enter__(self) -> TurnCrew:
        return self

    def __exit__(self, *_: object) -> None:
        given = [index for mate in self._mates for index in mate.frames]
        for mate in self._mates:
            if mate.frames:
                mate.process.ask_to_stop()
            else:
                mate.process.let_go()
        end = time.monotonic() + END_S
        for mate in list(self._mates):
            self._forget(mate, max(0.0, end - time.monotonic()))
        self._clean(given)
        self._selector.close()

    def start(self, count: int, frame_s: float, asset: Path, renderer: Renderer) -> None:
        """`count` processes that render `asset` as `renderer` does; fewer where the system has no
        more, which `size` tells."""
        self.was_started, self._patience_s = True, PATIENCE_S + PATIENCE_FRAMES * frame_s
        turn = {
            "asset": str(asset.resolve()),
            "pipeline": renderer.asked.model_dump(mode="json"),
            "driver": renderer.device.driver,
        }
        for _ in range(count):
            try:
                mate = _Mate(WorkerProcess(cores(), _MODULE), time.monotonic())
            except OSError as error:
                self._say(f"no process to share the frames could be started: {error}")
                break
            mate.process.send(turn)
            self._selector.register(mate.process.output, selectors.EVENT_READ, mate)
            self._mates.append(mate)
        self.size = len(self._mates)
        self._say(f"{self.size + 1} processes share the frames that are left")

    def give(self, waiting: list[int]) -> None:
        """Frames from the front of `waiting`: one for this process stays, one goes to each that has
        none, and a further one to each as long as all the others find one too. Of seven frames two
        processes get 0 and 1, then 2 and 3, and this one has 4."""
        for depth in range(ASIDE):
            kept = 1 + depth * len(self._mates)
            for mate in self._mates:
                if len(mate.frames) == depth and len(waiting) > kept:
                    index = waiting.pop(0)
                    path, level = self._file(index)
                    task = {"frame": index, "file": str(path.resolve()), "compression": level}
                    mate.process.send(task)
                    if not mate.frames:
                        mate.alive = time.monotonic()
                    mate.frames.append(index)

    @property
    def is_busy(self) -> bool:
        return any(mate.frames for mate in self._mates)

    def done(self, wait: bool) -> tuple[dict[int, float], list[int]]:
        """Frames that were rendered since, with milliseconds, and frames that will not be, of a
        process that failed or gives no sign of life. With `wait` a moment is waited for some, if
        there are any to come."""
        made: dict[int, float] = {}
        lost: list[int] = []
        if not self.is_busy:
            return made, lost
        for key, _ in self._selector.select(TICK_S if wait else 0):
            mate: _Mate = key.data
            try:
                events = mate.process.events()
            except ValueError:  # what is printed before anything of ours runs
                events = [{"error": "it said what is no answer"}]
            for event in events or ():
                mate.alive = time.monotonic()
                if "frame" in event:
                    mate.frames.remove(event["frame"])
                    made[event["frame"]] = event["ms"]
            said = [str(event["error"]) for event in events or () if "error" in event]
            if events is None:
                error = mate.process.death("render", self._file(0)[0].parent)
                said = [f"{error.what} {error.where}"]
            if said:
                lost += self._fail(mate, said[0])
        for mate in list(self._mates):
            if mate.frames and time.monotonic() - mate.alive > self._patience_s:
                lost += self._fail(mate, f"no sign of life for {self._patience_s:.0f} s")
        return made, lost

    def _fail(self, mate: _Mate, why: str) -> list[int]:
        """The frames that it leaves behind."""
        left = list(mate.frames)
        self._say(f"a process that shared the frames failed ({why}); the others render its frames")
        self._forget(mate)
        self._clean(left)
        return left

    def _clean(self, frames: list[int]) -> None:
        """Remove what a process that is gone had half-written of these."""
        for folder in {self._file(index)[0].parent for index in frames}:
            clean_stale(folder)

    def _forget(self, mate: _Mate, within_s: float = 0.0) -> None:
        self._mates.remove(mate)
        self._selector.unregister(mate.process.output)
        mate.process.end(within_s)
