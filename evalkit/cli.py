"""The command line: the commands, imported when they are called.

Exit codes: 0 success, 1 a failed run or a broken rule, 2 wrong usage, 3 incomplete results, 128 + N ended by signal N.
"""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from typing import Annotated, Any

import typer
from typer.core import TyperCommand, TyperGroup
from typer.main import get_group

from evalkit import __version__
from evalkit.core.errors import NotInstalled
from evalkit.plugins import registry
from evalkit.terminal.command_spec import CommandSpec
from evalkit.terminal.console import out
from evalkit.terminal.entry_point import run

START, VALIDATE, QUESTIONS, RESULTS, REFERENCE = "Start", "My implementation", "Questions", "Results", "Reference"
OTHER = "Other commands"
_SUMMARIES: Mapping[str, tuple[str, str]] = {
    "compare": (START, "Compare methods on a recording or an experiment, and write the report."),
    "validate": (VALIDATE, "Validate an implementation against a reference, level by level."),
    "basin": (QUESTIONS, "Measure convergence basins: success against the error of the initial guess."),
    "realtime": (QUESTIONS, "Simulate a slower device and measure the drift caused by dropped scans."),
    "study": (QUESTIONS, "Run a designed experiment: main effects, interactions, operating envelope."),
    "tune": (QUESTIONS, "Tune back ends with equal budgets and compare them on held-out sequences."),
    "diff": (RESULTS, "Compare two results folders, or two sets of benchmarks."),
    "export": (RESULTS, "Export a finished comparison to other file formats."),
    "schema": (REFERENCE, "Print the JSON Schema of experiment, study and tuning files, for editors."),
    "list": (REFERENCE, "List back ends, mappers, data sets and metrics, or print the card of a metric."),
}

COMMANDS: Mapping[str, CommandSpec] = {
    name: CommandSpec(summary, panel, f"evalkit.commands.{name}.command:{name if name != 'list' else 'list_names'}")
    for name, (panel, summary) in _SUMMARIES.items()
}
"""The commands of evalkit itself; plug-ins register theirs as entry points of the group ``evalkit.commands``."""


class LazyGroup(TyperGroup):
    """A group that imports the module of a command only when the command is called.

    The help and the shell completion need the specs of the commands alone.
    """

    def list_commands(self, ctx: Any) -> list[str]:  # noqa: ARG002 - the signature of click
        """Return the names of all commands."""
        return [*COMMANDS, *registry.names("commands")]

    def get_command(self, ctx: Any, cmd_name: str) -> Any:
        """Return a command as the help shows it, without its options."""
        if cmd_name not in self.list_commands(ctx):
            return None
        spec = COMMANDS.get(cmd_name) or _plugin_spec(cmd_name)
        return TyperCommand(cmd_name, help=spec.summary, rich_help_panel=spec.panel)

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Return the name of the command, the loaded command, and the remaining arguments."""
        self.commands.update({name: TyperCommand(name) for name in self.list_commands(ctx)})  # for "did you mean"
        name, command, rest = super().resolve_command(ctx, args)
        return name, command and load_command(str(name)), rest


app = typer.Typer(
    cls=LazyGroup,
    help="Compare 2D lidar registration methods, and validate your own implementation.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
)


def main() -> None:
    """Run the program."""
    run(app)


@app.callback(invoke_without_command=True)
def _root(version: Annotated[bool, typer.Option("--version", help="Print the version.")] = False) -> None:
    if version:
        out.print(f"evalkit {__version__}")
        raise typer.Exit


def load_command(name: str) -> Any:
    """Import a command and return it as a click command. Raises NotInstalled if a plug-in does not load."""
    function = load_function(name)
    wrapper = typer.Typer(add_completion=False, pretty_exceptions_enable=False)
    wrapper.callback()(lambda: None)
    if isinstance(function, typer.Typer):
        wrapper.add_typer(function, name=name)
    else:
        wrapper.command(name)(function)
    command = get_group(wrapper).commands[name]
    _join_lines(command)
    return command


def _join_lines(command: Any) -> None:
    """Join the lines of each paragraph of a help text, so that it wraps at the width of the terminal.

    The help is a docstring, broken at the width of the code. A paragraph that starts with ``\\b`` is kept as it is.
    """
    paragraphs = inspect.cleandoc(command.help or "").replace("``", "").split("\n\n")
    command.help = "\n\n".join(one if one.startswith("\b") else " ".join(one.split()) for one in paragraphs)
    for part in getattr(command, "commands", {}).values():
        _join_lines(part)


def load_function(name: str) -> Any:
    """Import a command and return its function, or its ``typer.Typer`` if it has subcommands."""
    found = COMMANDS.get(name) or registry.load("commands", name, object)
    function = found.load() if isinstance(found, CommandSpec) else found
    if not callable(function):
        raise NotInstalled(name, f"its command is a {type(function).__name__}", "expected a function or a typer.Typer")
    return function


def _plugin_spec(name: str) -> CommandSpec:
    """Return the spec of a plug-in's command; of a plug-in that does not load one that says why."""
    try:
        found = registry.load("commands", name, object)
    except NotInstalled as error:
        return CommandSpec(str(error), OTHER, "")
    if isinstance(found, CommandSpec):
        return found
    summary = found.info.help if isinstance(found, typer.Typer) else inspect.getdoc(found)
    return CommandSpec((summary or "").partition("\n")[0], OTHER, "")
