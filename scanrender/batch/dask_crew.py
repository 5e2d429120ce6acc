"""The workers of a Dask cluster that a run may use: who they are, what they see, who is free.

Before anything starts each is asked whether it has this machine's code and libraries, by which
results are keyed, and sees its files; a cluster with one that does not is refused. One that joins
later is left out, and that is said.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from scanrender.batch import dask_worker
from scanrender.batch.dask_link import ASK_S, Link, Seat
from scanrender.batch.seen import differences
from scanrender.batch.tasks import Say, Task
from scanrender.errors import ScanrenderError, UsageError

LOOK_EVERY_S = 1.0
JOIN_S = 15.0  # for the answers of one that joins: the others wait meanwhile
FIRST_S = 60.0  # for the first worker to appear
SAME_CODE = "install the same scanrender and libraries there (constraints.txt), and start it again"
SAME_FILES = (
    "let it see the same files by the same path (docs/batch.md, On several machines), or stop it"
)


@dataclass
class Mate:
    """A worker that may be used. `machine` is its host as temporary files name it."""

    seat: Seat
    host: str
    machine: str
    free_mib: int | None
    tasks: list[Task] = field(default_factory=list)

    @property
    def address(self) -> str:
        return self.seat.address

    def __str__(self) -> str:
        return f"{self.address} on {self.host}"


class Crew:
    """`made_by` and `question` (`seen`) are what every worker has to agree with."""

    def __init__(
        self, link: Link, made_by: Mapping[str, str], question: dict[str, Any], say: Say
    ) -> None:
        self.link, self.made_by, self.question, self.say = link, made_by, question, say
        self.mates: dict[str, Mate] = {}
        self.has_gpus = False
        self._refused: set[str] = set()
        self._next_look = 0.0

    def gather(self) -> None:
        """Wait for the first workers. Raises UsageError for one that will not do, or none."""
        self._ask_scheduler()
        end, said = time.monotonic() + FIRST_S, False
        while True:
            refused = self._take_on(self.link.seats(), ASK_S)
            if refused:
                more = f", and {len(refused) - 1} more will not do" if len(refused) > 1 else ""
                first = refused[0]
                raise UsageError(f"{first.what}{more}", first.where, first.fix)
            if self.mates:
                return
            if time.monotonic() > end:
                raise UsageError(
                    f"the scheduler {self.link.address} has no workers",
                    fix=f"start some: dask worker {self.link.address} --nthreads 1 --nworkers 2",
                )
            if not said:
                self.say(f"the scheduler {self.link.address} has no workers yet; waiting for one")
                said = True
            time.sleep(0.2)

    def look(self) -> list[Mate]:
        """Take on who came; returns who is gone. Raises LinkLostError."""
        now = time.monotonic()
        if now < self._next_look:
            return []
        self._next_look = now + LOOK_EVERY_S
        seats = self.link.seats()
        gone = [
            mate
            for address, mate in self.mates.items()
            if address not in seats or seats[address].id != mate.seat.id
        ]
        for mate in gone:
            del self.mates[mate.address]
        new = {
            address: seat
            for address, seat in seats.items()
            if address not in self.mates and seat.id not in self._refused
        }
        for error in self._take_on(new, JOIN_S):
            self.say(f"{error.what}; it gets no work")
        for address, mate in self.mates.items():
            mate.seat = seats.get(address, mate.seat)
        return gone

    def free_for(self, task: Task) -> list[Mate]:
        """Those that could begin the task, the best first: what needs no GPU leaves them free."""
        needs_gpu = self.wants_gpu(task)
        free = [mate for mate in self.mates.values() if mate.seat.works and _has_room(mate)]
        if needs_gpu:
            return [mate for mate in free if _rendering(mate) < mate.seat.gpus]
        return sorted(free, key=lambda mate: (mate.seat.gpus > 0, len(mate.tasks)))

    def fits(self, task: Task, mate: Mate) -> bool:
        """Whether the memory of its machine holds the task beside the others there."""
        there = [other for other in self.mates.values() if other.machine == mate.machine]
        used = sum(each.mib for other in there for each in other.tasks)
        free = [other.free_mib for other in there if other.free_mib is not None]
        return not used or not free or used + task.mib <= min(free)

    def wants_gpu(self, task: Task) -> bool:
        return self.has_gpus and task.needs_gl

    def take(self, task: Task, mate: Mate) -> None:
        mate.tasks.append(task)

    def leave(self, task: Task, mate: Mate) -> None:
        mate.tasks.remove(task)

    def sharers(self, mate: Mate) -> int:
        """Tasks that its machine may have at once: they share its cores."""
        there = [other for other in self.mates.values() if other.machine == mate.machine]
        return max(1, sum(other.seat.slots for other in there))

    def _take_on(self, seats: Mapping[str, Seat], within_s: float) -> list[ScanrenderError]:
        """Those that do become mates; what is wrong with the others. One that goes while it is
        asked is neither."""
        refused = []
        about = self.link.ask(dask_worker.about, workers=sorted(seats), within_s=within_s)
        alike = [address for address, said in about.items() if not self._other(address, said)]
        seen = self.link.ask(dask_worker.sees, self.question, workers=alike, within_s=within_s)
        for address, said in about.items():
            answer = seen.get(address)
            if _is_gone(said) or _is_gone(answer):
                continue
            error = self._other(address, said) or _blind(address, said["host"], answer)
            if error is not None:
                self._refused.add(seats[address].id)
                refused.append(error)
                continue
            seat = seats[address]
            self.mates[address] = Mate(seat, said["host"], said["machine"], said["free_mib"])
            self.has_gpus |= seat.gpus > 0
        return refused

    def _other(self, address: str, said: Any) -> ScanrenderError | None:
        """What makes its results other ones than this machine's."""
        if isinstance(said, OSError):
            return UsageError(f"the Dask worker {address} gives {said}", address, SAME_FILES)
        if not isinstance(said, dict):
            what = f"the Dask worker {address} cannot run this scanrender ({_short(said)})"
            return UsageError(what, address, SAME_CODE)
        if other := differences(self.made_by, said["made_by"]):
            what = f"the Dask worker {address} on {said['host']} is another installation: {other}"
            return UsageError(what, address, SAME_CODE)
        return None

    def _ask_scheduler(self) -> None:
        """Dask's scheduler unpacks tasks, so scanrender has to be there too."""
        try:
            self.link.ask_scheduler(dask_worker.about)
        except Exception as error:
            what = f"the Dask scheduler {self.link.address} cannot import scanrender"
            where = _short(error)
            raise UsageError(
                what, where, "start it where the same scanrender is installed"
            ) from error


def _is_gone(answer: Any) -> bool:
    """The connection broke: it ended, or will be asked again."""
    return isinstance(answer, OSError) and not isinstance(answer, TimeoutError)


def _blind(address: str, host: str, answer: Any) -> ScanrenderError | None:
    """What a worker does not see, by its answer to `sees`."""
    if answer is None:
        return None
    if isinstance(answer, BaseException):
        what = f"the Dask worker {address} on {host} cannot look at the files ({_short(answer)})"
        return UsageError(what, host, SAME_FILES)
    path, wrong = answer
    what = f"the Dask worker {address} on {host} does not see {path}: it {wrong}"
    return UsageError(what, f"{path}, on {host}", SAME_FILES)


def _has_room(mate: Mate) -> bool:
    return len(mate.tasks) < mate.seat.slots


def _rendering(mate: Mate) -> int:
    return sum(task.needs_gl for task in mate.tasks)


def _short(error: Any) -> str:
    return f"{type(error).__name__}: {error}".split("\n")[0][:300]
