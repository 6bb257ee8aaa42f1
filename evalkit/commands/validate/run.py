"""Run a validation: every kind of subject and every selection of levels gives one ``AcceptanceReport``."""

from __future__ import annotations

import hashlib
import shutil
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from evalkit.commands.validate import level_answers, level_costs, level_maps, level_trajectories
from evalkit.commands.validate.acceptance import AcceptanceLevel, AcceptanceReport, Check
from evalkit.commands.validate.comparison_terms import ComparisonTerms, ResultsByPlace, choose_margin, format_margin
from evalkit.commands.validate.determinism import measure_determinism
from evalkit.commands.validate.equivalence.margins import FLOAT32
from evalkit.commands.validate.level_tasks import (
    lockstep_tasks,
    mapper_tasks,
    pair_tasks,
    perturbation_tasks,
    rules_task,
    timing_tasks,
)
from evalkit.commands.validate.plan import (
    ValidationPlan,
    compiled_files,
)
from evalkit.commands.validate.probes import EXACT
from evalkit.commands.validate.rules import dataset_rules, runner
from evalkit.commands.validate.rules.rule import RuleResult
from evalkit.config.experiment import Experiment
from evalkit.execution import environment, sandbox
from evalkit.execution.executors import LocalExecutor, Progress
from evalkit.execution.scheduler import Scheduler
from evalkit.execution.task import AnyTask, Result
from evalkit.execution.task_runner import OnDone, run_tasks
from evalkit.execution.task_store import TaskStore
from evalkit.external import elf
from evalkit.external.declaration import split_words
from evalkit.plugins import registry
from evalkit.plugins.address import backend_at, dataset_at
from evalkit.plugins.parameter_parsing import from_text, parse_dataset
from evalkit.plugins.parameters import Value
from evalkit.results.run_record import RunRecord
from evalkit.results.store import Store

FATAL_RULES = ("rule starts", "rule in-time")
"""Rules without which no other level can run."""


@dataclass(frozen=True)
class ProgressDisplay:
    """Context managers that show progress: ``tasks(count, workers)``, and ``runs(experiment, workers)``."""

    tasks: Callable[[int, int], AbstractContextManager[OnDone]]
    runs: Callable[[Experiment, int], AbstractContextManager[Progress]]


@dataclass(frozen=True)
class ValidationRun:
    """A plan with the folder of its results, the number of workers and the progress display."""

    plan: ValidationPlan
    folder: Path
    workers: int
    progress: ProgressDisplay

    def report(self) -> AcceptanceReport:
        """Run the levels of the request; results that are in the folder already are not computed again."""
        plan, only = self.plan, self.plan.request.only
        if only == "registrations":
            return self._comparison_report(self._compute(pair_tasks(plan)))
        if only == "lockstep":
            return self._comparison_report(self._compute(lockstep_tasks(plan)))
        results = self._compute([rules_task(plan)], workers=1)["rules"]["rules"]
        rules = level_answers.rules_level([RuleResult(**one) for one in results], waivers=plan.request.waivers)
        if any(check.outcome == "failed" and check.name in FATAL_RULES for check in rules.checks):
            return self._report(EXACT, "", (rules,))
        return self._full_report(rules)

    def _comparison_report(self, results: ResultsByPlace) -> AcceptanceReport:
        """The report of level 1 or level 2 alone."""
        compared = _comparisons(results)
        margin = choose_margin(compared, self.plan.request.margins)
        levels = self._comparison_levels(results, self._terms(margin))
        return self._report(margin, format_margin(compared, margin), levels)

    def _comparison_levels(self, results: ResultsByPlace, terms: ComparisonTerms) -> tuple[AcceptanceLevel, ...]:
        pairs, scans = of_kind("pairs", results), of_kind("scans", results)
        answers = {name: of_kind(f"answers of {name}", results) for name in self.plan.peers}
        peers = {name: own for name, own in answers.items() if own}
        drawn = of_kind("questions", results)
        levels = [level_answers.registrations_level(pairs, peers, terms, drawn)] if pairs else []
        return (*levels, *([level_answers.lockstep_level(scans, terms)] if scans else []))

    def _full_report(self, rules: AcceptanceLevel) -> AcceptanceReport:
        plan = self.plan
        results = self._compute([*pair_tasks(plan), *lockstep_tasks(plan), *mapper_tasks(plan)])
        records = self._run_experiment()
        compared = _comparisons(results)
        margin = choose_margin(compared, plan.request.margins)
        perturbed = self._compute(perturbation_tasks(plan)) if margin == FLOAT32 else {}
        times = self._compute(timing_tasks(plan), workers=1)  # alone: nothing else may run beside a measurement
        terms = self._terms(margin)
        limits = {
            place: (one[margin]["margin"]["metres"], one[margin]["margin"]["radians"])
            for place, one in of_kind("scans", results).items()
            if sandbox.ENDED not in one
        }
        levels = (
            rules,
            *self._comparison_levels(results, terms),
            level_trajectories.trajectories_level(records, limits, of_kind("copies", perturbed), terms),
            level_maps.maps_level(records, limits, of_kind("mapper", results), plan.mappers, terms),
            level_costs.costs_level(
                of_kind("time", times), of_kind("time of a pair", times), plan.methods, plan.registrations, records,
                terms, compiled_files(plan.backend),
            ),
        )  # fmt: skip
        return self._report(margin, format_margin(compared, margin), levels)

    def _compute(self, tasks: Any, workers: int | None = None) -> dict[str, Result]:
        every: list[AnyTask] = list(tasks)
        count = workers or self.workers
        with self.progress.tasks(len(every), count) as done:
            return run_tasks(TaskStore(self.folder / "tasks"), every, count, done)

    def _run_experiment(self) -> dict[str, dict[str, RunRecord]]:
        """The runs of all methods by place and method."""
        experiment, ran_on = self.plan.experiment, environment.describe(jobs=self.workers)
        with self.progress.runs(experiment, self.workers) as shown:
            scheduler = Scheduler(Store(self.folder), shown, ran_on, resume=True)
            records = scheduler.run_and_load(experiment, LocalExecutor(self.workers))
        by_place: dict[str, dict[str, RunRecord]] = {}
        for record in records:
            place = record.sequence if record.seed is None else f"{record.sequence}, seed {record.seed}"
            by_place.setdefault(place, {})[record.method] = record
        return by_place

    def _terms(self, margin: str) -> ComparisonTerms:
        plan = self.plan
        request = plan.request
        return ComparisonTerms(
            plan.backend, plan.reference_label, margin, request.noise_share, plan.peers, request.waivers
        )

    def _report(self, margin: str, margin_text: str, levels: tuple[AcceptanceLevel, ...]) -> AcceptanceReport:
        plan = self.plan
        return AcceptanceReport(
            plan.backend, plan.reference_label, plan.why_reference, plan.peers, plan.unavailable, plan.request.claim,
            margin, margin_text, levels, plan.settings(), environment.describe(jobs=self.workers), plan.request.waivers,
            describe_binaries(plan.backend),
        )  # fmt: skip


def report_rules(
    backend: str, given: Mapping[str, str], rules: Sequence[str], limit_s: float, seed: int = 0,
    waivers: Mapping[str, str] | None = None, report_slow: Callable[[str], None] = lambda _: None,
) -> AcceptanceReport:  # fmt: skip
    """Level 0 of a back end alone; ``rules``: names of the rules to check, () for all; ``limit_s``: time of one rule.

    ``report_slow``: as for ``runner.check``.
    Raises UnknownName, BadParameter, NotInstalled or BackendFailed before anything runs.
    """
    values = from_text(backend, backend_at(backend).parameters, given)
    checked = runner.check(backend, values, limit_s=limit_s, only=rules, seed=seed, report_slow=report_slow)
    level = level_answers.rules_level(checked.results, waivers=waivers)
    alone = report_alone(checked.label, level, {"backend": values, "seed": seed})
    return replace(alone, waivers=waivers or {}, binaries=describe_binaries(backend))


def report_dataset(dataset: str, given: Mapping[str, str], frames: int) -> AcceptanceReport:
    """Level 0 of a data set: its rules over its first ``frames`` frames."""
    values = from_text(dataset, dataset_at(dataset).parameters, given)
    checked = dataset_rules.check(dataset, frames, values)
    level = level_answers.rules_level(checked.results, "data set")
    return report_alone(checked.label, level, {"dataset": values, "frames": frames})


def report_determinism(
    backends: Sequence[str], given: Mapping[str, str], on: Sequence[str], threads: int, repetitions: int,
    announce: Callable[[str], None],
) -> AcceptanceReport:  # fmt: skip
    """Level 6: repeated runs of back ends, with one thread and with ``threads``; (): all that can run here.

    ``announce`` is called with each back end's name before it runs.
    """
    installed = backends or [name for name in registry.names("backends") if not registry.find_backend(name).missing()]
    sequences = [parse_dataset(text) for text in on]
    checks = []
    for name in installed:
        announce(name)
        checks += [_determinism_check(name, given, *sequence, threads, repetitions) for sequence in sequences]
    question = f"Are the answers of {repetitions} runs equal to the bit, with one thread and with {threads}?"
    level = AcceptanceLevel(6, "determinism", question, tuple(checks))
    subject = ", ".join(backends) or "every installed back end"
    settings = {"on": list(on), "threads": threads, "repetitions": repetitions, "backend": dict(given)}
    return report_alone(subject, level, settings)


def _determinism_check(
    backend: str, given: Mapping[str, str], dataset: str, parameters: Mapping[str, Value], threads: int,
    repetitions: int,
) -> Check:  # fmt: skip
    result = measure_determinism(backend, given, dataset, parameters, (1, threads), repetitions)
    passed = result.verdict in ("bit-equal", "thread-dependent")
    if result.apart_m is None:
        observed = f"{result.verdict}: {result.reason or 'the runs have no scan in common'}"
    else:
        observed = f"{result.verdict}: positions at most {result.apart_m:.3g} m apart over {result.scans} scans"
    return Check(
        f"repeats {backend}", dataset, "passed" if passed else "failed", "always", observed, data=asdict(result)
    )


def describe_binaries(backend: str) -> dict[str, str]:
    """SHA-256, compiler and flags, where the file tells them, of the files of machine code of a back end, by name."""
    files = compiled_files(backend)
    if backend.startswith("exec:"):
        files = [
            Path(found) for word in split_words(backend, backend.partition(":")[2]) if (found := shutil.which(word))
        ]
    described = {}
    for file in files:
        if file.is_file():
            content = file.read_bytes()
            facts = (f"SHA-256 {hashlib.sha256(content).hexdigest()}", elf.read_compiler(content))
            described[file.name] = "; ".join(filter(None, facts))
    return described


def report_alone(subject: str, level: AcceptanceLevel, settings: Mapping[str, Any]) -> AcceptanceReport:
    """The report of one level that needs no reference."""
    return AcceptanceReport(subject, "", "", (), {}, "equal", "", "", (level,), settings, environment.describe(jobs=1))


def _comparisons(results: ResultsByPlace) -> dict[str, Result]:
    """All comparisons with the reference, question by question."""
    return {
        f"{kind}, {place}": one
        for kind in ("pairs", "questions", "scans")
        for place, one in of_kind(kind, results).items()
    }


def of_kind(kind: str, results: ResultsByPlace) -> dict[str, Result]:
    """The results of one kind of task by place."""
    prefix = f"{kind}, "
    return {name.removeprefix(prefix): result for name, result in results.items() if name.startswith(prefix)}
