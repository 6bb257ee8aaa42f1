"""A plan and its records made one comparison: cards from the specs, and what was held equal, in sentences."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from datetime import datetime
from functools import cache
from importlib.metadata import PackageNotFoundError, metadata, packages_distributions

from evalkit.config.experiment import Experiment, Limits, MapperChoice, Method, SequenceSpec
from evalkit.execution import environment
from evalkit.metrics import all_metrics
from evalkit.odometry.frontend import settable_parameters
from evalkit.plugins import registry
from evalkit.plugins.parameters import Parameter, Value
from evalkit.plugins.protocols import Sequence as Recording
from evalkit.plugins.specs import GUESS_NOT_REPORTED
from evalkit.report.analysis.comparison import Comparison, MethodCard, SequenceCard, Setting
from evalkit.results.run_record import RunRecord

LIBRARIES = ("numpy", "scipy")


def comparison_of(
    plan: Experiment,
    records: Sequence[RunRecord],
    started: datetime,
    finished: datetime,
    ran_on: Mapping[str, str] | None = None,
) -> Comparison:
    """The comparison of a plan's records, scored by every registered metric.

    ``ran_on``: the environment as it was before the first run; without it, as it is now.
    """
    specs = [registry.find_backend(method.backend) for method in plan.methods]
    where = dict(ran_on or environment.describe())
    libraries = dict.fromkeys((*LIBRARIES, *(distribution(name) for spec in specs for name in spec.requires)))
    return Comparison(
        title=plan.title,
        description=plan.description,
        records=in_order(plan, records),
        metrics=all_metrics(),
        methods={method.label: method_card(method) for method in plan.methods},
        sequences={sequence.label: sequence_card(sequence, records) for sequence in plan.sequences},
        environment={**where, **environment.versions(libraries)},
        command=f"evalkit {plan.source}",
        started=started,
        finished=finished,
        mapper=mapper_text(plan.mapper),
        fairness=(*fairness(records, where), limits_text(plan.limits)),
        scans={sequence.label: scans_of(sequence) for sequence in plan.sequences if not sequence.missing},
    )


def scans_of(sequence: SequenceSpec) -> Callable[[], Recording]:
    """What makes the sequence of a sequence's lowest seed."""
    seed = min((seed for seed in sequence.seeds if seed is not None), default=None)
    return lambda: registry.dataset(sequence.dataset).make(**sequence.seeded(seed))


def in_order(plan: Experiment, records: Sequence[RunRecord]) -> tuple[RunRecord, ...]:
    """The records by sequence, seed and method as the plan names them, whatever the order they were run in."""
    entrants = [method.label for method in plan.methods]
    sequences = {sequence.label: (row, sequence.seeds) for row, sequence in enumerate(plan.sequences)}

    def place(record: RunRecord) -> tuple[int, int, int]:
        row, seeds = sequences[record.sequence]
        return row, seeds.index(record.seed), entrants.index(record.method)

    return tuple(sorted(records, key=place))


def distribution(requirement: str) -> str:
    """The installed distribution that answers a requirement: open3d also comes as open3d-cpu."""
    try:
        return str(metadata(requirement)["Name"])
    except PackageNotFoundError:
        known = _distributions()
    return known.get(requirement.replace("-", "_"), [requirement])[0]


@cache
def _distributions() -> Mapping[str, Sequence[str]]:
    return packages_distributions()  # reads the records of everything installed: a second


def method_card(method: Method) -> MethodCard:
    """The card of a method, with every setting it ran with."""
    spec = registry.find_backend(method.backend)
    settings = settings_of(method.parameters, settable_parameters(spec), "set for this method")
    guess = "" if spec.guess == GUESS_NOT_REPORTED else spec.guess
    return MethodCard(spec.summary, spec.citation, spec.licence, settings, guess, method.missing, spec.role)


def settings_of(given: Mapping[str, Value], parameters: Sequence[Parameter], otherwise: str) -> tuple[Setting, ...]:
    """The values beside the defaults; ``otherwise``: the meaning of one that is no declared parameter."""
    known = {parameter.name: parameter for parameter in parameters}
    return tuple(
        Setting(name, value, known[name].default, known[name].unit, known[name].meaning)
        if name in known
        else Setting(name, value, value, "", otherwise)
        for name, value in given.items()
    )


def sequence_card(sequence: SequenceSpec, records: Sequence[RunRecord]) -> SequenceCard:
    """The card of a sequence; the truth is told as its runs met it, else as the data set promises it."""
    spec = registry.dataset(sequence.dataset)
    met = dict.fromkeys(t.truth.how for t in records if t.sequence == sequence.label and len(t.result.steps))
    return SequenceCard(
        spec.summary,
        spec.sensor,
        "; ".join(met) or spec.truth,
        spec.citation,
        spec.licence,
        spec.defects,
        spec.degenerate,
        spec.published,
        settings_of(sequence.parameters, spec.parameters, "set for this sequence"),
    )


def mapper_text(mapper: MapperChoice) -> str:
    """The mapper with its settings, and how many scans it was given."""
    return f"{mapper.name} ({_settings(mapper.parameters)}) from at most {mapper.scans} scans, evenly spaced."


def fairness(records: Sequence[RunRecord], environment: Mapping[str, str]) -> tuple[str, ...]:
    """What was held equal between methods, and what was not; ``environment``: what they ran on."""
    warm = sorted({record.result.warm_up_scans for record in records if len(record.result.steps)})
    warmed = f"the first {'/'.join(map(str, warm))} scans" if warm else "the first scans"
    at_once = environment.get("runs at a time", "")
    given = any(record.result.is_complete and not len(record.result.steps) for record in records)
    elsewhere = "; a map made elsewhere is held against the truth as it is" if given else ""
    shared = "; those at the same time share caches and memory, and slow each other" if at_once != "1" else ""
    return (
        *([f"Runs at a time: {at_once}{shared}."] if at_once else []),
        "Every run has a process of its own, one thread for numerical libraries, and methods take turns within "
        "each repetition, forth in one and back in the next (A B, B A), so that a slow hour hits all alike.",
        "Only the method's own call is timed; turning values into a library's format and back is part of it and is "
        "also shown apart. Reading, checking and storing are not timed.",
        f"Imports and first allocations are paid by another instance that sees {warmed} before the timed one starts.",
        "What a method starts its registration from is on its card; all that start from wheel odometry get the "
        "same odometry.",
        "All maps are drawn by one mapper from each method's trajectory, aligned to the truth where there is one"
        f"{elsewhere}.",
        "Runs that did not complete are counted and shown, and enter no median; nobody who lost a run can win.",
    )


def limits_text(limits: Limits) -> str:
    """The limits every run was under."""
    return (
        f"Every run, with all it started, had {limits.run_s:g} s in all and {limits.scan_s:g} s for an answer by the "
        f"wall clock, {limits.run_cpu_s:g} s and {limits.scan_cpu_s:g} s of CPU time, and {limits.memory_mib} MiB of "
        "memory; what breaks a limit is ended, and its answers up to then count as partial."
    )


def _settings(parameters: Mapping[str, Value]) -> str:
    return ", ".join(f"{name} {value}" for name, value in parameters.items())
