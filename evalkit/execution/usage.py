"""What a child process has used, and whether that is beyond a limit on a machine that others use as well."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

BUSY, IDLE, WORKING = 3.0, 0.02, 0.8
"""A child on a busy machine may take this many times its limit by the wall clock: one whose CPU time lies between these
shares of the limit. Below it waits, above it had its time.
"""


@dataclass(frozen=True, slots=True)
class Usage:
    """Resources that a child and its descendants have used: wall clock and CPU time in seconds, resident memory.

    ``waited_s``: how long the process that waited most was ready to run and got no core; 0 where the system does not
    count it.
    """

    wall_s: float
    cpu_s: float
    resident_bytes: int
    waited_s: float = 0.0

    def exceeds_wall(self, limit_s: float, begin: Usage | None = None) -> bool:
        """Whether a limit by the wall clock, counted from ``begin``, is exceeded.

        Time without a core on a busy machine does not count, up to ``BUSY`` times the limit.
        """
        wall_s = self.wall_s - (begin.wall_s if begin else 0.0)
        waited_s = self.waited_s - (begin.waited_s if begin else 0.0)
        return wall_s - min(max(waited_s, 0.0), (BUSY - 1.0) * limit_s) > limit_s

    def exceeds(self, limit_s: float, begin: Usage | None = None) -> bool:
        """Whether a time limit, counted from ``begin``, is exceeded: by a child that works, or that waits.

        A child that got less CPU time than it needs, but some, or that waited for a core, is on a busy machine: it has
        ``BUSY`` times the limit.
        """
        wall_s = self.wall_s - (begin.wall_s if begin else 0.0)
        cpu_s = self.cpu_s - (begin.cpu_s if begin else 0.0)
        waited_s = self.waited_s - (begin.waited_s if begin else 0.0)
        starved = IDLE * limit_s < max(cpu_s, waited_s) and cpu_s < WORKING * limit_s
        return wall_s > (BUSY * limit_s if starved else limit_s)


def read_waited_ns(pid: int) -> int | None:
    """How long the main thread of a process was ready and not running; None where the system does not say."""
    try:
        return int(Path(f"/proc/{pid}/schedstat").read_text(encoding="ascii").split()[1])
    except (OSError, ValueError, IndexError):
        return None


def count_starts() -> int | None:
    """How many processes and threads the system has started since its boot; None where it does not say."""
    try:
        lines = Path("/proc/stat").read_bytes().splitlines()
        return next((int(line.split()[1]) for line in lines if line.startswith(b"processes ")), 0) or None
    except (OSError, ValueError, IndexError):
        return None
