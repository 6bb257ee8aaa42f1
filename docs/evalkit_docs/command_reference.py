"""The page of options command, from the functions that the program is made of."""

from __future__ import annotations

import inspect
import types
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Any, Literal, Union, get_args, get_origin, get_type_hints

import typer
from typer.models import ArgumentInfo, OptionInfo

from evalkit import cli
from evalkit.plugins import registry
from evalkit_docs.markup import code, heading, page, table, text

Function = Callable[..., Any]
COLUMNS = ("", "takes", "default", "meaning")
TYPES: dict[type, str] = {int: "a whole number", float: "a number", str: "a text", Path: "a path"}
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
    """Return the page of options command with its arguments and options (Markdown)."""
    return page("# Commands", LEAD, *(_command(name, function) for name, function in load_functions().items()))


def load_functions() -> dict[str, Function]:
    """Return the function of options command by its full name, such as "datasets list"; those of plug-ins last."""
    functions: dict[str, Function] = {}
    for name in (*cli.COMMANDS, *registry.names("commands")):
        loaded = cli.load_function(name)
        functions |= _subcommands(name, loaded) if isinstance(loaded, typer.Typer) else {name: loaded}
    return functions


def find_options(function: Function) -> list[Option]:
    """Return the arguments and options of a command."""
    hints = get_type_hints(function, include_extras=True)
    parameters = inspect.signature(function).parameters.items()
    options = (_option(name, hints[name], parameter.default) for name, parameter in parameters)
    return [option for option in options if option is not None]


def _subcommands(name: str, app: typer.Typer) -> dict[str, Function]:
    commands = ((info.name, info.callback) for info in app.registered_commands)
    return {f"{name} {inner or function.__name__}": function for inner, function in commands if function is not None}


def _command(name: str, function: Function) -> str:
    options = sorted(find_options(function), key=lambda one: not one.positional)
    arguments = [one.written if one.default == "required" else f"[{one.written}]" for one in options if one.positional]
    usage = " ".join((f"evalkit {name}", *arguments, "[OPTIONS]"))
    rows = [(code(one.written), text(one.takes), text(one.default), text(one.meaning)) for one in options]
    return page(
        heading(2, f"evalkit {name}", name.replace(" ", "-")),
        text(inspect.getdoc(function) or ""),
        f"<pre><code>{text(usage)}</code></pre>",
        table(COLUMNS, rows) if rows else "",
    ).rstrip()


def _option(name: str, hint: Any, default: Any) -> Option | None:
    info = next((one for one in get_args(hint)[1:] if isinstance(one, (OptionInfo, ArgumentInfo))), None)
    if info is None:
        return None
    kind, many = _kind(get_args(hint)[0])
    positional = isinstance(info, ArgumentInfo)
    dashed = name.replace("_", "-")
    written = name.upper() if positional else ", ".join(_list_names(info) or (f"--{dashed}",))
    if kind is bool and default is True:
        written = f"{written} / --no-{dashed}"
    return Option(
        f"{written}..." if positional and many else written,
        _takes(kind, info),
        _default(info, default),
        info.help or "",
        positional,
    )


def _list_names(info: OptionInfo | ArgumentInfo) -> tuple[str, ...]:
    """Return the declared names of an option; in an annotation typer keeps the first name as the default."""
    first = (info.default,) if isinstance(info.default, str) and info.default.startswith("-") else ()
    return (*first, *(info.param_decls or ()))


def _kind(hint: Any) -> tuple[Any, bool]:
    """Return the type of one value, and whether the option is repeatable."""
    if get_origin(hint) in (Union, types.UnionType):
        hint = next(one for one in get_args(hint) if one is not type(None))
    return (get_args(hint)[0], True) if get_origin(hint) is list else (hint, False)


def _takes(kind: Any, info: OptionInfo | ArgumentInfo) -> str:
    if kind is bool:
        return ""
    if get_origin(kind) is Literal:
        words = "one of " + ", ".join(map(str, get_args(kind)))
    elif isinstance(kind, type) and issubclass(kind, Enum):
        words = "one of " + ", ".join(str(one.value) for one in kind)
    else:
        words = TYPES.get(kind, "a text")
    low, high = info.min, info.max
    if low is not None and high is not None:
        words += f" within {low:g} and {high:g}"
    elif low is not None or high is not None:
        words += f", at least {low:g}" if low is not None else f", at most {high:g}"
    return words


def _default(info: OptionInfo | ArgumentInfo, default: Any) -> str:
    if isinstance(info.show_default, str):
        return info.show_default
    if default is inspect.Parameter.empty:
        return "required"
    return "" if default in (None, "", False, True) or info.show_default is False else str(default)
