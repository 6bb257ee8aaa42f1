"""The command line: arguments, paths, progress, exit codes (0 fine, 1 failed run or broken rule, 2 usage); no more."""

from __future__ import annotations

import shlex
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import asdict, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated

import typer
from rich.markup import escape
from rich.table import Table

from evalkit import __version__
from evalkit.commands.basin.command import basin
from evalkit.commands.diff.benchmark_command import bench
from evalkit.commands.diff.command import diff
from evalkit.commands.export.command import export
from evalkit.commands.metric_validation.command import metrics
from evalkit.commands.realtime.command import realtime
from evalkit.commands.study.command import study
from evalkit.commands.tune.command import tune
from evalkit.commands.validate.check_command import check
from evalkit.commands.validate.command import validate
from evalkit.commands.validate.determinism_command import determinism
from evalkit.commands.validate.equivalence_command import equiv
from evalkit.config import adhoc_experiment, experiment
from evalkit.config.experiment import Experiment
from evalkit.core.errors import EvalkitError, NotInstalled
from evalkit.core.run_result import NOT_EXECUTED
from evalkit.execution import environment
from evalkit.execution.executors import There
from evalkit.execution.scheduler import Engine
from evalkit.plugins import registry
from evalkit.results.store import Store, reported
from evalkit.terminal import inventory, options, progress, run_summary
from evalkit.terminal.options import AccuracyOnly, Collect, Jobs, Json, Making, Out, Rerun, Resume, Scheduler, err, out

app = typer.Typer(
    help="Which scan matcher, on my robot, and is my own one right? Compare 2D lidar registration back ends.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
)

ExperimentFile = Annotated[Path, typer.Argument(help="An experiment file (*.toml).", show_default=False)]
Sequences = Annotated[list[str] | None, typer.Option(help="Only this sequence (repeatable).", show_default="all")]
Methods = Annotated[list[str] | None, typer.Option(help="Only this method (repeatable).", show_default="all")]
Seeds = Annotated[list[int] | None, typer.Option(help="Only this seed (repeatable).", show_default="all")]


def main() -> None:
    """Entry point: every EvalkitError becomes one line and exit code 2."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # whoever ends us must not leave our runs behind
    try:
        for name in registry.names("commands"):  # of plug-ins: the data sets bring "datasets"
            _add(name, registry.load("commands", name, object))
        app()
    except EvalkitError as error:
        err.print(f"evalkit: {error}", style="red", markup=False, highlight=False)
        sys.exit(2)


def _add(name: str, command: object) -> None:
    """A plug-in's command: a function, or a whole typer application."""
    if isinstance(command, typer.Typer):
        app.add_typer(command, name=name)
    elif callable(command):
        app.command(name)(command)
    else:
        raise NotInstalled(name, f"its command is a {type(command).__name__}", "expected a function or a typer.Typer")


@app.callback(invoke_without_command=True)
def _root(version: Annotated[bool, typer.Option("--version", help="Print the version.")] = False) -> None:
    if version:
        out.print(f"evalkit {__version__}", highlight=False)
        raise typer.Exit


@app.command("list")
def list_(
    kind: Annotated[str, typer.Argument(help="backends, mappers, datasets, metrics or all.")] = "all",
    as_json: Json = False,
) -> None:
    """Back ends, mappers, data sets and metrics, with what is missing and why."""
    if kind != "all" and kind not in inventory.KINDS:
        raise typer.BadParameter(f"found '{kind}', expected one of: all, {', '.join(inventory.KINDS)}")
    chosen = {name: rows for name, rows in inventory.KINDS.items() if kind in ("all", name)}
    found = {name: rows() for name, rows in chosen.items()}
    if as_json:
        options.print_json({name: [asdict(row) for row in rows] for name, rows in found.items()})
        return
    for name, rows in found.items():
        table = Table("name", "what it is", "missing here", title=name, title_justify="left", expand=out.is_terminal)
        for row in rows:
            table.add_row(*map(escape, (row.name, row.summary, row.missing or "-")))
        progress.show(out, table)


@app.command()
def run(
    file: ExperimentFile,
    folder: Out = None,
    jobs: Jobs = None,
    resume: Resume = False,
    rerun: Rerun = None,
    collect: Collect = False,
    sequence: Sequences = None,
    method: Methods = None,
    seed: Seeds = None,
    engine: options.Engine = "local",
    scheduler: Scheduler = "",
    accuracy_only: AccuracyOnly = False,
    as_json: Json = False,
) -> None:
    """Run an experiment and score it; results land in the folder as they come."""
    plan = _plan(experiment.read(file), accuracy_only).only(sequence or [], method or [], seed or [])
    store = Store(folder or _folder(plan))
    how = Making.of(jobs, resume, rerun, collect, engine, scheduler)
    with _engine(plan, store, how) as asked, closing(asked.ended()) as all_ended:
        runs = {run.spec.key: run_summary.without_steps(run) for run in all_ended}
    run_summary.print_summary([runs[spec.key] for spec in asked.planned], plan.title, store, None, as_json)


@app.command()
def report(
    file: ExperimentFile,
    folder: Out = None,
    jobs: Jobs = None,
    resume: Resume = False,
    rerun: Rerun = None,
    collect: Collect = False,
    sequence: Sequences = None,
    method: Methods = None,
    seed: Seeds = None,
    engine: options.Engine = "local",
    scheduler: Scheduler = "",
    accuracy_only: AccuracyOnly = False,
    as_json: Json = False,
) -> None:
    """Run an experiment and write its report: one HTML page, CSV and JSON tables, trajectories and maps."""
    plan = _plan(experiment.read(file), accuracy_only).only(sequence or [], method or [], seed or [])
    _report(plan, folder, Making.of(jobs, resume, rerun, collect, engine, scheduler), as_json)


@app.command()
def compare(
    file: Annotated[Path, typer.Argument(help="A bag (ROS 1 or 2) or a CARMEN log.", show_default=False)],
    topic: Annotated[str, typer.Option(help="Laser topic of a bag.", show_default="the only one")] = "",
    relations: Annotated[Path | None, typer.Option(help="Relations file (Kuemmerle).", show_default=False)] = None,
    reference: Annotated[Path | None, typer.Option(help="True trajectory (TUM).", show_default=False)] = None,
    spans: Annotated[Path | None, typer.Option(help="Distances by tape (TOML).", show_default=False)] = None,
    backends: Annotated[str, typer.Option(help="Back ends, a,b,c.", show_default="all")] = "",
    setting: Annotated[list[str] | None, typer.Option("--set", help="NAME=VALUE for the reader.")] = None,
    folder: Out = None,
    jobs: Jobs = None,
    resume: Resume = False,
    rerun: Rerun = None,
    collect: Collect = False,
    sequence: Sequences = None,
    method: Methods = None,
    engine: options.Engine = "local",
    scheduler: Scheduler = "",
    accuracy_only: AccuracyOnly = False,
    as_json: Json = False,
) -> None:
    """Compare back ends on your own recording, in one line."""
    given = {"topic": topic, "relations": relations, "reference": reference, "spans": spans}
    source = f"compare {shlex.quote(str(file))}" + "".join(
        f" --{name} {shlex.quote(str(value))}" for name, value in given.items() if value
    )
    source += f" --backends {shlex.quote(backends)}" if backends else ""
    source += "".join(f" --set {shlex.quote(item)}" for item in setting or [])
    own = {name: str(value) for name, value in given.items() if value}
    names = [name for word in backends.split(",") if (name := word.strip())]
    plan = adhoc_experiment.plan(file, own, options.settings(setting or []), names, source)
    adhoc_experiment.first_frame(plan)
    plan = _plan(plan, accuracy_only).only(sequence or [], method or [], [])
    _report(plan, folder, Making.of(jobs, resume, rerun, collect, engine, scheduler), as_json)


COMMANDS: tuple[Callable[..., None], ...] = (
    check, equiv, realtime, basin, determinism, diff, validate, study, tune, export,
)  # fmt: skip
"""The commands with a module of their own, in the order of the help."""

for _command in COMMANDS:
    app.command()(_command)
app.add_typer(metrics, name="metrics")
app.add_typer(bench, name="bench")


def _report(plan: Experiment, folder: Path | None, how: Making, as_json: bool) -> None:
    from evalkit import report as pages  # noqa: PLC0415 - loads pandas and matplotlib: only who draws pays for them

    started = datetime.now(UTC)
    store = Store(folder or _folder(plan))
    with _engine(plan, store, how) as asked:
        records = asked.records()
    made = [record.result.provenance for record in records if record.result.status not in NOT_EXECUTED]
    ran_on = {**asked.ran_on, **environment.kept(made, started), **environment.machines(made)}
    comparison = pages.comparison_of(plan, records, started, datetime.now(UTC), ran_on)
    with reported(store.folder):
        page = pages.write(comparison, store.folder)
    run_summary.print_summary(records, plan.title, store, page, as_json)


@contextmanager
def _engine(plan: Experiment, store: Store, how: Making) -> Iterator[Engine]:
    """What makes the runs of a plan, told of while it does; it knows the machine as it was before the first."""
    for line in progress.missing(plan):
        err.print(line, markup=False, highlight=False)
    place = There(replace(how.cluster, timed=plan.timed)) if how.cluster else None
    ran_on = environment.describe(jobs=how.jobs)
    try:
        with progress.progress(err, list(plan.runs()), how.jobs, quiet=how.collect) as shown:
            yield Engine(plan, store, shown, how.jobs, how.resume, ran_on, how.rerun, how.collect, place)
    except KeyboardInterrupt:
        err.print("interrupted; finished runs are kept: the same command with --resume goes on from here")
        raise


def _plan(plan: Experiment, accuracy_only: bool) -> Experiment:
    return plan.untimed() if accuracy_only else plan


def _folder(plan: Experiment) -> Path:
    return Path("reports") / "build" / plan.name
