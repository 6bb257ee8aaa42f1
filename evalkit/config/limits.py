"""The limits of a run and their defaults; ``[limits]`` of an experiment changes them.

``evalkit.execution.run_process`` enforces them. The keys of the file are in ``evalkit.config.forms.LIMITS``.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Limits:
    """Limits of one run: ``run_*`` for the whole run, ``scan_*`` for the time without an answer.

    ``*_s``: wall clock; ``*_cpu_s``: CPU time. CPU time and memory include all descendants of the run's process.
    """

    run_s: float = 900.0
    scan_s: float = 60.0
    run_cpu_s: float = 3600.0
    scan_cpu_s: float = 240.0
    memory_mib: int = 2048
