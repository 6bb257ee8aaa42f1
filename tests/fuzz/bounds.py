"""Check a reader: any input gives a result or a short EvalkitError with the file name, in bounded time and memory."""

from __future__ import annotations

import contextlib
import signal
import tempfile
import threading
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path

from evalkit.core.errors import EvalkitError

SPARE_BYTES = 256 * 2**20
BYTES_EACH = 50
"""Limits of additional memory of a reader: a constant, and bytes per byte of input. The C library reserves 128 MiB of
address space at once for the memory of another thread."""

SECONDS = 1.0
PIECE = 100_000
"""CPU seconds allowed for each piece of ``PIECE`` bytes, partial pieces included."""

free = False
"""Whether the limits are disabled, while libraries are loaded."""

SLACK = 5.0
"""Factor on SECONDS for slow machines and instrumented programs."""

MAX_MESSAGE = 1_000
"""Longest message in characters, without the folder's name."""


class Violation(AssertionError):
    """An input that exceeded a limit or raised another error."""


class TooSlow(BaseException):
    """Raised by the watchdog; a BaseException, so that readers do not catch it."""


@cache
def folder() -> Path:
    """Return the folder where inputs are written, in memory if the system has such a folder."""
    memory = Path("/dev/shm")
    return Path(tempfile.mkdtemp(prefix="evalkit-fuzz-", dir=memory if memory.is_dir() else None))


def check_file_reader(
    read: Callable[[Path], object], data: bytes, name: str, named: str | None = None, resident: bool = False
) -> None:
    """Write the input to a file of that name and check its reader; ``named``: see ``check_call``."""
    path = folder() / name
    path.write_bytes(data)
    check_call(lambda: read(path), len(data), path.name if named is None else named, resident)


def check_call(call: Callable[[], object], size: int, named: str, resident: bool = False) -> None:
    """Run a call within the limits; an EvalkitError with ``named`` in its message is accepted, other errors are raised.

    ``resident``: limit the resident memory instead of the address space.
    """
    try:
        with contextlib.ExitStack() as limits:
            if not free:
                limits.enter_context(
                    (_limit_resident if resident else _limit_address_space)(SPARE_BYTES + BYTES_EACH * size)
                )
                limits.enter_context(_limit_time(size))
            call()
    except EvalkitError as error:
        _check_error(error, named, (RecursionError,) if resident else (RecursionError, MemoryError))
    except TooSlow:
        raise Violation(f"more than {_is_allowed(size):g} s of CPU time for {size} bytes") from None


def _check_error(error: EvalkitError, named: str, never: tuple[type[BaseException], ...]) -> None:
    cause: BaseException | None = error
    while cause is not None:
        if isinstance(cause, never):
            raise Violation(f"{type(cause).__name__} behind: {str(error)[:300]}") from error
        cause = cause.__cause__
    message = str(error)
    if named not in message:
        raise Violation(f"does not name {named}: {message[:300]!r}")
    if len(message) > MAX_MESSAGE + len(str(folder())):
        raise Violation(f"{len(message)} characters: {message[:300]!r}")
    if not message.isprintable():
        raise Violation(f"not printable on one line: {message[:300]!r}")


@contextlib.contextmanager
def _limit_address_space(more: int) -> Iterator[None]:
    """Limit the address space, if the system supports it: beyond the limit a MemoryError is raised."""
    try:
        import resource

        pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
    except (ImportError, OSError):
        yield
        return
    before = resource.getrlimit(resource.RLIMIT_AS)
    limit = pages * resource.getpagesize() + more
    resource.setrlimit(resource.RLIMIT_AS, (limit, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, before)


@contextlib.contextmanager
def _limit_resident(more: int) -> Iterator[None]:
    """Check the growth of the peak resident memory afterwards, if the system reports it."""
    try:
        import resource
    except ImportError:
        yield
        return
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    yield
    if (grown := 1024 * (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before)) > more:
        raise Violation(f"{grown} bytes of memory")


@contextlib.contextmanager
def _limit_time(size: int) -> Iterator[None]:
    """Raise TooSlow beyond the limit of CPU time, which does not depend on the load of the machine."""
    if not hasattr(signal, "SIGPROF") or threading.current_thread() is not threading.main_thread():
        yield
        return

    def stop(_signal: int, _frame: object) -> None:
        raise TooSlow

    before = signal.signal(signal.SIGPROF, stop)
    signal.setitimer(signal.ITIMER_PROF, _is_allowed(size), 1.0)  # repeated, in case a destructor swallows it
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, before)


def _is_allowed(size: int) -> float:
    return SLACK * SECONDS * (1 + size // PIECE)
