"""What a comparison looks like while it runs: a bar with the time left on a terminal, plain lines when piped."""

from __future__ import annotations

import time
from collections import Counter, defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from statistics import fmean
from typing import TYPE_CHECKING

from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from evalkit.config.experiment import Experiment, RunSpec

if TYPE_CHECKING:
    from evalkit.execution.run_task import FinishedRun  # loads every metric

WIDE = 10_000
"""Columns of a table that is piped: one line a row, whatever it holds."""


class TimeLeft:
    """An estimate from what finished runs took: a sequence's mean times a method's share of the mean."""

    def __init__(self, planned: list[RunSpec], jobs: int) -> None:
        self._open = Counter((item.sequence.label, item.method.label) for item in planned)
        self._jobs = jobs
        self._took: dict[str, float] = defaultdict(float)
        self._runs: dict[str, int] = defaultdict(int)

    def finished(self, sequence: str, method: str, seconds: float) -> None:
        """One run less; ``seconds``: what it took with its scoring, 0 for one that was kept and tells nothing."""
        self._open[sequence, method] -= 1
        for name in ("", f"sequence {sequence}", f"method {method}") if seconds > 0.0 else ():
            self._took[name] += seconds
            self._runs[name] += 1

    def seconds(self) -> float | None:
        """Seconds until all is done; None before anything is known."""
        if not self._took:
            return None
        of = {name: took / self._runs[name] for name, took in self._took.items()}
        mean = of[""]
        expected = (
            count * of.get(f"sequence {sequence}", mean) * of.get(f"method {method}", mean) / mean
            for (sequence, method), count in self._open.items()
        )
        return sum(expected) / self._jobs


class RunLines:
    """Plain lines, one a finished run: for logs and pipes."""

    def __init__(self, console: Console, planned: list[RunSpec], jobs: int) -> None:
        self._console, self._total, self._done = console, len(planned), 0
        self._left = TimeLeft(planned, jobs)

    def begun(self, planned: RunSpec) -> None:
        """A run starts; its line comes when it has ended."""

    def answered(self, planned: RunSpec, scans: int) -> None:
        """A run has answered so many scans; a line each would be too many."""

    def finished(self, run: FinishedRun) -> None:
        """A run is done: its line, and the time left."""
        self._done += 1
        self._left.finished(run.spec.sequence.label, run.spec.method.label, run.seconds)
        self._tell(run)

    def _tell(self, run: FinishedRun) -> None:
        self._console.print(f"[{self._done}/{self._total}] {_line(run)}, {self._time_left()}", markup=False)

    def _time_left(self) -> str:
        left = self._left.seconds()
        return "time left unknown" if left is None else f"{_clock(left)} left"


class Silence(RunLines):
    """Nothing."""

    def finished(self, run: FinishedRun) -> None:
        """Tells nobody."""


class RunBar(RunLines):
    """A bar with the time left, and above it a line for every run that did not complete."""

    def __init__(self, console: Console, planned: list[RunSpec], jobs: int) -> None:
        super().__init__(console, planned, jobs)
        columns = (BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), TextColumn("{task.description}"))
        self.bar = Progress(*columns, console=console, transient=True)
        self._task = self.bar.add_task("starting", total=self._total)

    def answered(self, planned: RunSpec, scans: int) -> None:
        """Shows which run is at which scan."""
        at = escape(f"{planned.sequence.label} / {planned.method.label}: scan {scans:,}")
        self.bar.update(self._task, description=f"{self._time_left()}  {at}")

    def _tell(self, run: FinishedRun) -> None:
        self.bar.update(self._task, completed=self._done, description=self._time_left())
        if not run.result.is_complete:
            self._console.print(_line(run), markup=False)


@contextmanager
def progress(console: Console, planned: list[RunSpec], jobs: int, quiet: bool = False) -> Iterator[RunLines]:
    """A bar on a terminal, lines elsewhere; nothing where that is ``quiet``."""
    if quiet:
        yield Silence(console, [], 1)
        return
    if not console.is_terminal:
        yield RunLines(console, planned, jobs)
        return
    shown = RunBar(console, planned, jobs)
    with shown.bar:
        yield shown


class JobLines:
    """How a study goes on: a line now and then, for logs and pipes. Call it with each job that is done."""

    EVERY_S = 10.0

    def __init__(self, console: Console, total: int, workers: int) -> None:
        self._console, self._total, self._workers = console, total, workers
        self._done = self._kept = 0
        self._took: list[float] = []
        self._told_at = time.monotonic()

    def __call__(self, name: str, seconds: float) -> None:
        """One job is done; 0 seconds: it was kept from before."""
        self._done += 1
        if seconds > 0.0:
            self._took.append(seconds)
        else:
            self._kept += 1
        self._tell(name)

    def _tell(self, name: str) -> None:
        last = self._done == self._total
        if last or time.monotonic() - self._told_at >= self.EVERY_S:
            self._told_at = time.monotonic()
            self._console.print(f"[{self._done}/{self._total}] {name}, {self._time_left()}", markup=False)

    def _time_left(self) -> str:
        kept = f", {self._kept} kept from before" if self._kept else ""
        if not self._took:
            return f"time left unknown{kept}"
        return f"{_clock((self._total - self._done) * fmean(self._took) / self._workers)} left{kept}"


class JobBar(JobLines):
    """The same as a bar with the time left."""

    def __init__(self, console: Console, total: int, workers: int) -> None:
        super().__init__(console, total, workers)
        columns = (BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), TextColumn("{task.description}"))
        self.bar = Progress(*columns, console=console, transient=True)
        self._task = self.bar.add_task("starting", total=total)

    def _tell(self, name: str) -> None:
        self.bar.update(self._task, completed=self._done, description=f"{self._time_left()}  {escape(name)}")


@contextmanager
def jobs(console: Console, total: int, workers: int) -> Iterator[JobLines]:
    """What a ledger tells of its jobs: a bar on a terminal, lines elsewhere."""
    if not console.is_terminal:
        yield JobLines(console, total, workers)
        return
    shown = JobBar(console, total, workers)
    with shown.bar:
        yield shown


@contextmanager
def say_what_is_kept(console: Console, what: str, option: str = "") -> Iterator[None]:
    """On an interrupt, print how to continue, and raise it again. ``what`` is kept; ``option``: " with --resume"."""
    try:
        yield
    except KeyboardInterrupt:
        console.print(f"interrupted; {what} are kept: repeat the command{option} to continue")
        raise


def show(console: Console, table: Table) -> None:
    """Prints a table: fitted to a terminal, one line a row elsewhere."""
    (console if console.is_terminal else Console(width=WIDE)).print(table)


def missing(plan: Experiment) -> list[str]:
    """A line for every reason why part of a plan cannot run here: what the system lacks first, one command mends it."""
    entrants = [(entrant.label, entrant.missing) for entrant in plan.methods]
    sequences = [(sequence.label, sequence.missing) for sequence in plan.sequences]
    lacking: dict[str, list[str]] = defaultdict(list)
    for label, reason in entrants + sequences:
        if reason:
            lacking[" ".join(reason.split())].append(label)
    by_system = sorted(lacking, key=lambda reason: "apt-get" not in reason)
    return [f"missing here: {', '.join(lacking[reason])}: {reason}" for reason in by_system]


def _line(run: FinishedRun) -> str:
    spec, result = run.spec, run.result
    seed = "" if spec.seed is None else f" seed {spec.seed}"
    reason = f" ({result.reason})" if result.reason else ""
    return f"{spec.sequence.label}{seed} / {spec.method.label}: {result.status}{reason}, {run.seconds:.1f} s"


def _clock(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes}:{rest:02d}"
