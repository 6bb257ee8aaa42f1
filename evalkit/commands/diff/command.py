"""``evalkit diff``: what changed between two results folders."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table
from rich.text import Text

from evalkit.terminal import options, progress
from evalkit.terminal.options import Json, out


def share(text: str) -> float:
    """The share that "5%", "5 %" or "0.05" says; anything else or below zero is a usage error."""
    number = text.strip().removesuffix("%")
    try:
        value = float(number) / (100.0 if text.strip().endswith("%") else 1.0)
    except ValueError:
        value = -1.0
    if not 0.0 <= value < float("inf"):
        raise typer.BadParameter(f"found '{text}', expected a share such as 5% or 0.05")
    return value


def diff(
    old: Annotated[Path, typer.Argument(help="The results folder before.", show_default=False)],
    new: Annotated[Path, typer.Argument(help="The results folder after.", show_default=False)],
    limit_ate: Annotated[str, typer.Option(help="So much more error is no regression.")] = "5%",
    limit_time: Annotated[str, typer.Option(help="So much more CPU time is no regression.")] = "10%",
    everything: Annotated[bool, typer.Option("--all", help="List what did not change, too.")] = False,
    markdown: Annotated[bool, typer.Option("--markdown", help="Markdown for a pull request.")] = False,
    as_json: Json = False,
) -> None:
    """Tell what changed between two results folders: 1 if anything is worse by more than the noise and the limits."""
    from evalkit.commands.diff import differences, snapshot  # noqa: PLC0415
    from evalkit.commands.diff import text as change_text  # noqa: PLC0415
    from evalkit.metrics import all_metrics  # noqa: PLC0415 - scipy: only who compares pays for it

    limits = differences.Limits(share(limit_ate), share(limit_time))
    metrics = {metric.name: metric for metric in all_metrics()}
    found = differences.difference(snapshot.read(old), snapshot.read(new), tuple(metrics.values()), limits)
    if as_json:
        options.print_json(found.as_json())
    elif markdown:
        out.print(change_text.markdown(found, metrics), markup=False, highlight=False, emoji=False, end="")
    else:
        table = Table(*change_text.COLUMNS, expand=out.is_terminal)
        rows = change_text.rows(found, metrics, everything)
        for row in rows:
            table.add_row(*map(Text, row))
        if rows:
            progress.show(out, table)
        for line in (*change_text.remarks(found), change_text.verdict(found)):
            out.print(line, markup=False, highlight=False, emoji=False)
    if found.regressions:
        raise typer.Exit(1)
