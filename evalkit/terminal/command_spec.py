"""The spec of a command: what the help shows of it, and where its function is."""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from typing import Any


@dataclass(frozen=True)
class CommandSpec:
    """A command of the program, described without importing it.

    ``summary``: one line for the help. ``panel``: the panel of the help, by its title. ``function``: the address
    ``module:name`` of the command's function, or of a ``typer.Typer`` with subcommands.
    """

    summary: str
    panel: str
    function: str

    def load(self) -> Any:
        """Import the module and return the function."""
        module, _, name = self.function.partition(":")
        return getattr(import_module(module), name)
