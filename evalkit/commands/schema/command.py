"""``evalkit schema``: print the JSON Schema of a kind of file."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from evalkit.core.errors import UnknownName
from evalkit.io.output_files import write_texts
from evalkit.terminal.options import out

if TYPE_CHECKING:
    from evalkit.config.models import Kind

KINDS: Mapping[str, Kind] = {"experiment": "experiment", "study": "study", "tuning": "tuning"}


def schema(
    kind: Annotated[str, typer.Argument(help="experiment, study or tuning.", show_default=False)],
    file: Annotated[Path | None, typer.Option("--out", "-o", help="Write it to this file.", show_default=False)] = None,
) -> None:
    """Print the JSON Schema of experiment, study and tuning files, for editors.

    It knows the installed methods and data sets. An editor that reads it completes names, and marks mistakes while
    typing.
    """
    from evalkit.config.models import make_schema  # noqa: PLC0415 - loads pydantic

    if kind not in KINDS:
        raise UnknownName("kind of file", kind, KINDS)
    text = json.dumps(make_schema(KINDS[kind]), indent=1) + "\n"
    if file is None:
        out.file.write(text)
    else:
        write_texts(file.parent, {file.name: text})
