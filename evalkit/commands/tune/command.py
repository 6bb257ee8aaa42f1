"""``evalkit tune``: search parameters with equal budgets on training worlds, and compare on held-out sequences."""

from __future__ import annotations

import json
import re
import shlex
from contextlib import nullcontext
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from evalkit.config.experiment import RESULTS
from evalkit.config.forms import MAX_POINTS
from evalkit.core.run_status import RunStatus
from evalkit.execution import environment
from evalkit.io.output_files import write_texts
from evalkit.plugins.parameters import split_settings
from evalkit.results import descriptions
from evalkit.results.store import Store
from evalkit.terminal import options, progress
from evalkit.terminal.console import err, out, print_json
from evalkit.terminal.options import Collect, Jobs, Json, Out

if TYPE_CHECKING:
    from evalkit.commands.tune.plan import Tuning
    from evalkit.commands.tune.result import TuningResult
    from evalkit.commands.tune.search_loop import MethodSearch
    from evalkit.config.experiment import Experiment
    from evalkit.results.run_record import RunRecord

BUDGET = 24
FILE = ".toml"


def tune(
    what: Annotated[list[str], typer.Argument(help="A tuning file (*.toml), or back ends.", show_default=False)],
    on: Annotated[
        list[str] | None,
        typer.Option(help="Train on this data set, 'NAME laps=0.3' (repeatable).", show_default=False),
    ] = None,
    held_out: Annotated[
        list[str] | None, typer.Option(help="Judge on this data set (repeatable).", show_default="fresh seeds of --on")
    ] = None,
    budget: Annotated[
        int | None,
        options.count(2, high=MAX_POINTS, help="Parameter points tried for each back end.", show_default=str(BUDGET)),
    ] = None,
    setting: Annotated[list[str] | None, typer.Option("--set", help="NAME=VALUE for every data set.")] = None,
    folder: Out = None,
    jobs: Jobs = None,
    collect: Collect = False,
    as_json: Json = False,
) -> None:
    """Tune back ends with equal budgets and compare them on held-out sequences.

    Finished runs are kept: repeat the command to continue an interrupted search.
    """
    from evalkit.commands.tune.result import TuningResult  # noqa: PLC0415 - loads scipy
    from evalkit.commands.tune.search_loop import make_held_out_experiment  # noqa: PLC0415 - loads scipy
    from evalkit.config.experiment_toml import format_experiment  # noqa: PLC0415 - as above
    from evalkit.report import build_comparison  # noqa: PLC0415 - as below

    options.add_working_directory()
    name = _name_tuning(what, on or [])
    folder = folder or RESULTS / name
    with descriptions.only_stored_in(folder) if collect else nullcontext():
        tuning = _read_tuning(name, what, on or [], held_out or [], budget, setting or [])
        workers = jobs or environment.physical_cores()
        ran_on = environment.describe(jobs=workers)
        started = datetime.now(UTC)
        searches = _run_search(tuning, folder, workers, collect)
        file = folder / "tuned.toml"
        plan = make_held_out_experiment(tuning, searches, shlex.quote(str(file)))
        write_texts(folder, {file.name: f"# Written by: {tuning.command}\n{format_experiment(plan)}"})
        records = _run_held_out(plan, Store(folder / "report"), workers, ran_on, collect)
        comparison = build_comparison(plan, records, started, datetime.now(UTC), ran_on)
    report = f"evalkit compare {shlex.quote(str(file))} --resume --out {shlex.quote(str(folder / 'report'))}"
    _write_results(TuningResult(tuning, searches, comparison, ran_on, report), folder, as_json)


def _name_tuning(what: list[str], on: list[str]) -> str:
    """The name of a tuning, and of its results folder: by its file, or by the data sets of the command line."""
    if not what[0].endswith(FILE):
        return re.sub(r"[^\w.=+-]+", "-", f"tune-{'-'.join(on)}")
    stem = Path(what[0]).stem
    return stem if stem.startswith("tune") else f"tune-{stem}"


def _read_tuning(
    name: str, what: list[str], on: list[str], held_out: list[str], budget: int | None, setting: list[str]
) -> Tuning:
    """The tuning of a file, or of back ends and data sets named on the command line."""
    from evalkit.commands.tune import config  # noqa: PLC0415 - loads scipy

    if what[0].endswith(FILE):
        if len(what) > 1 or on or held_out or budget is not None or setting:
            raise typer.BadParameter("a tuning file stands alone: its points, data sets and settings are in it")
        return config.load_tuning(Path(what[0]), name, f"evalkit tune {shlex.quote(what[0])}")
    if not on:
        raise typer.BadParameter(f"give a tuning file (*{FILE}), or back ends and --on DATASET to train on")
    option_words = [("--on", name) for name in on] + [("--held-out", name) for name in held_out]
    option_words += [("--budget", str(budget or BUDGET)), *(("--set", item) for item in setting)]
    command = shlex.join(["evalkit", "tune", *what, *(word for pair in option_words for word in pair)])
    content = config.make_tuning_tables(what, on, held_out, budget or BUDGET, split_settings("--set", setting))
    return config.tuning_from_tables(content, "evalkit tune", name, command)


def _run_search(tuning: Tuning, folder: Path, workers: int, collect: bool) -> tuple[MethodSearch, ...]:
    """The results of the search; exit code 3 if ``collect`` and a result is missing."""
    from evalkit.commands.tune import search_loop  # noqa: PLC0415 - loads scipy

    for tunable in tuning.methods:
        if tunable.missing:
            err.print(f"not available here: {tunable.label}: {tunable.missing}")
    results = folder / "results"
    backends = dict.fromkeys(tunable.method.backend for tunable in tuning.methods)
    if not collect:
        descriptions.save(folder, backends)
    progress.print_undescribed(err, backends)
    if collect:
        try:
            return search_loop.run_search(tuning, search_loop.load_stored(results))
        except search_loop.ResultsMissing as error:
            what = (
                f"the search is not finished: {error.missing} runs of the next points are missing; repeat the command"
            )
            out.print(f"{what} without --collect to continue")
            raise typer.Exit(3) from None
    with (
        progress.announce_kept(err, "finished runs"),
        progress.show_tasks(err, search_loop.count_runs(tuning), workers) as done,
    ):
        return search_loop.run_search(tuning, search_loop.compute_missing(results, workers, done))


def _run_held_out(
    plan: Experiment, store: Store, workers: int, ran_on: dict[str, str], collect: bool
) -> tuple[RunRecord, ...]:
    """Run default and tuned methods on the held-out sequences; stored runs are not repeated."""
    from evalkit.execution.executors import LocalExecutor  # noqa: PLC0415 - with the search's modules
    from evalkit.execution.scheduler import Scheduler  # noqa: PLC0415 - as above

    for line in progress.format_unavailable(plan):
        err.print(line)
    with progress.announce_kept(err, "finished runs"), progress.show_runs(err, list(plan.runs()), workers) as shown:
        scheduler = Scheduler(store, shown, ran_on, resume=True, collect=collect)
        return scheduler.run_and_load(plan, LocalExecutor(workers))


def _write_results(result: TuningResult, folder: Path, as_json: bool) -> None:
    """Write page and JSON, and print the verdicts; exit code 1 if a method completed no run, 3 if runs are missing."""
    from evalkit.commands.tune import page as pages  # noqa: PLC0415 - loads matplotlib
    from evalkit.commands.tune.results_json import tuning_as_json  # noqa: PLC0415 - as above
    from evalkit.report.html.blocks import render  # noqa: PLC0415 - as above

    content = tuning_as_json(result)
    write_texts(folder, {
        "tuned.json": json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False) + "\n",
        "index.html": render(pages.build_document(result)),
    })  # fmt: skip
    page = folder / "index.html"
    skipped = sum(record.result.status == RunStatus.SKIPPED for record in result.comparison.records)
    if as_json:
        print_json(content | {"page": str(page)})
    else:
        for one in result.searched:
            out.print(result.sentence(one))
        if skipped:
            out.print(f"{skipped} held-out runs are missing")
        for text in (result.report, str(page.resolve())):
            out.print(text)
    if result.failed:
        err.print(f"no run completed: {', '.join(result.failed)}")
        raise typer.Exit(1)
    if skipped:
        raise typer.Exit(3)
