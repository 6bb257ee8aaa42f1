"""A call under a limit of time that holds in C as well, with a note that outlives its process."""

from __future__ import annotations

import contextlib
import faulthandler
import re
import threading
from collections.abc import Iterator
from pathlib import Path

LATE = "not finished after"
"""How the reason of a call that was ended for its time begins."""

_WATCH = threading.Lock()  # a process has one; a cluster's worker may have many threads

_PLACE = re.compile(r'File "([^"]*)", line (\d+) in (\S+)')


@contextlib.contextmanager
def noted(note: Path, limit_s: float) -> Iterator[None]:
    """While it lasts the file ``note`` is there; after ``limit_s`` (0: never) the process ends and says in it where.

    The watch is kept by a thread of the interpreter's own in C: it needs no lock that foreign code may hold. There is
    one in a process: a second call under a limit waits for the first.
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


def taken(note: Path, limit_s: float) -> str | None:
    """What a note left behind tells, which is removed: why the call was ended, "" where it was not; None: no note."""
    try:
        said = note.read_text(encoding="utf-8", errors="replace")
    except OSError:
        return None
    note.unlink(missing_ok=True)
    if not said:
        return ""
    *_, own = said.split("Thread 0x")  # the thread that called comes last, its innermost call first
    place = _PLACE.search(own)
    where = f"; it was in {place[3]} ({Path(place[1]).name}, line {place[2]})" if place else ""
    return f"{LATE} {limit_s:g} s{where}"
