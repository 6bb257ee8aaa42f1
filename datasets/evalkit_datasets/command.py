"""The command ``evalkit datasets list | fetch NAME... | example BAG``."""

from __future__ import annotations

import json
import sys
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.markup import escape
from rich.progress import Progress
from rich.table import Table

from evalkit.core.errors import EvalkitError, UnknownName
from evalkit.plugins.parameter_parsing import from_text
from evalkit.terminal import options, progress
from evalkit_datasets import catalog, recorded
from evalkit_datasets.fetch import fetch

app = typer.Typer(help="List, download and generate recordings.", no_args_is_help=True, add_completion=False)
out = Console(soft_wrap=True)
err = Console(stderr=True, soft_wrap=True)


@app.command("list")
def list_(as_json: Annotated[bool, typer.Option("--json", help="Print the result as JSON.")] = False) -> None:
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
    table = Table("name", "content", "licence", "location")
    for row in rows:
        table.add_row(*map(escape, row.values()))
    progress.print_table(out, table)


@app.command("fetch")
def fetch_(
    names: Annotated[list[str], typer.Argument(help="Names of files or data sets.", show_default=False)],
) -> None:
    """Download files, or all files of a data set, into the cache and verify them."""
    files = dict.fromkeys(file for name in names for file in recorded.FILES.get(name, (name,)))
    failed = False
    for name in files:
        try:
            out.print(str(_fetch_with_progress(name)), highlight=False)
        except EvalkitError as error:
            err.print(str(error), style="red", highlight=False, markup=False)
            failed = True
    if failed:
        raise typer.Exit(2)


@app.command("example")
def example_(
    bag: Annotated[Path, typer.Argument(help="Folder of the new bag.", show_default=False)],
    world: Annotated[str, typer.Option(help="A synthetic data set: room, lab, loop, corridor or office.")] = "lab",
    setting: Annotated[list[str] | None, typer.Option("--set", help="NAME=VALUE for the data set.")] = None,
    as_json: options.Json = False,
) -> None:
    """Write a simulated drive as a ROS 2 bag, with its true trajectory next to it."""
    from evalkit_datasets import example_bag  # noqa: PLC0415 - heavy, and used for examples only

    if world not in example_bag.WORLDS:
        raise UnknownName("synthetic data set", world, example_bag.WORLDS)
    given = from_text(world, example_bag.WORLDS[world].parameters, options.settings(setting or []))
    example = example_bag.write_example(bag, world, given)
    if as_json:
        options.print_json(asdict(example) | {"bag": str(example.bag), "truth": str(example.truth)})
        return
    summary = f"{example.bag}: {example.scans} scans, {example.duration_s:.1f} s, {example.path_m:.1f} m, simulated"
    out.print(summary, markup=False, highlight=False)
    out.print(f"{example.truth}: true poses", markup=False, highlight=False)


def _fetch_with_progress(name: str) -> str:
    with Progress(console=err, transient=True) as bar:
        task = bar.add_task(name, total=None)
        return str(fetch(name, lambda received, total: bar.update(task, completed=received, total=total or None)))
