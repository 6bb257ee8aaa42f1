"""Options that several commands share, and their shell completion."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from evalkit.plugins import registry

if TYPE_CHECKING:
    from evalkit.execution.dask_cluster import Cluster

EngineName = Literal["local", "dask"]
EXECUTION = "Execution"
"""The panel of the options that say how runs are executed."""


def complete(kind: str) -> Callable[[str], list[str]]:
    """Return a shell completion of the registered names of a kind: "backends", "mappers" or "datasets"."""

    def names(incomplete: str) -> list[str]:
        return [name for name in registry.names(kind) if name.startswith(incomplete)]

    return names


def complete_list(kind: str) -> Callable[[str], list[str]]:
    """Return a shell completion of the registered names of a kind, in a list separated by commas."""

    def names(incomplete: str) -> list[str]:
        before, comma, last = incomplete.rpartition(",")
        return [f"{before}{comma}{name}" for name in complete(kind)(last)]

    return names


def complete_metric(incomplete: str) -> list[str]:
    """Return the names of metrics that start with a text."""
    from evalkit.metrics import all_metrics  # noqa: PLC0415 - loads scipy

    return [metric.name for metric in all_metrics() if metric.name.startswith(incomplete)]


def complete_status() -> list[str]:
    """Return what ``--rerun`` takes."""
    from evalkit.core.run_result import DISTURBED  # noqa: PLC0415 - loads numpy
    from evalkit.core.run_status import RunStatus  # noqa: PLC0415 - loads numpy

    return [*(status.value for status in RunStatus), DISTURBED]


MAX_COUNT = 10_000
"""Largest number of an option that counts and has no other limit: more would take days or fill the memory."""

MAX_JOBS, MAX_SEEDS, MAX_SECONDS = 1_000, 1_000, 1e6


def count(low: int, *names: str, high: int = MAX_COUNT, **shown: Any) -> Any:
    """Return an option that takes a whole number from ``low`` to ``high``."""
    return typer.Option(*names, min=low, max=high, **shown)


def number(low: float, high: float, **shown: Any) -> Any:
    """Return an option that takes a number from ``low`` to ``high``, which nan is not."""
    return typer.Option(min=low, max=high, callback=_refuse_nan, **shown)


def _refuse_nan(value: float) -> float:
    if math.isnan(value):
        raise typer.BadParameter(f"{value} is not a number")
    return value


Backend = Annotated[
    str,
    typer.Argument(
        help="A registered name, module:SPEC, lib:./libmine.so or 'exec:ssh board ./my_icp'.",
        show_default=False, autocompletion=complete("backends"),
    ),
]  # fmt: skip
Backends = Annotated[
    list[str] | None,
    typer.Argument(
        help="Registered names, module:SPEC, lib:./libmine.so or 'exec:ssh board ./my_icp'.",
        show_default="all", autocompletion=complete("backends"),
    ),
]  # fmt: skip
BackendSettings = Annotated[list[str] | None, typer.Option("--set", help="NAME=VALUE of every back end (repeatable).")]
On = Annotated[
    list[str] | None,
    typer.Option(
        help="A data set with its parameters, 'NAME laps=0.3' (repeatable).", show_default=False,
        autocompletion=complete("datasets"),
    ),
]  # fmt: skip
Sequences = Annotated[list[str] | None, typer.Option(help="Only this sequence (repeatable).", show_default="all")]
Methods = Annotated[list[str] | None, typer.Option(help="Only this method (repeatable).", show_default="all")]
Seeds = Annotated[list[int] | None, typer.Option(help="Only this seed (repeatable).", show_default="all")]
Out = Annotated[Path | None, typer.Option("--out", "-o", help="Results folder.", show_default="./evalkit-results")]
Jobs = Annotated[
    int | None,
    count(
        1,
        "--jobs",
        "-j",
        high=MAX_JOBS,
        help="Parallel runs.",
        show_default="physical cores",
        rich_help_panel=EXECUTION,
    ),
]
Resume = Annotated[
    bool, typer.Option("--resume", help="Keep finished runs, and run only what is missing.", rich_help_panel=EXECUTION)
]
Rerun = Annotated[
    list[str] | None,
    typer.Option(
        help="Keep finished runs except those with this status (repeatable); failed: any kind of failure; disturbed: "
        "runs whose times other processes disturbed.",
        show_default=False, rich_help_panel=EXECUTION, autocompletion=complete_status,
    ),
]  # fmt: skip
Collect = Annotated[
    bool, typer.Option("--collect", help="Run nothing; report what is finished and missing.", rich_help_panel=EXECUTION)
]
Engine = Annotated[
    EngineName,
    typer.Option(
        help="local: run on this machine; dask: run on the workers of a Dask cluster.", rich_help_panel=EXECUTION
    ),
]  # fmt: skip
SchedulerAddress = Annotated[
    str,
    typer.Option(
        help="A Dask scheduler, tls://HOST:PORT.", show_default="a new cluster on this machine",
        rich_help_panel=EXECUTION,
    ),
]  # fmt: skip
Insecure = Annotated[
    bool,
    typer.Option(
        "--insecure", help="Accept a scheduler without TLS, in a trusted network only.", rich_help_panel=EXECUTION
    ),
]
AccuracyOnly = Annotated[
    bool,
    typer.Option("--accuracy-only", help="Discard times, so that runs may share a core.", rich_help_panel=EXECUTION),
]
READER: dict[str, Any] = {"help": "The data set whose reader is used.", "show_default": "by its content"}
"""The option ``--reader``, which the commands show in different panels."""

Markdown = Annotated[bool, typer.Option("--markdown", help="Print Markdown, for a pull request.")]
Json = Annotated[bool, typer.Option("--json", help="Print the result as JSON.")]


@dataclass(frozen=True)
class RunOptions:
    """How runs are executed; the fields are the options of the same names."""

    jobs: int
    resume: bool
    rerun: frozenset[str]
    collect: bool
    cluster: Cluster | None = None

    @classmethod
    def of(
        cls,
        jobs: int | None,
        resume: bool,
        rerun: list[str] | None,
        collect: bool,
        engine: EngineName = "local",
        scheduler: str = "",
        insecure: bool = False,
    ) -> RunOptions:
        """Return the checked options. Raises typer.BadParameter for an unknown status."""
        from evalkit.core.run_result import DISTURBED  # noqa: PLC0415 - loads numpy
        from evalkit.core.run_status import BROKEN, RunStatus  # noqa: PLC0415 - loads numpy
        from evalkit.execution.environment import physical_cores  # noqa: PLC0415 - loads psutil

        again: set[str] = set()
        known = (*RunStatus, DISTURBED)
        for name in rerun or []:
            if name not in known:
                raise typer.BadParameter(f"--rerun: found '{name}', expected one of: {', '.join(known)}")
            again.update(BROKEN if name == "failed" else [name])
        workers = jobs or physical_cores()
        return cls(
            workers, resume or bool(rerun), frozenset(again), collect, cluster(engine, scheduler, workers, insecure)
        )


def cluster(engine: EngineName, scheduler: str, jobs: int, insecure: bool = False) -> Cluster | None:
    """Return the requested cluster, None for this machine. Raises typer.BadParameter if the options contradict."""
    from evalkit.execution.dask_cluster import Cluster  # noqa: PLC0415 - rarely used

    if engine == "local" and scheduler:
        raise typer.BadParameter("--scheduler: needs --engine dask")
    return Cluster(scheduler, jobs, insecure=insecure) if engine == "dask" else None


def add_working_directory() -> None:
    """Put the working directory on ``sys.path``, so that ``module:SPEC`` finds a module under development."""
    sys.path.append(str(Path.cwd()))
