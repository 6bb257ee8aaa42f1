"""The runs of one method over one sequence in two results folders."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from evalkit.config.experiment import name_repetition
from evalkit.results.reader import StoredResults, StoredRun

RunSeed = int | None
RunPairs = Mapping[RunSeed, tuple[StoredRun, StoredRun]]
"""Runs before and after, by seed."""


@dataclass(frozen=True, eq=False)
class ComparedRuns:
    """The runs of one method over one sequence before and after, by seed."""

    method: str
    sequence: str
    old: Mapping[RunSeed, StoredRun]
    new: Mapping[RunSeed, StoredRun]

    @property
    def perturbed(self) -> bool:
        """Whether the runs are perturbations of a recording."""
        return any(run.perturbed for run in (*self.old.values(), *self.new.values()))

    def name_run(self, seed: RunSeed) -> str:
        """Return the name of a run among these: "seed 3", "perturbation 2", or "run"."""
        return name_repetition(seed, self.perturbed) or "run"

    @property
    def common(self) -> RunPairs:
        """The runs that both folders have."""
        return {seed: (run, self.new[seed]) for seed, run in self.old.items() if seed in self.new}

    @property
    def complete(self) -> RunPairs:
        """The runs that completed on both sides."""
        return {seed: pair for seed, pair in self.common.items() if all(run.status == "complete" for run in pair)}


def pair_runs(old: StoredResults, new: StoredResults) -> list[ComparedRuns]:
    """Return the runs of every method over every sequence that either folder has."""
    pairs = dict.fromkeys(name[:2] for name in (*old.runs, *new.runs))
    return [ComparedRuns(*pair, *(_runs_of(one, pair) for one in (old, new))) for pair in pairs]


def _runs_of(results: StoredResults, pair: tuple[str, str]) -> dict[RunSeed, StoredRun]:
    return {name[2]: run for name, run in results.runs.items() if name[:2] == pair}
