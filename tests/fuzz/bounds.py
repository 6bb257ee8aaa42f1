"""What evalkit owes any input: an answer, or a short EvalkitError that names the file, in bounded time and memory."""

from __future__ import annotations

import contextlib
import signal
import tempfile
import threading
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path

from evalkit.core.errors import EvalkitError

SPARE_BYTES = 64 * 2**20
BYTES_EACH = 50
"""Memory a reader may ask for beyond what the process has: so much, and so many bytes for each of the input."""

SECONDS = 1.0
PIECE = 100_000
"""CPU seconds a reader may take for each piece of so many bytes, begun ones counted."""

free = False
"""Whether nothing is measured: while libraries load, which is no reader's doing."""

SLACK = 5.0
"""Factor on SECONDS: a slow machine, or a program that counts its own branches, is no hang."""

LONGEST = 1_000
"""Characters of a message beyond those of the file's name."""


class InspectionFinding(AssertionError):
    """A promise that an input broke."""


class TooSlow(BaseException):
    """The watchdog's; no reader may catch it."""


@cache
def folder() -> Path:
    """Where inputs are written, one over the other: in memory where this system has such a folder."""
    memory = Path("/dev/shm")
    return Path(tempfile.mkdtemp(prefix="evalkit-fuzz-", dir=memory if memory.is_dir() else None))


def held_file(
    read: Callable[[Path], object], data: bytes, name: str, named: str | None = None, resident: bool = False
) -> None:
    """Writes the input as a file of that name and holds its reader to the promises; ``named``: see ``held``."""
    path = folder() / name
    path.write_bytes(data)
    held(lambda: read(path), len(data), path.name if named is None else named, resident)


def held(call: Callable[[], object], size: int, named: str, resident: bool = False) -> None:
    """Raises whatever the call raises but an EvalkitError that keeps the promises; ``named`` must be in its message.

    ``resident``: what is filled of memory counts, not what is asked for.
    """
    try:
        with contextlib.ExitStack() as limits:
            if not free:
                limits.enter_context((_filled if resident else _asked)(SPARE_BYTES + BYTES_EACH * size))
                limits.enter_context(_time(size))
            call()
    except EvalkitError as error:
        _check(error, named, (RecursionError,) if resident else (RecursionError, MemoryError))
    except TooSlow:
        raise InspectionFinding(f"more than {_allowed(size):g} s of CPU time for {size} bytes") from None


def _check(error: EvalkitError, named: str, never: tuple[type[BaseException], ...]) -> None:
    cause: BaseException | None = error
    while cause is not None:
        if isinstance(cause, never):
            raise InspectionFinding(f"{type(cause).__name__} behind: {str(error)[:300]}") from error
        cause = cause.__cause__
    told = str(error)
    if named not in told:
        raise InspectionFinding(f"does not name {named}: {told[:300]!r}")
    if len(told) > LONGEST + len(str(folder())):
        raise InspectionFinding(f"{len(told)} characters: {told[:300]!r}")
    if not told.isprintable():
        raise InspectionFinding(f"not printable on one line: {told[:300]!r}")


@contextlib.contextmanager
def _asked(more: int) -> Iterator[None]:
    """Whoever asks for more than is allowed gets a MemoryError, where this system can see to it."""
    try:
        import resource

        pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
    except (ImportError, OSError):
        yield
        return
    before = resource.getrlimit(resource.RLIMIT_AS)
    most = pages * resource.getpagesize() + more
    resource.setrlimit(resource.RLIMIT_AS, (most, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, before)


@contextlib.contextmanager
def _filled(more: int) -> Iterator[None]:
    """Whoever has had more than is allowed is found out afterwards, where this system can tell."""
    try:
        import resource
    except ImportError:
        yield
        return
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    yield
    if (grown := 1024 * (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before)) > more:
        raise InspectionFinding(f"{grown} bytes of memory")


@contextlib.contextmanager
def _time(size: int) -> Iterator[None]:
    """Ends whoever takes longer than is allowed: by CPU time, so that a busy machine is nobody's fault."""
    if not hasattr(signal, "SIGPROF") or threading.current_thread() is not threading.main_thread():
        yield
        return

    def stop(_signal: int, _frame: object) -> None:
        raise TooSlow

    before = signal.signal(signal.SIGPROF, stop)
    signal.setitimer(signal.ITIMER_PROF, _allowed(size), 1.0)  # again, where a destructor swallowed it
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, before)


def _allowed(size: int) -> float:
    return SLACK * SECONDS * (1 + size // PIECE)
