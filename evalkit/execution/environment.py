"""Where a comparison ran: processor, threads, versions, commit."""

from __future__ import annotations

import os
import platform
import subprocess
import sys
from collections import Counter
from collections.abc import Iterable, Mapping
from datetime import datetime
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import psutil

from evalkit import __version__

SINGLE_THREAD: dict[str, str] = dict.fromkeys(
    ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMEXPR_NUM_THREADS", "TBB_NUM_THREADS"), "1"
)
"""Environment of every timed process."""

KEPT_WITH_RUNS = (
    "evalkit", "commit", "python", "system", "host", "processor", "governor", "load before", "runs at a time",
)  # fmt: skip
"""What of a description is kept with every run: a later report may show the run beside others."""


def describe(distributions: Iterable[str] = (), *, jobs: int | None = None) -> dict[str, str]:
    """What a reader needs to judge the numbers, as ordered pairs of name and text; to be asked before the first run."""
    return {
        "evalkit": __version__,
        "commit": _commit(),
        **machine(),
        "cores": f"{psutil.cpu_count(logical=False) or '?'} physical, {psutil.cpu_count()} logical",
        "memory": f"{psutil.virtual_memory().total / 2**30:.1f} GiB",
        "threads per run": "1 (pinned to one core)" if hasattr(os, "sched_setaffinity") else "1 (not pinned)",
        **({"runs at a time": str(jobs)} if jobs else {}),
        **versions(distributions),
    }


def machine() -> dict[str, str]:
    """The part of it that is another on every machine of a cluster."""
    return {
        "python": f"{platform.python_implementation()} {platform.python_version()}",
        "system": f"{platform.system()} {platform.release()} {platform.machine()}",
        "processor": _processor(),
        "host": platform.node() or "unknown",
        "governor": _governor(),
        "load before": f"{os.getloadavg()[0]:.2f}" if hasattr(os, "getloadavg") else "unknown",
    }


def machines(made: Iterable[Mapping[str, Any]]) -> dict[str, str]:
    """The line on the machines that runs were made on, where there was more than one; empty where there was not.

    ``made``: a record for every run, as the store keeps it.
    """
    found = Counter(tuple(str(one.get(name, "unknown")) for name in ("host", "processor", "governor")) for one in made)
    if len(found) < 2:
        return {}
    told = [
        f"{count} {'run' if count == 1 else 'runs'} on {host} ({processor}, governor {governor})"
        for (host, processor, governor), count in sorted(found.items())
    ]
    return {"made on": "; ".join(told)}


def versions(distributions: Iterable[str]) -> dict[str, str]:
    """The version of each distribution, or that it is not installed."""
    return {name: _version(name) for name in distributions}


def kept(made: Iterable[Mapping[str, Any]], started: datetime) -> dict[str, str]:
    """The line on runs made before ``started`` and kept: how many, when and on which commit; empty where none was.

    ``made``: a record for every run, as the store keeps it.
    """
    times = [(_time(record.get("executed_at")), record) for record in made]
    earlier = [(time, record) for time, record in times if time is None or time < started]
    if not earlier:
        return {}
    dates = sorted(f"{time:%Y-%m-%d %H:%M}" for time, _ in earlier if time is not None)
    told = [f"{len(earlier)} {'run' if len(earlier) == 1 else 'runs'}"]
    told.append(f"made {'..'.join(dict.fromkeys((dates[0], dates[-1])))} UTC" if dates else "made nobody knows when")
    for name in ("commit", "processor"):
        found = sorted({str(record.get(name, "unknown")) for _, record in earlier})
        told.append(f"{name} {' and '.join(found)}")
    return {"kept from earlier": ", ".join(told)}


def cores() -> list[int | None]:
    """The logical CPUs this process may use, one of each physical core before the second of any; empty: cannot pin."""
    if not hasattr(os, "sched_getaffinity"):
        return []
    seen: dict[str, int] = {}
    order: list[tuple[int, int]] = []
    for cpu in sorted(os.sched_getaffinity(0)):
        core = _siblings(cpu)
        seen[core] = seen.get(core, 0) + 1
        order.append((seen[core], cpu))
    return [cpu for _, cpu in sorted(order)]


def core_of_each(processes: int) -> list[int | None]:
    """One core for each of so many processes to pin to, in turns; None where the system cannot pin."""
    known = cores() or [None]
    return [known[process % len(known)] for process in range(processes)]


def physical_cores() -> int:
    """How many physical cores this process may use: that many runs do not disturb one another."""
    usable = cores()
    known = psutil.cpu_count(logical=False) or psutil.cpu_count() or 1
    return min(known, len({_siblings(cpu) for cpu in usable})) if usable else known


def _siblings(cpu: int | None) -> str:
    """What all logical CPUs of one physical core share; Linux only, elsewhere each counts for itself."""
    path = Path(f"/sys/devices/system/cpu/cpu{cpu}/topology/thread_siblings_list")
    try:
        return path.read_text(encoding="ascii").strip()
    except OSError:
        return str(cpu)


def _time(text: object) -> datetime | None:
    try:
        return datetime.fromisoformat(str(text))
    except ValueError:
        return None


def _version(distribution: str) -> str:
    try:
        return version(distribution)
    except PackageNotFoundError:
        return "not installed"


def _governor() -> str:
    """How the system sets the clock of the first core; Linux only."""
    try:
        return Path("/sys/devices/system/cpu/cpu0/cpufreq/scaling_governor").read_text(encoding="ascii").strip()
    except OSError:
        return "unknown"


@cache
def _processor() -> str:
    if sys.platform == "linux":
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or "unknown"


def _commit() -> str:
    """The commit of the checkout evalkit runs from, "-dirty" if changed, or "none (installed package)"."""
    folder = Path(__file__).resolve().parents[1]
    if not (folder.parent / ".git").exists():
        return "none (installed package)"
    try:
        answer = subprocess.run(
            ["git", "-C", str(folder), "describe", "--always", "--dirty", "--abbrev=12"],
            capture_output=True, text=True, timeout=10, check=False,
        )  # fmt: skip
    except (OSError, subprocess.TimeoutExpired):
        return "unknown (git is not there)"
    return answer.stdout.strip() or "unknown"
