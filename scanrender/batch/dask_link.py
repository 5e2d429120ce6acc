"""The connection to a Dask cluster. Only here is `distributed` imported by the command, and only by
a run that asks for a scheduler.
"""

from __future__ import annotations

import contextlib
import logging
import signal
import socket
import threading
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from multiprocessing import resource_tracker
from typing import Any
from urllib.parse import urlsplit

from scanrender.errors import UsageError
from scanrender.files import scratch_folder

LOCAL = "local"
GPU = "GPU"  # the resource that workers offer which are to render, if any does
CONNECT_S = 10.0
ASK_S = 60.0  # scans of a slow file server are looked at meanwhile
_ADDRESS = "tcp://HOST:8786, as `dask scheduler` prints it, or `local`"


class LinkLostError(Exception):
    """The scheduler does not answer any more, or has nobody to work; says how, after its name."""


@dataclass(frozen=True)
class Seat:
    """A Dask worker. `id` tells two apart that had the same address one after the other; `slots`
    are its threads, `gpus` how many GPUs it offers."""

    address: str
    id: str
    host: str
    slots: int
    gpus: int
    works: bool


class Link:
    """A client's few verbs. All raise LinkLostError once the scheduler is gone."""

    def __init__(self, client: Any) -> None:
        self.client = client
        self.address = str(client.scheduler.address)

    def seats(self) -> dict[str, Seat]:
        """The workers there are, by address."""
        found = self._bounded(self.client.scheduler_info, CONNECT_S)
        if "workers" not in found:
            raise LinkLostError("has closed the connection")
        return {
            address: Seat(
                address,
                str(said.get("id")),
                str(said.get("host")),
                max(1, int(said.get("nthreads", 1))),
                int(said.get("resources", {}).get(GPU, 0)),
                said.get("status", "running") == "running",
            )
            for address, said in found["workers"].items()
        }

    def ask(
        self,
        function: Callable[..., Any],
        *arguments: Any,
        workers: Sequence[str],
        within_s: float = ASK_S,
    ) -> dict[str, Any]:
        """Each worker's answer by its address, or the exception that it ended with: TimeoutError
        for one that hangs, which keeps no other from answering."""
        self.wait_until_up()
        answers: dict[str, Any] = {}

        def ask(address: str) -> None:
            try:
                answers.update(
                    self.client.run(function, *arguments, workers=[address], on_error="return")
                )
            except BaseException as error:  # noqa: BLE001  an answer too
                answers[address] = error

        threads = [threading.Thread(target=ask, args=[x], daemon=True) for x in workers]
        end = time.monotonic() + within_s
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join(max(0.0, end - time.monotonic()))
        late = TimeoutError(f"no answer within {within_s:g} s")
        return {address: answers.get(address, late) for address in workers}

    def ask_scheduler(self, function: Callable[..., Any]) -> Any:
        """Its answer. Raises whatever that ends with."""
        return self.client.run_on_scheduler(function)

    def submit(
        self, function: Callable[..., Any], *arguments: Any, key: str, seat: Seat, gpu: bool
    ) -> Any:
        """A future of that worker alone."""
        return self.client.submit(
            function,
            *arguments,
            key=key,
            workers=[seat.address],
            allow_other_workers=False,
            resources={GPU: 1} if gpu else None,
            retries=0,
            pure=False,
        )

    def subscribe(self, topic: str, hear: Callable[[dict[str, Any]], None]) -> None:
        """Call `hear`, on Dask's own thread, with each event of the topic."""
        self.client.subscribe_topic(topic, lambda event: hear(event[1]))

    def unsubscribe(self, topic: str) -> None:
        self.client.unsubscribe_topic(topic)

    def wait_until_up(self) -> None:
        """Dask connects again after a moment's interruption, if it can."""
        end = time.monotonic() + CONNECT_S
        while self.client.status != "running":
            if self.client.status == "closed" or time.monotonic() > end:
                raise LinkLostError("was lost: the connection broke")
            time.sleep(0.1)

    def _bounded(self, call: Callable[[], dict[str, Any]], within_s: float) -> dict[str, Any]:
        """Dask waits for what it has lost; a run must not. Ctrl-C comes through meanwhile."""
        self.wait_until_up()
        found: list[dict[str, Any]] = []
        failed: list[BaseException] = []

        def do() -> None:
            try:
                found.append(call())
            except BaseException as error:  # noqa: BLE001  it is told to the main thread
                failed.append(error)

        thread = threading.Thread(target=do, daemon=True)
        thread.start()
        thread.join(within_s)
        if found:
            return found[0]
        cause = failed[0] if failed else TimeoutError(f"no answer within {within_s:g} s")
        raise LinkLostError(f"does not answer ({type(cause).__name__}: {cause})") from cause


def check_address(scheduler: str) -> None:
    """Raises UsageError for what cannot be a scheduler's address."""
    if scheduler == LOCAL:
        return
    with contextlib.suppress(ValueError):
        parts = urlsplit(scheduler)
        if parts.scheme in ("tcp", "tls") and parts.hostname and parts.port:
            return
    raise UsageError(f"--scheduler {scheduler} is no address of a scheduler", fix=f"say {_ADDRESS}")


@contextlib.contextmanager
def connected(scheduler: str, workers: int) -> Iterator[Link]:
    """A link to the scheduler, or to a cluster of this machine with so many workers, which ends
    with it. Raises UsageError when nobody answers, or `distributed` is not installed."""
    distributed = _library()
    if scheduler != LOCAL:
        _knock(scheduler)
        try:
            client = distributed.Client(scheduler, timeout=CONNECT_S, set_as_default=False)
        except (OSError, ValueError, TypeError) as error:
            what = f"what answers at {scheduler} is no Dask scheduler that this one understands"
            raise UsageError(what, str(error), f"say {_ADDRESS}") from error
        with _closing(client):
            yield Link(client)
        return
    with scratch_folder() as folder, _temporary(str(folder)):
        with _unheard_ctrl_c():
            cluster = distributed.LocalCluster(
                n_workers=workers,
                threads_per_worker=1,
                processes=True,
                dashboard_address="127.0.0.1:0",  # None takes 8787, and warns where it is taken
                memory_limit=0,  # `memory` counts what scans take; Dask does not see our processes
                silence_logs=logging.CRITICAL,
            )
        with _closing(cluster):
            client = distributed.Client(cluster, timeout=CONNECT_S, set_as_default=False)
            with _closing(client):
                yield Link(client)


@contextlib.contextmanager
def _unheard_ctrl_c() -> Iterator[None]:
    """Processes and threads that are started meanwhile never hear of Ctrl-C, nor do those that they
    start: a terminal sends it to all of them, and it is this process that has to answer."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    # Python starts this helper with the first process, and lets Ctrl-C through again after that.
    resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _temporary(folder: str) -> Any:
    """Dask's own files go there."""
    import dask

    return dask.config.set({"temporary-directory": folder})


def _library() -> Any:
    try:
        import distributed
    except ImportError as error:
        raise UsageError(
            f"--scheduler needs Dask distributed, which is not installed here ({error})",
            fix="pip install 'scanrender[dask]', here and where scheduler and workers run",
        ) from error
    # What Dask notices is told by us, in sentences: a lost worker is one line, not thirty.
    for name in list(logging.root.manager.loggerDict):
        if name.partition(".")[0] in ("distributed", "tornado"):
            logging.getLogger(name).setLevel(logging.CRITICAL)
    warnings.filterwarnings("ignore", module="distributed")
    return distributed


def _knock(scheduler: str) -> None:
    """Dask itself tries again and again, where nobody listens."""
    parts = urlsplit(scheduler)
    try:
        socket.create_connection((str(parts.hostname), parts.port or 0), CONNECT_S).close()
    except OSError as error:
        raise UsageError(
            f"no Dask scheduler answers at {scheduler} ({error.strerror or error})",
            fix="start one (`dask scheduler`) and say the address that it prints",
        ) from error


@contextlib.contextmanager
def _closing(opened: Any) -> Iterator[None]:
    """Without what Dask says of connections that were lost before."""
    try:
        yield
    finally:
        with contextlib.suppress(OSError, RuntimeError):
            opened.close()
