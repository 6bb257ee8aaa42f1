"""``evalkit compare``: compare methods on a recording or an experiment, and write the report."""

from __future__ import annotations

import shlex
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated

import typer

from evalkit.config import adhoc_experiment, experiment
from evalkit.config.experiment import Experiment
from evalkit.core.run_result import NOT_EXECUTED
from evalkit.execution import environment
from evalkit.execution.executors import There
from evalkit.execution.scheduler import Engine
from evalkit.results.store import Store, reported
from evalkit.terminal import options, progress, run_summary
from evalkit.terminal.options import RunOptions, err

RECORDING = "Options for a recording"


def compare(
    source: Annotated[
        Path, typer.Argument(help="A bag (ROS 1 or 2), a CARMEN log, or an experiment (*.toml).", show_default=False)
    ],
    topic: Annotated[
        str, typer.Option(help="Laser topic of a bag.", show_default="the only one", rich_help_panel=RECORDING)
    ] = "",
    reference: Annotated[
        Path | None,
        typer.Option(help="Ground-truth trajectory (TUM).", show_default=False, rich_help_panel=RECORDING),
    ] = None,
    relations: Annotated[
        Path | None,
        typer.Option(help="Measured relations (Kuemmerle et al.).", show_default=False, rich_help_panel=RECORDING),
    ] = None,
    spans: Annotated[
        Path | None, typer.Option(help="Measured distances (TOML).", show_default=False, rich_help_panel=RECORDING)
    ] = None,
    backends: Annotated[
        str,
        typer.Option(
            help="Back ends, separated by commas.",
            show_default="all",
            autocompletion=options.complete_list("backends"),
            rich_help_panel=RECORDING,
        ),
    ] = "",
    setting: Annotated[
        list[str] | None,
        typer.Option("--set", help="NAME=VALUE of the reader (repeatable).", rich_help_panel=RECORDING),
    ] = None,
    sequence: options.Sequences = None,
    method: options.Methods = None,
    seed: options.Seeds = None,
    folder: options.Out = None,
    no_page: Annotated[bool, typer.Option("--no-page", help="Run and score only; write no report.")] = False,
    jobs: options.Jobs = None,
    resume: options.Resume = False,
    rerun: options.Rerun = None,
    collect: options.Collect = False,
    engine: options.Engine = "local",
    scheduler: options.Scheduler = "",
    accuracy_only: options.AccuracyOnly = False,
    as_json: options.Json = False,
) -> None:
    """Compare methods on a recording or an experiment, and write the report.

    The report is one HTML page with CSV and JSON tables, trajectories and maps beside it. Exit code 1 if a run failed,
    3 if a run is still missing.
    """
    files = {"topic": topic, "relations": relations, "reference": reference, "spans": spans}
    given = {name: str(value) for name, value in files.items() if value}
    if source.suffix == ".toml":
        for name in [*given, *(["backends"] if backends else []), *(["set"] if setting else [])]:
            raise typer.BadParameter(f"--{name}: needs a recording; in an experiment it is a key of the file")
        plan = experiment.read(source)
    else:
        plan = _recording_plan(source, given, backends, setting or [])
    plan = (plan.untimed() if accuracy_only else plan).only(sequence or [], method or [], seed or [])
    store = Store(folder or Path("reports") / "build" / plan.name)
    how = RunOptions.of(jobs, resume, rerun, collect, engine, scheduler)
    (_run if no_page else _run_and_report)(plan, store, how, as_json)


def _recording_plan(source: Path, given: dict[str, str], backends: str, settings: list[str]) -> Experiment:
    """Return the plan of all methods on one recording, whose first frame has been read."""
    words = ["compare", str(source)]
    words += [word for name, value in given.items() for word in (f"--{name}", value)]
    words += ["--backends", backends] if backends else []
    words += [word for item in settings for word in ("--set", item)]
    names = [name for word in backends.split(",") if (name := word.strip())]
    plan = adhoc_experiment.plan(source, given, options.settings(settings), names, shlex.join(words))
    adhoc_experiment.first_frame(plan)
    return plan


def _run(plan: Experiment, store: Store, how: RunOptions, as_json: bool) -> None:
    with _engine(plan, store, how) as engine, closing(engine.ended()) as all_ended:
        runs = {run.spec.key: run_summary.without_steps(run) for run in all_ended}
    run_summary.print_summary([runs[spec.key] for spec in engine.planned], plan.title, store, None, as_json)


def _run_and_report(plan: Experiment, store: Store, how: RunOptions, as_json: bool) -> None:
    from evalkit import report as pages  # noqa: PLC0415 - loads pandas and matplotlib

    started = datetime.now(UTC)
    with _engine(plan, store, how) as engine:
        records = engine.records()
    made = [record.result.provenance for record in records if record.result.status not in NOT_EXECUTED]
    ran_on = {**engine.ran_on, **environment.kept(made, started), **environment.machines(made)}
    comparison = pages.build_comparison(plan, records, started, datetime.now(UTC), ran_on)
    with reported(store.folder):
        page = pages.write_report(comparison, store.folder)
    run_summary.print_summary(records, plan.title, store, page, as_json)


@contextmanager
def _engine(plan: Experiment, store: Store, how: RunOptions) -> Iterator[Engine]:
    """Yield the engine of a plan, with progress on standard error; the environment is read before the first run."""
    for line in progress.missing(plan):
        err.print(line, markup=False, highlight=False)
    place = There(replace(how.cluster, timed=plan.timed)) if how.cluster else None
    ran_on = environment.describe(jobs=how.jobs)
    with (
        progress.say_what_is_kept(err, "finished runs", " with --resume"),
        progress.progress(err, list(plan.runs()), how.jobs, quiet=how.collect) as shown,
    ):
        yield Engine(plan, store, shown, how.jobs, how.resume, ran_on, how.rerun, how.collect, place)
