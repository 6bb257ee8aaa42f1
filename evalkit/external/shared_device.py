"""One serial device and several programs that ask the board behind it: one question at a time has the line."""

from __future__ import annotations

import contextlib
import os
import secrets
import tempfile
from collections.abc import Iterator
from pathlib import Path

from evalkit.external.serial_line import LineError

MAX_BYTES = 100


class SharedDevice:
    """A device that programs of one user on this machine take turns to use.

    The lock is a file for each device, which names its last user. The system releases it where a program ends.
    """

    def __init__(self, path: str) -> None:
        self._path = path
        self._own = f"{os.getpid()}-{secrets.token_hex(8)}"
        self._lock = -1

    @contextlib.contextmanager
    def turn(self) -> Iterator[int]:
        """Wait for the device and have it for a question; raises LineError without a lock.

        Gives the number of the other process that has used it since the last turn, 0 if none has.
        """
        import fcntl  # noqa: PLC0415 - not on Windows

        if self._lock < 0:
            self._lock = _open_lock(self._path)
        fcntl.flock(self._lock, fcntl.LOCK_EX)
        try:
            user = os.pread(self._lock, MAX_BYTES, 0).decode("ascii", "replace")
            os.ftruncate(self._lock, 0)
            os.pwrite(self._lock, self._own.encode("ascii"), 0)
            number = user.partition("-")[0]
            yield 0 if user == self._own else int(number) if number.isdecimal() else -1
        finally:
            fcntl.flock(self._lock, fcntl.LOCK_UN)


def _open_lock(path: str) -> int:
    """Open the lock of a device, which is this user's own file; raises LineError."""
    try:
        number = Path(path).stat().st_rdev
        lock = Path(tempfile.gettempdir()) / f"evalkit-device-{os.getuid()}-{number}"
        descriptor = os.open(lock, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC, 0o600)
    except OSError as error:
        raise LineError(f"{path}: {error.strerror}; give the board's serial device, such as /dev/ttyACM0") from None
    if os.fstat(descriptor).st_uid != os.getuid():
        os.close(descriptor)
        raise LineError(f"{lock} is another user's file; remove it")
    return descriptor
