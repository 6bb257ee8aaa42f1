"""``evalkit bench``: whether the benchmarks of ``make bench`` have become slower."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table
from rich.text import Text

from evalkit.commands.diff import benchmark
from evalkit.commands.diff.command import share
from evalkit.terminal import options, progress
from evalkit.terminal.options import Json, out

bench = typer.Typer(help="Compare benchmarks.", no_args_is_help=True)


@bench.callback()
def _root() -> None:
    """Compare what ``make bench`` measured (reports/build/bench) before and after a change."""


@bench.command()
def compare(
    old: Annotated[Path, typer.Argument(help="What was measured before: a file, or a folder.", show_default=False)],
    new: Annotated[Path, typer.Argument(help="What was measured after.", show_default=False)],
    limit: Annotated[str, typer.Option(help="So much more is no regression.")] = "10%",
    across_machines: Annotated[bool, typer.Option("--across-machines", help="Different processors, too.")] = False,
    markdown: Annotated[bool, typer.Option("--markdown", help="Markdown for a pull request.")] = False,
    as_json: Json = False,
) -> None:
    """Tell what became slower or larger: 1 if anything did by more than the noise and the limit."""
    from evalkit.commands.diff import benchmark_comparison  # noqa: PLC0415 - scipy: only who compares pays for it

    found = benchmark_comparison.compared(benchmark.read(old), benchmark.read(new), share(limit), across_machines)
    if as_json:
        options.print_json(found.as_json())
    elif markdown:
        out.print(benchmark_comparison.markdown(found), markup=False, highlight=False, emoji=False, end="")
    else:
        table = Table(*benchmark_comparison.COLUMNS, expand=out.is_terminal)
        for row in benchmark_comparison.rows(found):
            table.add_row(*map(Text, row))
        if table.row_count:
            progress.show(out, table)
        for line in (*found.apart, benchmark_comparison.verdict(found)):
            out.print(line, markup=False, highlight=False, emoji=False)
    if found.regressions:
        raise typer.Exit(1)
