"""Progress of runs and tasks: a bar with the time left on a terminal, plain lines when piped."""

from __future__ import annotations

import os
import time
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from statistics import fmean

from rich import box
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from evalkit.config.experiment import Experiment, RunSpec
from evalkit.core.run_result import RunResult
from evalkit.core.run_status import RunStatus
from evalkit.plugins import registry
from evalkit.results import descriptions
from evalkit.terminal.console import WordConsole

WIDE = 10_000
"""Width of a table that is piped, in columns: one line per row."""


class TimeLeft:
    """Estimate from durations of finished runs: mean of the sequence times ratio of the method to the mean."""

    def __init__(self, specs: Sequence[RunSpec], jobs: int) -> None:
        self._open = Counter((spec.sequence.label, spec.method.label) for spec in specs)
        self._jobs = jobs
        self._took: dict[str, float] = defaultdict(float)
        self._runs: dict[str, int] = defaultdict(int)

    def finished(self, sequence: str, method: str, seconds: float) -> None:
        """One run less. ``seconds``: its duration with scoring; 0 if it was not executed, which does not count."""
        self._open[sequence, method] -= 1
        for name in ("", f"sequence {sequence}", f"method {method}") if seconds > 0.0 else ():
            self._took[name] += seconds
            self._runs[name] += 1

    def seconds(self) -> float | None:
        """Seconds until all runs are finished; None before the first duration is known."""
        if not self._took:
            return None
        mean_of = {name: took / self._runs[name] for name, took in self._took.items()}
        mean = mean_of[""]
        expected = (
            count * mean_of.get(f"sequence {sequence}", mean) * mean_of.get(f"method {method}", mean) / mean
            for (sequence, method), count in self._open.items()
        )
        return sum(expected) / self._jobs


class _Display:
    """The output of progress: a bar on a terminal, lines elsewhere, nothing if ``quiet``."""

    def __init__(self, console: WordConsole, total: int, quiet: bool = False) -> None:
        self._console, self._quiet, self._total, self._done = console, quiet, total, 0
        text = TextColumn("{task.description}", markup=False)
        columns = (BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), text)
        self.bar = Progress(*columns, console=console, transient=True, disable=quiet or not console.is_terminal)
        self._task = self.bar.add_task("starting", total=total)

    def show(self, text: str, time_left: str) -> None:
        """Update the bar, if there is one."""
        self.bar.update(self._task, completed=self._done, description=f"{time_left}  {text}".rstrip())

    def line(self, text: str) -> None:
        """Print a line."""
        if not self._quiet:
            self._console.print(text)

    def numbered_line(self, text: str) -> None:
        """Print a line with the number of finished items."""
        self.line(f"[{self._done}/{self._total}] {text}")


class RunLines(_Display):
    """Progress of runs: a line per finished run; on a terminal a bar, and a line for what did not complete."""

    def __init__(self, console: WordConsole, specs: Sequence[RunSpec], jobs: int, quiet: bool = False) -> None:
        super().__init__(console, len(specs), quiet)
        self._left = TimeLeft(specs, jobs)
        self._started_at: dict[str, float] = {}

    def started(self, spec: RunSpec) -> None:
        """A run starts; its line is printed at its end."""
        self._started_at[spec.key] = time.monotonic()

    def answered(self, spec: RunSpec, scans: int) -> None:
        """A run has answered this many scans."""
        self.show(f"{spec.sequence.label} / {spec.method.label}: scan {scans:,}", self._time_left())

    def finished(self, spec: RunSpec, result: RunResult) -> None:
        """A run is finished: print its line and the time left."""
        started_at = self._started_at.pop(spec.key, None)
        seconds = 0.0 if started_at is None else time.monotonic() - started_at
        self._done += 1
        self._left.finished(spec.sequence.label, spec.method.label, seconds)
        self.show("", self._time_left())
        absent = result.status in (RunStatus.NOT_INSTALLED, RunStatus.DATA_MISSING)
        unavailable = absent and not result.expected  # said before the first run, once for all methods
        if self.bar.disable and not unavailable:
            self.numbered_line(f"{_format_line(spec, result, seconds)}, {self._time_left()}")
        elif not (result.is_complete or unavailable):
            self.line(_format_line(spec, result, seconds))

    def _time_left(self) -> str:
        left = self._left.seconds()
        return "time left unknown" if left is None else f"{_format_clock(left)} left"


@contextmanager
def show_runs(console: WordConsole, specs: Sequence[RunSpec], jobs: int, quiet: bool = False) -> Iterator[RunLines]:
    """Progress of runs: a bar on a terminal, lines elsewhere, nothing if ``quiet``."""
    shown = RunLines(console, specs, jobs, quiet)
    with shown.bar:
        yield shown


class TaskLines(_Display):
    """Progress of tasks: a bar on a terminal, else a line every few seconds. Call it with each finished task."""

    EVERY_S = 10.0

    def __init__(self, console: WordConsole, total: int, workers: int) -> None:
        super().__init__(console, total)
        self._workers, self._kept, self._printed_at = workers, 0, time.monotonic()
        self._took: list[float] = []

    def __call__(self, name: str, seconds: float) -> None:
        """A task is finished; 0 seconds: its result was stored already."""
        self._done += 1
        if seconds > 0.0:
            self._took.append(seconds)
        else:
            self._kept += 1
        self.show(name, self._time_left())
        last = self._done == self._total
        if self.bar.disable and (last or time.monotonic() - self._printed_at >= self.EVERY_S):
            self._printed_at = time.monotonic()
            self.numbered_line(f"{name}, {self._time_left()}")

    def _time_left(self) -> str:
        kept = f", {self._kept} kept from before" if self._kept else ""
        if not self._took:
            return f"time left unknown{kept}"
        return f"{_format_clock((self._total - self._done) * fmean(self._took) / self._workers)} left{kept}"


@contextmanager
def show_tasks(console: WordConsole, total: int, workers: int) -> Iterator[TaskLines]:
    """Progress of tasks: a bar on a terminal, lines elsewhere."""
    shown = TaskLines(console, total, workers)
    with shown.bar:
        yield shown


@contextmanager
def announce_kept(console: WordConsole, what: str, option: str = "") -> Iterator[None]:
    """On an interrupt, print how to continue, and raise it again. ``what`` is kept; ``option``: " with --resume"."""
    try:
        yield
    except KeyboardInterrupt:
        console.print(f"{what} are kept: repeat the command{option} to continue")
        raise


def print_table(console: WordConsole, table: Table) -> None:
    """Print a table: fitted to a terminal or to COLUMNS, one line per row elsewhere.

    On a terminal it has no frame; words stay whole if those of all columns fit beside each other. Else they are folded,
    except the names in the first column where they take at most a third of the width.
    """
    for column in table.columns:
        column.overflow = "fold"
    if console.is_terminal:
        table.box, table.pad_edge, table.collapse_padding = box.SIMPLE_HEAD, False, True
        longest = [
            max((len(word) for cell in (column.header, *column.cells) for word in str(cell).split()), default=1)
            for column in table.columns
        ]
        if sum(longest) + 3 * len(longest) <= console.width:
            for column, size in zip(table.columns, longest, strict=True):
                column.min_width = size
        elif 3 * longest[0] <= console.width:
            table.columns[0].min_width = longest[0]
    (console if has_width(console) else WordConsole(width=WIDE)).print(table)


def has_width(console: WordConsole) -> bool:
    """Whether a console has a width: that of its terminal, or COLUMNS."""
    return console.is_terminal or os.environ.get("COLUMNS", "").isdecimal()


def format_unavailable(experiment: Experiment) -> list[str]:
    """One line per reason why methods or sequences are not available here; reasons with a system package first."""
    methods = [(method.label, method.missing) for method in experiment.methods]
    sequences = [(sequence.label, sequence.missing) for sequence in experiment.sequences]
    labels: dict[str, list[str]] = defaultdict(list)
    for label, reason in methods + sequences:
        if reason:
            labels[" ".join(reason.split())].append(label)
    by_system = sorted(labels, key=lambda reason: "apt-get" not in reason)
    return [f"not available here: {', '.join(labels[reason])}: {reason}" for reason in by_system]


def print_undescribed(console: WordConsole, backends: Iterable[str]) -> None:
    """Print a line for each back end that ``--collect`` would have to start, to know its runs."""
    for name in dict.fromkeys(backends):
        if registry.find_backend(name).broken == descriptions.UNKNOWN:
            console.print(f"{name}: {descriptions.UNKNOWN}")


def _format_line(spec: RunSpec, result: RunResult, seconds: float) -> str:
    name = f"{spec.sequence.label} {spec.repetition}".rstrip()
    reason = f" ({result.reason})" if result.reason else ""
    return f"{name} / {spec.method.label}: {result.status}{reason}, {seconds:.1f} s"


def _format_clock(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes}:{rest:02d}"
