"""The page of every command, from the functions that the program is made of."""

from __future__ import annotations

import inspect
import types
from collections.abc import Callable, Iterator
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
COLUMNS = ("", "takes", "default", "what it is")
KINDS: dict[type, str] = {int: "a whole number", float: "a number", str: "a text", Path: "a path"}
LEAD = """\
Every command answers `--help` with the same. Results go to standard output, progress and remarks to standard error.
What the exit codes mean stands in the [glossary](../glossary.md#exit-codes)."""


@dataclass(frozen=True)
class Given:
    """One argument or option: how it is written, what it takes, what it is unless given, and what it does."""

    written: str
    takes: str
    default: str
    meaning: str
    positional: bool


def commands() -> str:
    """Markdown: every command with its arguments and options."""
    parts = ["# Commands", LEAD]
    for name, function in functions().items():
        parts.append(_command(name, function))
    return page(*parts)


def functions() -> dict[str, Function]:
    """Every command by its whole name ("metrics show"), in the order of the help; those of plug-ins last."""
    found = dict(_of(cli.app))
    for name in registry.names("commands"):
        own = registry.load("commands", name, object)
        if isinstance(own, typer.Typer):
            found |= {f"{name} {inner}": function for inner, function in _of(own)}
        elif callable(own):
            found[name] = own
    return found


def given(function: Function) -> list[Given]:
    """The arguments and options of a command."""
    hints = get_type_hints(function, include_extras=True)
    read = (_given(name, hints[name], one.default) for name, one in inspect.signature(function).parameters.items())
    return [one for one in read if one is not None]


def _of(app: typer.Typer) -> Iterator[tuple[str, Function]]:
    for info in app.registered_commands:
        if info.callback is not None:
            yield info.name or info.callback.__name__.replace("_", "-"), info.callback
    for group in app.registered_groups:
        if group.typer_instance is not None:
            yield from ((f"{group.name} {name}", function) for name, function in _of(group.typer_instance))


def _command(name: str, function: Function) -> str:
    every = sorted(given(function), key=lambda one: not one.positional)
    placed = [one.written if one.default == "required" else f"[{one.written}]" for one in every if one.positional]
    usage = " ".join((f"evalkit {name}", *placed, "[OPTIONS]"))
    rows = [(code(one.written), text(one.takes), text(one.default), text(one.meaning)) for one in every]
    return page(
        heading(2, f"evalkit {name}", name.replace(" ", "-")),
        text(inspect.getdoc(function) or ""),
        f"<pre><code>{text(usage)}</code></pre>",
        table(COLUMNS, rows) if rows else "",
    ).rstrip()


def _given(name: str, hint: Any, default: Any) -> Given | None:
    info = next((one for one in get_args(hint)[1:] if isinstance(one, (OptionInfo, ArgumentInfo))), None)
    if info is None:
        return None
    kind, many = _kind(get_args(hint)[0])
    positional = isinstance(info, ArgumentInfo)
    dashed = name.replace("_", "-")
    written = name.upper() if positional else ", ".join(_declared(info) or (f"--{dashed}",))
    if kind is bool and default is True:
        written = f"{written} / --no-{dashed}"
    return Given(
        f"{written}..." if positional and many else written,
        _takes(kind, info, many),
        _default(info, default),
        info.help or "",
        positional,
    )


def _declared(info: OptionInfo | ArgumentInfo) -> tuple[str, ...]:
    """How an option is written, where it says so: in an annotation the first of its names stands as its default."""
    first = (info.default,) if isinstance(info.default, str) and info.default.startswith("-") else ()
    return (*first, *(info.param_decls or ()))


def _kind(hint: Any) -> tuple[Any, bool]:
    """The type that is meant, and whether there may be many of it."""
    if get_origin(hint) in (Union, types.UnionType):
        hint = next(one for one in get_args(hint) if one is not type(None))
    return (get_args(hint)[0], True) if get_origin(hint) is list else (hint, False)


def _takes(kind: Any, info: OptionInfo | ArgumentInfo, many: bool) -> str:
    if kind is bool:
        return ""
    if get_origin(kind) is Literal:
        told = "one of " + ", ".join(map(str, get_args(kind)))
    elif isinstance(kind, type) and issubclass(kind, Enum):
        told = "one of " + ", ".join(str(one.value) for one in kind)
    else:
        told = KINDS.get(kind, "a text")
    low, high = info.min, info.max
    if low is not None and high is not None:
        told += f" within {low:g} and {high:g}"
    elif low is not None or high is not None:
        told += f", at least {low:g}" if low is not None else f", at most {high:g}"
    return f"{told}; repeatable" if many and isinstance(info, OptionInfo) else told


def _default(info: OptionInfo | ArgumentInfo, default: Any) -> str:
    if isinstance(info.show_default, str):
        return info.show_default
    if default is inspect.Parameter.empty:
        return "required"
    return "" if default in (None, "", False, True) or info.show_default is False else str(default)
