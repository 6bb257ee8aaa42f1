"""The page: figures, tables and sentences put into one HTML file that needs nothing else."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from jinja2 import Environment, PackageLoader, StrictUndefined

from evalkit.core.grid import OccupancyGrid
from evalkit.metrics.table import Metric
from evalkit.metrics.validated import shipped
from evalkit.report.analysis.comparison import Comparison, SequenceCard
from evalkit.report.analysis.driven_paths import alignments, driven
from evalkit.report.analysis.pairwise import Pairs, pairs
from evalkit.report.analysis.significance import evidence
from evalkit.report.analysis.standings import STATUS, method_of
from evalkit.report.analysis.verdict import Verdict
from evalkit.report.html import figures, view_models
from evalkit.report.html.formatting import bounds, figure
from evalkit.report.html.maps import Window, picture, window
from evalkit.report.html.palette import Stroke, strokes
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
    verdict: Verdict
    table: view_models.Table
    pairs: Pairs | None
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
    records: tuple[RunRecord, ...]


def render(comparison: Comparison, overview: Sequence[str], verdicts: Sequence[Verdict]) -> str:
    """The HTML of a whole report."""
    lines = strokes(comparison.method_labels, method_of(comparison, "baseline"))
    environment = Environment(
        loader=PackageLoader("evalkit.report.html"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["sentence"] = sentence
    environment.filters["figure"] = figure
    environment.filters["bounds"] = bounds
    return environment.get_template("page.html.j2").render(
        comparison=comparison,
        overview=overview,
        sections=[section(comparison, verdict, number, lines) for number, verdict in enumerate(verdicts, start=1)],
        glance=view_models.glance(comparison),
        evidence=evidence(comparison),
        metrics=_by_group(comparison.metrics),
        trust=shipped(),
        strokes=lines,
        places={label: place for place, label in enumerate(comparison.methods, start=1)},
        status=STATUS,
        finished=sum(record.result.is_complete for record in comparison.records),
    )


def sentence(text: str) -> str:
    """The text with a capital first letter, the rest untouched."""
    return text[:1].upper() + text[1:]


def section(comparison: Comparison, verdict: Verdict, number: int, lines: Mapping[str, Stroke]) -> Section:
    """One sequence, drawn from each method's first run."""
    grouped = comparison.by_method(verdict.sequence)
    records = tuple(record for own in grouped.values() for record in own)
    first = tuple(own[0] for own in grouped.values())
    grids = [record.scores.grid for record in first if record.scores.grid is not None]
    shown = window(grids, true_grid(first)) if grids else None
    seeds = sorted({record.seed for record in first if record.seed is not None})
    scans, paper = comparison.scans.get(verdict.sequence), next(iter(method_of(comparison, "reference")), "")
    return Section(
        label=verdict.sequence,
        anchor=f"sequence-{number}",
        card=comparison.sequences[verdict.sequence],
        verdict=verdict,
        table=view_models.headline(comparison, verdict.sequence),
        pairs=pairs(comparison, verdict.sequence),
        drawn=f"seed {seeds[0]} only" if seeds else "the one run of each",
        pictures=tuple(drawings(first, lines)),
        player=player(first, scans, shown, lines, budget(len(comparison.sequences)), paper),
        maps=map_tiles(comparison, first, shown) if shown else (),
        map_window=shown,
        everything=view_models.everything(comparison, verdict.sequence),
        absent=view_models.absent(comparison, verdict.sequence),
        methods=tuple(grouped),
        published=view_models.published(comparison, verdict.sequence),
        failures=view_models.failures(records),
        notes=view_models.notes(records),
        driven=driven(comparison, verdict.sequence),
        alignments=alignments(records),
        records=records,
    )


def drawings(records: Sequence[RunRecord], lines: Mapping[str, Stroke]) -> list[Picture]:
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
    made = ((draw(records, lines), title, caption) for draw, title, caption in planned)
    return [
        Picture(_uri("svg+xml", drawing.svg), title, f"{caption} {drawing.admits}".strip())
        for drawing, title, caption in made
        if drawing is not None
    ]


def true_grid(records: Sequence[RunRecord]) -> OccupancyGrid | None:
    """The true map of a sequence, None where nobody knows it."""
    return next((record.truth.grid for record in records if record.truth.grid is not None), None)


def map_tiles(comparison: Comparison, records: Sequence[RunRecord], shown: Window) -> tuple[Picture, ...]:
    """The maps in one window, the true one first."""
    metric = _map_metric(comparison, records)
    true = true_grid(records)
    tiles = [Picture(_uri("png", picture(true, shown)), "truth", "")] if true is not None else []
    for record in records:
        if record.scores.grid is not None:
            uri = _uri("png", picture(record.scores.grid, shown))
            tiles.append(Picture(uri, record.method, _map_caption(record, metric)))
    return tuple(tiles)


def _map_metric(comparison: Comparison, records: Sequence[RunRecord]) -> Metric | None:
    for group in MAP_CAPTION_GROUPS:
        for metric in comparison.metrics:
            scores = [
                record.scores.by_metric[metric.name] for record in records if metric.name in record.scores.by_metric
            ]
            if metric.group == group and metric.headline and any(score.value is not None for score in scores):
                return metric
    return None


def _map_caption(record: RunRecord, metric: Metric | None) -> str:
    parts = []
    score = record.scores.by_metric.get(metric.name) if metric else None
    if metric and score and score.value is not None:
        parts.append(f"{metric.label} {view_models.printed(metric, score.value)} {metric.unit}".rstrip())
    if not record.result.is_complete:
        parts.append(STATUS[record.result.status])
    return ", ".join(parts)


def _by_group(metrics: Sequence[Metric]) -> dict[str, list[Metric]]:
    groups: dict[str, list[Metric]] = {}
    for metric in metrics:
        groups.setdefault(metric.group, []).append(metric)
    return groups


def _uri(kind: str, body: bytes) -> str:
    return f"data:image/{kind};base64,{b64encode(body).decode()}"
