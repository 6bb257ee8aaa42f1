"""The dot plot of a report: methods by rank in rows, data sets in columns, each error with its interval."""

from __future__ import annotations

import math
from dataclasses import dataclass
from statistics import median

from markupsafe import Markup

from evalkit.core.run_status import RunStatus
from evalkit.report.analysis.analysis import Analysis
from evalkit.report.analysis.contests import Contest
from evalkit.report.analysis.ranking import Ranking, mark
from evalkit.report.analysis.scores import STATUS_LABELS, MethodScore, find_loss
from evalkit.report.analysis.sequence import SequenceAnalysis
from evalkit.report.formatting import format_amount, format_loss, format_losses, format_tick
from evalkit.report.html.method_colours import Strokes
from evalkit.report.html.svg import AxisScale, element, join, log_scale

ROW = 22
"""Height of a row of the dot plot (px)."""

TICKS_PX, LETTER_PX = 560.0, 7.6
"""Width of all columns on a usual screen, and of a letter of their labels."""

DIGITS = (
    (1.0, 2.0, 5.0), tuple(range(1, 10)), tuple(0.5 * n for n in range(2, 20)), tuple(0.1 * n for n in range(10, 100)),
)  # fmt: skip
"""Digits of labelled values, round ones first."""

MIN_APART = 0.55
"""Share of the width that lies at least between the two labelled values."""

USED = 0.86
"""Share of the width of a column between the smallest and the largest value."""

REACH = 4.0
"""An interval that reaches further than this factor beyond all values is cut, with an arrow at its end."""

CUT_LEFT, CUT_RIGHT = "M4 -4L0 0L4 4", "M-4 -4L0 0L-4 4"

SHAPES = {"tuned": "M0 -5.5L5.5 0L0 5.5L-5.5 0Z", "lost": "M-4 -4L4 4M-4 4L4 -4"}
"""Marks that are no circles: settings chosen there, track lost."""

TOO_FEW, OUTVOTED = "too few runs to tell it from the best", "not tied in every map metric"
"""Why a method has no verdict."""


def draw_dots(analysis: Analysis, strokes: Strokes) -> Markup | None:
    """Return the dot plot: methods by rank in rows, data sets in columns; None without a value."""
    answer = analysis.answer
    contests = {one.sequence: one for one in answer.contests}
    shown = [s for s in analysis.sequences if s.deciding is not None and not s.card.degenerate]
    if not shown:
        return None
    panels = [_panel(sequence, contests.get(sequence.label), TICKS_PX / len(shown)) for sequence in shown]
    standings = [one for one in answer.standings if one.method not in analysis.comparison.missing_methods]
    last = len(standings) + 2
    heads = [_cell("columnheader", 0, 1, element("span", "Method", class_="unseen"), "corner")]
    heads += [_cell("columnheader", at, 1, _head(one), "head") for at, one in enumerate(panels, 1)]
    heads.append(_cell("columnheader", len(panels) + 1, 1, "best or tied" if contests else "", "count"))
    rows = [element("div", join(heads), role="row", class_="dots-row")]
    for place, standing in enumerate(standings, start=2):
        own = [_cell("rowheader", 0, place, standing.method, "who")]
        own += [_cell("cell", at, place, _dot(panel, standing.method), "panel") for at, panel in enumerate(panels, 1)]
        led = f"{standing.led}/{standing.counted}" if standing.counted else "–"
        own.append(_cell("cell", len(panels) + 1, place, led if contests else "", "count"))
        leads = " led" if standing.method in answer.ahead else ""
        css = strokes[standing.method].css
        rows.append(
            element("div", join(own), role="row", class_=f"dots-row series{leads}", data_of=standing.method,
                    style=f"--own:{css}")
        )  # fmt: skip
    ticks = join(_cell("cell", at, last, _ticks(panel), "panel foot") for at, panel in enumerate(panels, 1))
    rows.append(element("div", ticks, role="row", class_="dots-row", aria_hidden="true"))
    style = f"--panels:{len(panels)};--rows:{last}"
    kind = "dots" if contests else "dots uncounted"
    return element("div", join(rows), role="table", class_=kind, style=style, aria_label=_describe_dots(analysis))


@dataclass(frozen=True, slots=True)
class _Panel:
    """One column of the dot plot. ``ticks``: labelled values on its scale."""

    sequence: str
    ranking: Ranking
    contest: Contest | None
    scale: AxisScale
    runs: SequenceAnalysis
    width_px: float
    ticks: tuple[float, ...]


def _panel(sequence: SequenceAnalysis, contest: Contest | None, width_px: float) -> _Panel:
    ranking = sequence.deciding
    if ranking is None:
        raise ValueError(f"{sequence.label}: no metric has a value")
    medians = [median(score.values) for score in ranking.scores if score.values]
    low, high = min(medians) / REACH, max(medians) * REACH
    spreads = [score.spread for score in ranking.scores if score.spread is not None]
    ends = [min(max(end, low), high) for spread in spreads for end in (spread.low, spread.high)]
    scale = log_scale([*medians, *ends])
    return _Panel(sequence.label, ranking, contest, scale, sequence, width_px, _choose_ticks(scale))


def _choose_ticks(scale: AxisScale) -> tuple[float, ...]:
    """Return two values far apart, as round as possible: they tell the scale of a column."""
    powers = range(math.floor(math.log10(scale.low)), math.ceil(math.log10(scale.high)) + 1)
    for digits in DIGITS:
        values = (float(f"{digit * 10.0**power:.2g}") for power in powers for digit in digits)
        inside = sorted(value for value in values if scale.low <= value <= scale.high)
        if inside and scale.share(inside[-1]) - scale.share(inside[0]) >= MIN_APART:
            return inside[0], inside[-1]
    return scale.ticks(1)


def _label(panel: _Panel, tick: float) -> str:
    """Return a round value with its unit."""
    unit = panel.ranking.metric.unit
    return format_tick(tick) if unit == "m" else f"{tick:g} {unit}".strip()


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
    bounds = (score.spread.low, score.spread.high) if score.spread else (median(score.values),) * 2
    low, high = (_percent(panel.scale.share(bound)) for bound in bounds)
    parts.append(element("line", x1=low, x2=high, y1=ROW / 2, y2=ROW / 2, class_="span"))
    for end, shape in ((bounds[0], CUT_LEFT), (bounds[1], CUT_RIGHT)):
        if not panel.scale.low <= end <= panel.scale.high:
            arrow = element("path", d=shape, class_="span cut")
            at_end = _percent(panel.scale.share(end))
            parts.append(element("svg", arrow, x=at_end, y=ROW / 2, overflow="visible"))
    if kind in SHAPES:
        shape = element("path", d=SHAPES[kind], class_=f"dot {kind}")
        parts.append(element("svg", shape, x=_percent(at), y=ROW / 2, overflow="visible"))
    else:
        parts.append(element("circle", cx=_percent(at), cy=ROW / 2, r=4.6, class_=f"dot {kind}"))
    value = format_amount(panel.ranking.metric, median(score.values))
    title = element("title", f"{method} on {panel.sequence}: {value}, {words}")
    drawing = element("svg", join((title, *parts)), width="100%", height=ROW, role="img")
    beside = f"{value} lost" if kind == "lost" else value
    return join((name, drawing, element("span", beside, class_="own-value", aria_hidden="true")))


def _mark(panel: _Panel, score: MethodScore) -> tuple[str, str]:
    """Return what a score is on a data set, in words and as the class of its dot."""
    tuned = "settings chosen here: not counted"
    if score.lost is not None:
        return f"lost the track {format_losses(score)}{f'; {tuned}' if score.tuned else ''}", "lost"
    if score.tuned:
        return tuned, "tuned"
    if len(panel.ranking.ranked) == 1 and panel.contest is not None and score.method in panel.contest.leaders:
        return "the only one ranked", "tied"
    words = {
        "best": ("best", "tied"), "tied": ("tied with the best", "tied"), "worse": ("worse than the best", ""),
        "undecided": (OUTVOTED if score.method in panel.ranking.outvoted else TOO_FEW, "unranked"),
        "not comparable": ("not comparable", "unranked"),
    }  # fmt: skip
    return words[mark(panel.ranking, score.method)]


def _explain(panel: _Panel, method: str) -> str:
    """Return in a word or two why there is no value."""
    runs = panel.runs.runs.get(method, ())
    lost = find_loss(runs)
    if lost is not None:
        return format_loss(lost)
    broken = [run for run in runs if not run.result.is_complete]
    if broken and broken[0].result.status == RunStatus.DATA_MISSING:
        return "no input"  # the sequence exists for others
    return STATUS_LABELS[broken[0].result.status] if broken else "no value" if runs else "not run"


def _ticks(panel: _Panel) -> Markup:
    spans = [
        element("span", _label(panel, tick), class_=f"tick {_anchor(panel, tick)}".strip(),
                style=f"left:{_percent(panel.scale.share(tick))}")
        for tick in panel.ticks
    ]  # fmt: skip
    return element("span", join(spans), class_="ticks")


def _anchor(panel: _Panel, tick: float) -> str:
    """Return on which side of its tick a label begins or ends, so that it stays within its column."""
    half = 0.5 * LETTER_PX * len(_label(panel, tick)) / panel.width_px
    share = 0.5 - 0.5 * USED + USED * panel.scale.share(tick)
    return "first" if share < half else "last" if share > 1.0 - half else ""


def _percent(share: float) -> str:
    return f"{100.0 * (0.5 - 0.5 * USED + USED * share):.1f}%"


def _describe_dots(analysis: Analysis) -> str:
    first = analysis.answer.standings[0]
    led = f"{first.led} of {first.counted}"
    return f"Methods by data sets, error with its interval: {first.method} is best or tied on {led}"
