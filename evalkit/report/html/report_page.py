"""The page of a report: figures, tables and sentences in one HTML file that loads nothing else."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from evalkit.core.grid import OccupancyGrid
from evalkit.metrics.table import Metric
from evalkit.metrics.validated import load_validation
from evalkit.report.analysis.analysis import Analysis
from evalkit.report.analysis.comparison import Comparison, SequenceCard
from evalkit.report.analysis.ranking import PairwiseTable
from evalkit.report.analysis.scores import STATUS_LABELS
from evalkit.report.analysis.sequence import SequenceAnalysis
from evalkit.report.analysis.verdict import SequenceVerdict
from evalkit.report.formatting import capitalise, format_bounds, format_number
from evalkit.report.html import run_figures, view_models
from evalkit.report.html.blocks import Document, Figure, NavigationLink, load_template
from evalkit.report.html.maps import Window, find_window, render_map
from evalkit.report.html.palette import Stroke, assign_strokes
from evalkit.report.html.player import Player, build_player, ranges_per_sequence
from evalkit.results.run_record import RunRecord

MAP_CAPTION_GROUPS = ("map against truth", "map consistency")


@dataclass(frozen=True, slots=True)
class SequenceSection:
    """Everything that the page shows of one sequence."""

    label: str
    anchor: str
    card: SequenceCard
    verdict: SequenceVerdict
    table: view_models.HeadlineTable
    pairs: PairwiseTable | None
    drawn: str
    pictures: tuple[Figure, ...]
    player: Player | None
    maps: tuple[Figure, ...]
    map_window: Window | None
    everything: Mapping[str, tuple[view_models.MetricRow, ...]]
    absent: Mapping[str, tuple[str, ...]]
    methods: tuple[str, ...]
    published: tuple[Metric, tuple[view_models.PublishedRow, ...]] | None
    failures: tuple[view_models.FailedRuns, ...]
    notes: Mapping[str, int]
    driven: tuple[tuple[str, str], ...]
    alignments: tuple[str, ...]
    runs: tuple[RunRecord, ...]


def render_report(analysis: Analysis) -> str:
    """Return the HTML of a report."""
    comparison = analysis.comparison
    lines = assign_strokes(comparison.method_labels, comparison.methods_with_role("baseline"))
    sections = [
        build_section(comparison, sequence, verdict, number, lines)
        for number, (sequence, verdict) in enumerate(zip(analysis.sequences, analysis.verdicts, strict=True), 1)
    ]
    finished = sum(record.result.is_complete for record in comparison.records)
    facts = (
        ("Methods", str(len(comparison.method_labels))),
        ("Sequences", str(len(sections))),
        ("Runs finished", f"{finished} of {len(comparison.records)}"),
        ("Finished", comparison.finished.strftime("%Y-%m-%d %H:%M")),
    )
    links = [NavigationLink(title.lower(), title) for title in ("Summary", "Results")]
    links += [NavigationLink(section.anchor, section.label, minor=True) for section in sections]
    links += [NavigationLink(title.lower(), title) for title in ("Metrics", "Methods", "Data", "Provenance")]
    template = load_template("report.html.j2", sentence=capitalise, figure=format_number, bounds=format_bounds)
    return template.render(
        document=Document("evalkit report", comparison.title, comparison.description, (), facts),
        links=links,
        comparison=comparison,
        overview=analysis.overview,
        sections=sections,
        glance=view_models.build_glance(analysis),
        evidence=analysis.significance,
        metrics=_by_group(comparison.metrics),
        validation=load_validation(),
        strokes=lines,
        places={label: place for place, label in enumerate(comparison.methods, start=1)},
        status=STATUS_LABELS,
    )


def build_section(
    comparison: Comparison,
    sequence: SequenceAnalysis,
    verdict: SequenceVerdict,
    number: int,
    lines: Mapping[str, Stroke],
) -> SequenceSection:
    """Return the section of a sequence; its figures show each method's first run."""
    grouped, runs = sequence.runs, sequence.all_runs
    first = tuple(own[0] for own in grouped.values())
    grids = [run.scores.grid for run in first if run.scores.grid is not None]
    shown = find_window(grids, true_grid(first)) if grids else None
    seeds = sorted({run.seed for run in first if run.seed is not None})
    scans, paper = comparison.scans.get(verdict.sequence), next(iter(comparison.methods_with_role("reference")), "")
    return SequenceSection(
        label=verdict.sequence,
        anchor=f"sequence-{number}",
        card=sequence.card,
        verdict=verdict,
        table=view_models.build_headline(sequence),
        pairs=sequence.pairwise,
        drawn=f"seed {seeds[0]} only" if seeds else "the single run of each method",
        pictures=tuple(draw_figures(first, lines)),
        player=build_player(first, scans, shown, lines, ranges_per_sequence(len(comparison.sequences)), paper),
        maps=map_tiles(comparison, first, shown) if shown else (),
        map_window=shown,
        everything=view_models.build_all_metrics(sequence),
        absent=view_models.find_absent(sequence),
        methods=tuple(grouped),
        published=view_models.build_published(sequence),
        failures=view_models.group_failures(runs),
        notes=view_models.count_notes(runs),
        driven=sequence.drive,
        alignments=sequence.alignments,
        runs=runs,
    )


def draw_figures(runs: Sequence[RunRecord], lines: Mapping[str, Stroke]) -> list[Figure]:
    """Return the figures of a sequence that have content."""
    planned = (
        (
            run_figures.draw_trajectories,
            "Trajectories",
            "View from above, aligned to the ground truth if there is one.",
        ),
        (
            run_figures.draw_errors,
            "Error over time",
            "Distance to the ground truth; each point is the maximum of a stretch.",
        ),
        (
            run_figures.draw_runtimes,
            "CPU time per scan",
            "Box: 25 to 75 %. Bar: median. Whiskers: 5 to 95 %. Dot: maximum. Logarithmic axis.",
        ),
        (
            run_figures.draw_residuals,
            "Registration residuals over time",
            "As reported by each method, by its own definition. Each point is the median of a stretch.",
        ),
    )
    drawn = ((draw(runs, lines), title, caption) for draw, title, caption in planned)
    return [
        Figure(figure.svg, title, f"{caption} {figure.remark}".strip())
        for figure, title, caption in drawn
        if figure is not None
    ]


def true_grid(runs: Sequence[RunRecord]) -> OccupancyGrid | None:
    """Return the true map of a sequence, None if it is unknown."""
    return next((run.truth.grid for run in runs if run.truth.grid is not None), None)


def map_tiles(comparison: Comparison, runs: Sequence[RunRecord], shown: Window) -> tuple[Figure, ...]:
    """Return the maps in a common window, the true one first."""
    metric = _map_metric(comparison, runs)
    true = true_grid(runs)
    tiles = [Figure(render_map(true, shown), "truth", media="png")] if true is not None else []
    for run in runs:
        if run.scores.grid is not None:
            image = render_map(run.scores.grid, shown)
            tiles.append(Figure(image, run.method, _map_caption(run, metric), "png"))
    return tuple(tiles)


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
        parts.append(f"{metric.label} {view_models.format_value(metric, score.value)} {metric.unit}".rstrip())
    if not run.result.is_complete:
        parts.append(STATUS_LABELS[run.result.status])
    return ", ".join(parts)


def _by_group(metrics: Sequence[Metric]) -> dict[str, list[Metric]]:
    groups: dict[str, list[Metric]] = {}
    for metric in metrics:
        groups.setdefault(metric.group, []).append(metric)
    return groups
