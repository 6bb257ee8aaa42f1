"""Measure how often 95 % intervals hold and verdicts are false, from many seeds run once and then resampled."""

from __future__ import annotations

import json
import shlex
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, replace
from datetime import UTC, datetime
from itertools import combinations
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from evalkit.config.experiment import Experiment, load_experiment
from evalkit.core.errors import BadExperiment
from evalkit.execution import environment
from evalkit.io.output_files import write_texts
from evalkit.plugins import registry
from evalkit.terminal import options, progress
from evalkit.terminal.options import Json, Out, err, out

if TYPE_CHECKING:
    from numpy.random import Generator

    from evalkit.commands.calibration.coverage import Coverage, Verdicts
    from evalkit.metrics.table import Metric

app = typer.Typer(help="Measure intervals and verdicts.", no_args_is_help=True, add_completion=False)

SCHEMA = {"name": "evalkit-calibration", "version": 1}
MIN_SEEDS = 20


@app.command()
def calibrate(
    file: Annotated[Path, typer.Argument(help="Experiment with methods and simulated worlds (TOML).")],
    seeds: Annotated[int, typer.Option(min=MIN_SEEDS, help="Seeds of each world.")] = 160,
    subsets: Annotated[int, typer.Option(min=50, help="Random subsets for each number of runs.")] = 400,
    folder: Out = None,
    jobs: options.Jobs = None,
    as_json: Json = False,
) -> None:
    """Run every seed once, then measure intervals and verdicts of 1, 2, 3, 5 and 8 runs on random subsets.

    The exit code is 1 if a share is outside its limits.
    """
    from evalkit.commands.calibration import page  # noqa: PLC0415 - loads matplotlib
    from evalkit.report.html.blocks import render  # noqa: PLC0415 - as above

    experiment = load_experiment(file)
    folder = folder or Path("reports") / "build" / "calibration"
    content = {
        "schema": SCHEMA,
        "command": shlex.join(["python", "-m", "evalkit.commands.calibration", *sys.argv[1:]]),
        "created": datetime.now(UTC).strftime("%Y-%m-%d"),
        "versions": environment.versions(("evalkit", "numpy", "scipy")),
        "seeds": seeds,
        "subsets": subsets,
        **measure(experiment, seeds, subsets, folder, jobs),
    }
    texts = {
        "calibration.json": json.dumps(content, indent=1) + "\n",
        "calibration.md": page.format_markdown(content),
        "index.html": render(page.build_document(content)),
    }
    write_texts(folder, texts)
    if as_json:
        options.print_json(content | {"page": str(folder / "index.html")})
    else:
        out.print(texts["calibration.md"], markup=False, highlight=False)
        out.print(str((folder / "index.html").resolve()), markup=False, highlight=False)
    if content["failures"]:
        err.print(f"evalkit: outside the limits: {'; '.join(content['failures'])}", markup=False, highlight=False)
        raise typer.Exit(1)


def measure(experiment: Experiment, seeds: int, subsets: int, folder: Path, jobs: int | None) -> dict[str, Any]:
    """Run the seeds and resample them: ``coverage``, ``verdicts`` and ``failures`` as JSON."""
    import numpy as np  # noqa: PLC0415 - loaded only if something is computed

    from evalkit.commands.calibration import coverage, seed_runs  # noqa: PLC0415 - as above
    from evalkit.metrics import METRICS  # noqa: PLC0415 - as above

    results = _run_seeds(experiment, seeds, folder, jobs)
    labels = [method.label for method in experiment.methods]
    intervals, verdicts = [], []
    for metric in (metric for metric in METRICS if metric.name in seed_runs.METRICS):
        for number, (world, own) in enumerate(results.items()):
            rng = np.random.default_rng([number, *metric.name.encode()])
            found = [*_measure_world(metric, world, own, labels, subsets, rng)]
            intervals += [one for one in found if isinstance(one, coverage.Coverage)]
            verdicts += [one for one in found if isinstance(one, coverage.Verdicts)]
    return {
        "coverage": [asdict(one) for one in intervals],
        "verdicts": [asdict(one) for one in verdicts],
        "failures": coverage.find_failures(intervals, verdicts),
    }


def _measure_world(
    metric: Metric, world: str, results: Sequence[Mapping[str, Any]], labels: list[str], subsets: int, rng: Generator
) -> Iterator[Coverage | Verdicts]:
    """Resample the runs of one world in one metric."""
    from evalkit.commands.calibration import coverage, seed_runs  # noqa: PLC0415 - loads NumPy

    found = {label: seed_runs.read_runs(world, label, metric.name, results) for label in (*labels, *seed_runs.DRIFTS)}
    for runs in coverage.RUNS:
        for label in (*labels, seed_runs.DRIFTS[0]):
            yield coverage.measure_coverage(found[label], runs, rng, subsets)
        for one, other in (*combinations(labels, 2), seed_runs.DRIFTS):
            yield coverage.measure_verdicts(metric, found[one], found[other], runs, rng, subsets)


def _run_seeds(
    experiment: Experiment, seeds: int, folder: Path, jobs: int | None
) -> dict[str, Sequence[Mapping[str, Any]]]:
    """Run every seed of every world; results by world, in the order of the seeds."""
    from evalkit.commands.calibration.seed_runs import make_seed_task  # noqa: PLC0415 - loads NumPy
    from evalkit.execution.task_runner import run_tasks  # noqa: PLC0415 - as above
    from evalkit.execution.task_store import TaskStore  # noqa: PLC0415 - as above

    for sequence in experiment.sequences:
        if not registry.dataset(sequence.dataset).seeded:
            raise BadExperiment(sequence.label, "", "is a recording; give simulated worlds, which have seeds")
    methods = [(method.label, method.backend, method.parameters) for method in experiment.methods]
    backends = [registry.plug_in_of("backends", backend).module for _, backend, _ in methods]
    tasks = {
        (sequence.label, seed): make_seed_task(
            sequence.label,
            sequence.dataset,
            replace(sequence, seeds=(seed,)).parameters_with_seed(seed),
            seed,
            methods,
            [registry.plug_in_of("datasets", sequence.dataset).module, *backends],
        )
        for sequence in experiment.sequences
        for seed in range(seeds)
    }
    at_once = jobs or environment.physical_cores()
    with progress.announce_kept(err, "finished jobs"), progress.show_tasks(err, len(tasks), at_once) as done:
        results = run_tasks(TaskStore(folder / "results"), list(tasks.values()), at_once, done)
    return {
        sequence.label: [results[tasks[sequence.label, seed].name] for seed in range(seeds)]
        for sequence in experiment.sequences
    }
