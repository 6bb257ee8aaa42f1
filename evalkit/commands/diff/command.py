"""``evalkit diff``: compare two results folders, or two sets of benchmark files."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer
from rich.table import Table

from evalkit.core.errors import BadData
from evalkit.terminal import options, progress
from evalkit.terminal.console import err, out, print_json
from evalkit.terminal.options import Json

if TYPE_CHECKING:
    from evalkit.commands.diff.changes import ChangeText

Content = Literal["results", "benchmarks"]

ERROR_LIMIT, TIME_LIMIT, BENCHMARK_LIMIT = "5%", "10%", "10%"


def parse_share(text: str) -> float:
    """Return the share that "5%", "5 %" or "0.05" states; below zero, or from 1 on without %, it is a usage error."""
    number = text.strip().removesuffix("%")
    try:
        value = float(number) / (100.0 if text.strip().endswith("%") else 1.0)
    except ValueError:
        value = -1.0
    if not 0.0 <= value < (float("inf") if text.strip().endswith("%") else 1.0):
        raise typer.BadParameter(f"found '{text}', expected a share such as 5% or 0.05")
    return value


def diff(
    old: Annotated[Path, typer.Argument(help="The results before: a folder, or benchmarks.", show_default=False)],
    new: Annotated[Path, typer.Argument(help="The results after.", show_default=False)],
    limit_ate: Annotated[
        str | None, typer.Option(help="Results: tolerated increase of the error.", show_default=ERROR_LIMIT)
    ] = None,
    limit_time: Annotated[
        str | None, typer.Option(help="Results: tolerated increase of CPU time.", show_default=TIME_LIMIT)
    ] = None,
    limit: Annotated[
        str | None, typer.Option(help="Benchmarks: tolerated increase of time or size.", show_default=BENCHMARK_LIMIT)
    ] = None,
    across_machines: Annotated[
        bool, typer.Option("--across-machines", help="Benchmarks: accept different processors.")
    ] = False,
    allow_missing: Annotated[
        bool,
        typer.Option("--allow-missing", help="Accept runs, metrics or series of OLD without a counterpart in NEW."),
    ] = False,
    everything: Annotated[bool, typer.Option("--all", help="List unchanged values as well.")] = False,
    markdown: options.Markdown = False,
    as_json: Json = False,
) -> None:
    """Compare two results folders, or two sets of benchmarks.

    Benchmarks are the JSON files of ``make bench``, or a folder of them. Exit code 1 if anything is worse by more than
    the noise and the limits, or if something in OLD has no counterpart in NEW.
    """
    from evalkit.commands.diff.changes import format_markdown  # noqa: PLC0415 - loads what formats a report

    listed = everything and not markdown
    if _find_common_content(old, new) == "benchmarks":
        _refuse({"--limit-ate": limit_ate, "--limit-time": limit_time}, "results folders", "benchmarks")
        share = parse_share(BENCHMARK_LIMIT if limit is None else limit)
        text = _compare_benchmarks(old, new, share, across_machines, listed)
    else:
        _refuse({"--limit": limit, "--across-machines": across_machines or None}, "benchmarks", "results folders")
        error = parse_share(ERROR_LIMIT if limit_ate is None else limit_ate)
        time = parse_share(TIME_LIMIT if limit_time is None else limit_time)
        text = _compare_results(old, new, error, time, listed)
    if as_json:
        print_json(text.content)
    elif markdown:
        out.print(format_markdown(text), end="")
    else:
        _print(text)
    if text.missing and not allow_missing:
        err.print("exit code 1: something in OLD has no counterpart in NEW; --allow-missing accepts this")
    if text.regressions or (text.missing and not allow_missing):
        raise typer.Exit(1)


def _find_common_content(old: Path, new: Path) -> Content:
    """Return what both paths hold. Raises BadData if a path holds neither, or both hold different things."""
    content: list[Content] = [_find_content(path) for path in (old, new)]
    if content[0] != content[1]:
        names = [
            "a results folder" if holds == "results" else "a folder of JSON files" if path.is_dir() else "a JSON file"
            for path, holds in zip((old, new), content, strict=True)
        ]
        what = f"is {names[1]}, {old} is {names[0]}"
        raise BadData(str(new), "", what, "compare two results folders or two benchmarks")
    return content[0]


def _find_content(path: Path) -> Content:
    """Return what a path holds: a file, or a folder of JSON files without results in it, is taken for benchmarks."""
    remedy = "name a folder that `evalkit compare` has written, or a benchmark of `make bench`"
    if path.is_file():
        if path.name == "results.json":
            raise BadData(str(path), "", "is a file of a results folder", f"name the folder: {path.parent}")
        if path.suffix != ".json":
            raise BadData(str(path), "", "is neither a results folder nor a benchmark (*.json)", remedy)
        return "benchmarks"
    if not path.exists():
        raise BadData(str(path), "", "there is no such file or folder", remedy)
    if (path / "results.json").exists() or (path / "runs").exists():
        return "results"
    if any(path.glob("*.json")):
        return "benchmarks"
    raise BadData(str(path), "", "holds neither results nor benchmarks", remedy)


def _refuse(options: Mapping[str, object], meant: str, found: str) -> None:
    """Raise typer.BadParameter for the first option that is given and means nothing to what is compared."""
    for name, value in options.items():
        if value is not None:
            raise typer.BadParameter(f"{name} is for {meant}; OLD and NEW are {found}")


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
    from evalkit.commands.diff import results_changes, results_text  # noqa: PLC0415
    from evalkit.commands.diff.metric_changes import DiffLimits  # noqa: PLC0415
    from evalkit.metrics import all_metrics  # noqa: PLC0415
    from evalkit.results.reader import load_stored_results  # noqa: PLC0415

    metrics = {metric.name: metric for metric in all_metrics()}
    changes = results_changes.compare_results(
        load_stored_results(old), load_stored_results(new), tuple(metrics.values()), DiffLimits(error, time)
    )
    return results_text.describe_results_diff(changes, metrics, everything)


def _print(text: ChangeText) -> None:
    """Print the changes as a table, or one line each where the table would break words; then the remarks."""
    from evalkit.commands.diff.changes import format_lines  # noqa: PLC0415

    columns = list(zip(text.columns, *text.rows, strict=True))
    longest = [max(len(word) for cell in cells for word in cell.split()) for cells in columns]
    if progress.has_width(out) and sum(longest) + 3 * len(longest) + 1 > out.width:
        for line in format_lines(text):
            out.print(line)
    elif text.rows:
        table = Table(expand=out.is_terminal)
        for name, width in zip(text.columns, longest, strict=True):
            table.add_column(name, min_width=width)
        for row in text.rows:
            table.add_row(*row)
        progress.print_table(out, table)
    for line in (*text.remarks, text.conclusion):
        out.print(line)
