"""A run with everything a report needs: what was run, how it went, its scores and the ground truth."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from evalkit.config.experiment import Experiment, RunSpec
from evalkit.core.errors import StoreError
from evalkit.core.ground_truth import Truth
from evalkit.core.run_result import RunResult, Scores
from evalkit.io.output_files import REMEDY
from evalkit.plugins import registry
from evalkit.results.store import Store


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


def load_records(store: Store, experiment: Experiment, results: Mapping[str, RunResult]) -> tuple[RunRecord, ...]:
    """The runs of an experiment with their stored scores, in the experiment's order. ``results``: by key of the run.

    Raises StoreError if the scores of a run cannot be read back.
    """
    truths: dict[tuple[str, int | None], Truth] = {}
    records = []
    for spec in experiment.runs():
        result = results[spec.key]
        scores = store.load_scores(spec.key) if result.is_scorable else Scores()
        if scores is None:
            raise StoreError(str(store.run_folder(spec.key)), "was written but cannot be read back", REMEDY)
        sequence = spec.sequence.label, None if spec.sequence.perturbed else spec.seed  # perturbed: one truth for all
        if sequence not in truths:
            truths[sequence] = _load_truth(spec)
        records.append(RunRecord(spec, result, scores, truths[sequence], experiment.command(spec)))
    return tuple(records)


def _load_truth(spec: RunSpec) -> Truth:
    if spec.sequence.missing:
        return Truth("the data are not available here")
    try:
        return registry.dataset(spec.sequence.dataset).open(spec.dataset_parameters).truth()
    except Exception as error:  # noqa: BLE001 - an error of the reader, which is the reason of each of its runs too
        return Truth(f"cannot be read: {error}")
