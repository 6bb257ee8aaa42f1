"""The table of methods that tracked the robot in a known map, and the predicted beside the true error of each scan."""

from __future__ import annotations

import numpy as np

from evalkit.core.se2 import Floats
from evalkit.metrics.fit_calibration import WRONG_M, describe_calibration
from evalkit.metrics.localisation import WITHIN
from evalkit.report.analysis.analysis import Analysis
from evalkit.report.analysis.sequence import SequenceAnalysis
from evalkit.report.formatting import MAP_USES, capitalise, format_length, format_loss
from evalkit.report.html import charts
from evalkit.report.html.blocks import Block, Cell, Column, Figure, Figures, Heading, Table, Text
from evalkit.report.html.charts import Axis, Points
from evalkit.report.html.method_colours import TRUTH, Strokes
from evalkit.report.html.report_tables import (
    DASH,
    by_rank,
    method_cell,
    metric_column,
    runs_anchor,
    score_cell,
)
from evalkit.results.run_record import RunRecord

COLUMNS = (
    "map_wrong_percent", "map_truly_wrong_percent", "map_fit_m", "map_fit_ratio", "map_fit_within_percent",
    "map_fit_percent", "map_misfit_percent",
)  # fmt: skip
"""Metrics of the table after the error, in order; those without a value are left out."""

NOTE = (
    "Every method starts at the same place of the known map, and nothing is aligned. The column Map says what it does "
    f"then. {capitalise(MAP_USES['matches'])}: evalkit matches each scan with the map. "
    f"{capitalise(MAP_USES['reads'])}: the method reads the map itself. "
    f"{capitalise(MAP_USES['starts there'])}: it runs as without a map, and its drift stays. The pose error by map fit "
    "needs no ground truth: it is what the scans that fit say about the pose. It is calibrated if the ratio is 1 and "
    f"95 % of the true errors are within {WITHIN:g} times the prediction. Wrong by map fit: the probability that the "
    f"position is more than {100.0 * WRONG_M:g} cm off, by the same fit."
)
UNSEEN = "without ground truth the motion is checked, and not the place in the map: see the scans that do not fit"
SEARCH = "the search of the start, the same for all methods"


def build_known_map(
    analysis: Analysis, sequence: SequenceAnalysis, number: int, strokes: Strokes, anchor: str
) -> list[Block]:
    """Return heading, note, table and figure of the runs in a known map; [] without any."""
    first = {label: own[0] for label, own in sequence.runs.items() if own[0].result.start is not None}
    if not first:
        return []
    deciding = [sequence.deciding.metric.name] if sequence.deciding else []
    found = [sequence.rankings.get(name) for name in dict.fromkeys([*deciding, *COLUMNS])]
    shown = [one for one in found if one is not None and one.has_values]
    places = {label: place for place, label in enumerate(analysis.comparison.methods, start=1)}
    rows = []
    for label in (label for label in by_rank(sequence) if label in first):
        link, record = f"#{runs_anchor(number, places[label])}", first[label]
        start = record.result.start
        after = DASH if start is None or not start.searched else Cell(f"{start.after_s:.1f} s", start.after_s,
                     tip=f"scan {start.scans}, score {start.score:.2f}")  # fmt: skip
        track = _describe_track(record)
        cells = [score_cell(one, one.of(label), link, says_loss=False) for one in shown]
        use = Cell(MAP_USES[analysis.comparison.methods[label].map_use], "")
        rows.append([method_cell(analysis.comparison, strokes, label, link), use, after, track, *cells])
    columns = [
        Column("Method"), Column("Map"), Column("Localised after", "", True, SEARCH),
        Column("Track"), *(metric_column(one.metric) for one in shown),
    ]  # fmt: skip
    blocks: list[Block] = [
        Heading("In the known map", f"{anchor}-known-map"), Text(f"{NOTE} {describe_calibration()}", "note"),
        Table(columns, rows, label=f"In the known map, {sequence.label}"),
    ]  # fmt: skip
    pairs = {label: known for label, record in first.items() if len(known := _select_known(record.scores.fit))}
    return [*blocks, *([Figures([draw_calibration(pairs, strokes)])] if pairs else [])]


def _describe_track(record: RunRecord) -> Cell:
    """Return whether a run kept its place in the map; without ground truth only its motion was checked."""
    lost = record.scores.lost
    if lost is not None:
        return Cell(format_loss(lost), lost.at_s, "bad", lost.reason)
    return Cell("held", "") if record.truth.trajectory is not None else Cell("no loss seen", "", tip=UNSEEN)


def draw_calibration(pairs: dict[str, Floats], strokes: Strokes) -> Figure:
    """Draw the true error of each scan against the predicted one, both axes logarithmic; ``pairs``: (K, 2) in m."""
    every = np.maximum(np.concatenate(list(pairs.values())), 1e-4)
    ends = np.array([every.min(), every.max()])
    layers = [
        *(
            Points(label, np.maximum(own, 1e-4), strokes[label].colour, alpha=0.5, mark=strokes[label].mark)
            for label, own in pairs.items()
        ),
        Points("as predicted", np.column_stack([ends, ends]), TRUTH, 1.2, joined=True),
        Points(f"{WITHIN:g} times", np.column_stack([ends, WITHIN * ends]), TRUTH, 0.6, joined=True),
    ]
    ticks = charts.compute_log_ticks(float(every.min()), float(every.max()))
    x, y = (Axis(f"{name} error of the position [m]", "log", ticks=ticks) for name in ("predicted", "true"))
    ratios = {label: float(np.sqrt(np.mean(own[:, 1] ** 2) / np.mean(own[:, 0] ** 2))) for label, own in pairs.items()}
    worst = max(ratios, key=ratios.__getitem__)
    size = format_length(float(np.sqrt(np.mean(pairs[worst][:, 1] ** 2))))
    finding = f"{worst} has the largest ratio of true to predicted error, {ratios[worst]:.2f}, at {size}"
    caption = f"One point a scan that fits the map. {finding}."
    return Figure(charts.scatter(layers, x, y, equal=False), "Predicted and true error", caption, alt=caption)


def _select_known(fit: Floats | None) -> Floats:
    """Return the pairs (K, 2) of which both errors are known."""
    return np.zeros((0, 2)) if fit is None else fit[np.isfinite(fit).all(axis=1)]
