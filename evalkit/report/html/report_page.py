"""The page of a report: the answer, the sequences and the appendix in one HTML file that loads nothing else."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from markupsafe import Markup

from evalkit.core.grid import OccupancyGrid
from evalkit.metrics.metric import Metric
from evalkit.report.analysis.analysis import Analysis
from evalkit.report.analysis.comparison import Comparison
from evalkit.report.analysis.map_agreement import decided_by_fit
from evalkit.report.analysis.ranking import Ranking
from evalkit.report.analysis.scores import STATUS_LABELS
from evalkit.report.analysis.sequence import SequenceAnalysis
from evalkit.report.analysis.statements.verdict import SequenceVerdict
from evalkit.report.formatting import capitalise, format_amount, name_or_count
from evalkit.report.html import (
    appendix,
    corrected_runs,
    corrected_tables,
    cost_plot,
    dot_plot,
    known_map,
    map_strip,
    published,
    report_tables,
    run_charts,
)
from evalkit.report.html.blocks import (
    Block,
    Bullets,
    Document,
    Facts,
    Figure,
    Figures,
    Fold,
    Heading,
    Html,
    Text,
    load_template,
)
from evalkit.report.html.maps import MapWindow, find_window, measure_image, render_map
from evalkit.report.html.method_colours import Stroke, assign_strokes
from evalkit.report.html.player import build_player, ranges_per_sequence
from evalkit.results.run_record import RunRecord

MAX_NAMED = 4
"""Methods named beside the heading of a sequence; more are counted."""
MAP_CAPTION_GROUPS = ("map against truth", "map consistency")
BADGES = {
    "one run": "one run: no verdict", "lost": "no method held the track",
    "single": "one ranked method", "degenerate": "degenerate geometry",
    "disagreement": "no ground truth: map metrics disagree", "unranked": "no ranking",
}  # fmt: skip


@dataclass(frozen=True, slots=True)
class SequenceMaps:
    """The maps of each method's first run over a sequence, in a common window; ``window`` is None without any."""

    figures: Mapping[str, Figure]
    window: MapWindow | None


def render_report(analysis: Analysis) -> str:
    """Return the HTML of a report."""
    comparison = analysis.comparison
    strokes = assign_strokes(comparison.method_labels, comparison.methods_with_role("baseline"))
    maps = [draw_maps(comparison, sequence, strokes) for sequence in analysis.sequences]
    hardest = map_strip.find_hardest(analysis)
    tiles = [] if hardest is None else map_strip.build_tiles(analysis, hardest, strokes)
    folds = [
        build_sequence(analysis, number, maps[number], strokes, is_open=number == (hardest or 0))
        for number in range(len(analysis.sequences))
    ]
    title, emphasis = analysis.answer.title, analysis.answer.emphasis
    return load_template("report.html.j2").render(
        document=Document("evalkit report", comparison.title, comparison.description, ()),
        title=title.partition(emphasis) if emphasis else ("", "", title),
        lead_stroke=strokes[analysis.answer.winners[0]] if len(analysis.answer.winners) == 1 else None,
        answer=analysis.answer,
        corrects=any(sequence.final is not None for sequence in analysis.sequences),
        tiles=tiles,
        hardest="" if hardest is None else analysis.sequences[hardest].label,
        strip="" if hardest is None else map_strip.describe_strip(analysis, analysis.sequences[hardest]),
        dots=dot_plot.draw_dots(analysis, strokes),
        scatter=cost_plot.draw_scatter(analysis, strokes),
        numbers=report_tables.numbers_table(analysis, strokes),
        overview=analysis.overview,
        folds=folds,
        appendix=appendix.build_appendix(analysis, strokes),
        methods={label: strokes[label] for label in comparison.method_labels},
    )


def build_sequence(
    analysis: Analysis, number: int, maps: SequenceMaps, strokes: Mapping[str, Stroke], is_open: bool
) -> Fold:
    """Return everything that the page shows of one sequence; figures show each method's first run."""
    sequence, verdict = analysis.sequences[number], analysis.verdicts[number]
    anchor = f"sequence-{number + 1}"
    first = [own[0] for own in sequence.runs.values()]
    blocks: list[Block] = [Bullets(verdict.sentences)]
    if sequence.card.degenerate:
        blocks.insert(0, Text(f"Degenerate geometry. {capitalise(sequence.card.degenerate)}", "warn"))
    charts = _draw_charts(sequence, first, strokes)
    if charts:
        blocks += [Html(chart) for chart in charts[:1]]
    else:
        blocks.append(Text("No figures and no player: the runs consist of maps without paths." if maps.figures
                           else "No figures: no run answered a scan.", "warn"))  # fmt: skip
    blocks += _build_player(analysis, sequence, first, maps.window, strokes, anchor)
    if maps.figures and maps.window:
        width, height = maps.window.size_m
        cut = " Maps of runs that lost the track may be cut." if any(one.scores.lost for one in first) else ""
        blocks += [
            Heading("Maps", f"{anchor}-maps"),
            Text(f"One mapper draws all maps. Each shows the same {width:.1f} × {height:.1f} m: black is occupied, "
                 f"white free, grey not observed.{cut}", "note"),
            Figures(list(maps.figures.values()), maps=True),
        ]  # fmt: skip
    blocks += _build_tables(analysis, number, strokes)
    if charts[1:]:
        blocks.append(Fold("Paths, CPU times and residuals", [Html(chart) for chart in charts[1:]], f"{anchor}-more"))
    facts = (*sequence.drive, ("Ground truth", sequence.card.truth.rstrip(".")), ("Sensor", sequence.card.sensor))
    blocks.append(Facts((("The data set", sequence.card.summary), *facts)))
    blocks.append(Text(f"Figures show {_describe_shown(sequence)}.", "note"))
    return Fold(
        sequence.label, blocks, anchor, _badge(verdict, sequence.deciding), heading=True, lazy=True, is_open=is_open
    )


def _describe_shown(sequence: SequenceAnalysis) -> str:
    """Return which run of each method the figures show: the first one."""
    if all(len(own) == 1 for own in sequence.runs.values()):
        return "the single run of each method"
    first = next(iter(sequence.runs.values()))[0]
    if not first.spec.sequence.perturbed:
        return f"seed {first.seed} only"
    return "the run without perturbation only" if first.seed is None else f"perturbation {first.seed} only"


def _badge(verdict: SequenceVerdict, ranking: Ranking | None) -> str:
    """Return the verdict in a few words; ``ranking``: the one that decides."""
    if verdict.outcome == "winner":
        how = "best fit to the known map" if decided_by_fit(ranking) else "best map"
        return f"{'winner' if verdict.counts else f'{how}, no ground truth'}: {verdict.leaders[0]}"
    if verdict.outcome == "tied":
        return f"tied: {name_or_count(verdict.leaders, MAX_NAMED)}"
    return BADGES[verdict.outcome]


def _draw_charts(
    sequence: SequenceAnalysis, first: Sequence[RunRecord], strokes: Mapping[str, Stroke]
) -> list[Markup]:  # fmt: skip
    """Return the charts of a sequence that have content, the error over time first."""
    leader = report_tables.by_rank(sequence)[0]
    both, every = corrected_runs.with_corrected(first), corrected_runs.add_strokes(strokes)
    charts = [
        run_charts.error_chart(both, every, leader),
        run_charts.path_chart(both, every, leader),
        run_charts.cost_chart(first, strokes, leader),
    ]
    return [chart for chart in charts if chart is not None] + run_charts.residual_charts(first, strokes, leader)


def _build_player(
    analysis: Analysis, sequence: SequenceAnalysis, first: Sequence[RunRecord], shown: MapWindow | None,
    strokes: Mapping[str, Stroke], anchor: str,
) -> list[Block]:  # fmt: skip
    comparison = analysis.comparison
    preferred = next(iter(comparison.methods_with_role("reference")), "")
    most = ranges_per_sequence(len(comparison.sequences))
    scans, leader = comparison.scans.get(sequence.label), report_tables.by_rank(sequence)[0]
    both, every = corrected_runs.with_corrected(first), corrected_runs.add_strokes(strokes)
    player = build_player(both, scans, shown, every, most, preferred, leader)
    if player is None:
        return []
    template = load_template("player.html.j2", sentence=capitalise)
    return [Html(Markup(template.render(player=player, anchor=anchor, label=sequence.label, strokes=every)))]


def _build_tables(analysis: Analysis, number: int, strokes: Mapping[str, Stroke]) -> list[Block]:
    sequence, anchor = analysis.sequences[number], f"sequence-{number + 1}"
    table = report_tables.headline_table(analysis, sequence, number + 1, strokes)
    headline = [sequence.rankings[metric.name] for metric in report_tables.headline_metrics(sequence)]
    blocks: list[Block] = [
        Heading("Results", f"{anchor}-results"), table,
        Text("Below a number: its 95 % interval, or the lowest and highest of few or perturbed runs.", "note"),
        *report_tables.absent_note(headline),
        *(Text(text, "note") for text in sequence.alignments),
        *known_map.build_known_map(analysis, sequence, number + 1, strokes, anchor),
        *corrected_tables.build_corrected(analysis, sequence, number + 1, strokes, anchor),
    ]  # fmt: skip
    if failures := report_tables.failure_texts(sequence.all_runs):
        blocks.append(Fold("Runs that did not complete", [Bullets(failures)], f"{anchor}-failures", is_open=True))
    blocks += _build_published(analysis, sequence, strokes, anchor)
    pairs = report_tables.pairs_table(analysis, sequence, strokes)
    if pairs is not None and sequence.pairwise is not None:
        references = " and ".join(sequence.pairwise.references)
        title = f"Paired differences: {sequence.pairwise.metric.label}, every method against {references}"
        blocks.append(Fold(title, [Text(appendix.PAIRS, "note"), pairs], f"{anchor}-pairs"))
    tables = list(report_tables.all_metrics_tables(analysis, sequence, number + 1))
    if tables:
        absent = report_tables.absent_note(list(sequence.rankings.values()))
        blocks.append(Fold("All metrics", [*tables, *absent], f"{anchor}-everything"))
    return blocks


def _build_published(
    analysis: Analysis, sequence: SequenceAnalysis, strokes: Mapping[str, Stroke], anchor: str
) -> list[Block]:
    """Return the published results beside those of this report, or why they are left out; nothing without any."""
    if why := published.explain_no_published(sequence):
        return [Text(why, "note")]
    table = published.published_table(analysis, sequence, strokes)
    if table is None:
        return []
    return [
        Heading("Comparison with published results", f"{anchor}-published"),
        Text("Means over the relations, with the standard deviation as spread. The publications used other sensor "
             "models, priors and loop closures: the table gives a range to expect, not a ranking.", "note"),
        table,
    ]  # fmt: skip


def true_grid(runs: Sequence[RunRecord]) -> OccupancyGrid | None:
    """Return the true map of a sequence, None if it is unknown."""
    return next((run.truth.grid for run in runs if run.truth.grid is not None), None)


def draw_maps(comparison: Comparison, sequence: SequenceAnalysis, strokes: Mapping[str, Stroke]) -> SequenceMaps:
    """Return the maps of each method's first run in a common window, the true one first, then by rank.

    The window holds the maps of the runs that held the track: a map with wrong turns would make all others small.
    """
    first = {label: own[0] for label, own in sequence.runs.items()}
    grids = {label: run.scores.grid for label, run in first.items() if run.scores.grid is not None}
    true = true_grid(list(first.values()))
    held = [grid for label, grid in grids.items() if first[label].scores.lost is None]
    shown = find_window(held or list(grids.values()), true) if grids else None
    if shown is None:
        return SequenceMaps({}, None)
    metric = _map_metric(comparison, list(first.values()))
    scale = (100.0 * shown.scale_bar_m / shown.size_m[0], f"{shown.scale_bar_m:g} m")
    figures = {}
    for label in [*([""] if true is not None else []), *report_tables.by_rank(sequence)]:
        grid = grids.get(label) if label else true
        if grid is not None:
            caption = _map_caption(first[label], metric) if label else ""
            alt = f"Map of {label or 'truth'}, {sequence.label}{f': {caption}' if caption else ''}"
            image = render_map(grid, shown)
            figures[label] = Figure(
                image, label or "truth", caption, "png", measure_image(grid, shown), alt, strokes.get(label), scale
            )
    return SequenceMaps(figures, shown)


def _map_metric(comparison: Comparison, runs: Sequence[RunRecord]) -> Metric | None:
    for group in MAP_CAPTION_GROUPS:
        for metric in comparison.metrics:
            scores = [run.scores.by_metric[metric.name] for run in runs if metric.name in run.scores.by_metric]
            if metric.group == group and metric.headline and any(score.value is not None for score in scores):
                return metric
    return None


def _map_caption(run: RunRecord, metric: Metric | None) -> str:
    parts = []
    score = run.scores.by_metric.get(metric.name) if metric else None
    if metric and score and score.value is not None:
        parts.append(f"{metric.label} {format_amount(metric, score.value)}")
    if not run.result.is_complete:
        parts.append(STATUS_LABELS[run.result.status])
    return ", ".join(parts)
