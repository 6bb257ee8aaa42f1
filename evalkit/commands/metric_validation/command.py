"""Measure how map metrics follow the true error, and inject faults that the metrics must detect.

Run it as ``python -m evalkit.commands.metric_validation validate`` or ``... selftest``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.table import Table

from evalkit.commands.metric_validation import page, validation
from evalkit.execution import environment
from evalkit.io.output_files import format_json, write_texts
from evalkit.plugins import defaults
from evalkit.report.html.blocks import render
from evalkit.terminal import options, progress
from evalkit.terminal.console import out, print_json
from evalkit.terminal.options import Json, Out
from evalkit.terminal.shown_tasks import run_shown_tasks

app = typer.Typer(help="Validate the metrics themselves.", no_args_is_help=True, add_completion=False)

QUICK_SIZES, QUICK_SCANS = 2, 40

MapperOption = Annotated[str, typer.Option(help="Mapper of all maps.", show_default="the default mapper")]
Seed = Annotated[int, typer.Option(min=0, help="Seed of the worlds' noise and of random perturbations.")]


@app.command()
def validate(
    world: Annotated[
        list[str] | None, typer.Option(help="A data set (repeatable).", show_default="a simulated one")
    ] = None,
    mapper: MapperOption = "",
    scans: Annotated[int, options.count(20, help="Scans per map.")] = 150,
    sizes: Annotated[int, options.count(2, high=5, help="Sizes of every perturbation.")] = 5,
    seed: Seed = 0,
    quick: Annotated[bool, typer.Option("--quick", help="One world, two sizes, few scans: seconds.")] = False,
    folder: Out = None,
    jobs: options.Jobs = None,
    as_json: Json = False,
) -> None:
    """Measure how metrics without ground truth follow the true error of maps from perturbed trajectories."""
    worlds = tuple(dict.fromkeys(world or [defaults.find_simulated_dataset()]))
    plan = validation.MetricValidationPlan(
        worlds[:1] if quick else worlds, mapper or defaults.find_default_mapper(), worlds[0],
        QUICK_SIZES if quick else sizes, seed, min(scans, QUICK_SCANS) if quick else scans,
    )  # fmt: skip
    folder = folder or Path("reports") / "build" / "metrics"
    results = run_shown_tasks(validation.make_tasks(plan), folder, jobs, "jobs")
    provenance = environment.describe_origin("evalkit.commands.metric_validation")
    content, maps = validation.summarize(plan, results, provenance), validation.collect_maps(plan, results)
    texts = {
        "validated.json": format_json(content) + "\n",
        "maps.csv": validation.format_csv(maps),
        "index.html": render(page.build_document(content, maps)),
    }
    write_texts(folder, texts)
    if as_json:
        print_json(content | {"page": str(folder / "index.html")})
    else:
        _print_agreement(content)
        _print_faults(content["faults"])
        out.print(str((folder / "index.html").resolve()))
    _check_faults(content["faults"])


@app.command()
def selftest(
    world: Annotated[
        str, typer.Option(help="A data set with a ground-truth trajectory.", show_default="a simulated one")
    ] = "",
    mapper: MapperOption = "",
    seed: Seed = 0,
    folder: Out = None,
    jobs: options.Jobs = None,
    as_json: Json = False,
) -> None:
    """Inject faults between a sequence and its scores; exit code 1 if the metrics miss one of them."""
    plan = validation.MetricValidationPlan(
        (), mapper or defaults.find_default_mapper(), world or defaults.find_simulated_dataset(), seed=seed
    )
    folder = folder or Path("reports") / "build" / "metrics"
    results = run_shown_tasks(validation.make_fault_tasks(plan), folder, jobs, "jobs")
    faults = [validation.fault_as_json(*one) for one in validation.detect_faults(results).items()]
    if as_json:
        print_json(faults)
    else:
        _print_faults(faults)
    _check_faults(faults)


def _print_agreement(content: Mapping[str, Any]) -> None:
    perturbations = list(content["perturbations"])
    table = Table("metric", "Spearman", "95 %", *perturbations)
    for row in content["agreement"]:
        overall = row["overall"]
        bounds = "-" if overall is None else f"{overall['low']:.2f} to {overall['high']:.2f}"
        values = [overall, *(row["by_perturbation"][name] for name in perturbations)]
        value, *parts = ["-" if one is None else f"{one['value']:.2f}" for one in values]
        table.add_row(row["metric"], value, bounds, *parts)
    progress.print_table(out, table)


def _print_faults(faults: Sequence[Mapping[str, Any]]) -> None:
    table = Table("fault", "what it is", "detected by (times worse)")
    for row in faults:
        table.add_row(row["fault"], row["what"], page.format_detections(row["strongest"][:3]))
    progress.print_table(out, table)


def _check_faults(faults: Sequence[Mapping[str, Any]]) -> None:
    if any(not row["metric_count"] for row in faults):
        raise typer.Exit(1)
