"""The map strip of a report: the hardest recording as the answer, a peer, a baseline and the worst method map it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from statistics import median
from urllib.parse import quote

from evalkit.metrics.runtime import COST
from evalkit.report.analysis.analysis import Analysis
from evalkit.report.analysis.ranking import Mark, mark
from evalkit.report.analysis.sequence import SequenceAnalysis
from evalkit.report.analysis.statements.pills import find_left_out
from evalkit.report.formatting import format_amount, format_losses, format_milliseconds
from evalkit.report.html.blocks import Figure
from evalkit.report.html.maps import find_window, measure_image, render_map
from evalkit.report.html.method_colours import Stroke, Strokes

MAX_TILES = 4
BEST: Mapping[Mark, str] = {"best": "best here", "tied": "tied for the best"}


@dataclass(frozen=True, slots=True)
class Tile:
    """One map of the strip: the method's map on the hardest recording. ``role``: why it is shown.

    "worst" and "best here" are verdicts; of a difference that these runs do not show, only the value is stated.
    """

    method: str
    role: str
    figure: Figure
    caption: str
    link: str
    stroke: Stroke


def find_hardest(analysis: Analysis) -> int | None:
    """Return the index of the sequence whose maps differ most: recordings before simulations, whole before excerpts.

    Of these one that the answer counts.
    """
    counted = {one.sequence for one in analysis.answer.contests}
    found: list[tuple[bool, bool, bool, float, int]] = []
    for number, sequence in enumerate(analysis.sequences):
        drawn = [own[0] for own in sequence.runs.values() if own[0].scores.grid is not None]
        if len(drawn) < 2 or sequence.deciding is None or sequence.card.degenerate:
            continue
        values = [max(median(score.values), 1e-9) for score in sequence.deciding.scores if score.values]
        spread = max(values) / min(values) if values else 0.0
        recorded = drawn[0].seed is None or drawn[0].spec.sequence.perturbed
        whole = not drawn[0].spec.sequence.excerpt_scans
        found.append((recorded, whole, sequence.label in counted, spread, -number))
    return -max(found)[-1] if found else None


def choose_tiles(analysis: Analysis, sequence: SequenceAnalysis) -> list[tuple[str, str]]:
    """Return method and role of each map, best first: the answer, a peer, the baseline, the worst, others.

    Methods whose settings were chosen on the sequence are left out, but for the answer and, beside it, the best other
    one of them: an answer with such settings is not compared with methods without them alone.
    """
    comparison, ranking = analysis.comparison, sequence.deciding
    if ranking is None:
        return []
    drawn = {label for label, own in sequence.runs.items() if own[0].scores.grid is not None}
    valued = [score for score in ranking.scores if score.values and score.method in drawn]
    sign = ranking.metric.sign
    every = [score.method for score in sorted(valued, key=lambda score: sign * median(score.values))]
    tuned = [method for method in every if method in find_left_out(comparison, sequence)]
    others = [method for method in tuned if method not in analysis.answer.winners]
    rival = others[:1] if len(others) < len(tuned) else []
    ordered = [method for method in every if method not in others or method in rival]
    if not ordered:
        return []
    winners = [method for method in ordered if method in analysis.answer.winners and not analysis.answer.rivals]
    best = BEST.get(mark(ranking, ordered[0]), "best value")
    worst = "worst" if mark(ranking, ordered[-1]) in ("worse", "lost") else "worst value"
    wanted = (
        *([("answer", [winner]) for winner in winners] or [(best, ordered[:1])]),
        ("best other tuned", rival),
        (worst, ordered[-1:]),
        ("established", [method for method in ordered if comparison.methods[method].role == "peer"]),
        ("baseline", comparison.methods_with_role("baseline")),
        ("reference", comparison.methods_with_role("reference")),
        *[("", ordered)] * MAX_TILES,
    )
    chosen: dict[str, str] = {}
    for role, methods in wanted:
        free = [method for method in methods if method in ordered and method not in chosen]
        if free and len(chosen) < MAX_TILES:
            chosen[free[0]] = role
    return [(method, chosen[method]) for method in ordered if method in chosen]


def describe_strip(analysis: Analysis, sequence: SequenceAnalysis) -> str:
    """Return which recording the maps are of, what their numbers are, and whether it counts in the answer."""
    label = sequence.deciding.metric.label if sequence.deciding else ""
    counts = any(one.sequence == sequence.label for one in analysis.answer.contests)
    return f"{sequence.label}: {label}, CPU time a scan{'' if counts else '; not counted'}"


def build_tiles(analysis: Analysis, number: int, strokes: Strokes) -> list[Tile]:
    """Return the map strip of a sequence, best first: each map in the window of the first one."""
    sequence = analysis.sequences[number]
    ranking, tiles = sequence.deciding, []
    chosen, left_out = choose_tiles(analysis, sequence), find_left_out(analysis.comparison, sequence)
    grids = {method: grid for method, _ in chosen if (grid := sequence.runs[method][0].scores.grid) is not None}
    shown = find_window([grids[chosen[0][0]]]) if chosen else None
    if shown is None:
        return []
    for method, role in chosen:
        grid = grids[method]
        score = ranking.of(method) if ranking else None
        value = format_amount(ranking.metric, median(score.values)) if ranking and score and score.values else ""
        cost = sequence.rankings[COST].of(method) if COST in sequence.rankings else None
        times = format_milliseconds(cost.median) if cost is not None and cost.median is not None else ""
        lost = f"lost {format_losses(score)}" if score is not None and score.lost is not None else ""
        corrected = sequence.final.of(method) if sequence.final else None
        if ranking and corrected is not None and corrected.values:
            value += f", corrected {format_amount(ranking.metric, median(corrected.values))}"
        tuned = "settings chosen here" if method in left_out else ""
        caption = " · ".join(filter(None, (value, lost or times, tuned)))
        has_player = any(len(run.result.steps) for run in sequence.runs[method])
        anchor = f"sequence-{number + 1}"
        link = f"#{anchor}-player?by={quote(method)}&on=own&play=1" if has_player else f"#{anchor}"
        image = Figure(render_map(grid, shown), method, media="png", size=measure_image(grid, shown))
        tiles.append(Tile(method, role, image, caption, link, strokes[method]))
    return tiles
