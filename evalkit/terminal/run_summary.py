"""What a command says of its runs at the end, and its exit code."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import typer

from evalkit.core.run_result import Status, Trial
from evalkit.execution.run_task import Ended
from evalkit.results.store import Store
from evalkit.terminal import options
from evalkit.terminal.options import FAILED, out

ABSENT: tuple[Status, ...] = ("not-installed", "data-missing", "skipped")
"""The statuses of runs that were never begun."""

MOST = 50
"""So many runs that are not made yet are named."""


@dataclass(frozen=True, slots=True)
class Row:
    """A run in short: a plan may have thousands. ``expected``: scans in its sequence, 0 where that was not opened."""

    key: str
    method: str
    sequence: str
    seed: int | None
    status: Status
    reason: str
    expected: int

    @classmethod
    def of(cls, ended: Ended) -> Row:
        """The row of a run that has ended."""
        planned = ended.planned
        labels = planned.method.label, planned.sequence.label
        return cls(planned.key, *labels, planned.seed, ended.status, ended.reason, ended.expected)

    @classmethod
    def of_trial(cls, trial: Trial) -> Row:
        """The row of a trial."""
        run = trial.run
        return cls(trial.key, trial.method, trial.sequence, trial.seed, run.status, run.reason, run.expected)

    @property
    def place(self) -> str:
        """The sequence with the seed."""
        return self.sequence if self.seed is None else f"{self.sequence} seed {self.seed}"

    def as_json(self, store: Store) -> dict[str, Any]:
        """The row with its scores."""
        return {
            "method": self.method,
            "sequence": self.sequence,
            "seed": self.seed,
            "status": self.status,
            "reason": self.reason,
            "key": self.key,
            "scores": {} if self.status in ABSENT else store.score_values(self.key),
        }


def tell(rows: Sequence[Row], title: str, store: Store, page: Path | None, as_json: bool) -> None:
    """Prints where the result is; exit code 1 if a run that could have completed did not, 3 if one is not made yet."""
    broken = any(row.status in FAILED for row in rows)
    skipped = [row for row in rows if row.status == "skipped"]
    if as_json:
        told = [row.as_json(store) for row in rows]
        options.print_json({"title": title, "page": str(page) if page else None, "runs": told})
    else:
        _tell(rows, skipped)
        if page is not None:
            out.print(str(page.resolve()), highlight=False, markup=False)
    if broken:
        raise typer.Exit(1)
    if skipped:
        raise typer.Exit(3)


def _tell(rows: Sequence[Row], skipped: Sequence[Row]) -> None:
    complete, broken = (sum(row.status in of for row in rows) for of in (("complete",), FAILED))
    absent = len(rows) - complete - broken - len(skipped)
    names = ", ".join(_absent(rows))
    told = f"{complete} runs complete, {broken} failed, {absent} not possible here"
    out.print(f"{told}: {names}" if names else told, markup=False, highlight=False)
    if skipped:
        missing = ", ".join(f"{row.method} on {row.place}" for row in skipped[:MOST])
        more = f" and {len(skipped) - MOST:,} more" if len(skipped) > MOST else ""
        out.print(f"{len(skipped)} not made yet: {missing}{more}", markup=False, highlight=False)


def _absent(rows: Sequence[Row]) -> list[str]:
    """The methods and sequences that could not run here, each once; "who on what" where it was the pair alone."""
    absent = [row for row in rows if row.status in ABSENT and row.status != "skipped"]
    missing = {row.sequence for row in absent if row.status == "data-missing" and row.expected == 0}
    return list(dict.fromkeys(_what_is_absent(row, row.sequence not in missing) for row in absent))


def _what_is_absent(row: Row, sequence_is_here: bool) -> str:
    if row.status == "not-installed":
        return row.method
    return f"{row.method} on {row.sequence}" if sequence_is_here else row.sequence
