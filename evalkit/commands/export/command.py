"""``evalkit export``: convert a finished report to the formats of other programs."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from evalkit.core.errors import NotInstalled, UnknownName
from evalkit.io.map_server import write_map
from evalkit.io.output_files import as_store_error, create_folder, write_bytes
from evalkit.terminal import options
from evalkit.terminal.console import err, out, print_json
from evalkit.terminal.options import Json

if TYPE_CHECKING:
    from evalkit.commands.export.latex import Width
    from evalkit.commands.export.results import ExportSelection

    Writers = dict[str, Callable[[ExportSelection, Path], Iterator[Path]]]

FORMATS = ("csv", "json", "latex", "markdown", "pdf", "svg", "tum", "evo", "kitti", "g2o", "map", "mcap", "rerun")
WITH_SCANS = {"pdf", "svg", "tum", "evo", "kitti", "mcap", "rerun"}
"""Formats with ground truth or scans, for which the sequences are opened."""

ABSENT = {"evo": "no run has a ground-truth trajectory, which its errors need; --format tum writes trajectories"}
"""Why a format has no file, where it is not that no run is complete."""


def export(
    results: Annotated[Path, typer.Argument(help="A results folder.", show_default=False)],
    formats: Annotated[
        list[str],
        typer.Option(
            "--format",
            "-f",
            help=f"all, {', '.join(FORMATS)} (repeatable).",
            show_default=False,
            autocompletion=lambda: [*FORMATS, "all"],
        ),
    ],
    folder: Annotated[Path, typer.Option("--out", "-o", help="Output folder.")] = Path("export"),
    sequence: options.Sequences = None,
    method: options.Methods = None,
    metric: Annotated[
        list[str] | None,
        typer.Option(
            help="A column of the tables (repeatable).",
            show_default="error, drift, CPU time",
            autocompletion=options.complete_metric,
        ),
    ] = None,
    width: Annotated[Literal["column", "text"], typer.Option(help="Width of tables and figures.")] = "column",
    font: Annotated[str, typer.Option(help="Font family of the figures.", show_default="DejaVu Sans")] = "",
    as_json: Json = False,
) -> None:
    """Export a finished comparison to other file formats.

    Tables (CSV, JSON, LaTeX, Markdown), figures, trajectories (TUM, KITTI, g2o, evo), maps, ROS 2 bags and rerun files.
    Exit code 1 if nothing could be written.
    """
    from evalkit.commands.export.results import load_selection  # noqa: PLC0415 - loaded only to export

    wanted = _check_formats(formats)
    writers = _make_writers(width, font)
    scans = bool(WITH_SCANS & set(wanted))
    selection = load_selection(results, sequence or [], method or [], metric or [], scans)
    for remark in selection.remarks:
        err.print(remark)
    written = [path for name in wanted for path in _write_format(name, writers, selection, folder, "all" in formats)]
    if as_json:
        print_json({"written": [str(path) for path in written], "remarks": list(selection.remarks)})
    else:
        out.print(f"{len(written)} file{'s' * (len(written) != 1)} in {folder.resolve()}")
    if not written:
        raise typer.Exit(1)


def _check_formats(formats: list[str]) -> list[str]:
    for name in formats:
        if name not in (*FORMATS, "all"):
            raise UnknownName("format", name, (*FORMATS, "all"))
    return list(FORMATS) if "all" in formats else list(dict.fromkeys(formats))


def _write_format(
    name: str, writers: Writers, selection: ExportSelection, folder: Path, all_formats: bool
) -> list[Path]:
    try:
        with as_store_error(folder):
            create_folder(folder / name, folder)
            written = list(writers[name](selection, folder / name))
        if not written and not all_formats:
            err.print(f"{name}: no file: {ABSENT.get(name, 'no complete run has what it shows')}", soft_wrap=True)
        return written
    except NotInstalled as error:
        if not all_formats:
            raise
        err.print(f"{name} is left out: {error}")
        return []


def _make_writers(width: Width, font: str) -> Writers:
    """Return the function that writes each format; ``width`` and ``font``: of tables and figures for a paper."""
    from evalkit.commands.export import evo, figures, latex, numbers, poses  # noqa: PLC0415 - loads matplotlib

    return {
        "csv": lambda selection, folder: _write_files(numbers.format_csv(selection), folder),
        "json": lambda selection, folder: _write_files(numbers.format_json(selection), folder),
        "latex": lambda selection, folder: _write_files(latex.format_latex(selection, width), folder),
        "markdown": lambda selection, folder: _write_files(latex.format_markdown(selection), folder),
        "pdf": lambda selection, folder: _write_files(figures.draw_figures(selection, "pdf", width, font), folder),
        "svg": lambda selection, folder: _write_files(figures.draw_figures(selection, "svg", width, font), folder),
        "tum": lambda selection, folder: _write_files(poses.format_tum_files(selection), folder),
        "evo": lambda selection, folder: _write_files(evo.format_evo(selection), folder),
        "kitti": lambda selection, folder: _write_files(poses.format_kitti(selection), folder),
        "g2o": lambda selection, folder: _write_files(poses.format_g2o(selection), folder),
        "map": _write_maps,
        "mcap": _write_bags,
        "rerun": _write_rerun_files,
    }


def _write_files(files: Iterator[tuple[str, bytes]], folder: Path) -> Iterator[Path]:
    for name, content in files:
        write_bytes(folder / name, content, folder)
        yield folder / name


def _write_maps(selection: ExportSelection, folder: Path) -> Iterator[Path]:
    for run in selection.runs:
        if run.scores.grid is not None:
            write_map(folder / run.key, run.scores.grid, folder, run.scores.map_from_start)
            yield from (folder / f"{run.key}.yaml", folder / f"{run.key}.pgm")


def _write_bags(selection: ExportSelection, folder: Path) -> Iterator[Path]:
    from evalkit.commands.export import mcap  # noqa: PLC0415 - loaded only to export bags

    for run in selection.runs:
        sequence = selection.opened.get((run.sequence, run.seed))
        if sequence is not None:
            yield mcap.write_run(folder, run, sequence)


def _write_rerun_files(selection: ExportSelection, folder: Path) -> Iterator[Path]:
    from evalkit.commands.export import poses, rerun_file  # noqa: PLC0415 - rerun is slow to load

    rerun_file.import_rerun()
    for name in dict.fromkeys((run.sequence, run.seed) for run in selection.runs):
        own = [run for run in selection.runs if (run.sequence, run.seed) == name]
        path = folder / f"{poses.run_name(*name)}.rrd"
        yield rerun_file.write_rerun(path, own, selection.opened.get(name), selection.strokes)
