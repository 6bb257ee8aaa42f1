"""Run a validation of a mapper: its rules, and every cell beside another mapper after every scan."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from evalkit.commands.validate import level_answers, probes
from evalkit.commands.validate.acceptance import AcceptanceLevel, AcceptanceReport
from evalkit.commands.validate.comparison_terms import ComparisonTerms
from evalkit.commands.validate.plan import (
    AUTO,
    ValidationRequest,
    installed_only,
    make_experiment,
    seeded_sequences,
)
from evalkit.commands.validate.probes import EXACT
from evalkit.commands.validate.rules import mapper_rules
from evalkit.commands.validate.run import ProgressDisplay, of_kind, report_alone
from evalkit.execution import sandbox
from evalkit.execution.task import make_task
from evalkit.execution.task_runner import run_tasks
from evalkit.execution.task_store import TaskStore
from evalkit.plugins import defaults, registry
from evalkit.plugins.address import address_of, mapper_at
from evalkit.plugins.parameter_parsing import from_text
from evalkit.plugins.parameters import Value


def report_mapper(request: ValidationRequest, folder: Path, workers: int, display: ProgressDisplay) -> AcceptanceReport:
    """Levels 0 and 2 of a mapper, or one of them: its rules, and cell by cell beside another one after every scan."""
    name, spec = request.backend, mapper_at(request.backend)
    given = from_text(name, spec.parameters, request.given)
    if request.only == "lockstep":
        return _mapper_lockstep(request, given, folder, workers, display)
    checked = mapper_rules.check(name, given)
    rules = level_answers.rules_level(checked.results, "mapper", request.waivers)
    if request.only == "rules":
        return replace(report_alone(checked.label, rules, {"mapper": given}), waivers=request.waivers)
    compared = _mapper_lockstep(request, given, folder, workers, display)
    return replace(compared, levels=(rules, *compared.levels), waivers=request.waivers)


def _mapper_lockstep(
    request: ValidationRequest, given: Mapping[str, Value], folder: Path, workers: int, display: ProgressDisplay
) -> AcceptanceReport:
    """Level 2 of a mapper: compared with another one, cell by cell after every scan."""
    name, reference = request.backend, request.reference or defaults.find_default_mapper()
    spec, reference_spec = mapper_at(name), mapper_at(reference)
    known = {parameter.name for parameter in reference_spec.parameters}
    texts = {name: text for name, text in request.given.items() if name in known} | dict(request.given_reference)
    given_reference = from_text(reference, reference_spec.parameters, texts)
    planned = make_experiment(request, [{"use": defaults.find_reference_backend()}])
    unavailable = {sequence.label: sequence.missing for sequence in planned.sequences if sequence.missing}
    margin = EXACT if request.margin == AUTO else request.margin
    modules = [_module_of_mapper(mapper) for mapper in (name, reference)]
    tasks = [
        sandbox.make_sandboxed_task(
            make_task(
                f"mapper, {place.label}", probes.compare_maps,
                a={"name": reference, "given": given_reference}, b={"name": name, "given": given},
                on=place.data, scans=request.effort.scans, margin=margin,
            ).depending_on(*modules, registry.plug_in_of("datasets", place.sequence.dataset).module),
            request.effort.limit_s, request.effort.memory_mib,
        )
        for place in seeded_sequences(installed_only(planned))
    ]  # fmt: skip
    with display.tasks(len(tasks), workers) as done:
        results = run_tasks(TaskStore(folder / "tasks"), tasks, workers, done)
    label = reference if reference != name else f"{reference} (reference)"
    terms = ComparisonTerms(name, label, margin, request.noise_share)
    checks = [level_answers.mapper_check(place, one, terms) for place, one in of_kind("mapper", results).items()]
    question = f"Given the same scans as {label}, which cell differs first?"
    level = AcceptanceLevel(2, "lockstep", question, tuple(checks))
    settings = {"backend": given, "reference": given_reference, "on": list(request.on), "seeds": request.seeds}
    why = "given with --reference" if request.reference else "the default mapper"
    if spec.differs:
        why += f"; {name} is meant to differ from the default mapper: {spec.differs}"
    margins = {one["cells"]["margin"]["log_odds"] for one in results.values() if sandbox.ENDED not in one}
    margin_text = f"within {max(margins):.2g} log-odds" if margins else "within no margin: no scan was drawn"
    return replace(
        report_alone(name, level, settings), reference=label, why_reference=why, unavailable=unavailable,
        margin=margin, margin_text=margin_text,
    )  # fmt: skip


def _module_of_mapper(name: str) -> str:
    return address_of(name).module or registry.plug_in_of("mappers", name).module
