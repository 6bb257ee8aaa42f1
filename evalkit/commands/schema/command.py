"""``evalkit schema``: print the JSON Schema of a kind of file."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, get_args

import typer

from evalkit.config.forms import FileKind
from evalkit.core.errors import UnknownName
from evalkit.io.json_values import indent_json
from evalkit.io.output_files import write_named_file
from evalkit.terminal.console import out


def schema(
    kind: Annotated[str, typer.Argument(help="experiment, study or tuning.", show_default=False)],
    file: Annotated[Path | None, typer.Option("--out", "-o", help="Write it to this file.", show_default=False)] = None,
) -> None:
    """Print the JSON Schema of experiment, study and tuning files, for editors.

    It knows the installed methods and data sets. An editor that reads it completes names, and marks mistakes while
    typing.
    """
    from evalkit.config.json_schema import make_schema  # noqa: PLC0415 - loads numpy

    kinds: dict[str, FileKind] = {name: name for name in get_args(FileKind)}
    if kind not in kinds:
        raise UnknownName("kind of file", kind, kinds)
    text = indent_json(make_schema(kinds[kind]))
    if file is None:
        out.file.write(text)
    else:
        write_named_file(file, text)
