"""Calls on the workers of a Dask cluster, one at a time per thread.

Calls are assigned to workers here instead of being queued at Dask's scheduler, which therefore never holds more calls
than the workers compute; the calls lost with a worker are known. Dask is imported only when a cluster is used.
"""

from __future__ import annotations

import os
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
from evalkit.execution import environment

TIMED = "timed"
"""Dask resource of workers on which times are measured: they have one thread and run nothing else of evalkit."""

MAX_LOST_WORKERS = 2
"""A call that killed this many workers fails."""

LIST_S = 1.0
"""Interval between two listings of the workers."""

CONNECT_S = 10.0
WORKER_TIMEOUT_S = 60.0
"""Maximum time without any worker."""


class NoCluster(EvalkitError):
    """The cluster cannot be used: ``NoCluster(scheduler, what, remedy)``."""

    def __init__(self, scheduler: str, what: str, remedy: str) -> None:
        super().__init__(scheduler, what, remedy)

    def __str__(self) -> str:
        scheduler, what, remedy = self.args
        return f"{scheduler}: {what}; {remedy}"


class WorkerLost(Exception):
    """A call killed ``MAX_LOST_WORKERS`` workers; the message names them."""


@dataclass(frozen=True)
class Slot:
    """A thread of a worker. ``beside``: number of threads of the cluster on the same host."""

    address: str
    host: str
    beside: int


@dataclass
class Call:
    """``function(*arguments, slot)``, for a worker. ``lost``: slots of workers that died during the call."""

    name: str
    function: Callable[..., Any]
    arguments: tuple[Any, ...] = ()
    lost: list[Slot] = field(default_factory=list)

    def best(self, slots: list[Slot]) -> Slot:
        """One of the slots, preferably on a host where no worker died during this call."""
        hosts = {slot.host for slot in self.lost}
        return next((slot for slot in slots if slot.host not in hosts), slots[0])


@dataclass(frozen=True)
class Cluster:
    """The workers of a Dask scheduler; "" starts ``workers`` local processes for the duration of the calls.

    ``timed``: use only workers with the resource ``TIMED``. ``insecure``: accept a scheduler without TLS. ``security``:
    a ``distributed.Security`` with the keys of the scheduler, None for those of Dask's configuration.
    """

    scheduler: str = ""
    workers: int = 1
    timed: bool = False
    insecure: bool = False
    security: Any = None

    def answers(self, calls: Iterable[Call]) -> Generator[tuple[Call, Future[Any]]]:
        """Yield every call with its result as it finishes; WorkerLost as the exception of a call that killed workers.

        The next call is taken only when a thread is free. Raises NoCluster where there are no workers (any more).
        """
        with self._client() as client:
            yield from _Dispatcher(client, self.scheduler or "the workers here", self.timed).answers(iter(calls))

    @contextmanager
    def _client(self) -> Iterator[Any]:
        distributed = dask()
        address, security = self.scheduler, self.security
        if address and not address.startswith(("tls://", "inproc://")) and not self.insecure:
            what = "it has no TLS: everybody who reaches it can run code as its workers and as you"
            raise NoCluster(
                address, what, "give it keys and use tls://HOST:PORT, or add --insecure in a trusted network"
            )
        with ExitStack() as stack:
            if not address:
                local = stack.enter_context(_local(self.workers))
                address, security = local.scheduler_address, local.security
            options = {"timeout": CONNECT_S, "set_as_default": False, "security": security}
            try:
                client = stack.enter_context(distributed.Client(address, **options))
            except (OSError, ValueError) as error:
                raise NoCluster(
                    address, f"no scheduler answers ({error})", "is it running, on this port, and with these keys?"
                ) from error
            yield client


def dask() -> Any:
    """The module ``distributed``, an optional dependency. Raises NotInstalled if it cannot be imported."""
    try:
        return import_module("distributed")
    except ImportError as error:
        raise NotInstalled("dask", f"cannot be loaded ({error})", "pip install 'evalkit[dask]'") from error


@contextmanager
def _local(workers: int) -> Iterator[Any]:
    """A cluster of local processes with one thread each, restarted when they die and closed after the block.

    Its connections are encrypted with keys made for it: no other user of the machine can run code on it. Raises
    NotInstalled without the library that makes them.
    """
    always_restart = {
        "distributed.deploy.lost-worker-timeout": "1 day"
    }  # by default a worker that dies twice in 15 s is not restarted
    distributed = dask()  # first: the import defines the settings
    try:
        security = distributed.Security.temporary()
    except ImportError as error:
        raise NotInstalled("dask", f"cannot encrypt ({error})", "pip install 'evalkit[dask]'") from error
    with (
        import_module("dask").config.set(always_restart),
        tempfile.TemporaryDirectory(prefix="evalkit-workers-", ignore_cleanup_errors=True) as folder,
        distributed.LocalCluster(
            n_workers=workers, threads_per_worker=1, processes=True, host="127.0.0.1", dashboard_address="127.0.0.1:0",
            security=security, resources={TIMED: 1}, memory_limit=0, local_directory=folder, silence_logs=50,
        ) as cluster,
    ):  # fmt: skip
        yield cluster


class _Dispatcher:
    """Assigns calls to the threads of the workers."""

    def __init__(self, client: Any, name: str, timed: bool) -> None:
        self._client, self._name, self._timed = client, name, timed
        self._threads: dict[str, int] = {}
        self._hosts: dict[str, str] = {}
        self._refused: dict[str, str] = {}
        self._running: dict[str, tuple[Call, Slot, Any]] = {}
        self._ended_keys: SimpleQueue[str] = SimpleQueue()
        self._listed_at = self._had_workers_at = time.monotonic()
        self._submitted = 0

    def answers(self, calls: Iterator[Call]) -> Generator[tuple[Call, Future[Any]]]:
        repeated: list[Call] = []
        exhausted = False
        self._list_workers()
        try:
            while True:
                while (slots := self._idle_slots()) and (repeated or not exhausted):
                    call = repeated.pop() if repeated else next(calls, None)
                    if call is None:
                        exhausted = True
                        break
                    self._submit(call, call.best(slots))
                if exhausted and not repeated and not self._running:
                    return
                for call, outcome in self._collect_ended():
                    if outcome is None:
                        repeated.append(call)
                    else:
                        yield call, outcome
        finally:
            with suppress(Exception):  # the scheduler may be gone
                self._client.cancel([future for _, _, future in self._running.values()], force=True)

    def _submit(self, call: Call, slot: Slot) -> None:
        self._submitted += 1
        future = self._client.submit(
            call.function, *call.arguments, slot, key=f"{call.name}-{os.getpid()}-{self._submitted}", pure=False,
            workers=[slot.address], allow_other_workers=False, retries=0, resources={TIMED: 1} if self._timed else None,
        )  # fmt: skip
        self._running[future.key] = call, slot, future
        future.add_done_callback(self._note_end)

    def _note_end(self, future: Any) -> None:
        self._ended_keys.put(future.key)

    def _collect_ended(self) -> Iterator[tuple[Call, Future[Any] | None]]:
        """Calls that have ended since the last call of this method; None as the result of a call to repeat."""
        with suppress(Empty):
            key = self._ended_keys.get(timeout=LIST_S)
            if key in self._running:
                yield self._read_outcome(*self._running.pop(key))
        if time.monotonic() - self._listed_at >= LIST_S:
            self._list_workers()
            gone = [key for key, (_, slot, _) in self._running.items() if slot.address not in self._threads]
            for key in gone:
                call, slot, future = self._running.pop(key)
                future.cancel(force=True)
                yield call, _count_lost_worker(call, slot)

    def _read_outcome(self, call: Call, slot: Slot, future: Any) -> tuple[Call, Future[Any] | None]:
        outcome: Future[Any] = Future()
        try:
            outcome.set_result(future.result(timeout=WORKER_TIMEOUT_S))
        except dask().KilledWorker:
            return call, _count_lost_worker(call, slot)
        except Exception as error:
            if isinstance(error, TimeoutError) and future.status != "error":  # its result was lost with its worker
                return call, _count_lost_worker(call, slot)
            if future.cancelled():
                raise NoCluster(self._name, "the scheduler has disappeared", RESUME_HINT) from error
            outcome.set_exception(error)
        return call, outcome

    def _idle_slots(self) -> list[Slot]:
        """One slot per idle thread."""
        busy = Counter(slot.address for _, slot, _ in self._running.values())
        beside = Counter[str]()
        for address, threads in self._threads.items():
            beside[self._hosts[address]] += threads
        return [
            Slot(address, self._hosts[address], beside[self._hosts[address]])
            for address, threads in self._threads.items()
            for _ in range(threads - busy[address])
        ]

    def _list_workers(self) -> None:
        """List the workers and check new ones."""
        try:
            present: dict[str, int] = dict(self._client.nthreads())
            new = [address for address in present if address not in self._hosts and address not in self._refused]
            facts = self._client.run(_describe_worker, workers=new, on_error="return") if new else {}
        except (OSError, RuntimeError) as error:
            raise NoCluster(self._name, f"the scheduler does not answer any more ({error})", RESUME_HINT) from error
        for address, about in facts.items():
            self._check_worker(address, present[address], about)
        self._threads = {address: threads for address, threads in present.items() if address in self._hosts}
        self._listed_at = time.monotonic()
        if self._threads:
            self._had_workers_at = self._listed_at
        elif refused := [self._refused[address] for address in present if address in self._refused]:
            raise NoCluster(self._name, refused[0], RESUME_HINT)
        elif self._listed_at - self._had_workers_at > WORKER_TIMEOUT_S:
            raise NoCluster(self._name, f"it had no workers for {WORKER_TIMEOUT_S:g} s", RESUME_HINT)

    def _check_worker(self, address: str, threads: int, about: object) -> None:
        if not isinstance(about, tuple):
            self._refused[address] = f"its worker {address} cannot load evalkit ({about})"
        elif self._timed and (about[1] < 1 or threads != 1):
            need = f"start workers with --nthreads 1 --resources {TIMED}=1, or add --accuracy-only"
            self._refused[address] = f"its worker {address} is not offered for measuring times: {need}"
        else:
            self._hosts[address] = about[0]


RESUME_HINT = "finished runs are kept: start workers, and repeat the command with --resume"


def _count_lost_worker(call: Call, slot: Slot) -> Future[Any] | None:
    """Count a worker that died during a call: WorkerLost for the last allowed one, None before."""
    call.lost.append(slot)
    if len(call.lost) < MAX_LOST_WORKERS:
        return None
    outcome: Future[Any] = Future()
    names = ", ".join(f"{slot.address} on {slot.host}" for slot in call.lost)
    outcome.set_exception(WorkerLost(f"killed its worker twice ({names})"))
    return outcome


def _describe_worker(dask_worker: Any) -> tuple[str, float]:
    """The host of a worker and its amount of the resource ``TIMED``."""
    return environment.host_name(), float(dask_worker.state.total_resources.get(TIMED, 0))
