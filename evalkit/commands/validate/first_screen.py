"""The first screen of an acceptance page: the stamp, and one bar from the measured difference to the allowed one."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import islice
from typing import Any

from markupsafe import Markup

from evalkit.commands.validate.acceptance import AcceptanceReport
from evalkit.commands.validate.charts import map_figures
from evalkit.commands.validate.equivalence.lockstep import DISTURBED
from evalkit.commands.validate.known_motion import noise_level
from evalkit.report.html.blocks import Figure
from evalkit.report.html.svg import element, join

GOOD, BAD, OPEN, NEUTRAL = ("#1a7f45", "#b42318", "#9a6700", "#5b6672")
FONT = "system-ui, sans-serif"
LOW, HIGH = -16.0, 0.0
"""Ends of the bar: powers of ten of a metre."""

WIDTH, LEFT, RIGHT = 460.0, 30.0, 430.0


def first_figures(report: AcceptanceReport) -> tuple[list[Figure], list[Figure]]:
    """The stamp with the bar, and both maps with their difference: two rows, of what really ran."""
    above = [_stamp(report)]
    levels = {level.number: level for level in report.levels}
    compared = [
        check.data
        for level in (levels.get(1), levels.get(2)) if level
        for check in level.checks if check.data.get("intervals")
    ]  # fmt: skip
    if compared:
        pairs = levels[1].results.get("results", {}) if 1 in levels else {}
        noise_m = noise_level(pairs, 1.0)[0] if pairs else math.nan
        above.append(_difference_bar(compared, noise_m, report.passed))
    maps = map_figures(levels[4], report.subject, report.reference) if 4 in levels and levels[4].results else iter(())
    return above, list(islice(maps, 3))


def _stamp(report: AcceptanceReport) -> Figure:
    failed = any(level.failed(report.claim) for level in report.levels)
    word, colour = ("PASSED", GOOD) if report.passed else ("FAILED", BAD) if failed else ("NOT SHOWN", OPEN)
    text = f"{report.check_count} checks"
    if report.passed and report.reference:  # the title names it
        text = f"{'equivalent to' if report.claim == 'equal' else 'as good as'} the reference; {text}"
    elif failed:
        text = f"not all of {text} passed"
    parts = [
        element("rect", x=8, y=8, width=444, height=124, rx=14, fill="none", stroke=colour, stroke_width=7),
        _text(230, 82, word, colour, 58, 800, anchor="middle"),
        _text(230, 114, text, colour, 17, 600, anchor="middle"),
    ]
    return Figure(_document(parts, 140), f"{word}: {report.subject}", "", size=(460, 140))


def _difference_bar(compared: Sequence[Mapping[str, Any]], matters_m: float, passed: bool) -> Figure:
    """The largest difference by its margin; ``passed``: whether all checks did. Odometries are compared in the mean."""
    measured_m, data = max(((_measure(one), one) for one in compared), key=lambda one: one[0] / _margin_m(one[1]))
    excepted = sum(one.get("excepted", 0) for one in compared)
    caption = "Largest difference of two answers to the same scans" if "largest_m" in data else (
        "Largest mean difference of the poses of the same scans, with its interval"
    )  # fmt: skip
    caption += ", on a logarithmic scale from 0.1 fm to 1 m."
    caption += f" {excepted} answers that rounding decides do not count." if excepted else ""
    caption += " Other checks failed." if measured_m <= _margin_m(data) and not passed else ""
    return _bar(measured_m, _margin_m(data), matters_m, passed, caption)


def _margin_m(data: Mapping[str, Any]) -> float:
    return float(data["margin"]["metres"])


def _measure(data: Mapping[str, Any]) -> float:
    """The largest difference (m) of a comparison among the answers that count, or in the mean of poses."""
    if "largest_m" in data:
        return float(data["largest_m"])
    deciding = [one for one in data["intervals"] if one["unit"] == "m" and DISTURBED not in one["quantity"]]
    return max((abs(one[end]) for one in deciding for end in ("low", "high") if one[end] is not None), default=0.0)


def _bar(measured_m: float, allowed_m: float, matters_m: float, passed: bool, caption: str) -> Figure:
    """Three lengths on one logarithmic bar; a matter of nan is left out. ``passed``: whether all checks did."""
    within = measured_m <= allowed_m
    marks = [("measured", measured_m, BAD if not within else GOOD if passed else NEUTRAL)]
    marks += [("allowed", allowed_m, NEUTRAL)]
    marks += [("noise of the sensor", matters_m, "#0b5cad")] if math.isfinite(matters_m) else []
    parts = [element("rect", x=LEFT, y=62, width=RIGHT - LEFT, height=12, rx=6, fill="#d5dbe2")]
    end = _place(measured_m)
    parts.append(element("rect", x=LEFT, y=62, width=max(end - LEFT, 3.0), height=12, rx=6, fill=marks[0][2]))
    for number, (name, metres, colour) in enumerate(marks):
        at, below = _place(metres), number == 1
        parts.append(element("line", x1=at, x2=at, y1=54, y2=82, stroke=colour, stroke_width=3))
        anchor = "start" if at < 110 else "end" if at > 350 else "middle"
        text = f"{name} {_format_metres(metres)}"
        parts.append(_text(at, 106 if below else 40 if number == 0 else 20, text, colour, 15, 600, anchor))
    what = f"measured {_format_metres(measured_m)}, allowed {_format_metres(allowed_m)}"
    return Figure(_document(parts, 120), f"Difference on scans: {what}", caption, size=(460, 120))


def _place(metres: float) -> float:
    power = min(max(math.log10(max(metres, 10.0**LOW)), LOW), HIGH)
    return LEFT + (RIGHT - LEFT) * (power - LOW) / (HIGH - LOW)


def _format_metres(metres: float) -> str:
    if metres == 0.0:
        return "0 m"
    for unit, size in (("m", 1.0), ("mm", 1e-3), ("µm", 1e-6), ("nm", 1e-9), ("pm", 1e-12)):
        if metres >= size:
            return f"{float(f'{metres / size:.2g}'):g} {unit}"
    return f"{metres / 1e-15:.2g} fm"


def _text(x: float, y: float, text: str, colour: str, size: int, weight: int, anchor: str) -> Markup:
    return element("text", text, x=x, y=y, fill=colour, font_size=size, font_weight=weight, text_anchor=anchor,
                   font_family=FONT)  # fmt: skip


def _document(parts: list[Markup], height: int) -> bytes:
    drawn = element("svg", join(parts), xmlns="http://www.w3.org/2000/svg", viewBox=f"0 0 {WIDTH:g} {height}")
    return str(drawn).encode()
