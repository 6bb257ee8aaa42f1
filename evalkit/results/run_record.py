"""A run with everything a report needs: what was run, how it went, its scores and the ground truth."""

from __future__ import annotations

from dataclasses import dataclass

from evalkit.config.experiment import RunSpec
from evalkit.core.ground_truth import Truth
from evalkit.core.run_result import RunResult, Scores


@dataclass(frozen=True, eq=False)
class RunRecord:
    """One row of a comparison. ``command``: the command line that reproduces this run alone."""

    spec: RunSpec
    result: RunResult
    scores: Scores
    truth: Truth
    command: str = ""

    @property
    def key(self) -> str:
        """Name of the run's folder."""
        return self.spec.key

    @property
    def method(self) -> str:
        """Label of the method."""
        return self.spec.method.label

    @property
    def sequence(self) -> str:
        """Label of the sequence, without the seed."""
        return self.spec.sequence.label

    @property
    def seed(self) -> int | None:
        """Seed of the sequence, None for a recording."""
        return self.spec.seed
