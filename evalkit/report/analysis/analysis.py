"""The analysis of a comparison: everything that the page, results.json, tables and exports state, computed once."""

from __future__ import annotations

from dataclasses import dataclass

from evalkit.report.analysis.answer import Answer, compute_answer
from evalkit.report.analysis.comparison import Comparison
from evalkit.report.analysis.sequence import SequenceAnalysis, analyse_sequence
from evalkit.report.analysis.significance import Significance, compute_significance
from evalkit.report.analysis.standings import compute_tally
from evalkit.report.analysis.statements.overview import compute_overview
from evalkit.report.analysis.statements.verdict import SequenceVerdict, compute_verdict


@dataclass(frozen=True)
class Analysis:
    """The analysis of a comparison. ``verdicts``: one per sequence, in the order of ``sequences``."""

    comparison: Comparison
    sequences: tuple[SequenceAnalysis, ...]
    verdicts: tuple[SequenceVerdict, ...]
    overview: tuple[str, ...]
    answer: Answer
    significance: Significance


def analyse(comparison: Comparison) -> Analysis:
    """Compute the analysis of a comparison."""
    sequences = tuple(analyse_sequence(comparison, label) for label in comparison.sequence_labels)
    verdicts = tuple(compute_verdict(comparison, sequence) for sequence in sequences)
    tally = compute_tally(comparison, sequences, verdicts)
    significance = compute_significance(comparison, sequences, tally.winners)
    answer = compute_answer(comparison, sequences, verdicts, tally, significance)
    overview = compute_overview(comparison, sequences, verdicts, {one.sequence for one in tally.contests})
    return Analysis(comparison, sequences, verdicts, overview, answer, significance)
