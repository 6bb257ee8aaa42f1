"""The tasks of each level of a validation."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any

from evalkit.commands.validate import probes, question_probes, timing_probes
from evalkit.commands.validate.plan import SeededSequence, ValidationPlan, seeded_sequences
from evalkit.commands.validate.probes import EXACT
from evalkit.execution import sandbox
from evalkit.execution.task import AnyTask, Parameters, Result, make_task
from evalkit.plugins import registry

COPIES = 5
"""Perturbed copies of a sequence from which the effect of rounding on a path is estimated."""


def rules_task(plan: ValidationPlan) -> AnyTask:
    """Return the task of level 0."""
    spec = registry.backend(plan.backend)
    own = {p.name for p in spec.parameters}
    given = {name: value for name, value in plan.given.items() if name in own}
    task = make_task(
        "rules", probes.rules, name=plan.backend, given=given, limit_s=30.0, seed=plan.request.seed,
        digest=spec.digest,
    )  # fmt: skip
    return replace(task.depending_on(*_find_modules(plan.backend)), own_process=True)


def pair_tasks(plan: ValidationPlan) -> Iterator[AnyTask]:
    """Yield the tasks of level 1."""
    request, effort = plan.request, plan.request.effort
    a, b = _plugin(plan, plan.reference), _plugin(plan, plan.backend)
    if {plan.backend, plan.reference} <= set(plan.registrations):
        drawn = make_task(
            f"questions, drawn with seed {request.seed}", question_probes.compare_questions, a=a, b=b,
            seed=request.seed, margins=request.margins, quick=effort.quick,
        )  # fmt: skip
        modules = _find_modules(plan.backend, plan.reference)
        yield sandbox.make_sandboxed_task(drawn.depending_on(*modules), effort.limit_s, effort.memory_mib)
    for place in seeded_sequences(plan.experiment):
        exact = registry.dataset(place.sequence.dataset).seeded  # a simulated truth has no error
        yield _make_sandboxed_task(
            plan, f"pairs, {place.label}", place, probes.compare_pairs,
            a=a, b=b, on=place.data, count=effort.pairs, exact=exact, margins=request.margins,
        )  # fmt: skip
        for name in plan.registering_peers:
            yield _make_sandboxed_task(
                plan, f"answers of {name}, {place.label}", place, probes.answer_pairs,
                backend=_plugin(plan, name), on=place.data, count=effort.pairs, exact=exact,
            )  # fmt: skip


def lockstep_tasks(plan: ValidationPlan) -> Iterator[AnyTask]:
    """Yield the tasks of level 2."""
    request, a, b = plan.request, _plugin(plan, plan.reference), _plugin(plan, plan.backend)
    for place in seeded_sequences(plan.experiment):
        yield _make_sandboxed_task(
            plan, f"scans, {place.label}", place, probes.compare_scans, a=a, b=b, on=place.data,
            scans=request.effort.scans, margins=request.margins, disturbed=request.disturbed,
        )  # fmt: skip


def mapper_tasks(plan: ValidationPlan) -> Iterator[AnyTask]:
    """Yield the comparisons of mappers in level 4."""
    own, reference = ({"name": name, "given": {}} for name in plan.mappers)
    for place in _find_first_seeds(plan) if all(plan.mappers) else ():
        yield _make_sandboxed_task(
            plan, f"mapper, {place.label}", place, probes.compare_maps,
            a=reference, b=own, on=place.data, scans=plan.request.effort.mapper_scans, margin=EXACT,
        )  # fmt: skip


def perturbation_tasks(plan: ValidationPlan) -> Iterator[AnyTask]:
    """Yield the reference over copies of each sequence perturbed by rounding."""
    for place in seeded_sequences(plan.experiment):
        backend = _plugin(plan, plan.reference)
        yield _make_sandboxed_task(
            plan, f"copies, {place.label}", place, probes.perturbed_paths, backend=backend, on=place.data, copies=COPIES
        )


def timing_tasks(plan: ValidationPlan) -> Iterator[AnyTask]:
    """Yield the measurements of level 5; nothing else may run beside them."""
    methods = [_plugin(plan, name) for name in plan.methods]
    registrations = [_plugin(plan, name) for name in plan.registrations]
    effort = plan.request.effort
    for place in _find_first_seeds(plan):
        yield _make_sandboxed_task(
            plan, f"time, {place.label}", place, timing_probes.time_scans,
            methods=methods, on=place.data, scans=effort.timed,
        )  # fmt: skip
        if plan.backend in plan.registrations:
            yield _make_sandboxed_task(
                plan, f"time of a pair, {place.label}", place, timing_probes.time_pairs,
                methods=registrations, on=place.data, count=effort.pairs,
            )  # fmt: skip


def _find_first_seeds(plan: ValidationPlan) -> list[SeededSequence]:
    """Return the first seed of every sequence."""
    first: dict[str, SeededSequence] = {}
    for place in seeded_sequences(plan.experiment):
        first.setdefault(place.sequence.label, place)
    return list(first.values())


def _make_sandboxed_task(
    plan: ValidationPlan, name: str, place: SeededSequence, function: Callable[Parameters, Result], /,
    *args: Parameters.args, **kwargs: Parameters.kwargs,
) -> AnyTask:  # fmt: skip
    """Return the task that runs a probe in a sandbox."""
    modules = (*_find_modules(*plan.methods), registry.plug_in_of("datasets", place.sequence.dataset).module)
    probe = make_task(name, function, *args, **kwargs).depending_on(*modules)
    return sandbox.make_sandboxed_task(probe, plan.request.effort.limit_s, plan.request.effort.memory_mib)


def _plugin(plan: ValidationPlan, name: str) -> dict[str, Any]:
    """Return a back end with its given parameters; the digest distinguishes builds of a library."""
    given = plan.given if name == plan.backend else plan.given_reference if name == plan.reference else {}
    return {"name": name, "given": dict(given), "digest": registry.backend(name).digest}


def _find_modules(*names: str) -> tuple[str, ...]:
    return tuple(sorted({registry.plug_in_of("backends", name).module for name in names}))
