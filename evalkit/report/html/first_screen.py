"""The first screen of a report: maps of the hardest recording, methods by data sets, and error against CPU time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from statistics import median
from urllib.parse import quote

import numpy as np
from markupsafe import Markup

from evalkit.core.run_result import RunStatus
from evalkit.metrics.runtime import period_ns
from evalkit.report.analysis.analysis import Analysis
from evalkit.report.analysis.answer import COST, Contest, Standing
from evalkit.report.analysis.pills import find_left_out
from evalkit.report.analysis.ranking import Ranking, mark
from evalkit.report.analysis.scores import STATUS_LABELS, MethodScore, find_loss
from evalkit.report.analysis.sequence import SequenceAnalysis
from evalkit.report.formatting import format_milliseconds, format_quantity, format_tick
from evalkit.report.html.blocks import Figure
from evalkit.report.html.maps import find_window, measure_image, render_map
from evalkit.report.html.palette import Stroke
from evalkit.report.html.svg import Scale, element, join, log_scale, place_labels

Strokes = Mapping[str, Stroke]
MAX_TILES = 4
ROW = 22
"""Height of a row of the dot plot (px)."""

SHAPES = {"tuned": "M0 -5.5L5.5 0L0 5.5L-5.5 0Z", "lost": "M-4 -4L4 4M-4 4L4 -4"}
"""Marks that are no circles: settings chosen there, track lost."""

SCATTER = (360.0, 296.0)
PLOT = (34.0, 8.0, 350.0, 252.0)
"""Size of the scatter plot, and left, top, right and bottom of its frame."""


@dataclass(frozen=True, slots=True)
class Tile:
    """One map of the strip: the method's map on the hardest recording. ``role``: why it is shown."""

    method: str
    role: str
    figure: Figure
    caption: str
    link: str
    stroke: Stroke


def find_hardest(analysis: Analysis) -> int | None:
    """Return the index of the sequence whose maps differ most: recordings before simulations, then counted ones."""
    counted = {one.sequence: one for one in analysis.answer.contests}
    found: list[tuple[bool, bool, float, int]] = []
    for number, sequence in enumerate(analysis.sequences):
        drawn = [own[0] for own in sequence.runs.values() if own[0].scores.grid is not None]
        if len(drawn) < 2 or sequence.deciding is None or sequence.card.degenerate:
            continue
        values = [max(median(score.values), 1e-9) for score in sequence.deciding.scores if score.values]
        spread = max(values) / min(values) if values else 0.0
        found.append(
            (not sequence.card.settings or drawn[0].truth.grid is None, sequence.label in counted, spread, -number)
        )
    return -max(found)[-1] if found else None


def choose_tiles(analysis: Analysis, sequence: SequenceAnalysis) -> list[tuple[str, str]]:
    """Return method and role of each map, best first: the answer, the best peer, the baseline, the worst, others."""
    comparison, ranking = analysis.comparison, sequence.deciding
    if ranking is None:
        return []
    drawn = {label for label, own in sequence.runs.items() if own[0].scores.grid is not None}
    drawn -= set(find_left_out(comparison, sequence))
    valued = [score for score in ranking.scores if score.values and score.method in drawn]
    sign = -1.0 if ranking.metric.better == "higher" else 1.0
    ordered = [score.method for score in sorted(valued, key=lambda score: sign * median(score.values))]
    winners = [method for method in ordered if method in analysis.answer.winners]
    wanted = (
        *([("answer", [winner]) for winner in winners[:2]] or [("best here", ordered)]),
        ("worst", ordered[::-1]),
        ("best peer", [method for method in ordered if comparison.methods[method].role == "peer"]),
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


def build_tiles(analysis: Analysis, number: int, strokes: Strokes) -> list[Tile]:
    """Return the map strip of a sequence, best first: each map in the window of the first one."""
    sequence = analysis.sequences[number]
    ranking, tiles = sequence.deciding, []
    chosen = choose_tiles(analysis, sequence)
    grids = {method: grid for method, _ in chosen if (grid := sequence.runs[method][0].scores.grid) is not None}
    shown = find_window([grids[chosen[0][0]]]) if chosen else None
    if shown is None:
        return []
    for method, role in chosen:
        grid = grids[method]
        score = ranking.of(method) if ranking else None
        value = format_quantity(ranking.metric, median(score.values)) if ranking and score and score.values else ""
        cost = sequence.rankings[COST].of(method) if COST in sequence.rankings else None
        times = format_milliseconds(cost.median) if cost is not None and cost.median is not None else ""
        lost = f"lost at {score.lost.at_s:.0f} s" if score is not None and score.lost is not None else ""
        caption = " · ".join(filter(None, (value, lost or times)))
        has_player = any(len(run.result.steps) for run in sequence.runs[method])
        anchor = f"sequence-{number + 1}"
        link = f"#{anchor}-player?by={quote(method)}&on=own&play=1" if has_player else f"#{anchor}"
        image = Figure(render_map(grid, shown), method, media="png", size=measure_image(grid, shown))
        tiles.append(Tile(method, role, image, caption, link, strokes[method]))
    return tiles


def draw_dots(analysis: Analysis, strokes: Strokes) -> Markup | None:
    """Return the dot plot: methods by rank in rows, data sets in columns; None without a value."""
    answer = analysis.answer
    contests = {one.sequence: one for one in answer.contests}
    shown = [s for s in analysis.sequences if s.deciding is not None and not s.card.degenerate]
    if not shown:
        return None
    panels = [_panel(sequence, contests.get(sequence.label)) for sequence in shown]
    last = len(answer.standings) + 2
    heads = [_cell("columnheader", 0, 1, element("span", "Method", class_="unseen"), "corner")]
    heads += [_cell("columnheader", at, 1, _head(one), "head") for at, one in enumerate(panels, 1)]
    heads.append(_cell("columnheader", len(panels) + 1, 1, "best or tied" if contests else "", "count"))
    rows = [element("div", join(heads), role="row", class_="dots-row")]
    for place, standing in enumerate(answer.standings, start=2):
        own = [_cell("rowheader", 0, place, standing.method, "who")]
        own += [_cell("cell", at, place, _dot(panel, standing.method), "panel") for at, panel in enumerate(panels, 1)]
        led = f"{standing.led}/{standing.counted}" if standing.counted else "–"
        own.append(_cell("cell", len(panels) + 1, place, led if contests else "", "count"))
        leads = " led" if standing.method in answer.winners else ""
        css = strokes[standing.method].css
        rows.append(
            element("div", join(own), role="row", class_=f"dots-row series{leads}", data_of=standing.method,
                    style=f"--own:{css}")
        )  # fmt: skip
    ticks = join(_cell("cell", at, last, _ticks(panel), "panel foot") for at, panel in enumerate(panels, 1))
    rows.append(element("div", ticks, role="row", class_="dots-row", aria_hidden="true"))
    style = f"--panels:{len(panels)};--rows:{last}"
    return element("div", join(rows), role="table", class_="dots", style=style, aria_label=_describe_dots(analysis))


@dataclass(frozen=True, slots=True)
class _Panel:
    """One column of the dot plot."""

    sequence: str
    ranking: Ranking
    contest: Contest | None
    scale: Scale
    runs: SequenceAnalysis

    @property
    def ticks(self) -> tuple[float, ...]:
        """At most two round values, far enough apart for their labels."""
        found = self.scale.ticks(2)
        near = len(found) > 1 and self.scale.share(found[-1]) - self.scale.share(found[0]) < 0.36
        return found[:1] if near else found


def _panel(sequence: SequenceAnalysis, contest: Contest | None) -> _Panel:
    ranking = sequence.deciding
    if ranking is None:
        raise ValueError(f"{sequence.label}: no metric has a value")
    values = [median(score.values) for score in ranking.scores if score.values]
    return _Panel(sequence.label, ranking, contest, log_scale(values), sequence)


def _head(panel: _Panel) -> Markup:
    """Return the name of a data set, and in a word or two why it does not count."""
    name = element("b", panel.sequence)
    if panel.contest is not None:
        return name
    why = "one run" if panel.ranking.comparable and not panel.ranking.repeated else "not counted"
    return join((name, Markup(" "), element("span", why, class_="tick")))


def _cell(role: str, column: int, row: int, content: object, kind: str) -> Markup:
    return element("div", content, role=role, class_=kind, style=f"--c:{column};--r:{row}")


def _dot(panel: _Panel, method: str) -> Markup:
    """Return name (for narrow screens), drawing and words of one method on one data set."""
    score = panel.ranking.of(method)
    name = element("span", method, class_="own-name", aria_hidden="true")
    if score is None or not score.values:
        why = _explain(panel, method)
        return join((name, element("span", why, class_="why")))
    words, kind = _mark(panel, score)
    at = panel.scale.share(median(score.values))
    parts = [
        element("line", x1=_percent(panel.scale.share(tick)), x2=_percent(panel.scale.share(tick)), y1=0, y2=ROW,
                class_="grid")
        for tick in panel.ticks
    ]  # fmt: skip
    spread = score.band or score.interval
    bounds = (spread.low, spread.high) if spread else (min(score.values), max(score.values))
    low, high = (_percent(panel.scale.share(bound)) for bound in bounds)
    parts.append(element("line", x1=low, x2=high, y1=ROW / 2, y2=ROW / 2, class_="span"))
    if kind in SHAPES:
        shape = element("path", d=SHAPES[kind], class_=f"dot {kind}")
        parts.append(element("svg", shape, x=_percent(at), y=ROW / 2, overflow="visible"))
    else:
        parts.append(element("circle", cx=_percent(at), cy=ROW / 2, r=4.6, class_=f"dot {kind}"))
    value = format_quantity(panel.ranking.metric, median(score.values))
    title = element("title", f"{method} on {panel.sequence}: {value}, {words}")
    drawing = element("svg", join((title, *parts)), width="100%", height=ROW, role="img")
    return join((name, drawing, element("span", value, class_="own-value", aria_hidden="true")))


def _mark(panel: _Panel, score: MethodScore) -> tuple[str, str]:
    """Return what a score is on a data set, in words and as the class of its dot."""
    if score.tuned:
        return "settings chosen here: not counted", "tuned"
    words = {
        "best": ("best", "tied"), "tied": ("tied with the best", "tied"), "worse": ("worse than the best", ""),
        "lost": ("lost the track", "lost"), "not comparable": ("not comparable", "unranked"),
    }  # fmt: skip
    return words[mark(panel.ranking, score.method)]


def _explain(panel: _Panel, method: str) -> str:
    """Return in a word or two why there is no value."""
    runs = panel.runs.runs.get(method, ())
    lost = find_loss(runs)
    if lost is not None:
        return f"lost at {lost.at_s:.0f} s"
    broken = [run for run in runs if not run.result.is_complete]
    if broken and broken[0].result.status == RunStatus.DATA_MISSING:
        return "no input"  # the sequence exists for others
    return STATUS_LABELS[broken[0].result.status] if broken else "no value" if runs else "not run"


def _ticks(panel: _Panel) -> Markup:
    unit = panel.ranking.metric.unit
    texts = [format_tick(tick) if unit == "m" else f"{tick:g} {unit}".strip() for tick in panel.ticks]
    spans = [
        element("span", text, class_="tick", style=f"left:{_percent(panel.scale.share(tick))}")
        for tick, text in zip(panel.ticks, texts, strict=True)
    ]
    return element("span", join(spans), class_="ticks")


def _percent(share: float) -> str:
    return f"{7.0 + 86.0 * share:.1f}%"


def _describe_dots(analysis: Analysis) -> str:
    first = analysis.answer.standings[0]
    return f"Methods by data sets, error with its interval: {first.method} leads {first.led} of {first.counted}"


def draw_scatter(analysis: Analysis, strokes: Strokes) -> Markup | None:
    """Return error against CPU time, with the Pareto front and the sensor's period; None with fewer than two points."""
    points = [one for one in analysis.answer.standings if one.ratio is not None and one.cpu_ms is not None]
    if len(points) < 2:
        return None
    period = _find_period_ms(analysis)
    costs = [one.cpu_ms or 0.0 for one in points]
    near = period is not None and period < 300.0 * max(costs)
    x = log_scale([*costs, *([period] if period is not None and near else [])], 0.12)
    y = log_scale([1.0, *(one.ratio or 1.0 for one in points)], 0.1)
    left, top, right, bottom = PLOT
    place = {
        one.method: (
            left + (right - left) * x.share(one.cpu_ms or 0.0), top + (bottom - top) * y.share(one.ratio or 1.0)
        )
        for one in points
    }  # fmt: skip
    parts = [element("rect", x=left, y=top, width=right - left, height=bottom - top, class_="frame"), *_grid(x, y)]
    front = _find_front(points)
    steps = " ".join(f"{place[one.method][0]:.1f},{place[one.method][1]:.1f}" for one in front)
    parts.append(element("polyline", points=steps, class_="front"))
    if period is not None and near:
        at = left + (right - left) * x.share(period)
        parts.append(element("line", x1=at, x2=at, y1=top, y2=bottom, class_="limit"))
        words = f"a scan every {format_milliseconds(period)}"
        parts.append(element("text", words, x=at - 4, y=bottom - 6, text_anchor="end", class_="tick"))
    labels = place_labels([(*place[one.method], one.method) for one in points], (right, bottom), 6.2, 9.0)
    for one in reversed(points):  # the best on top
        px, py = place[one.method]
        kind = f"series{' led' if one.method in analysis.answer.winners else ''}"
        label = labels.get(one.method, (px, py - 9.0, "middle"))
        hidden = "" if one.method in labels else "hinted"
        tip = f"{one.method}: {one.ratio:.1f} times the best error, {format_milliseconds(one.cpu_ms or 0.0)} a scan"
        own = (
            element("title", tip),
            element("circle", cx=px, cy=py, r=5.0, class_="dot tied"),
            element("text", one.method, x=label[0], y=label[1], text_anchor=label[2], class_=f"name {hidden}".strip()),
        )
        parts.append(element("g", join(own), class_=kind, data_of=one.method, style=f"--own:{strokes[one.method].css}"))
    parts.append(
        element("text", "CPU a scan (median)", x=(left + right) / 2, y=SCATTER[1] - 8, text_anchor="middle",
                class_="tick")
    )  # fmt: skip
    names = ", ".join(one.method for one in front)
    finding = f"Error against CPU time: no method is both cheaper and more accurate than {names}"
    size = f"0 0 {SCATTER[0]:.0f} {SCATTER[1]:.0f}"
    return element("svg", join(parts), class_="scatter", viewBox=size, role="img", aria_label=finding)


def _grid(x: Scale, y: Scale) -> list[Markup]:
    left, top, right, bottom = PLOT
    parts = []
    for tick in x.ticks(4):
        at = left + (right - left) * x.share(tick)
        parts.append(element("line", x1=at, x2=at, y1=top, y2=bottom, class_="grid"))
        parts.append(element("text", f"{tick:g} ms", x=at, y=bottom + 15, text_anchor="middle", class_="tick"))
    for tick in y.ticks(4):
        at = top + (bottom - top) * y.share(tick)
        parts.append(element("line", x1=left, x2=right, y1=at, y2=at, class_="grid"))
        parts.append(element("text", f"{tick:g}×", x=left - 5, y=at + 4, text_anchor="end", class_="tick"))
    return parts


def _find_front(points: Sequence[Standing]) -> list[Standing]:
    """Return the points that no other beats in both, by rising cost."""
    front: list[Standing] = []
    for one in sorted(points, key=lambda one: (one.cpu_ms or 0.0, one.ratio or 0.0)):
        if not front or (one.ratio or 0.0) < (front[-1].ratio or 0.0):
            front.append(one)
    return front


def _find_period_ms(analysis: Analysis) -> float | None:
    """Return the shortest period of the sensors of the data sets that count."""
    counted = {one.sequence for one in analysis.answer.contests}
    periods = [
        period_ns(run.result) * 1e-6
        for run in analysis.comparison.records
        if run.sequence in counted and len(run.result.steps) > 1
    ]
    return float(np.min(periods)) if periods else None
