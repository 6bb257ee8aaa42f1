"""What a comparison in a known map found, as a table for a terminal: use of the map, start, fit, wrong positions."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from statistics import median

from evalkit.metrics.fit_calibration import WRONG_M, load_calibration
from evalkit.report.analysis.analysis import Analysis
from evalkit.report.analysis.sequence import SequenceAnalysis
from evalkit.report.formatting import MAP_USES, format_amount
from evalkit.terminal.method_names import cut_middle

FIT, PREDICTED, TRUE = "map_fit_m", "map_wrong_percent", "map_truly_wrong_percent"
HEADS = {FIT: "fit", PREDICTED: "wrong by fit", TRUE: "truly wrong"}


def describe_map_fit(analysis: Analysis, names: Mapping[str, str], width: int) -> Iterator[str]:
    """Yield a table for each sequence in a known map, then what its columns mean; nothing without such a sequence.

    ``names``: those of the methods in a table of at most ``width`` columns.
    """
    shown = False
    for sequence in analysis.sequences:
        in_map = [label for label, own in sequence.runs.items() if any(one.result.start for one in own)]
        if not in_map:
            continue
        shown = True
        metrics = [name for name in HEADS if name != TRUE or _has_values(sequence, name)]
        rows = [["", "map", "localised after", *(HEADS[name] for name in metrics)]]
        for label in sorted(in_map, key=lambda one: _find_wrong(sequence, one)):
            cells = [_format(sequence, name, label) for name in metrics]
            use = MAP_USES[analysis.comparison.methods[label].map_use]
            rows.append([names[label], use, _format_start(sequence, label), *cells])
        yield f"In the known map, {sequence.label}:"
        yield from _align(rows, width)
        for label in in_map:
            ranking = sequence.rankings.get(PREDICTED)
            score = ranking.of(label) if ranking else None
            if score is not None and score.reason:
                yield f"{label}: no share of wrong positions, {score.reason}"
    if shown:
        wrong = 100.0 * load_calibration().check["wrong_share"]
        yield (
            "fit: error of the poses whose scans fit the map. wrong by fit: positions expected to be more than "
            f"{100.0 * WRONG_M:g} cm off; too high where fewer than {wrong:.0f} % really are (see the page). "
            f"{MAP_USES['starts there']}: runs as without a map, from the same start."
        )


def _find_wrong(sequence: SequenceAnalysis, label: str) -> float:
    """Return the share of wrong positions by map fit (%), infinite without one: the order of the table."""
    ranking = sequence.rankings.get(PREDICTED)
    score = ranking.of(label) if ranking else None
    return math.inf if score is None or score.median is None else score.median


def _has_values(sequence: SequenceAnalysis, name: str) -> bool:
    return name in sequence.rankings and sequence.rankings[name].has_values


def _format(sequence: SequenceAnalysis, name: str, label: str) -> str:
    ranking = sequence.rankings.get(name)
    score = ranking.of(label) if ranking else None
    if ranking is None or score is None or score.median is None:
        return "–"
    return format_amount(ranking.metric, score.median)


def _format_start(sequence: SequenceAnalysis, label: str) -> str:
    starts = [run.result.start for run in sequence.runs[label] if run.result.start is not None]
    return f"{median(one.after_s for one in starts):.1f} s" if starts[0].searched else "given"


def _align(rows: list[list[str]], width: int) -> Iterator[str]:
    """Yield the lines of a table: the first two columns to the left, the others to the right, the names cut to fit."""
    sizes = [max(map(len, column)) for column in zip(*rows, strict=True)]
    sizes[0] = max(1, min(sizes[0], width - sum(size + 2 for size in sizes[1:]) - 2))
    rows = [[cut_middle(name, sizes[0]), *others] for name, *others in rows]
    for row in rows:
        cells = [
            text.ljust(size) if at < 2 else text.rjust(size)
            for at, (text, size) in enumerate(zip(row, sizes, strict=True))
        ]
        yield f"  {'  '.join(cells)}".rstrip()
