"""A function that calls somebody else's code, in a process apart with limits: how that ended is its result.

``python -m evalkit.execution.sandbox FOLDER`` reads what to call in the folder, and leaves what it gave there.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from evalkit.execution import job_store, subprocesses
from evalkit.execution.job_store import Job, Ledger, Result

REQUEST, OUTPUT = "request.json", "output.txt"
PLACE = "place.txt"
WORD = "EVALKIT_PLACE"
"""Environment variable of such a child: the file in which it leaves word of where it is."""

ENDED = "ended"
"""Key of a result that tells how the process ended instead."""

MODULE = "evalkit.execution.sandbox"
FUNCTION = f"{MODULE}:run"
GIVEN = Job("result", FUNCTION)  # the name under which the child leaves what it has


def job(
    name: str, function: str, arguments: Mapping[str, Any], limits: Mapping[str, Any], uses: tuple[str, ...]
) -> Job:
    """The job that calls "module:name" apart; ``limits``: ``limit_s`` and ``memory_mib``."""
    own = {"function": function, "arguments": dict(arguments), **limits}
    return Job(name, FUNCTION, own, (function.partition(":")[0], *uses))


def run(function: str, arguments: Mapping[str, Any], limit_s: float, memory_mib: int) -> Result:
    """What "module:name" gives for the keywords, or {"ended": how its process ended, and where it was}.

    ``limit_s``: wall clock in all; ``memory_mib``: what it and all it starts may hold.
    """
    with tempfile.TemporaryDirectory(prefix="evalkit-validate-") as place:
        folder = Path(place)
        path = [str(Path(entry or ".").resolve()) for entry in sys.path]
        request = {"function": function, "arguments": dict(arguments), "path": path}
        (folder / REQUEST).write_text(json.dumps(request), encoding="utf-8")
        with (folder / OUTPUT).open("ab") as output:
            process = subprocesses.started(MODULE, folder, output)
            try:
                limit = _watched(process, limit_s, memory_mib)
            finally:
                subprocesses.end_group(process, folder)
        made = Ledger(folder).kept(GIVEN) if not limit else None
        if made is not None:
            return made
        how = limit or subprocesses.last_words(process.returncode, folder / OUTPUT)
        at = (folder / PLACE).read_text(encoding="utf-8") if (folder / PLACE).exists() else ""
        return {ENDED: f"{how}; it was at {at}" if at else how}


def at(place: str) -> None:
    """Leaves word of what is asked next, for the case that it is the last."""
    if WORD in os.environ:
        Path(os.environ[WORD]).write_text(place, encoding="utf-8")


def main() -> int:
    """Calls what the folder named on the command line asks for."""
    folder = Path(sys.argv[1]).resolve()  # a back end may change the working directory
    os.environ[WORD] = str(folder / PLACE)
    request = json.loads((folder / REQUEST).read_text(encoding="utf-8"))
    sys.path.extend(entry for entry in request["path"] if entry not in sys.path)
    result, _ = job_store.call(request["function"], request["arguments"])
    Ledger(folder).keep(GIVEN, result)
    return 0


def _watched(process: subprocess.Popen[bytes], limit_s: float, memory_mib: int) -> str:
    """Waits for the process's end; which limit it broke, or ""."""
    begun, family = time.monotonic(), subprocesses.Family(process.pid)
    while process.poll() is None:
        time.sleep(subprocesses.POLL_S)
        if time.monotonic() - begun > limit_s:
            return f"not finished after {limit_s:g} s"
        if family.usage().resident_bytes > memory_mib * 2**20:
            return f"used more than {memory_mib} MiB"
    return ""


if __name__ == "__main__":
    sys.exit(main())
