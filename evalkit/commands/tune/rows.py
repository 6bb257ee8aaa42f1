"""Tables of the held-out comparison: every method on every sequence, and tuned against default."""

from __future__ import annotations

import math
from collections.abc import Sequence

from evalkit.commands.tune.held_out import HeldOutSequence, HeldOutVerdict
from evalkit.commands.tune.result import TuningResult
from evalkit.core.run_status import NOT_EXECUTED, RunStatus
from evalkit.report.analysis.ranking import Ranking
from evalkit.report.analysis.scores import STATUS_LABELS
from evalkit.report.formatting import format_amount, format_difference, format_spread
from evalkit.report.html.blocks import Block, Cell, Column, Table, Text
from evalkit.stats.runs import FEW_CONFIDENCE, FEW_RUNS, PAIRED_CONFIDENCE


def build_held_out_blocks(result: TuningResult) -> list[Block]:
    """The medians with their intervals, the tests over all runs, and the differences on each sequence."""
    comparison = result.comparison
    rankings = {sequence.label: sequence.deciding for sequence in result.analysis.sequences}
    columns = [Column("Method"), *(_make_heading(name, ranking) for name, ranking in rankings.items())]
    rows = [
        [Cell(label), *(_make_score_cell(result, label, name, ranking) for name, ranking in rankings.items())]
        for label in comparison.method_labels
    ]
    caption = "Median over the runs with its 95 % interval, in the metric that decides the sequence"
    blocks: list[Block] = [Table(columns, rows, caption)]
    verdicts = list(result.held_out_verdicts.values())
    if not verdicts:
        return [*blocks, Text("All back ends keep their default.")]
    blocks.append(_build_tests(verdicts))
    if pairs := [(one.label, each) for one in verdicts for each in one.sequences]:
        blocks.append(_build_differences(pairs))
    return blocks


def format_number(value: float) -> str:
    """A number with three digits, "none" if it is not finite."""
    return f"{value:.3g}" if math.isfinite(value) else "none"


def _make_heading(name: str, ranking: Ranking | None) -> Column:
    if ranking is None:
        return Column(name, number=True)
    return Column(f"{name}: {ranking.metric.label}", number=True)


def _make_score_cell(result: TuningResult, label: str, sequence: str, ranking: Ranking | None) -> Cell:
    score = None if ranking is None else ranking.of(label)
    own = [record for record in result.comparison.records if (record.method, record.sequence) == (label, sequence)]
    if ranking is None or score is None or not score.values:
        statuses = dict.fromkeys(STATUS_LABELS[record.result.status] for record in own if not record.result.is_complete)
        why = score.reason if score is not None else "; ".join(record.result.reason for record in own[:1])
        return Cell(", ".join(statuses) or "no value", sort=math.inf, tone="warn", tip=why)
    middle, between = score.median or 0.0, score.interval
    shown = (
        format_amount(ranking.metric, middle)
        if between is None
        else format_spread(ranking.metric, middle, between.low, between.high)
    )
    executed = [record.result.status for record in own if record.result.status not in NOT_EXECUTED]
    lost = sum(status != RunStatus.COMPLETE for status in executed)
    text = f"{shown}, {lost} of {len(executed)} lost" if lost else shown
    return Cell(text, sort=middle, tone="warn" if lost else "", tip=f"{len(score.values)} runs")


def _build_tests(verdicts: Sequence[HeldOutVerdict]) -> Table:
    columns = (
        Column("Back end"),
        Column("Runs", number=True, tip="runs of both with a known ground truth and a unique pose"),
        Column("Better / worse", number=True, tip="runs in which tuned has the smaller / larger error"),
        Column("Ratio", "x", number=True, tip="error of tuned divided by the default's, median over runs"),
        Column("p", number=True, tip="Wilcoxon's signed-rank test, Holm over the back ends"),
        Column("Detectable", "x", number=True, tip="the ratio that these runs detect with 80 % power, in all rows"),
        Column("Lost", number=True, tip="runs that were not completed: default → tuned"),
        Column("Verdict"),
    )  # fmt: skip
    return Table(columns, [_make_test_row(one) for one in verdicts], "Tuned against default, over all held-out runs")


def _make_test_row(one: HeldOutVerdict) -> Sequence[Cell | str]:
    paired = one.paired
    lost = Cell(f"{one.lost[0]} → {one.lost[1]}", sort=one.lost[1] - one.lost[0])
    verdict = Cell(one.verdict, tone="bad" if one.overfitted else "")
    if paired is None:
        return (one.label, *[Cell("-", sort=math.inf)] * 5, lost, verdict)
    detectable = f"{1.0 / paired.detectable:.2f}" if math.isfinite(paired.detectable) else "none"
    return (
        one.label,
        Cell(str(paired.runs), sort=paired.runs),
        Cell(f"{paired.better} / {paired.worse}", sort=paired.better),
        Cell("-", sort=math.inf) if paired.ratio is None else Cell(f"{paired.ratio:.2f}", sort=paired.ratio),
        Cell(f"{paired.p:.3f}", sort=paired.p),
        Cell(detectable, sort=paired.detectable),
        lost,
        verdict,
    )


PAIRED = (
    f"paired, with the interval of {100 * PAIRED_CONFIDENCE:.0f} %, of {100 * FEW_CONFIDENCE:.0f} % below {FEW_RUNS} "
    "pairs and on recordings"
)


def _build_differences(pairs: Sequence[tuple[str, HeldOutSequence]]) -> Table:
    columns = (
        Column("Back end"), Column("Sequence"), Column("Metric"), Column("Default", number=True),
        Column("Tuned", number=True), Column("Tuned - default", number=True, tip=PAIRED),
        Column("Detectable", number=True, tip="the difference that these runs detect with 80 % power"),
        Column("Significant"),
    )  # fmt: skip
    return Table(
        columns, [_make_difference_row(*pair) for pair in pairs], "Tuned against default, sequence by sequence"
    )


def _make_difference_row(label: str, one: HeldOutSequence) -> Sequence[Cell | str]:
    metric = one.ranking.metric
    head = (label, one.ranking.sequence, metric.label)
    medians = [Cell(format_amount(metric, cell.median or 0.0), sort=cell.median) for cell in (one.default, one.tuned)]
    if one.difference is None:
        return (*head, *medians, Cell("-"), Cell("-"), "one run, no interval")
    verdict = "no"
    if one.significant:
        verdict = "worse" if one.worse else "better"
    detectable = one.difference.detectable or math.inf
    return (*head, *medians, Cell(format_difference(metric, one.difference), sort=one.difference.interval.value),
            Cell(format_amount(metric, detectable, 1) if math.isfinite(detectable) else "none", sort=detectable),
            Cell(verdict, tone="bad" if one.worse else "good" if one.significant else ""))  # fmt: skip
