"""The command ``evalkit datasets list | fetch NAME... | example BAG``."""

from __future__ import annotations

import json
import sys
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer
from rich.progress import Progress

from evalkit.core.errors import EvalkitError, UnknownName
from evalkit.io.toml import load_toml
from evalkit.plugins.parameter_parsing import from_text
from evalkit.plugins.parameters import split_settings
from evalkit.terminal import options
from evalkit.terminal.console import WordConsole, print_json
from evalkit.terminal.text_list import print_list
from evalkit_datasets.commands.inspect.finding import format_count
from evalkit_datasets.recordings import catalog, data_sets
from evalkit_datasets.recordings.fetch import fetch, list_downloads, why_offline

app = typer.Typer(help="List, download and generate recordings.", no_args_is_help=True, add_completion=False)
out = WordConsole(soft_wrap=True)
err = WordConsole(stderr=True, soft_wrap=True)


@app.command("list")
def list_(as_json: options.Json = False) -> None:
    """List all catalogued files and where they are on this machine."""
    rows = [
        {
            "name": card.name,
            "summary": card.summary,
            "licence": card.licence,
            "where": str(catalog.find_local(card) or ("can be fetched" if card.is_public else "no public URL")),
        }
        for card in catalog.load_catalog().values()
    ]
    if as_json:
        sys.stdout.write(json.dumps(rows, indent=1) + "\n")
        return
    print_list(
        out, "files", [(row["name"], f"{row['summary']}; licence: {row['licence']}; {row['where']}") for row in rows]
    )


@app.command("fetch")
def fetch_(
    names: Annotated[list[str] | None, typer.Argument(help="Names of files or data sets.", show_default=False)] = None,
    experiment: Annotated[
        Path | None,
        typer.Option("--for", help="Fetch what an experiment file needs; what cannot be had is named, and no error."),
    ] = None,
) -> None:
    """Download files, or all files of a data set, into the cache, build those that are built, and verify them.

    EVALKIT_OFFLINE=1 keeps it from the network.
    """
    if not names and experiment is None:
        raise typer.BadParameter("give names of data sets or files, or --for EXPERIMENT.toml")
    datasets = [*(names or ()), *(_datasets_of(experiment) if experiment is not None else ())]
    files = dict.fromkeys(file for name in datasets for file in data_sets.files_of(name))
    known = [name for name in files if name in catalog.load_catalog()]
    downloads = list_downloads(known)
    reason = why_offline(downloads[0].url) if downloads else ""
    if experiment is not None and reason:
        out.print(f"{reason}: not fetched: {', '.join(_lacking(datasets))}; their runs are listed as missing")
        files = dict.fromkeys(name for name in known if not list_downloads([name]))
    elif downloads and not reason:
        size = sum(card.bytes for card in downloads) / 1e6
        out.print(f"downloading {format_count(len(downloads), 'file')}, {size:.1f} MB:")
        for card in downloads:
            out.print(f"  {card.name}, {card.bytes / 1e6:.1f} MB, licence: {card.licence}")
    failed = False
    for name in files:
        try:
            path = _fetch_with_progress(name)
        except EvalkitError as error:
            (out if experiment is not None else err).print(str(error), style=None if experiment else "red")
            failed = True
        else:
            if experiment is None:
                out.print(path)
    if failed and experiment is None:
        raise typer.Exit(2)


@app.command("example")
def example_(
    bag: Annotated[Path, typer.Argument(help="Folder of the new bag.", show_default=False)],
    world: Annotated[
        str,
        typer.Option(
            help="A synthetic data set: room, lab, loop, corridor, office, random-office, random-home, "
            "random-warehouse, doors, wings, symmetric-office or long-loop."
        ),
    ] = "lab",
    setting: Annotated[list[str] | None, typer.Option("--set", help="NAME=VALUE for the data set.")] = None,
    as_json: options.Json = False,
) -> None:
    """Write a simulated drive as a ROS 2 bag, with its true trajectory and its true map next to it.

    It is a quarter of a lap; --set laps=1 drives a whole one.
    """
    from evalkit_datasets.commands.datasets import example_bag  # noqa: PLC0415 - heavy, and used for examples only

    if world not in example_bag.WORLDS:
        raise UnknownName("synthetic data set", world, example_bag.WORLDS)
    given = from_text(world, example_bag.WORLDS[world].parameters, split_settings("--set", setting or []))
    example = example_bag.write_example(bag, world, given)
    if as_json:
        print_json(asdict(example) | {name: str(getattr(example, name)) for name in ("bag", "truth", "map")})
        return
    summary = f"{example.bag}: {example.scans} scans, {example.duration_s:.1f} s, {example.path_m:.1f} m, simulated"
    out.print(summary)
    out.print(f"{example.truth}: true poses")
    out.print(f"{example.map}: true map, for evalkit compare {example.bag} --map {example.map}")


def _datasets_of(experiment: Path) -> list[str]:
    """Return the recorded data sets that an experiment file uses."""
    tables = load_toml(experiment, "an experiment").get("sequence", [])
    used = [str(table.get("use")) for table in tables if isinstance(table, dict)] if isinstance(tables, list) else []
    return [name for name in dict.fromkeys(used) if name in data_sets.FILES]


def _lacking(datasets: list[str]) -> list[str]:
    return [name for name in dict.fromkeys(datasets) if list_downloads(data_sets.files_of(name))]


def _fetch_with_progress(name: str) -> str:
    with Progress(console=err, transient=True, disable=not err.is_terminal) as bar:
        task = bar.add_task(name, total=None)
        return str(fetch(name, lambda received, total: bar.update(task, completed=received, total=total or None)))
