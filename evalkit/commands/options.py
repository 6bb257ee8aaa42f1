"""What several commands share: their consoles, ``NAME=VALUE`` settings, JSON on standard output."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

out = Console(soft_wrap=True)
err = Console(stderr=True, soft_wrap=True)

Out = Annotated[Path | None, typer.Option("--out", "-o", help="Results folder.", show_default="reports/build/NAME")]
Jobs = Annotated[int | None, typer.Option("--jobs", "-j", min=1, help="Runs at a time.", show_default="physical cores")]
Resume = Annotated[bool, typer.Option("--resume", help="Keep what is done, run only what is missing.")]
Json = Annotated[bool, typer.Option("--json", help="Print the result as JSON.")]


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
