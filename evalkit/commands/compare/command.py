"""``evalkit compare``: compare methods on a recording or an experiment, and write the report."""

from __future__ import annotations

import shlex
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer

from evalkit.config.adhoc_experiment import (
    Recording,
    experiment_from_recording,
    format_command,
    name_experiment,
    open_recording,
    option_name,
    read_first_frame,
    split_names,
)
from evalkit.config.experiment import RESULTS, Experiment
from evalkit.config.experiment_file import MAX_NUISANCE, load_experiment
from evalkit.core.errors import UnknownName
from evalkit.core.run_result import NO_STEPS
from evalkit.execution.environment import describe
from evalkit.execution.executors import DaskExecutor, Executor, LocalExecutor
from evalkit.execution.scheduler import Scheduler
from evalkit.odometry.frontend import settable_parameters
from evalkit.plugins import defaults, registry
from evalkit.plugins.parameters import ALIGN_TRUTH, MAP, MAP_START, NUISANCE, Value, split_settings
from evalkit.results import descriptions
from evalkit.results.store import Store
from evalkit.terminal import options, progress, run_summary
from evalkit.terminal.console import err, out
from evalkit.terminal.options import RunOptions

VERDICT_REPETITIONS = 5
"""Perturbed runs of a method on a recording that give a verdict, beside the run as it is."""

PLACE_OF_PARAMETERS = "set it below [[method]] of an experiment, with the [[sequence]] that evalkit inspect prints"
"""Where a parameter of a method is set on a recording."""

RECORDING, KNOWN = "Options for a recording", "Options for a recording in a known map"


def compare(
    source: Annotated[
        Path,
        typer.Argument(
            help="A recording (a bag, a log, a folder of clouds) or an experiment (*.toml).", show_default=False
        ),
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
        typer.Option(
            help="Measured relations between poses, one a line (Kuemmerle et al.).",
            show_default=False,
            rich_help_panel=RECORDING,
        ),
    ] = None,
    spans: Annotated[
        Path | None,
        typer.Option(
            help="Distances between places, measured by hand (TOML).", show_default=False, rich_help_panel=RECORDING
        ),
    ] = None,
    known_map: Annotated[
        Path | None,
        typer.Option(
            "--map",
            help="Track the robot in this map (YAML, or BAG?map=/map).",
            show_default=False,
            rich_help_panel=KNOWN,
        ),
    ] = None,
    start: Annotated[
        str,
        typer.Option(help="First pose x,y,yaw in the map (m, m, deg).", show_default="searched", rich_help_panel=KNOWN),
    ] = "",
    align_truth: Annotated[
        bool,
        typer.Option(
            "--align-truth", help="The truth is in another frame than the map: align it.", rich_help_panel=KNOWN
        ),
    ] = False,
    backends: Annotated[
        str,
        typer.Option(
            help="Back ends, separated by commas.",
            show_default="one of each family",
            autocompletion=options.complete_list("backends"),
            rich_help_panel=RECORDING,
        ),
    ] = "",
    everything: Annotated[bool, typer.Option("--all", help="All back ends.", rich_help_panel=RECORDING)] = False,
    as_is: Annotated[
        bool,
        typer.Option(
            "--as-is",
            help="Do not search the recording for topic, truth and no-return code.",
            rich_help_panel=RECORDING,
        ),
    ] = False,
    reader: Annotated[
        str,
        typer.Option(**options.READER, rich_help_panel=RECORDING),
    ] = "",
    setting: Annotated[
        list[str] | None,
        typer.Option("--set", help="NAME=VALUE of the reader (repeatable).", rich_help_panel=RECORDING),
    ] = None,
    nuisance: Annotated[
        int,
        options.count(
            0,
            high=MAX_NUISANCE,
            help=f"Repeat each run this many times, slightly perturbed; a verdict needs {VERDICT_REPETITIONS}.",
            show_default=False,
            rich_help_panel=RECORDING,
        ),
    ] = 0,
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
    scheduler: options.SchedulerAddress = "",
    insecure: options.Insecure = False,
    accuracy_only: options.AccuracyOnly = False,
    as_json: options.Json = False,
) -> None:
    """Compare methods on a recording or an experiment, and write the report.

    The report is one HTML page with CSV and JSON tables, trajectories and maps beside it. Exit code 1 if a run failed,
    3 if a run is still missing.
    """
    files = {"topic": topic, "relations": relations, "ground_truth": ground_truth, "spans": spans}
    given = {name: str(value) for name, value in files.items() if value}
    keys: dict[str, Value] = {
        MAP: str(known_map or ""), MAP_START: start, ALIGN_TRUTH: align_truth, NUISANCE: nuisance
    }  # fmt: skip
    keys = {name: value for name, value in keys.items() if value}
    if source.suffix == ".toml":
        flags: dict[str, object] = {
            "backends": backends, "set": setting, "all": everything, "as-is": as_is, "reader": reader
        }  # fmt: skip
        flags |= {option_name(name): value for name, value in keys.items()}
        for name in [*map(option_name, given), *(name for name, value in flags.items() if value)]:
            raise typer.BadParameter(f"--{name}: needs a recording; in an experiment it is a key of the file")
        recording, named = None, []
    else:
        if known_map is None and (start or align_truth):
            raise typer.BadParameter(f"--{'start' if start else 'align-truth'}: needs --map")
        named = _name_backends(backends, everything, announced=not method)
        settings = split_settings("--set", setting or [])
        for name in settings.keys() & given.keys():
            raise typer.BadParameter(f"--{option_name(name)}: contradicts --set {name}")
        recording = open_recording(source, settings | given, reader)
        _refuse_parameters_of_methods(recording, settings, named)
    folder = folder or RESULTS / (name_experiment(recording, keys) if recording else source.stem)
    with descriptions.only_stored_in(folder) if collect else nullcontext():
        if recording is None:
            experiment = load_experiment(source)
        else:
            experiment = _experiment_of_recording(recording, source, given, keys, named, setting or [], as_is, reader)
        experiment = experiment.without_times() if accuracy_only else experiment
        whole, experiment = experiment, experiment.select(sequence or [], method or [], seed or [])
        how = RunOptions.of(jobs, resume, rerun, collect, engine, scheduler, insecure)
        if no_page:
            _run(experiment, Store(folder), how, as_json)
        else:
            once = recording is not None and not nuisance
            again = f"evalkit {experiment.source} --nuisance {VERDICT_REPETITIONS}" if once else ""
            _run_and_report(experiment, Store(folder), how, as_json, again, whole)


def _name_backends(text: str, everything: bool, announced: bool) -> list[str]:
    """Return the named back ends, all, or those that declare themselves a default; ``announced``: print these."""
    names = split_names(text)
    if names and everything:
        raise typer.BadParameter("--all: contradicts --backends")
    if names or everything:
        return names or registry.names("backends")
    chosen = defaults.find_default_backends()
    others = len(registry.names("backends")) - len(chosen)
    if announced:
        err.print(f"{len(chosen)} methods: {', '.join(chosen)} (--all adds {others})")
    return chosen


def _refuse_parameters_of_methods(recording: Recording, settings: Mapping[str, str], backends: list[str]) -> None:
    """Raise UnknownName with their place for parameters of a method behind its name, or given to the reader."""
    registered = registry.names("backends")
    for text in backends:
        method, _, words = text.partition(" ")
        if method in registered and "=" in words:
            raise UnknownName("backend", text, registered, hint=PLACE_OF_PARAMETERS)
    known = [parameter.name for parameter in recording.spec.parameters]
    for name in (name for name in settings if name not in known):
        for method in backends:
            if any(name == parameter.name for parameter in settable_parameters(registry.find_backend(method))):
                hint = f"a parameter of {method}: {PLACE_OF_PARAMETERS}"
                raise UnknownName("parameter", name, known, recording.reader, hint=hint)


def _experiment_of_recording(
    recording: Recording,
    source: Path,
    given: dict[str, str],
    keys: dict[str, Value],
    backends: list[str],
    settings: list[str],
    as_is: bool,
    reader: str,
) -> Experiment:
    """Return the experiment of methods on one recording, whose first frame has been read; print what was chosen."""
    choices = () if as_is else recording.choose()
    for choice in choices:
        err.print(choice.reason)
    command = format_command(source, given, keys, backends, settings, as_is, reader)
    experiment = experiment_from_recording(recording, choices, backends, command, keys)
    read_first_frame(experiment)
    return experiment


def _run(experiment: Experiment, store: Store, how: RunOptions, as_json: bool) -> None:
    with _scheduler(experiment, store, how) as scheduler:
        runs = scheduler.run(experiment, _executor(experiment, how))
        # there may be thousands of runs
        none: dict[str, Any] = {"steps": NO_STEPS, "final": None, "loop_closures": (), "path_corrections": ()}
        results = {spec.key: replace(result, **none) for spec, result in runs}
    if store.is_newer_than_report(results):
        words = f"evalkit {experiment.source} --collect --out {shlex.quote(str(store.folder))}"
        err.print(f"the report in this folder is of before these runs; {words} writes it again", soft_wrap=True)
    run_summary.print_summary(
        [(spec, results[spec.key]) for spec in experiment.runs()], experiment.title, store, None, as_json
    )


def _run_and_report(
    experiment: Experiment, store: Store, how: RunOptions, as_json: bool, again: str, whole: Experiment
) -> None:
    """Run the experiment, load its records, analyse them, render the page, print the summary.

    ``again``: the command that repeats the runs, "" if they need no repetition; printed where methods can be compared.
    ``whole``: the experiment of which this one may be a part; a note tells which of its finished runs are left out.
    """
    from evalkit.api.pipeline import NothingToCollectError, run_and_report  # noqa: PLC0415 - loads pandas and matplotlib
    from evalkit.terminal.ranked_table import print_answer  # noqa: PLC0415 - as above

    with _scheduler(experiment, store, how) as scheduler:
        try:
            analysis, page = run_and_report(scheduler, experiment, _executor(experiment, how))
        except NothingToCollectError as error:
            err.print(f"evalkit: {error}")
            raise typer.Exit(3) from None
    records = analysis.comparison.records
    if not as_json and any(record.result.is_complete for record in records):
        print_answer(out, analysis)
    runs = [(record.spec, record.result) for record in records]
    shown = {spec.key for spec, _ in runs}
    if left_out := sum(store.is_finished(spec.key) for spec in whole.runs() if spec.key not in shown):
        words = f"evalkit {whole.source} --collect --out {shlex.quote(str(store.folder))}"
        count = f"{left_out} finished run{'s' * (left_out != 1)}"
        err.print(f"this report leaves out {count} in this folder; with all: {words}", soft_wrap=True)
    compared = len({record.method for record in records if record.result.is_complete}) > 1
    run_summary.print_summary(runs, experiment.title, store, page, as_json, again if compared else "")


@contextmanager
def _scheduler(experiment: Experiment, store: Store, how: RunOptions) -> Iterator[Scheduler]:
    """Yield the scheduler, with progress on standard error; the environment is read before the first run."""
    for line in progress.format_unavailable(experiment):
        err.print(line)
    progress.print_undescribed(err, [method.backend for method in experiment.methods])
    if how.resume and not how.collect and (count := store.count_outdated(spec.key for spec in experiment.runs())):
        runs = "1 run is" if count == 1 else f"{count} runs are"
        err.print(f"{runs} executed again: stored with other code, libraries, settings or data", soft_wrap=True)
    description = describe(jobs=how.jobs)
    with (
        progress.announce_kept(err, "finished runs", " with --resume"),
        progress.show_runs(err, list(experiment.runs()), how.jobs, quiet=how.collect) as shown,
    ):
        yield Scheduler(store, shown, description, how.resume, how.rerun, how.collect)


def _executor(experiment: Experiment, how: RunOptions) -> Executor:
    if how.cluster is None or how.collect:
        return LocalExecutor(how.jobs)
    return DaskExecutor(replace(how.cluster, timed=experiment.timed))
