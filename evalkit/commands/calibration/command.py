"""Measure how often 95 % intervals hold and verdicts are false, from many runs made once and then resampled."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import combinations
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from evalkit.commands.calibration import coverage, page, seed_runs
from evalkit.commands.calibration.coverage import Coverage, Verdicts
from evalkit.config.experiment import Experiment, SequenceSpec
from evalkit.config.experiment_file import load_experiment
from evalkit.core.errors import BadExperiment
from evalkit.execution import environment
from evalkit.io.json_values import indent_json
from evalkit.io.output_files import write_texts
from evalkit.metrics import METRICS
from evalkit.metrics.metric import Metric
from evalkit.plugins import registry
from evalkit.report.analysis.pairwise import noise_floor
from evalkit.report.html.blocks import render
from evalkit.terminal import options
from evalkit.terminal.console import err, out, print_json
from evalkit.terminal.options import Json, Out
from evalkit.terminal.shown_tasks import run_shown_tasks

app = typer.Typer(help="Measure intervals and verdicts.", no_args_is_help=True, add_completion=False)

SCHEMA = {"name": "evalkit-calibration", "version": 2}
MIN_POPULATION = 20
"""Fewer seeds or perturbations of a sequence are not resampled."""


@app.command()
def calibrate(
    file: Annotated[Path, typer.Argument(help="Experiment with methods, worlds and perturbed recordings (TOML).")],
    seeds: Annotated[int, options.count(MIN_POPULATION, help="Seeds of each world.")] = 120,
    subsets: Annotated[int, options.count(50, help="Random subsets for each number of runs.")] = 400,
    folder: Out = None,
    jobs: options.Jobs = None,
    as_json: Json = False,
) -> None:
    """Run every seed of each world and every perturbation of each recording once, then resample the runs.

    Measures intervals and verdicts of 1, 2, 3, 5 and 8 runs on random subsets. A recording that is not on this machine
    is skipped. The exit code is 1 if a share is outside its limits.
    """
    experiment = load_experiment(file)
    folder = folder or Path("reports") / "build" / "calibration"
    content = {
        "schema": SCHEMA,
        **environment.describe_origin("evalkit.commands.calibration"),
        "seeds": seeds,
        "subsets": subsets,
        **measure(experiment, seeds, subsets, folder, jobs),
    }
    texts = {
        "calibration.json": indent_json(content),
        "calibration.md": page.format_markdown(content),
        "index.html": render(page.build_document(content)),
    }
    write_texts(folder, texts)
    if as_json:
        print_json(content | {"page": str(folder / "index.html")})
    else:
        out.print(texts["calibration.md"])
        out.print(str((folder / "index.html").resolve()))
    for line in content["skipped"]:
        err.print(f"evalkit: skipped: {line}")
    if content["failures"]:
        err.print(f"evalkit: outside the limits: {'; '.join(content['failures'])}")
        raise typer.Exit(1)


def measure(experiment: Experiment, seeds: int, subsets: int, folder: Path, jobs: int | None) -> dict[str, Any]:
    """Run the seeds and perturbations and resample them: the measured keys of ``calibration.json``."""
    sequences, skipped = _select_sequences(experiment)
    results = _run_all(experiment, sequences, seeds, folder, jobs)
    labels = [method.label for method in experiment.methods]
    intervals: list[Coverage] = []
    verdicts: list[Verdicts] = []
    for number, sequence in enumerate(sequences):
        found = measure_sequence(number, sequence, results[sequence.label], labels, subsets)
        intervals += found.coverage
        verdicts += found.verdicts
        skipped += found.skipped
    if not intervals:
        raise BadExperiment(experiment.name, "", f"no runs to resample: {'; '.join(skipped)}")
    recordings = [sequence.label for sequence in sequences if sequence.perturbed]
    return {
        "recordings": recordings,
        "skipped": skipped,
        "coverage": [asdict(one) for one in intervals],
        "verdicts": [asdict(one) for one in verdicts],
        "failures": coverage.find_failures(intervals, verdicts, recordings),
    }


@dataclass(frozen=True, slots=True)
class SequenceCalibration:
    """Intervals and verdicts of one sequence, and what of it was skipped, in words."""

    coverage: tuple[Coverage, ...]
    verdicts: tuple[Verdicts, ...]
    skipped: tuple[str, ...]


def _select_sequences(experiment: Experiment) -> tuple[list[SequenceSpec], list[str]]:
    """Return the worlds and the recordings on this machine, and in words what is skipped."""
    sequences, skipped = [], []
    for sequence in experiment.sequences:
        if sequence.missing:
            skipped.append(f"{sequence.label}: {sequence.missing}")
        elif registry.dataset(sequence.dataset).seeded or len(sequence.seeds) >= MIN_POPULATION:
            sequences.append(sequence)
        else:
            found = f"is a recording with too few runs ({len(sequence.seeds)})"
            raise BadExperiment(sequence.label, "", f"{found}; write nuisance = {MIN_POPULATION} or more")
    return sequences, skipped


def measure_sequence(
    number: int, sequence: SequenceSpec, results: Sequence[Mapping[str, Any]], labels: Sequence[str], subsets: int
) -> SequenceCalibration:
    """Resample the runs of one sequence in every metric; a method that failed in any run is left out."""
    reasons = {label: seed_runs.read_reasons(label, results) for label in labels}
    skipped = [
        f"{sequence.label}: {label} failed in {len(found)} of {len(results)} runs ({found[0]})"
        for label, found in reasons.items()
        if found
    ]
    able = [label for label in labels if not reasons[label]]
    rows: list[Coverage | Verdicts] = []
    for metric in (metric for metric in METRICS if metric.name in seed_runs.METRICS):
        scored = seed_runs.select_scored(able, metric.name, results) if able else []
        if len(scored) >= MIN_POPULATION:
            rng = np.random.default_rng([number, *metric.name.encode()])
            rows += _resample(metric, sequence, scored, able, subsets, rng)
        elif scored:
            skipped.append(
                f"{sequence.label}: {metric.name}: {len(scored)} runs have a value, {MIN_POPULATION} are needed"
            )
    if able and not rows:
        skipped.append(f"{sequence.label}: too few runs have a value of {', '.join(seed_runs.METRICS)}")
    return SequenceCalibration(
        tuple(one for one in rows if isinstance(one, Coverage)),
        tuple(one for one in rows if isinstance(one, Verdicts)),
        tuple(skipped),
    )


def _resample(
    metric: Metric,
    sequence: SequenceSpec,
    results: Sequence[Mapping[str, Any]],
    labels: Sequence[str],
    subsets: int,
    rng: np.random.Generator,
) -> Iterator[Coverage | Verdicts]:
    """Resample the runs of one sequence in one metric; verdicts only where the ground truth has no noise floor."""
    drifts = () if sequence.perturbed else seed_runs.DRIFTS
    found = {label: seed_runs.read_runs(sequence.label, label, metric.name, results) for label in (*labels, *drifts)}
    pairs = [] if noise_floor(metric) > 0.0 else [*combinations(labels, 2), *([drifts] if drifts else [])]
    for runs in coverage.RUNS:
        for label in (*labels, *drifts[:1]):
            yield coverage.measure_coverage(found[label], runs, rng, subsets)
        for one, other in pairs:
            yield coverage.measure_verdicts(metric, found[one], found[other], runs, rng, subsets, sequence.perturbed)


def _run_all(
    experiment: Experiment, sequences: Sequence[SequenceSpec], seeds: int, folder: Path, jobs: int | None
) -> dict[str, Sequence[Mapping[str, Any]]]:
    """Run every seed or perturbation of every sequence; results by sequence, in the order of the seeds."""
    methods = [(method.label, method.backend, method.parameters) for method in experiment.methods]
    backends = [registry.plug_in_of("backends", backend).module for _, backend, _ in methods]
    repeats = {one.label: one.seeds if one.perturbed else tuple(range(seeds)) for one in sequences}
    tasks = {
        (sequence.label, seed): seed_runs.make_seed_task(
            sequence.label,
            sequence.dataset,
            sequence.parameters_with_seed(seed),
            seed,
            methods,
            [registry.plug_in_of("datasets", sequence.dataset).module, *backends],
        )
        for sequence in sequences
        for seed in repeats[sequence.label]
    }
    results = run_shown_tasks(list(tasks.values()), folder, jobs, "jobs")
    return {label: [results[tasks[label, seed].name] for seed in chosen] for label, chosen in repeats.items()}
