"""Run an experiment: take what is stored, execute what is missing, and return how every run went."""

from __future__ import annotations

from collections.abc import Generator, Mapping
from contextlib import closing, nullcontext
from dataclasses import asdict, dataclass, field

from evalkit.config.experiment import Experiment, RunSpec
from evalkit.core.run_result import DISTURBED, RunResult
from evalkit.core.run_status import Cause, RunStatus
from evalkit.execution import run_task
from evalkit.execution.executors import Executor, Progress
from evalkit.execution.run_task import PendingRun, RunSettings
from evalkit.results import descriptions
from evalkit.results.reader import check_same_experiment
from evalkit.results.run_record import RunRecord, load_records
from evalkit.results.store import Store

FINAL = (RunStatus.COMPLETE, RunStatus.FAILED, RunStatus.CRASHED)
"""Statuses that ``--resume`` treats as final."""

LIMITED = (RunStatus.TIMEOUT, RunStatus.OUT_OF_MEMORY)
"""Statuses that ``--resume`` treats as final if the limits are still the same."""


@dataclass(frozen=True)
class Scheduler:
    """Decides for every run whether a stored result is used or the run is executed.

    ``resume``: use final results, but execute runs with a status in ``rerun`` again, and the disturbed ones with
    ``DISTURBED`` in it. ``collect``: execute no run; missing runs are skipped. ``environment``: description of the
    machine, kept with every executed run.
    """

    store: Store
    progress: Progress
    environment: Mapping[str, str] = field(default_factory=dict)
    resume: bool = False
    rerun: frozenset[str] = frozenset()
    collect: bool = False

    def run(self, experiment: Experiment, executor: Executor) -> Generator[tuple[RunSpec, RunResult]]:
        """Yield every run as it ends, executed, scored and stored; runs that need nothing come first.

        A run that fails is a result with a cause. Raises StoreError if the results folder cannot be written, another
        process writes to it, or it holds the report of another experiment.
        """
        if not self.collect:
            check_same_experiment(self.store.folder, experiment)
        settings = RunSettings.from_experiment(experiment, self.environment)
        with nullcontext() if self.collect else self.store.writer_lock():
            if not self.collect:
                descriptions.save(self.store.folder, {method.backend for method in experiment.methods})
            pending = []
            for spec in experiment.runs():
                stored = self._stored_result(spec, settings)
                attempts = self._attempts(spec) if stored is None else ()
                if (result := self._finished_result(spec, stored, settings)) is None:
                    pending.append(PendingRun(spec, stored is not None, attempts))
                    continue
                self.progress.finished(spec, result)
                yield spec, result
            if not pending:
                return
            with closing(executor.run(self.store, settings, pending, self.progress)) as finished:
                for spec, result in finished:
                    self.progress.finished(spec, result)
                    yield spec, result

    def run_and_load(self, experiment: Experiment, executor: Executor) -> tuple[RunRecord, ...]:
        """Run an experiment and load every run with its scores and ground truth, in the experiment's order."""
        results = {spec.key: result for spec, result in self.run(experiment, executor)}
        return load_records(self.store, experiment, results)

    def _finished_result(self, spec: RunSpec, stored: RunResult | None, settings: RunSettings) -> RunResult | None:
        """The result of a run that needs neither executing nor scoring, None for any other run."""
        if (unavailable := run_task.unavailable_result(spec)) is not None:
            return unavailable
        if stored is not None:
            return stored if self._is_scored(spec, stored, settings) else None
        if self.collect:
            reason = "not run yet; the same command without --collect runs it"
            return run_task.empty_result(Cause.NOT_RUN, reason)
        return None

    def _stored_result(self, spec: RunSpec, settings: RunSettings) -> RunResult | None:
        """The stored result if it is final."""
        result = self.store.load_result(spec.key) if self.resume or self.collect else None
        if result is None or self.collect:
            return result
        if result.status not in self.rerun:
            result = run_task.before_scoring(result)  # a failed scoring is repeated
        if result.status in self.rerun or (settings.timed and not result.provenance.get("timed", True)):
            return None
        if DISTURBED in self.rerun and result.conditions is not None and result.conditions.disturbed:
            return None
        same_limits = result.provenance.get("limits") == asdict(settings.limits)
        return result if result.status in FINAL or (result.status in LIMITED and same_limits) else None

    def _is_scored(self, spec: RunSpec, result: RunResult, settings: RunSettings) -> bool:
        """Whether all scores of a run are stored, readable, and computed by the current code."""
        return not result.is_scorable or self.store.load_scores(spec.key, settings.scoring_code) is not None

    def _attempts(self, spec: RunSpec) -> tuple[str, ...]:
        """Processes that died while they executed the run; none if it is to be executed in any case."""
        return self.store.attempts(spec.key) if self.resume and RunStatus.CRASHED not in self.rerun else ()
