"""What several commands share: their consoles, ``NAME=VALUE`` settings, JSON on standard output."""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from evalkit.core.run_result import BROKEN, RunStatus
from evalkit.execution import environment
from evalkit.execution.dask_cluster import Cluster

out = Console(soft_wrap=True)
err = Console(stderr=True, soft_wrap=True)

ENGINES = ("local", "dask")

Out = Annotated[Path | None, typer.Option("--out", "-o", help="Results folder.", show_default="reports/build/NAME")]
Jobs = Annotated[int | None, typer.Option("--jobs", "-j", min=1, help="Runs at a time.", show_default="physical cores")]
Resume = Annotated[bool, typer.Option("--resume", help="Keep what is done, run only what is missing.")]
Rerun = Annotated[
    list[str] | None,
    typer.Option(
        help="Keep what is done, but make runs with this status again (repeatable); failed: whatever the way.",
        show_default=False,
    ),
]
Collect = Annotated[bool, typer.Option("--collect", help="Make no run: what is done, and what is missing.")]
Engine = Annotated[
    str, typer.Option(help=f"Where runs are made: {', '.join(ENGINES)}: on this machine, or by workers of a cluster.")
]
Scheduler = Annotated[
    str, typer.Option(help="A Dask scheduler, tcp://HOST:PORT.", show_default="a cluster of processes here")
]
AccuracyOnly = Annotated[
    bool, typer.Option("--accuracy-only", help="Times do not count: runs may be made beside others.")
]
Json = Annotated[bool, typer.Option("--json", help="Print the result as JSON.")]


@dataclass(frozen=True)
class Making:
    """How runs are made: see the options of the same names."""

    jobs: int
    resume: bool
    rerun: frozenset[RunStatus]
    collect: bool
    cluster: Cluster | None = None

    @classmethod
    def of(
        cls,
        jobs: int | None,
        resume: bool,
        rerun: list[str] | None,
        collect: bool,
        engine: str = "local",
        scheduler: str = "",
    ) -> Making:
        """What the command line says; a status or an engine that is none is a usage error."""
        again: set[RunStatus] = set()
        for name in rerun or []:
            found = [status for status in RunStatus if status == name]
            if not found:
                raise typer.BadParameter(f"--rerun: found '{name}', expected one of: {', '.join(RunStatus)}")
            again.update(BROKEN if name == "failed" else found)
        at_once = jobs or environment.physical_cores()
        return cls(at_once, resume or bool(rerun), frozenset(again), collect, cluster(engine, scheduler, at_once))


def cluster(engine: str, scheduler: str, jobs: int) -> Cluster | None:
    """The cluster that is asked for, None for this machine; what contradicts itself is a usage error."""
    if engine not in ENGINES:
        raise typer.BadParameter(f"--engine: found '{engine}', expected one of: {', '.join(ENGINES)}")
    if engine == "local" and scheduler:
        raise typer.BadParameter("--scheduler: needs --engine dask")
    return Cluster(scheduler, jobs) if engine == "dask" else None


def settings(items: list[str], option: str = "--set") -> dict[str, str]:
    """``["a=1", "b=x"]`` as a dictionary; what has no "=" is a usage error that names the option."""
    for item in items:
        if "=" not in item:
            raise typer.BadParameter(f"{option}: found '{item}', expected NAME=VALUE")
    return dict(item.split("=", 1) for item in items)


def print_json(content: object) -> None:
    """JSON on standard output, as it is."""
    sys.stdout.write(json.dumps(content, indent=1) + "\n")


def modules_from_here() -> None:
    """A module under development stands in the working directory: ``module:SPEC`` finds it there."""
    sys.path.append(str(Path.cwd()))
