"""``evalkit compare``: compare methods on a recording or an experiment, and write the report."""

from __future__ import annotations

import shlex
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from evalkit.config.adhoc_experiment import experiment_from_recording, read_first_frame
from evalkit.config.experiment import Experiment, load_experiment
from evalkit.core.run_result import NO_STEPS
from evalkit.execution.environment import describe
from evalkit.execution.executors import DaskExecutor, Executor, LocalExecutor
from evalkit.execution.scheduler import Scheduler
from evalkit.results.store import Store
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
    ground_truth: Annotated[
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
    files = {"topic": topic, "relations": relations, "ground_truth": ground_truth, "spans": spans}
    given = {name: str(value) for name, value in files.items() if value}
    if source.suffix == ".toml":
        for name in [*map(_option, given), *(["backends"] if backends else []), *(["set"] if setting else [])]:
            raise typer.BadParameter(f"--{name}: needs a recording; in an experiment it is a key of the file")
        experiment = load_experiment(source)
    else:
        experiment = _experiment_of_recording(source, given, backends, setting or [])
    experiment = experiment.untimed() if accuracy_only else experiment
    experiment = experiment.select(sequence or [], method or [], seed or [])
    store = Store(folder or Path("reports") / "build" / experiment.name)
    how = RunOptions.of(jobs, resume, rerun, collect, engine, scheduler)
    (_run if no_page else _run_and_report)(experiment, store, how, as_json)


def _option(parameter: str) -> str:
    """Return the name of the option of a reader's parameter."""
    return parameter.replace("_", "-")


def _experiment_of_recording(source: Path, given: dict[str, str], backends: str, settings: list[str]) -> Experiment:
    """Return the experiment of all methods on one recording, whose first frame has been read."""
    words = ["compare", str(source)]
    words += [word for name, value in given.items() for word in (f"--{_option(name)}", value)]
    words += ["--backends", backends] if backends else []
    words += [word for item in settings for word in ("--set", item)]
    names = [name for word in backends.split(",") if (name := word.strip())]
    experiment = experiment_from_recording(source, given, options.settings(settings), names, shlex.join(words))
    read_first_frame(experiment)
    return experiment


def _run(experiment: Experiment, store: Store, how: RunOptions, as_json: bool) -> None:
    with _scheduler(experiment, store, how) as scheduler:
        runs = scheduler.run(experiment, _executor(experiment, how))
        results = {spec.key: replace(result, steps=NO_STEPS) for spec, result in runs}  # there may be thousands
    run_summary.print_summary(
        [(spec, results[spec.key]) for spec in experiment.runs()], experiment.title, store, None, as_json
    )


def _run_and_report(experiment: Experiment, store: Store, how: RunOptions, as_json: bool) -> None:
    """Run the experiment, load its records, analyse them, render the page, print the summary."""
    from evalkit.api.pipeline import run_and_report  # noqa: PLC0415 - loads pandas and matplotlib

    with _scheduler(experiment, store, how) as scheduler:
        comparison, page = run_and_report(scheduler, experiment, _executor(experiment, how))
    runs = [(record.spec, record.result) for record in comparison.records]
    run_summary.print_summary(runs, experiment.title, store, page, as_json)


@contextmanager
def _scheduler(experiment: Experiment, store: Store, how: RunOptions) -> Iterator[Scheduler]:
    """Yield the scheduler, with progress on standard error; the environment is read before the first run."""
    for line in progress.format_unavailable(experiment):
        err.print(line, markup=False, highlight=False)
    description = describe(jobs=how.jobs)
    with (
        progress.announce_kept(err, "finished runs", " with --resume"),
        progress.show_runs(err, list(experiment.runs()), how.jobs, quiet=how.collect) as shown,
    ):
        yield Scheduler(store, shown, description, how.resume, how.rerun, how.collect)


def _executor(experiment: Experiment, how: RunOptions) -> Executor:
    if how.cluster is None:
        return LocalExecutor(how.jobs)
    return DaskExecutor(replace(how.cluster, timed=experiment.timed))
