"""The reference page of the commands, generated from their click parameters."""

from __future__ import annotations

import inspect
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from evalkit import cli
from evalkit.plugins import registry
from evalkit_docs.markup import code, heading, page, table, text

COLUMNS = ("", "takes", "default", "meaning")
TYPES = {"integer": "a whole number", "float": "a number", "text": "a text", "path": "a path"}
LEAD = """\
Every command prints the same with `--help`. Results go to standard output, progress and remarks to standard error. The
[glossary](../glossary.md#exit-codes) lists the exit codes."""


@dataclass(frozen=True)
class Option:
    """One argument or option of a command, as text."""

    written: str
    takes: str
    default: str
    meaning: str
    positional: bool


def write_commands() -> str:
    """Return the page of every command with its arguments and options (Markdown)."""
    return page("# Commands", LEAD, *(_section(name, command) for name, command in load_commands().items()))


def load_commands() -> dict[str, Any]:
    """Return every click command by its full name, such as "datasets list", in the order of the help."""
    names = (*cli.COMMANDS, *registry.names("commands"))
    return {full: command for name in names for full, command in _flatten(name, cli.load_command(name))}


def find_options(command: Any) -> list[Option]:
    """Return the arguments and options of a click command."""
    return [_option(parameter) for parameter in command.params if parameter.name != "help"]


def _flatten(name: str, command: Any) -> Iterator[tuple[str, Any]]:
    subcommands = getattr(command, "commands", None)
    if subcommands is None:
        yield name, command
    else:
        yield from ((f"{name} {inner}", one) for inner, one in subcommands.items())


def _section(name: str, command: Any) -> str:
    options = sorted(find_options(command), key=lambda one: not one.positional)
    arguments = [one.written if one.default == "required" else f"[{one.written}]" for one in options if one.positional]
    usage = " ".join((f"evalkit {name}", *arguments, "[OPTIONS]"))
    rows = [(code(one.written), text(one.takes), text(one.default), text(one.meaning)) for one in options]
    return page(
        heading(2, f"evalkit {name}", name.replace(" ", "-")),
        text(inspect.cleandoc(command.help or "")),
        f"<pre><code>{text(usage)}</code></pre>",
        table(COLUMNS, rows) if rows else "",
    ).rstrip()


def _option(parameter: Any) -> Option:
    positional = parameter.param_type_name == "argument"
    many = bool(parameter.multiple if not positional else parameter.nargs != 1)
    if positional:
        written = str(parameter.name).upper() + ("..." if many else "")
    else:
        written = ", ".join(parameter.opts)
        if parameter.secondary_opts:
            written += f" / {', '.join(parameter.secondary_opts)}"
    return Option(written, _takes(parameter, many), _default(parameter), parameter.help or "", positional)


def _takes(parameter: Any, many: bool) -> str:
    if getattr(parameter, "is_flag", False):
        return ""
    kind = parameter.type
    name = kind.name.removesuffix(" range")
    words = f"one of {', '.join(kind.choices)}" if name == "choice" else TYPES.get(name, "a text")
    low, high = getattr(kind, "min", None), getattr(kind, "max", None)
    if low is not None and high is not None:
        words += f" within {low:g} and {high:g}"
    elif low is not None or high is not None:
        words += f", at least {low:g}" if low is not None else f", at most {high:g}"
    return f"{words}; repeatable" if many and parameter.param_type_name == "option" else words


def _default(parameter: Any) -> str:
    if isinstance(parameter.show_default, str):
        return parameter.show_default
    if parameter.required:
        return "required"
    return "" if not parameter.default or parameter.default is True or not parameter.show_default else str(parameter.default)
