"""``evalkit export``: a finished comparison in the formats of other programs."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from evalkit.core.errors import NotInstalled, UnknownName
from evalkit.results.store import Store, reported
from evalkit.terminal import options
from evalkit.terminal.options import Json, err, out

if TYPE_CHECKING:
    from evalkit.commands.export.results import Results

FORMATS = ("csv", "json", "latex", "markdown", "pdf", "svg", "tum", "kitti", "g2o", "map", "mcap", "rerun")
WITH_SCANS = {"pdf", "svg", "tum", "kitti", "mcap", "rerun"}
"""Formats that show the truth or the scans: for these the sequences are made again."""


def export(
    results: Annotated[Path, typer.Argument(help="A results folder.", show_default=False)],
    forms: Annotated[
        list[str],
        typer.Option(
            "--format",
            "-f",
            help=f"all, {', '.join(FORMATS)} (repeatable).",
            show_default=False,
            autocompletion=lambda: [*FORMATS, "all"],
        ),
    ],
    folder: Annotated[Path, typer.Option("--out", "-o", help="Where to write.")] = Path("export"),
    sequence: options.Sequences = None,
    method: options.Methods = None,
    metric: Annotated[
        list[str] | None,
        typer.Option(
            help="A column of the tables (repeatable).",
            show_default="the headline metrics",
            autocompletion=options.complete_metric,
        ),
    ] = None,
    as_json: Json = False,
) -> None:
    """Export a finished comparison to other file formats.

    Tables (CSV, JSON, LaTeX, Markdown), figures, trajectories (TUM, KITTI, g2o), maps, ROS 2 bags and rerun files.
    """
    from evalkit.commands.export import results as finished  # noqa: PLC0415 - only who exports pays for it

    wanted = _wanted(forms)
    scans = bool(WITH_SCANS & set(wanted))
    found = finished.read(results, sequence or [], method or [], metric or [], scans)
    for remark in found.remarks:
        err.print(remark, markup=False, highlight=False)
    written = [path for form in wanted for path in _written(form, found, folder, "all" in forms)]
    if as_json:
        options.print_json({"written": [str(path) for path in written], "remarks": list(found.remarks)})
    else:
        out.print(f"{len(written)} files in {folder.resolve()}", markup=False, highlight=False)


def _wanted(forms: list[str]) -> list[str]:
    for form in forms:
        if form not in (*FORMATS, "all"):
            raise UnknownName("format", form, (*FORMATS, "all"))
    return list(FORMATS) if "all" in forms else list(dict.fromkeys(forms))


def _written(form: str, found: Results, folder: Path, everything: bool) -> list[Path]:
    try:
        with reported(folder):
            return list(_writers()[form](found, folder / form))
    except NotInstalled as error:
        if not everything:
            raise
        err.print(f"{form} left out: {error}", markup=False, highlight=False)
        return []


def _writers() -> dict[str, Callable[[Results, Path], Iterator[Path]]]:
    from evalkit.commands.export import latex, numbers, poses  # noqa: PLC0415 - loads matplotlib

    return {
        "csv": lambda found, folder: _files(numbers.as_csv(found), folder),
        "json": lambda found, folder: _files(numbers.as_json(found), folder),
        "latex": lambda found, folder: _files(latex.latex(found), folder),
        "markdown": lambda found, folder: _files(latex.markdown(found), folder),
        "pdf": lambda found, folder: _files(latex.drawings(found, "pdf"), folder),
        "svg": lambda found, folder: _files(latex.drawings(found, "svg"), folder),
        "tum": lambda found, folder: _files(poses.as_tum(found), folder),
        "kitti": lambda found, folder: _files(poses.as_kitti(found), folder),
        "g2o": lambda found, folder: _files(poses.as_g2o(found), folder),
        "map": _maps,
        "mcap": _bags,
        "rerun": _recordings,
    }


def _files(files: Iterator[tuple[str, bytes]], folder: Path) -> Iterator[Path]:
    for name, content in files:
        folder.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(content)
        yield folder / name


def _maps(found: Results, folder: Path) -> Iterator[Path]:
    for record in found.records:
        if record.scores.grid is not None:
            Store.existing(folder).write_map(folder / record.key, record.scores.grid)
            yield from (folder / f"{record.key}.yaml", folder / f"{record.key}.pgm")


def _bags(found: Results, folder: Path) -> Iterator[Path]:
    from evalkit.commands.export import mcap  # noqa: PLC0415 - only who exports bags pays for it

    for record in found.records:
        recording = found.recordings.get((record.sequence, record.seed))
        if recording is not None:
            yield mcap.write(folder, record, recording)


def _recordings(found: Results, folder: Path) -> Iterator[Path]:
    from evalkit.commands.export import poses, rerun_file  # noqa: PLC0415 - rerun is big

    rerun_file.installed()
    for place in dict.fromkeys((record.sequence, record.seed) for record in found.records):
        own = [record for record in found.records if (record.sequence, record.seed) == place]
        path = folder / f"{poses.run_name(*place)}.rrd"
        yield rerun_file.write(path, own, found.recordings.get(place), found.strokes)
