"""Time limit of a task that also ends C code, with a note on disk that remains after the process has ended.

The limits of a run are ``evalkit.config.limits.Limits``; ``evalkit.execution.run_process`` enforces them.
"""

from __future__ import annotations

import contextlib
import faulthandler
import re
import threading
from collections.abc import Iterator
from pathlib import Path

_WATCH = threading.Lock()  # one limit per process; a cluster's worker may have many threads

_PLACE = re.compile(r'File "([^"]*)", line (\d+) in (\S+)')


@contextlib.contextmanager
def time_limit(note: Path, limit_s: float) -> Iterator[None]:
    """Keep the file ``note`` while the block runs; after ``limit_s`` (0: no limit), write there where the block was
    and end the process.

    A C thread of the interpreter watches the time, without any lock that foreign code may hold. A process has one such
    thread: a second block with a limit waits for the first.
    """
    try:
        with _WATCH if limit_s else contextlib.nullcontext(), note.open("w", encoding="utf-8") as file:
            if limit_s:
                faulthandler.dump_traceback_later(limit_s, exit=True, file=file)
            try:
                yield
            finally:
                if limit_s:
                    faulthandler.cancel_dump_traceback_later()
    finally:
        note.unlink(missing_ok=True)


def take_note(note: Path, limit_s: float) -> str:
    """Read and remove the note that an ended process left: how the limit ended it, "" if something else did."""
    try:
        text = note.read_text(encoding="utf-8", errors="replace")
    except OSError:
        return ""
    note.unlink(missing_ok=True)
    *_, calling = text.split("Thread 0x")  # the calling thread comes last, its innermost call first
    place = _PLACE.search(calling)
    where = f"; it was in {place[3]} ({Path(place[1]).name}, line {place[2]})" if place else ""
    return f"not finished after {limit_s:g} s{where}" if text else ""
