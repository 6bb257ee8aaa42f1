"""``evalkit diff``: compare two results folders, or two sets of benchmark files."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.table import Table

from evalkit.core.errors import BadData
from evalkit.terminal import options, progress
from evalkit.terminal.console import out, print_json
from evalkit.terminal.options import Json

if TYPE_CHECKING:
    from evalkit.commands.diff.changes import ChangeText


def parse_share(text: str) -> float:
    """Return the share that "5%", "5 %" or "0.05" states; anything else or below zero is a usage error."""
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
    from evalkit.commands.diff import benchmark  # noqa: PLC0415 - SciPy: loaded only to compare
    from evalkit.commands.diff.changes import format_markdown  # noqa: PLC0415

    error, time, size = parse_share(limit_ate), parse_share(limit_time), parse_share(limit)
    kinds = [benchmark.is_benchmark(path) for path in (old, new)]
    if kinds[0] != kinds[1]:
        what = "benchmarks" if kinds[1] else "results"
        raise BadData(str(new), "", f"holds {what}, {old} does not", "compare two results folders or two benchmarks")
    listed = everything and not markdown
    text = (
        _compare_benchmarks(old, new, size, across_machines, listed)
        if all(kinds)
        else _compare_results(old, new, error, time, listed)
    )
    if as_json:
        print_json(text.content)
    elif markdown:
        out.print(format_markdown(text), end="")
    else:
        _print(text)
    if text.regressions:
        raise typer.Exit(1)


def _compare_benchmarks(old: Path, new: Path, limit: float, across_machines: bool, everything: bool) -> ChangeText:
    from evalkit.commands.diff.benchmark import load_benchmarks  # noqa: PLC0415
    from evalkit.commands.diff.benchmark_changes import (  # noqa: PLC0415
        compare_benchmarks,
        describe_benchmark_diff,
    )

    before, after = load_benchmarks(old), load_benchmarks(new)
    compared = compare_benchmarks(before, after, limit, across_machines)
    if not compared.changes:
        held = [f"{', '.join(sorted(each))} in {path}" for path, each in ((old, before), (new, after))]
        raise BadData(
            str(new), "", f"nothing was compared: no series is in both ({'; '.join(held)})",
            "give two measurements of one benchmark",
        )  # fmt: skip
    return describe_benchmark_diff(compared, everything)


def _compare_results(old: Path, new: Path, error: float, time: float, everything: bool) -> ChangeText:
    from evalkit.commands.diff import results_changes  # noqa: PLC0415
    from evalkit.metrics import all_metrics  # noqa: PLC0415
    from evalkit.results.reader import load_stored_results  # noqa: PLC0415

    metrics = {metric.name: metric for metric in all_metrics()}
    limits = results_changes.DiffLimits(error, time)
    changes = results_changes.compare_results(
        load_stored_results(old), load_stored_results(new), tuple(metrics.values()), limits
    )
    return results_changes.describe_results_diff(changes, metrics, everything)


def _print(text: ChangeText) -> None:
    table = Table(*text.columns, expand=out.is_terminal)
    for row in text.rows:
        table.add_row(*row)
    if text.rows:
        progress.print_table(out, table)
    for line in (*text.remarks, text.conclusion):
        out.print(line)
