"""``evalkit study``: effects and interactions of parameters on the metrics, and operating envelopes."""

from __future__ import annotations

import shlex
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from evalkit.config.experiment import RESULTS
from evalkit.core.errors import NotInstalled, UnknownName
from evalkit.execution import environment
from evalkit.io.json_values import indent_json
from evalkit.io.output_files import write_texts
from evalkit.terminal import options, progress
from evalkit.terminal.console import err, out, print_json
from evalkit.terminal.options import Json, Out, SchedulerAddress

if TYPE_CHECKING:
    from evalkit.commands.study.plan import Study
    from evalkit.commands.study.result import StudyResult


def study(
    file: Annotated[Path, typer.Argument(help="A study file (*.toml).", show_default=False)],
    point: Annotated[str, typer.Option(help="Compute this point alone, by its key.", show_default=False)] = "",
    folder: Out = None,
    jobs: options.Jobs = None,
    engine: options.Engine = "local",
    scheduler: SchedulerAddress = "",
    insecure: options.Insecure = False,
    as_json: Json = False,
) -> None:
    """Run a designed experiment: main effects, interactions, operating envelope.

    Finished points are kept: repeat the command to continue an interrupted study.
    """
    from evalkit.commands.study.config import load_study  # noqa: PLC0415 - as above
    from evalkit.commands.study.formatting import describe_missing_effects  # noqa: PLC0415 - loads scipy
    from evalkit.commands.study.result import StudyResult  # noqa: PLC0415 - as above
    from evalkit.design.run_points import run_points  # noqa: PLC0415 - as above

    options.add_working_directory()
    plan = load_study(file, f"evalkit study {shlex.quote(str(file))}")
    if plan.missing:
        raise NotInstalled(str(file), "cannot be run here", plan.missing)
    if point:
        _run_point(plan, point, as_json)
        return
    folder = folder or RESULTS / file.stem
    workers = jobs or environment.physical_cores()
    cluster = options.cluster(engine, scheduler, workers, insecure)
    if cluster:
        cluster = replace(cluster, timed=any(response.metric.group == "runtime" for response in plan.responses))
    ran_on = environment.describe(jobs=workers)
    tasks = plan.tasks()
    with progress.announce_kept(err, "finished points"), progress.show_tasks(err, len(tasks), workers) as done:
        outcome = StudyResult(plan, run_points(tasks, folder / "results", workers, done, cluster))
    page = _write(outcome, folder, ran_on)
    lost = sum(bool(outcome.lost(key, seed)) for key in plan.points for seed in plan.seeds(key))
    if as_json:
        print_json({"title": plan.title, "page": str(page), "points": len(plan.points), "lost": lost})
    else:
        counts = f"{len(plan.points):,} points, {len(tasks):,} runs, {lost} lost"
        out.print(counts)
        for response in plan.responses:
            for design, reason in outcome.missing_fits(response):
                out.print(describe_missing_effects(response, design, reason))
        out.print(str(page.resolve()))


def _run_point(plan: Study, key: str, as_json: bool) -> None:
    """Compute one point, and print its scores and the experiment that runs it."""
    from evalkit.config.experiment_toml import format_experiment  # noqa: PLC0415 - loaded only to print a point

    if key not in plan.points:
        raise UnknownName("point", key, plan.points, plan.command)
    results = {}
    for seed in plan.seeds(key):
        task = plan.task(plan.points[key], seed)
        results[task.name], _ = task.run()
    if as_json:
        print_json(results)
        return
    out.print(plan.points[key].label)
    for name, result in results.items():
        out.print(f"{name}: {result['status']} {result['reason']}".rstrip())
        for metric, value in result["scores"].items():
            text = result["why"][metric] if value is None else repr(value)
            out.print(f"  {metric} {text}")
    out.print("\nThe experiment that runs this point:\n")
    out.print(format_experiment(plan.point_experiment(key)))


def _write(outcome: StudyResult, folder: Path, ran_on: dict[str, str]) -> Path:
    """Write index.html, study.json, points.csv and effects.csv; return the path of index.html."""
    from evalkit.commands.study import page, results_json  # noqa: PLC0415 - as above
    from evalkit.report.html.blocks import render  # noqa: PLC0415 - loads matplotlib

    texts = {
        "points.csv": results_json.format_csv(results_json.make_run_rows(outcome)),
        "effects.csv": results_json.format_csv(results_json.make_effect_rows(outcome), results_json.EFFECT_COLUMNS),
        "study.json": indent_json(results_json.study_as_json(outcome)),
        "index.html": render(page.build_document(outcome, ran_on)),
    }
    write_texts(folder, texts)
    return folder / "index.html"
