"""The page: figures, tables and sentences put into one HTML file that needs nothing else."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from jinja2 import Environment, PackageLoader, StrictUndefined

from evalkit.core.grid import OccupancyGrid
from evalkit.metrics.table import Metric
from evalkit.metrics.validated import shipped
from evalkit.report.analysis.analysis import Analysis
from evalkit.report.analysis.comparison import Comparison, SequenceCard
from evalkit.report.analysis.ranking import PairwiseTable
from evalkit.report.analysis.scores import STATUS_LABELS
from evalkit.report.analysis.sequence import SequenceAnalysis
from evalkit.report.analysis.verdict import SequenceVerdict
from evalkit.report.formatting import capitalise, format_bounds, format_number
from evalkit.report.html import figures, view_models
from evalkit.report.html.maps import Window, picture, window
from evalkit.report.html.palette import Stroke, assign_strokes
from evalkit.report.html.player import Player, budget, player
from evalkit.results.run_record import RunRecord

MAP_CAPTION_GROUPS = ("map against truth", "map consistency")


@dataclass(frozen=True, slots=True)
class Picture:
    """An image within the page: a data URI, what it shows for those who cannot see it, and its caption."""

    uri: str
    title: str
    caption: str


@dataclass(frozen=True, slots=True)
class Section:
    """Everything the page shows of one sequence."""

    label: str
    anchor: str
    card: SequenceCard
    verdict: SequenceVerdict
    table: view_models.Table
    pairs: PairwiseTable | None
    drawn: str
    pictures: tuple[Picture, ...]
    player: Player | None
    maps: tuple[Picture, ...]
    map_window: Window | None
    everything: Mapping[str, tuple[view_models.Line, ...]]
    absent: Mapping[str, tuple[str, ...]]
    methods: tuple[str, ...]
    published: tuple[Metric, tuple[view_models.Reference, ...]] | None
    failures: tuple[view_models.Failure, ...]
    notes: Mapping[str, int]
    driven: tuple[tuple[str, str], ...]
    alignments: tuple[str, ...]
    trials: tuple[RunRecord, ...]


def render_report(analysis: Analysis) -> str:
    """The HTML of a whole report."""
    comparison = analysis.comparison
    lines = assign_strokes(comparison.method_labels, comparison.methods_with_role("baseline"))
    environment = Environment(
        loader=PackageLoader("evalkit.report.html"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["sentence"] = capitalise
    environment.filters["figure"] = format_number
    environment.filters["bounds"] = format_bounds
    return environment.get_template("page.html.j2").render(
        comparison=comparison,
        overview=analysis.overview,
        sections=[
            section(comparison, sequence, verdict, number, lines)
            for number, (sequence, verdict) in enumerate(zip(analysis.sequences, analysis.verdicts, strict=True), 1)
        ],
        glance=view_models.glance(analysis),
        evidence=analysis.significance,
        metrics=_by_group(comparison.metrics),
        trust=shipped(),
        strokes=lines,
        places={label: place for place, label in enumerate(comparison.methods, start=1)},
        status=STATUS_LABELS,
        finished=sum(trial.result.is_complete for trial in comparison.records),
    )


def section(
    comparison: Comparison,
    sequence: SequenceAnalysis,
    verdict: SequenceVerdict,
    number: int,
    lines: Mapping[str, Stroke],
) -> Section:
    """One sequence, drawn from each method's first run."""
    grouped, trials = sequence.runs, sequence.all_runs
    first = tuple(own[0] for own in grouped.values())
    grids = [trial.scores.grid for trial in first if trial.scores.grid is not None]
    shown = window(grids, true_grid(first)) if grids else None
    seeds = sorted({trial.seed for trial in first if trial.seed is not None})
    scans, paper = comparison.scans.get(verdict.sequence), next(iter(comparison.methods_with_role("reference")), "")
    return Section(
        label=verdict.sequence,
        anchor=f"sequence-{number}",
        card=sequence.card,
        verdict=verdict,
        table=view_models.headline(sequence),
        pairs=sequence.pairwise,
        drawn=f"seed {seeds[0]} only" if seeds else "the one run of each",
        pictures=tuple(drawings(first, lines)),
        player=player(first, scans, shown, lines, budget(len(comparison.sequences)), paper),
        maps=map_tiles(comparison, first, shown) if shown else (),
        map_window=shown,
        everything=view_models.everything(sequence),
        absent=view_models.absent(sequence),
        methods=tuple(grouped),
        published=view_models.published(sequence),
        failures=view_models.failures(trials),
        notes=view_models.notes(trials),
        driven=sequence.drive,
        alignments=sequence.alignments,
        trials=trials,
    )


def drawings(trials: Sequence[RunRecord], lines: Mapping[str, Stroke]) -> list[Picture]:
    """The figures of a sequence; those without anything to draw are left out."""
    planned = (
        (figures.trajectories, "Trajectories", "Seen from above, aligned to the truth where there is one."),
        (figures.errors, "Error over time", "Distance to the truth; the largest of each stretch, so no peak is lost."),
        (
            figures.runtimes,
            "CPU time per scan",
            "Box: middle half. Bar: median. Whiskers: 5 to 95 %. Dot: longest. Logarithmic axis.",
        ),
        (
            figures.residuals,
            "Registration residuals over time",
            "What each method says of itself, by its own definition. Each point is the median of a stretch.",
        ),
    )
    made = ((draw(trials, lines), title, caption) for draw, title, caption in planned)
    return [
        Picture(_uri("svg+xml", drawing.svg), title, f"{caption} {drawing.admits}".strip())
        for drawing, title, caption in made
        if drawing is not None
    ]


def true_grid(trials: Sequence[RunRecord]) -> OccupancyGrid | None:
    """The true map of a sequence, None where nobody knows it."""
    return next((trial.truth.grid for trial in trials if trial.truth.grid is not None), None)


def map_tiles(comparison: Comparison, trials: Sequence[RunRecord], shown: Window) -> tuple[Picture, ...]:
    """The maps in one window, the true one first."""
    metric = _map_metric(comparison, trials)
    true = true_grid(trials)
    tiles = [Picture(_uri("png", picture(true, shown)), "truth", "")] if true is not None else []
    for trial in trials:
        if trial.scores.grid is not None:
            uri = _uri("png", picture(trial.scores.grid, shown))
            tiles.append(Picture(uri, trial.method, _map_caption(trial, metric)))
    return tuple(tiles)


def _map_metric(comparison: Comparison, trials: Sequence[RunRecord]) -> Metric | None:
    for group in MAP_CAPTION_GROUPS:
        for metric in comparison.metrics:
            scores = [trial.scores.by_metric[metric.name] for trial in trials if metric.name in trial.scores.by_metric]
            if metric.group == group and metric.headline and any(score.value is not None for score in scores):
                return metric
    return None


def _map_caption(trial: RunRecord, metric: Metric | None) -> str:
    parts = []
    score = trial.scores.by_metric.get(metric.name) if metric else None
    if metric and score and score.value is not None:
        parts.append(f"{metric.label} {view_models.printed(metric, score.value)} {metric.unit}".rstrip())
    if not trial.result.is_complete:
        parts.append(STATUS_LABELS[trial.result.status])
    return ", ".join(parts)


def _by_group(metrics: Sequence[Metric]) -> dict[str, list[Metric]]:
    groups: dict[str, list[Metric]] = {}
    for metric in metrics:
        groups.setdefault(metric.group, []).append(metric)
    return groups


def _uri(kind: str, body: bytes) -> str:
    return f"data:image/{kind};base64,{b64encode(body).decode()}"
