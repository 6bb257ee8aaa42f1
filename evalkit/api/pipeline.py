"""Run an experiment and write its report: the same steps for the command line and for Python."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

from evalkit import report
from evalkit.config.experiment import Experiment
from evalkit.core.errors import StoreError
from evalkit.execution.environment import describe_provenance
from evalkit.execution.executors import Executor
from evalkit.execution.scheduler import Scheduler
from evalkit.io.output_files import as_store_error
from evalkit.report.analysis.analysis import Analysis, analyse
from evalkit.results.run_record import load_records


class NothingToCollectError(StoreError):
    """No finished run of the experiment is in the folder; an earlier report there stays as it is."""


def run_and_report(scheduler: Scheduler, experiment: Experiment, executor: Executor) -> tuple[Analysis, Path]:
    """Run an experiment and write the report into the scheduler's folder; return what it shows, and its page.

    Runs that fail are rows of the report. Raises StoreError if the results folder cannot be written, and
    NothingToCollectError.
    """
    started = datetime.now(UTC)
    results = {spec.key: result for spec, result in scheduler.run(experiment, executor)}
    if scheduler.collect and not any(result.is_scorable for result in results.values()):
        what = "no finished run of this experiment"
        remedy = "run it without --collect; runs of other code or other settings are not collected"
        raise NothingToCollectError(str(scheduler.store.folder), what, remedy)
    records = load_records(scheduler.store, experiment, results)
    environment = describe_provenance(scheduler.environment, results.values(), started)
    comparison = report.build_comparison(experiment, records, started, datetime.now(UTC), environment)
    analysis = analyse(comparison)
    with as_store_error(scheduler.store.folder):
        return analysis, report.write_analysis(analysis, scheduler.store.folder)
