"""The tables of a report, as blocks: results, all metrics, differences, tests, runs, settings."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from statistics import median

from evalkit.core.run_status import NOT_EXECUTED, RunStatus
from evalkit.metrics.metric import Metric
from evalkit.report.analysis.analysis import Analysis
from evalkit.report.analysis.comparison import Comparison
from evalkit.report.analysis.pairwise import PairedDifference
from evalkit.report.analysis.ranking import Mark, Ranking, mark
from evalkit.report.analysis.scores import STATUS_LABELS, MethodScore, select_unfinished
from evalkit.report.analysis.sequence import SequenceAnalysis
from evalkit.report.formatting import (
    capitalise,
    choose_decimals,
    format_amount,
    format_losses,
    format_number,
)
from evalkit.report.html.blocks import Block, Cell, Chips, Column, Table, Text, Tone
from evalkit.report.html.method_colours import Strokes
from evalkit.results.run_record import RunRecord
from evalkit.stats.intervals import wilson_interval
from evalkit.stats.runs import MIN_RUNS

DASH = Cell("–", "")
WORD_JOINER = "\u2060"
CHIPS: Mapping[str, Chips] = {"reference": (("reference", ""),), "baseline": (("baseline", ""),)}


def method_cell(
    comparison: Comparison, strokes: Strokes, label: str, link: str = "", *chips: tuple[str, Tone]
) -> Cell:  # fmt: skip
    """Return the cell with the label of a method, its line and its role."""
    role = comparison.methods[label].role if label in comparison.methods else ""
    return Cell(label, link=link, stroke=strokes.get(label), chips=(*CHIPS.get(role, ()), *chips))


def metric_column(metric: Metric) -> Column:
    """Return the column of a metric; positions have their unit in each cell."""
    unit = "" if metric.unit == "m" else metric.unit
    return Column(capitalise(metric.label), unit, True, metric.definition, metric.better)


def runs_anchor(number: int, place: int) -> str:
    """Return the anchor of a method's runs over the sequence of that number."""
    return f"sequence-{number}-runs-{place}"


TONES: Mapping[Mark, Tone] = {
    "best": "good",
    "tied": "tied",
    "undecided": "",
    "worse": "",
    "lost": "bad",
    "not comparable": "",
}


def score_cell(ranking: Ranking, score: MethodScore | None, link: str = "", says_loss: bool = True) -> Cell:
    """Return a score: the median with its interval or range, or a dash with the reason.

    ``says_loss``: state when the track was lost.
    """
    metric = ranking.metric
    if score is None:
        return Cell("–", "", tip="not run here")
    partial = ", ".join(format_in_cell(metric, value) for value in score.partial)
    early = f"ended early: {partial}" if partial else ""
    lost = f"lost {format_losses(score)}" if score.lost is not None and says_loss else ""
    if not score.values:
        return Cell("–", "", tip=score.reason, link=link, extent=early or lost)
    repeated = score.expected > 1 and len(score.values) == score.expected  # else the cell itself states how many
    runs = f"{score.expected} runs" if repeated else ""
    support = f"support {score.support}" if score.support else ""
    tuned = "settings chosen here: not counted" if score.tuned else ""
    tip = ", ".join(filter(None, (runs, support, tuned)))
    extent = ", ".join(filter(None, (_extent(metric, score), early, lost)))
    value = median(score.values)
    return Cell(format_in_cell(metric, value), value, TONES[mark(ranking, score.method)], tip, link, extent)


def headline_metrics(sequence: SequenceAnalysis) -> list[Metric]:
    """Return the deciding metric, that of corrected poses, the cost, then the other headline metrics.

    With a true map, map consistency appears only in the table of all metrics.
    """
    first = sequence.deciding.metric.name if sequence.deciding else ""
    corrected = [sequence.final.metric] if sequence.final else []
    mapped = any(record.truth.grid is not None for record in sequence.all_runs)
    shown = [m for m in sequence.metrics if m.headline and not (mapped and m.group == "map consistency")]
    order = sorted(shown, key=lambda metric: (metric.name != first, metric.group != "runtime"))
    return [*order[:1], *corrected, *order[1:]]


def by_rank(sequence: SequenceAnalysis) -> list[str]:
    """Return the methods of a sequence, each group best first: ranked ones, others with values, lost ones, the rest."""
    ranking = sequence.deciding
    if ranking is None:
        return list(sequence.methods)
    sign = ranking.metric.sign
    valued = [score for score in ranking.scores if score.values]
    valued.sort(key=lambda score: (score.lost is not None, sign * median(score.values)))
    ranked = [score.method for score in ranking.ranked]
    return list(dict.fromkeys([*ranked, *(score.method for score in valued), *sequence.methods]))


def headline_table(analysis: Analysis, sequence: SequenceAnalysis, number: int, strokes: Strokes) -> Table:
    """Return the first table of a sequence: methods by rank; deciding metric, cost and headline metrics."""
    comparison = analysis.comparison
    rankings = [sequence.rankings[metric.name] for metric in headline_metrics(sequence)]
    present = [one for one in rankings if one.has_values]
    repeated = any(len(own) > 1 for own in sequence.runs.values())
    places = {label: place for place, label in enumerate(comparison.methods, start=1)}
    rows = []
    for label in by_rank(sequence):
        link = f"#{runs_anchor(number, places[label])}"
        cells = [score_cell(one, one.of(label), link, says_loss=False) for one in present]
        success = [success_cell(sequence.runs[label])] if repeated else []
        chips = _describe_state(sequence, label, repeated)
        rows.append([method_cell(comparison, strokes, label, link, *chips), *success, *cells])
    runs = [Column("Runs complete", "", True, better="higher")] if repeated else []
    columns = [Column("Method"), *runs, *(metric_column(one.metric) for one in present)]
    return Table(columns, rows, label=f"Results on {sequence.label}")


def _describe_state(sequence: SequenceAnalysis, label: str, repeated: bool) -> list[tuple[str, Tone]]:
    """Return what a reader must know of a method beside its numbers; of a single run also how it ended."""
    score = sequence.deciding.of(label) if sequence.deciding else None
    chips: list[tuple[str, Tone]] = []
    if score is not None and score.lost is not None:
        chips.append((f"lost {format_losses(score)}", "bad"))
    if sequence.is_behind(label):
        chips.append(("worse than the baseline", "warn"))
    if not repeated and (broken := select_unfinished(sequence.runs[label])):
        chips.append((STATUS_LABELS[broken[0].result.status], "bad"))
    return chips


def success_cell(records: Sequence[RunRecord]) -> Cell:
    """Return the number of complete runs, with the interval of the share of runs that finish."""
    complete, count = len(records) - len(select_unfinished(records)), len(records)
    started = [record for record in records if record.result.status not in NOT_EXECUTED]
    share = wilson_interval(len(started) - len(select_unfinished(started)), len(started)) if started else None
    extent = f"{100.0 * share.low:.0f}–{100.0 * share.high:.0f} %" if share and count > 1 else ""
    return Cell(f"{complete} of {count}", complete / count, "" if complete == count else "bad", extent=extent)


def absent_text(rankings: Sequence[Ranking]) -> str:
    """Return the metrics without a value, by the reason of the complete runs; "" if no run completed."""
    reasons: dict[str, list[str]] = {}
    for one in rankings:
        reason = next((score.reason for score in one.scores if score.complete), "")
        if reason and not one.has_values:
            reasons.setdefault(reason, []).append(one.metric.label)
    listed = "; ".join(f"{' · '.join(labels)} ({reason})" for reason, labels in reasons.items())
    return f"Not shown, because no method has a value: {listed}." if listed else ""


def numbers_table(analysis: Analysis, strokes: Strokes) -> Table:
    """Return every method, best first, over every sequence in its deciding metric, with the cost; nothing missing."""
    comparison, answer = analysis.comparison, analysis.answer
    places = {label: place for place, label in enumerate(comparison.methods, start=1)}
    columns = [Column("Method"), Column("Best or tied", "", True, better="higher")]
    shown = [
        (number, sequence)
        for number, sequence in enumerate(analysis.sequences, start=1)
        if sequence.label not in comparison.missing_sequences
    ]
    for _, sequence in shown:
        found = sequence.deciding.metric if sequence.deciding else None
        column = metric_column(found) if found else Column("", "", True)
        text = f"{found.label}, {found.unit}" if found and column.unit else found.label if found else ""
        columns.append(Column(sequence.label, text, True, column.tip, column.better))
    columns.append(
        Column("CPU a scan", "ms", True, "median over the data sets that count, or over all if none does", "lower")
    )
    rows = []
    for standing in (one for one in answer.standings if one.method not in comparison.missing_methods):
        cells = []
        for number, sequence in shown:
            link = f"#{runs_anchor(number, places[standing.method])}" if standing.method in sequence.runs else ""
            ranking = sequence.deciding
            cell = score_cell(ranking, ranking.of(standing.method), link) if ranking else DASH
            cells.append(_add_corrected(cell, sequence.final, standing.method))
        led = Cell(f"{standing.led}/{standing.counted}", standing.led) if standing.counted else DASH
        every = len(answer.contests)
        extent = f"on {standing.counted}\u00a0of\u00a0{every}" if 0 < standing.counted < every else ""
        cost = DASH if standing.cpu_ms is None else Cell(_format_time(standing.cpu_ms), standing.cpu_ms, extent=extent)
        link = f"#method-{places[standing.method]}"
        rows.append([method_cell(comparison, strokes, standing.method, link), led, *cells, cost])
    return Table(columns, rows, label="At a glance")


def _add_corrected(cell: Cell, final: Ranking | None, method: str) -> Cell:
    """Add the median of a method's corrected poses, if it has any, below the number of its answers."""
    score = final.of(method) if final is not None else None
    if final is None or score is None or score.median is None:
        return cell
    corrected = f"corrected {format_in_cell(final.metric, score.median)}"
    return replace(cell, extent=f"{cell.extent}, {corrected}" if cell.extent else corrected)


def all_metrics_tables(analysis: Analysis, sequence: SequenceAnalysis, number: int) -> Iterator[Table]:
    """Yield all metrics of a sequence with a value, one table a group; methods in columns, by rank."""
    places = {label: place for place, label in enumerate(analysis.comparison.methods, start=1)}
    labels = by_rank(sequence)
    groups: dict[str, list[list[Cell | str]]] = {}
    for ranking in sequence.rankings.values():
        if ranking.has_values:
            unit = f" [{ranking.metric.unit}]" if ranking.metric.unit not in ("", "m") else ""
            name = Cell(f"{capitalise(ranking.metric.label)}{unit}", link=f"#metric-{ranking.metric.name}")
            cells = [
                score_cell(ranking, ranking.of(label), f"#{runs_anchor(number, places[label])}", says_loss=False)
                for label in labels
            ]
            groups.setdefault(ranking.metric.group, []).append([name, *cells])
    for group, rows in groups.items():
        columns = [Column(capitalise(group)), *(Column(label, number=True, of=label) for label in labels)]
        yield Table(columns, rows, sortable=False, label=f"All metrics on {sequence.label}: {group}")


def pairs_table(analysis: Analysis, sequence: SequenceAnalysis, strokes: Strokes) -> Table | None:
    """Return the paired differences of a sequence; None with fewer than two ranked methods."""
    pairs = sequence.pairwise
    if pairs is None:
        return None
    columns = [Column("Method")]
    for reference in pairs.references:
        columns += [Column(f"Worse than {reference} by", "", True), Column("Verdict"), Column("Detectable", "", True)]
    rows: list[list[Cell]] = []
    for label, entries in pairs.rows:
        cells: list[Cell] = []
        for one in entries:
            if one is None or one.difference is None:
                cells += [DASH, Cell(one.verdict if one else "itself"), DASH]
                continue
            bounds, metric = one.difference.interval, pairs.metric
            extent = f"{100 * bounds.confidence:.0f} %: {_bounds(metric, bounds.low, bounds.high)}"
            extent = extent if one.difference.runs != MIN_RUNS - 1 else ""  # two pairs have no interval
            value = Cell(format_in_cell(metric, bounds.value), bounds.value, extent=extent)
            cells += [value, Cell(one.verdict), _detectable_cell(metric, one.difference)]
        rows.append([method_cell(analysis.comparison, strokes, label), *cells])
    return Table(columns, rows, label=f"Paired differences on {sequence.label}")


def _detectable_cell(metric: Metric, difference: PairedDifference) -> Cell:
    """Return the difference that these runs detect, at most "over" ten times the reference; a dash for one run."""
    if difference.paired is None:
        return DASH
    detectable, most = difference.paired.detectable, 10.0 * difference.paired.scale
    return Cell(f"over {format_in_cell(metric, most)}" if detectable > most else format_in_cell(metric, detectable))


def failure_texts(records: Sequence[RunRecord]) -> list[str]:
    """Return the runs that did not complete in words; those of one method with one reason are one entry."""
    together: dict[tuple[str, RunStatus, str], list[RunRecord]] = {}
    for record in select_unfinished(records):
        together.setdefault((record.method, record.result.status, record.result.reason), []).append(record)
    texts = []
    for (method, status, reason), own in together.items():
        counts = dict.fromkeys(
            f"{len(one.result.steps)} of {one.result.expected} scans" for one in own if len(one.result.steps)
        )
        where = list(_name_repetitions(own))
        where += [f"after {' / '.join(counts)}"] if counts else []
        texts.append(f"{method} {STATUS_LABELS[status]} {' '.join(where)}{': ' if where else ''}{reason}")
    return texts


def _name_repetitions(records: Sequence[RunRecord]) -> Iterator[str]:
    """Yield which runs of a method on a sequence these are: "seeds 0, 1"; nothing for a single run of a recording."""
    perturbed = records[0].spec.sequence.perturbed
    seeds = [str(record.seed) for record in records if record.seed is not None]
    if perturbed and len(seeds) < len(records):
        yield f"without perturbation{' and' * bool(seeds)}"
    if seeds:
        yield f"{'perturbation' if perturbed else 'seed'}{'s' * (len(seeds) > 1)} {', '.join(seeds)}"


def absent_note(rankings: Sequence[Ranking]) -> list[Block]:
    """Return the metrics without a value as small print; nothing without any."""
    text = absent_text(rankings)
    return [Text(text, "note")] if text else []


def _extent(metric: Metric, score: MethodScore) -> str:
    """Return the 95 % interval, or the lowest and highest of several runs, as printed below the number."""
    parts = [f"{len(score.values)} of {score.expected} runs"] if len(score.values) < score.expected else []
    if (spread := score.spread) is not None:
        parts.append(_bounds(metric, spread.low, spread.high))
    return ", ".join(parts)


def _bounds(metric: Metric, low: float, high: float) -> str:
    """Return two bounds, with their common unit once; only two units are on two lines of a narrow column."""
    first, last = format_in_cell(metric, low), format_in_cell(metric, high)
    number, _, unit = first.partition("\u00a0")
    if unit and not last.endswith(f"\u00a0{unit}"):
        return f"{first}–{last}"
    return f"{number}–{WORD_JOINER}{last}"


def format_in_cell(metric: Metric, value: float) -> str:
    """Format a value for a cell: positions with their unit, others without."""
    if metric.unit == "m":
        return format_amount(metric, value)
    return format_number(value, choose_decimals(metric.unit, metric.digits, value))


def _format_time(milliseconds: float) -> str:
    return format_number(milliseconds, choose_decimals("ms", 2, milliseconds))
