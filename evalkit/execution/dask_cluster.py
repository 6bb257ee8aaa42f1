"""The workers of a Dask cluster, one call at a time for each of their threads.

Calls are handed out here, not queued at the scheduler: it never holds more than the workers compute, and whoever is
lost with a worker is known by name. Dask is imported only by who asks for a cluster.
"""

from __future__ import annotations

import os
import platform
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Generator, Iterable, Iterator
from concurrent.futures import Future
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field
from importlib import import_module
from queue import Empty, SimpleQueue
from typing import Any

from evalkit.core.errors import EvalkitError, NotInstalled

TIMED = "timed"
"""The resource of workers on which times are measured: they have one thread, and nothing else of ours runs there."""

TRIES = 2
"""Whoever ends those that make it so often is not tried again unasked."""

LOOK_S = 1.0
"""How often the workers are counted."""

CONNECT_S = 10.0
PATIENCE_S = 60.0
"""How long we wait where there is no worker."""


class NoCluster(EvalkitError):
    """A cluster that cannot be used: ``NoCluster(scheduler, what, remedy)``."""

    def __init__(self, scheduler: str, what: str, remedy: str) -> None:
        super().__init__(scheduler, what, remedy)

    def __str__(self) -> str:
        scheduler, what, remedy = self.args
        return f"{scheduler}: {what}; {remedy}"


class WorkerLost(Exception):
    """A call that was lost with its worker as often as it may be; the message names them."""


@dataclass(frozen=True)
class Slot:
    """A thread of a worker. ``beside``: so many threads of the cluster are on its host."""

    address: str
    host: str
    beside: int


@dataclass
class Call:
    """``function(*arguments, slot)``, on a worker. ``lost``: the hosts and addresses of workers lost with it."""

    name: str
    function: Callable[..., Any]
    arguments: tuple[Any, ...] = ()
    lost: list[Slot] = field(default_factory=list)

    def best(self, slots: list[Slot]) -> Slot:
        """One of the slots, on a host that no worker was lost on if there is one."""
        hosts = {slot.host for slot in self.lost}
        return next((slot for slot in slots if slot.host not in hosts), slots[0])


@dataclass(frozen=True)
class Cluster:
    """The workers of a scheduler; "" starts ``workers`` processes here for as long as it is asked.

    ``timed``: take only workers that are offered for measuring times.
    """

    scheduler: str = ""
    workers: int = 1
    timed: bool = False

    def answers(self, calls: Iterable[Call]) -> Generator[tuple[Call, Future[Any]]]:
        """Every call with what came of it, as they are done; WorkerLost for one that lost its worker twice.

        Takes a call only when a thread is free for it. NoCluster where there are no workers (any more).
        """
        with self._client() as client:
            yield from _Hall(client, self.scheduler or "the workers here", self.timed).answers(iter(calls))

    @contextmanager
    def _client(self) -> Iterator[Any]:
        distributed = dask()
        with ExitStack() as stack:
            address = self.scheduler or stack.enter_context(_local(self.workers)).scheduler_address
            try:
                client = stack.enter_context(distributed.Client(address, timeout=CONNECT_S, set_as_default=False))
            except (OSError, ValueError) as error:
                raise NoCluster(
                    address, f"no scheduler answers ({error})", "is it running, and on this port?"
                ) from error
            yield client


def dask() -> Any:
    """The library, which is an extra; NotInstalled where it does not load."""
    try:
        return import_module("distributed")
    except ImportError as error:
        raise NotInstalled("dask", f"cannot be loaded ({error})", "pip install 'evalkit[dask]'") from error


@contextmanager
def _local(workers: int) -> Iterator[Any]:
    """Processes of this machine, one thread each, restarted when they die; gone afterwards."""
    steadfast = {"distributed.deploy.lost-worker-timeout": "1 day"}  # else who dies twice in 15 s is not restarted
    distributed = dask()  # first: it brings the settings
    with (
        import_module("dask").config.set(steadfast),
        tempfile.TemporaryDirectory(prefix="evalkit-workers-", ignore_cleanup_errors=True) as folder,
        distributed.LocalCluster(
            n_workers=workers, threads_per_worker=1, processes=True, host="127.0.0.1", dashboard_address="127.0.0.1:0",
            resources={TIMED: 1}, memory_limit=0, local_directory=folder, silence_logs=50,
        ) as cluster,
    ):  # fmt: skip
        yield cluster


class _Hall:
    """Who computes what."""

    def __init__(self, client: Any, name: str, timed: bool) -> None:
        self._client, self._name, self._timed = client, name, timed
        self._threads: dict[str, int] = {}
        self._hosts: dict[str, str] = {}
        self._refused: dict[str, str] = {}
        self._flying: dict[str, tuple[Call, Slot, Any]] = {}
        self._landed: SimpleQueue[str] = SimpleQueue()
        self._looked_at = self._staffed_at = time.monotonic()
        self._flights = 0

    def answers(self, calls: Iterator[Call]) -> Generator[tuple[Call, Future[Any]]]:
        again: list[Call] = []
        exhausted = False
        self._look()
        try:
            while True:
                while (slots := self._free()) and (again or not exhausted):
                    call = again.pop() if again else next(calls, None)
                    if call is None:
                        exhausted = True
                        break
                    self._send(call, call.best(slots))
                if exhausted and not again and not self._flying:
                    return
                for call, outcome in self._ended():
                    if outcome is None:
                        again.append(call)
                    else:
                        yield call, outcome
        finally:
            with suppress(Exception):  # the scheduler may be gone
                self._client.cancel([future for _, _, future in self._flying.values()], force=True)

    def _send(self, call: Call, slot: Slot) -> None:
        self._flights += 1
        future = self._client.submit(
            call.function, *call.arguments, slot, key=f"{call.name}-{os.getpid()}-{self._flights}", pure=False,
            workers=[slot.address], allow_other_workers=False, retries=0, resources={TIMED: 1} if self._timed else None,
        )  # fmt: skip
        self._flying[future.key] = call, slot, future
        future.add_done_callback(self._land)

    def _land(self, future: Any) -> None:
        self._landed.put(future.key)

    def _ended(self) -> Iterator[tuple[Call, Future[Any] | None]]:
        """What has come of calls since; None for one to be made again."""
        with suppress(Empty):
            key = self._landed.get(timeout=LOOK_S)
            if key in self._flying:
                yield self._outcome(*self._flying.pop(key))
        if time.monotonic() - self._looked_at >= LOOK_S:
            self._look()
            gone = [key for key, (_, slot, _) in self._flying.items() if slot.address not in self._threads]
            for key in gone:
                call, slot, future = self._flying.pop(key)
                future.cancel(force=True)
                yield call, _strike(call, slot)

    def _outcome(self, call: Call, slot: Slot, future: Any) -> tuple[Call, Future[Any] | None]:
        outcome: Future[Any] = Future()
        try:
            outcome.set_result(future.result(timeout=PATIENCE_S))
        except dask().KilledWorker:
            return call, _strike(call, slot)
        except Exception as error:
            if isinstance(error, TimeoutError) and future.status != "error":  # its result was lost with its worker
                return call, _strike(call, slot)
            if future.cancelled():
                raise NoCluster(self._name, "the scheduler has gone", GO_ON) from error
            outcome.set_exception(error)
        return call, outcome

    def _free(self) -> list[Slot]:
        """A slot of every thread that computes nothing."""
        busy = Counter(slot.address for _, slot, _ in self._flying.values())
        beside = Counter[str]()
        for address, threads in self._threads.items():
            beside[self._hosts[address]] += threads
        return [
            Slot(address, self._hosts[address], beside[self._hosts[address]])
            for address, threads in self._threads.items()
            for _ in range(threads - busy[address])
        ]

    def _look(self) -> None:
        """Counts the workers, and asks the new ones whether they will do."""
        try:
            present: dict[str, int] = dict(self._client.nthreads())
            new = [address for address in present if address not in self._hosts and address not in self._refused]
            told = self._client.run(_about, workers=new, on_error="return") if new else {}
        except (OSError, RuntimeError) as error:
            raise NoCluster(self._name, f"the scheduler does not answer any more ({error})", GO_ON) from error
        for address, about in told.items():
            self._judge(address, present[address], about)
        self._threads = {address: threads for address, threads in present.items() if address in self._hosts}
        self._looked_at = time.monotonic()
        if self._threads:
            self._staffed_at = self._looked_at
        elif refused := [self._refused[address] for address in present if address in self._refused]:
            raise NoCluster(self._name, refused[0], GO_ON)
        elif self._looked_at - self._staffed_at > PATIENCE_S:
            raise NoCluster(self._name, f"it has had no workers for {PATIENCE_S:g} s", GO_ON)

    def _judge(self, address: str, threads: int, about: object) -> None:
        if not isinstance(about, tuple):
            self._refused[address] = f"its worker {address} cannot load evalkit ({about})"
        elif self._timed and (about[1] < 1 or threads != 1):
            need = f"start workers with --nthreads 1 --resources {TIMED}=1, or say --accuracy-only"
            self._refused[address] = f"its worker {address} is not offered for measuring times: {need}"
        else:
            self._hosts[address] = about[0]


GO_ON = "finished runs are kept: start workers, and repeat the command with --resume"


def _strike(call: Call, slot: Slot) -> Future[Any] | None:
    """What comes of a call that lost its worker: WorkerLost the second time, None before."""
    call.lost.append(slot)
    if len(call.lost) < TRIES:
        return None
    outcome: Future[Any] = Future()
    names = ", ".join(f"{slot.address} on {slot.host}" for slot in call.lost)
    outcome.set_exception(WorkerLost(f"lost its worker twice ({names})"))
    return outcome


def _about(dask_worker: Any) -> tuple[str, float]:
    """A worker's host and how much of ``TIMED`` it offers."""
    return platform.node(), float(dask_worker.state.total_resources.get(TIMED, 0))
