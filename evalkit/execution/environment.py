"""Description of the machine and the software: processor, threads, versions, commit."""

from __future__ import annotations

import os
import platform
import shlex
import subprocess
import sys
from collections import Counter
from collections.abc import Iterable, Mapping
from datetime import UTC, datetime
from functools import cache
from importlib.metadata import PackageNotFoundError, packages_distributions, version
from pathlib import Path
from queue import SimpleQueue
from typing import Any

import psutil

from evalkit import __version__
from evalkit.core.errors import plain
from evalkit.core.run_result import RunResult
from evalkit.core.run_status import NOT_EXECUTED

SINGLE_THREAD: dict[str, str] = dict.fromkeys(
    ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMEXPR_NUM_THREADS", "TBB_NUM_THREADS"), "1"
)
"""Environment variables of every timed process."""

KEPT_WITH_RUNS = (
    "evalkit", "commit", "python", "system", "host", "processor", "governor", "load before", "runs at a time",
)  # fmt: skip
"""Entries of a description that are kept with every run, because a later report may show it beside other runs."""


def describe(distributions: Iterable[str] = (), *, jobs: int | None = None) -> dict[str, str]:
    """The machine and the software by name, in the order of the report; to be called before the first run.

    ``distributions``: Python packages whose versions are added. ``jobs``: number of runs at a time.
    """
    return {
        "evalkit": __version__,
        "commit": _read_commit(),
        **machine(),
        "cores": f"{psutil.cpu_count(logical=False) or '?'} physical, {psutil.cpu_count()} logical",
        "memory": f"{psutil.virtual_memory().total / 2**30:.1f} GiB",
        "threads per run": "1 (pinned to one core)" if hasattr(os, "sched_setaffinity") else "1 (not pinned)",
        **({"runs at a time": str(jobs)} if jobs else {}),
        **versions(distributions),
    }


def host_name() -> str:
    """The name of this machine in results: the environment variable EVALKIT_HOST, or what the system says."""
    return plain(os.environ.get("EVALKIT_HOST") or platform.node() or "unknown")


def load_average() -> str:
    """The load of this machine over the last minute."""
    return f"{os.getloadavg()[0]:.2f}" if hasattr(os, "getloadavg") else "unknown"


def machine() -> dict[str, str]:
    """The part of the description that differs between the machines of a cluster."""
    return {
        "python": f"{platform.python_implementation()} {platform.python_version()}",
        "system": f"{platform.system()} {platform.release()} {platform.machine()}",
        "processor": _read_processor(),
        "host": host_name(),
        "governor": _read_governor(),
        "load before": load_average(),
    }


def describe_provenance(
    description: Mapping[str, str], results: Iterable[RunResult], started: datetime
) -> dict[str, str]:
    """A description with a line on runs executed before ``started`` and on runs of several machines, where there are.

    ``description``: of this machine, from ``describe``.
    """
    provenances = [result.provenance for result in results if result.status not in NOT_EXECUTED]
    lines = {"earlier runs": _describe_earlier(provenances, started), "executed on": _describe_machines(provenances)}
    return {**description, **{name: line for name, line in lines.items() if line}}


def _describe_machines(provenances: Iterable[Mapping[str, Any]]) -> str:
    """The machines that runs were executed on, "" for a single machine."""
    names = ("host", "processor", "governor")
    counts = Counter(tuple(str(one.get(name, "unknown")) for name in names) for one in provenances)
    if len(counts) < 2:
        return ""
    return "; ".join(
        f"{count} {'run' if count == 1 else 'runs'} on {host} ({processor}, governor {governor})"
        for (host, processor, governor), count in sorted(counts.items())
    )


def _describe_earlier(provenances: Iterable[Mapping[str, Any]], started: datetime) -> str:
    """The runs executed before ``started``: how many, when, on which commit and processor; "" where there are none."""
    times = [(_parse_time(provenance.get("executed_at")), provenance) for provenance in provenances]
    earlier = [(time, provenance) for time, provenance in times if time is None or time < started]
    if not earlier:
        return ""
    dates = sorted(f"{time:%Y-%m-%d %H:%M}" for time, _ in earlier if time is not None)
    parts = [f"{len(earlier)} {'run' if len(earlier) == 1 else 'runs'}"]
    parts.append(
        f"executed {'..'.join(dict.fromkeys((dates[0], dates[-1])))} UTC" if dates else "executed at an unknown time"
    )
    for name in ("commit", "processor"):
        values = sorted({str(provenance.get(name, "unknown")) for _, provenance in earlier})
        parts.append(f"{name} {' and '.join(values)}")
    return ", ".join(parts)


def versions(distributions: Iterable[str]) -> dict[str, str]:
    """The version of each distribution, or of one that provides the same module, or "not installed"."""
    return {name: _find_version(name) for name in distributions}


def describe_origin(module: str) -> dict[str, Any]:
    """What a file of results says of its origin: the command of a module that runs now, the date, and versions."""
    return {
        "command": shlex.join(["python", "-m", module, *sys.argv[1:]]),
        "created": datetime.now(UTC).strftime("%Y-%m-%d"),
        "versions": versions(("evalkit", "numpy", "scipy")),
    }


def cores() -> list[int | None]:
    """Logical CPUs this process may use, the first of each physical core before any second; empty if it cannot pin."""
    if not hasattr(os, "sched_getaffinity"):
        return []
    seen: dict[str, int] = {}
    order: list[tuple[int, int]] = []
    for cpu in sorted(os.sched_getaffinity(0)):
        core = _read_siblings(cpu)
        seen[core] = seen.get(core, 0) + 1
        order.append((seen[core], cpu))
    return [cpu for _, cpu in sorted(order)]


def core_of_each(processes: int) -> list[int | None]:
    """One core per process to pin to, in turns; None if the system cannot pin."""
    known = cores() or [None]
    return [known[process % len(known)] for process in range(processes)]


def queue_cores(processes: int) -> SimpleQueue[int | None]:
    """The cores of ``core_of_each`` in a queue, from which a process takes one while it runs."""
    queue: SimpleQueue[int | None] = SimpleQueue()
    for core in core_of_each(processes):
        queue.put(core)
    return queue


def physical_cores() -> int:
    """Number of physical cores this process may use; that many runs at a time do not disturb each other."""
    usable = cores()
    known = psutil.cpu_count(logical=False) or psutil.cpu_count() or 1
    return min(known, len({_read_siblings(cpu) for cpu in usable})) if usable else known


def _read_siblings(cpu: int | None) -> str:
    """Identifier that the logical CPUs of one physical core share; other systems than Linux have one per CPU."""
    path = Path(f"/sys/devices/system/cpu/cpu{cpu}/topology/thread_siblings_list")
    try:
        return path.read_text(encoding="ascii").strip()
    except OSError:
        return str(cpu)


def _parse_time(text: object) -> datetime | None:
    try:
        return datetime.fromisoformat(str(text))
    except ValueError:
        return None


def _find_version(distribution: str) -> str:
    """The version of a distribution, or of another one with the same module: "0.19.0 (open3d-cpu)"."""
    try:
        return version(distribution)
    except PackageNotFoundError:
        others = packages_distributions().get(distribution.replace("-", "_"), [])
        return ", ".join(f"{version(name)} ({name})" for name in dict.fromkeys(others)) or "not installed"


def _read_governor() -> str:
    """Frequency governor of the first core; Linux only."""
    try:
        return Path("/sys/devices/system/cpu/cpu0/cpufreq/scaling_governor").read_text(encoding="ascii").strip()
    except OSError:
        return "unknown"


@cache
def _read_processor() -> str:
    if sys.platform == "linux":
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or "unknown"


def _read_commit() -> str:
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
        return "unknown (git is not installed)"
    return answer.stdout.strip() or "unknown"
