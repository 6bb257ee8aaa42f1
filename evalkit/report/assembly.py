"""Build the input of a report from an experiment and its runs: cards from the specs, and sentences on fairness."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from datetime import datetime
from functools import cache
from importlib.metadata import PackageNotFoundError, metadata, packages_distributions

from evalkit.config.experiment import Experiment, MapperChoice, Method, SequenceSpec
from evalkit.config.limits import Limits
from evalkit.execution import environment
from evalkit.metrics import all_metrics
from evalkit.metrics.metric import Metric
from evalkit.odometry.frontend import settable_parameters
from evalkit.plugins import registry
from evalkit.plugins.parameters import Parameter, Value
from evalkit.plugins.protocols import Sequence as SensorSequence
from evalkit.plugins.specs import GUESS_NOT_REPORTED
from evalkit.report.analysis.comparison import Comparison, MethodCard, SequenceCard, Setting
from evalkit.results.run_record import RunRecord

LIBRARIES = ("numpy", "scipy")


def build_comparison(
    experiment: Experiment,
    runs: Sequence[RunRecord],
    started: datetime,
    finished: datetime,
    ran_on: Mapping[str, str] | None = None,
) -> Comparison:
    """Return the comparison of an experiment's runs, with every registered metric that its methods can have.

    ``ran_on``: the environment before the first run; without it, the present one.
    """
    specs = [registry.find_backend(method.backend) for method in experiment.methods]
    where = dict(ran_on or environment.describe())
    libraries = dict.fromkeys((*LIBRARIES, *(find_distribution(name) for spec in specs for name in spec.requires)))
    return Comparison(
        title=experiment.title,
        description=experiment.description,
        records=sort_runs(experiment, runs),
        metrics=select_metrics(runs),
        methods={method.label: build_method_card(method) for method in experiment.methods},
        sequences={sequence.label: build_sequence_card(sequence, runs) for sequence in experiment.sequences},
        environment={**where, **environment.versions(libraries)},
        command=experiment.whole_command,
        started=started,
        finished=finished,
        mapper=describe_mapper(experiment.mapper),
        fairness=(*describe_fairness(runs, where), describe_limits(experiment.limits)),
        scans={sequence.label: open_sequence(sequence) for sequence in experiment.sequences if not sequence.missing},
    )


def select_metrics(runs: Sequence[RunRecord]) -> tuple[Metric, ...]:
    """Return all metrics; without corrected poses or a known map in any run, without those that need them."""
    corrected = any(run.result.final is not None for run in runs)
    tracked = any(run.result.start is not None for run in runs)
    return tuple(
        metric
        for metric in all_metrics()
        if (corrected or not metric.slam_only) and (tracked or metric.group != "localisation")
    )


def open_sequence(sequence: SequenceSpec) -> Callable[[], SensorSequence]:
    """Return a function that opens a sequence at its lowest seed."""
    seed = min(sequence.seeds, key=lambda one: -1 if one is None else one)
    return lambda: registry.dataset(sequence.dataset).open(sequence.parameters_with_seed(seed))


def sort_runs(experiment: Experiment, runs: Sequence[RunRecord]) -> tuple[RunRecord, ...]:
    """Return the runs by sequence, seed and method in the experiment's order, whatever the order of execution."""
    methods = [method.label for method in experiment.methods]
    sequences = {sequence.label: (row, sequence.seeds) for row, sequence in enumerate(experiment.sequences)}

    def position(run: RunRecord) -> tuple[int, int, int]:
        row, seeds = sequences[run.sequence]
        return row, seeds.index(run.seed), methods.index(run.method)

    return tuple(sorted(runs, key=position))


def find_distribution(requirement: str) -> str:
    """Return the installed distribution of a requirement: a package may be distributed under another name."""
    try:
        return str(metadata(requirement)["Name"])
    except PackageNotFoundError:
        known = _distributions()
    return known.get(requirement.replace("-", "_"), [requirement])[0]


@cache
def _distributions() -> Mapping[str, Sequence[str]]:
    return packages_distributions()  # reads the records of everything installed: a second


def build_method_card(method: Method) -> MethodCard:
    """Return the card of a method with all its settings."""
    spec = registry.find_backend(method.backend)
    settings = build_settings(method.parameters, settable_parameters(spec), "set for this method")
    guess = "" if spec.guess == GUESS_NOT_REPORTED else spec.guess
    own = (guess, method.missing, spec.role, method.tuned_on, spec.map_use)
    return MethodCard(spec.summary, spec.citation, spec.licence, settings, *own)


def build_settings(given: Mapping[str, Value], parameters: Sequence[Parameter], otherwise: str) -> tuple[Setting, ...]:
    """Return the values beside the defaults; ``otherwise``: the meaning of a value without a declared parameter."""
    known = {parameter.name: parameter for parameter in parameters}
    return tuple(
        Setting(name, value, known[name].default, known[name].unit, known[name].meaning)
        if name in known
        else Setting(name, value, value, "", otherwise)
        for name, value in given.items()
    )


def build_sequence_card(sequence: SequenceSpec, runs: Sequence[RunRecord]) -> SequenceCard:
    """Return the card of a sequence; its ground truth as the runs found it, else as the data set describes it."""
    spec = registry.dataset(sequence.dataset)
    truths = dict.fromkeys(run.truth.how for run in runs if run.sequence == sequence.label and len(run.result.steps))
    return SequenceCard(
        spec.summary,
        spec.sensor,
        "; ".join(truths) or spec.truth,
        spec.citation,
        spec.licence,
        spec.defects,
        spec.degenerate,
        spec.published,
        build_settings(sequence.parameters, spec.parameters, "set for this sequence"),
        sequence.warnings,
        spec.seeded,
    )


def describe_mapper(mapper: MapperChoice) -> str:
    """Return the mapper with its settings and its number of scans."""
    settings = ", ".join(f"{name} {value}" for name, value in mapper.parameters.items())
    return f"{mapper.name} ({settings}) from at most {mapper.scans} scans, evenly spaced."


def describe_fairness(runs: Sequence[RunRecord], environment: Mapping[str, str]) -> tuple[str, ...]:
    """Return sentences on what was equal for all methods and what was not; ``environment``: of the runs."""
    warm = sorted({run.result.warm_up_scans for run in runs if len(run.result.steps)})
    warmed = f"the first {'/'.join(map(str, warm))} scans" if warm else "the first scans"
    at_once = environment.get("runs at a time", "")
    map_only = any(run.result.is_complete and not len(run.result.steps) for run in runs)
    elsewhere = "; a map from another program is compared with the ground truth as it is" if map_only else ""
    shared = "; concurrent runs share caches and memory and slow each other down" if at_once != "1" else ""
    alike = ", so that slow periods affect all alike"
    if "earlier runs" in environment:  # kept by --resume: the turns were not taken in this order
        alike = " where they ran in one call; some were kept from earlier calls, so a slow period may affect only some"
    return (
        *([f"Runs at a time: {at_once}{shared}."] if at_once else []),
        "Each run has its own process with one thread for numerical libraries. Methods take turns within each "
        f"repetition, in reverse order in every second one (A B, B A){alike}.",
        "Only the call of the method is timed. Conversion to and from a library's format is part of it and is also "
        "shown apart. Reading, checking and storing are not timed.",
        f"Another instance processes {warmed} before the timed one starts, to exclude imports and first allocations.",
        "The card of each method states the initial guess of its registration. All methods that start from wheel "
        "odometry get the same odometry.",
        "One mapper draws all maps from the methods' trajectories, aligned to the ground truth if there is one"
        f"{elsewhere}.",
        "Runs that did not complete are counted and shown, and enter no median. A method is not ranked on a data set "
        "where one of its runs did not complete or lost the track.",
    )


def describe_limits(limits: Limits) -> str:
    """Return the limits of every run in one sentence."""
    return (
        f"Every run, with all its child processes, was limited to {limits.run_s:g} s in all and {limits.scan_s:g} s "
        f"per answer of wall time, {limits.run_cpu_s:g} s and {limits.scan_cpu_s:g} s of CPU time, and "
        f"{limits.memory_mib} MiB of memory. A run that exceeds a limit is ended, and its answers so far are partial."
    )
