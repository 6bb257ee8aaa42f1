"""``evalkit diff``: compare two results folders, or two sets of benchmarks."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table
from rich.text import Text

from evalkit.commands.diff import benchmark
from evalkit.terminal import options, progress
from evalkit.terminal.options import Json, out


def share(text: str) -> float:
    """Return the share written as "5%", "5 %" or "0.05". Raises typer.BadParameter for any other text."""
    number = text.strip().removesuffix("%")
    try:
        value = float(number) / (100.0 if text.strip().endswith("%") else 1.0)
    except ValueError:
        value = -1.0
    if not 0.0 <= value < float("inf"):
        raise typer.BadParameter(f"found '{text}', expected a share such as 5% or 0.05")
    return value


def diff(
    old: Annotated[Path, typer.Argument(help="The results before: a folder, or benchmarks.", show_default=False)],
    new: Annotated[Path, typer.Argument(help="The results after.", show_default=False)],
    limit_ate: Annotated[str, typer.Option(help="Tolerated increase of the error.")] = "5%",
    limit_time: Annotated[str, typer.Option(help="Tolerated increase of CPU time.")] = "10%",
    limit: Annotated[str, typer.Option(help="Benchmarks: tolerated increase of time or size.")] = "10%",
    across_machines: Annotated[
        bool, typer.Option("--across-machines", help="Benchmarks: accept different processors.")
    ] = False,
    everything: Annotated[bool, typer.Option("--all", help="List unchanged values as well.")] = False,
    markdown: options.Markdown = False,
    as_json: Json = False,
) -> None:
    """Compare two results folders, or two sets of benchmarks.

    Benchmarks are the JSON files of ``make bench``, or a folder of them. Exit code 1 if anything is worse by more than
    the noise and the limits.
    """
    if benchmark.is_benchmark(old):
        _diff_benchmarks(old, new, share(limit), across_machines, everything, markdown, as_json)
    else:
        _diff_results(old, new, (share(limit_ate), share(limit_time)), everything, markdown, as_json)


def _diff_results(
    old: Path, new: Path, shares: tuple[float, float], everything: bool, markdown: bool, as_json: bool
) -> None:
    from evalkit.commands.diff import differences, snapshot  # noqa: PLC0415 - loads scipy
    from evalkit.commands.diff import text as change_text  # noqa: PLC0415 - as above
    from evalkit.metrics import all_metrics  # noqa: PLC0415 - as above

    metrics = {metric.name: metric for metric in all_metrics()}
    limits = differences.Limits(*shares)
    found = differences.difference(snapshot.read(old), snapshot.read(new), tuple(metrics.values()), limits)
    if as_json:
        options.print_json(found.as_json())
    elif markdown:
        _print_markdown(change_text.markdown(found, metrics))
    else:
        lines = (*change_text.remarks(found), change_text.verdict(found))
        _print_table(change_text.COLUMNS, change_text.rows(found, metrics, everything), lines)
    if found.regressions:
        raise typer.Exit(1)


def _diff_benchmarks(
    old: Path, new: Path, limit: float, across_machines: bool, everything: bool, markdown: bool, as_json: bool
) -> None:
    from evalkit.commands.diff import benchmark_comparison  # noqa: PLC0415 - loads scipy

    if everything:
        raise typer.BadParameter("--all: benchmarks are always listed in full")
    found = benchmark_comparison.compared(benchmark.read(old), benchmark.read(new), limit, across_machines)
    if as_json:
        options.print_json(found.as_json())
    elif markdown:
        _print_markdown(benchmark_comparison.markdown(found))
    else:
        lines = (*found.apart, benchmark_comparison.verdict(found))
        _print_table(benchmark_comparison.COLUMNS, benchmark_comparison.rows(found), lines)
    if found.regressions:
        raise typer.Exit(1)


def _print_markdown(text: str) -> None:
    out.print(text, markup=False, highlight=False, emoji=False, end="")


def _print_table(columns: Sequence[str], rows: Iterable[Sequence[str]], lines: Iterable[str]) -> None:
    """Print a table, unless it is empty, and the lines below it."""
    table = Table(*columns, expand=out.is_terminal)
    for row in rows:
        table.add_row(*map(Text, row))
    if table.row_count:
        progress.show(out, table)
    for line in lines:
        out.print(line, markup=False, highlight=False, emoji=False)
