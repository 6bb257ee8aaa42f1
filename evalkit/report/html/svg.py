"""Inline SVG of the report's page: elements, scales, ticks, labels; CSS gives text, colours and dark mode."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from markupsafe import Markup, escape

from evalkit.core.se2 import Floats

STEPS = ((1.0,), (1.0, 3.0), (1.0, 2.0, 5.0))
"""Digits of ticks on a logarithmic scale, coarse to fine."""


@dataclass(frozen=True, slots=True)
class AxisScale:
    """A range of values drawn as shares 0..1, logarithmic or linear (``low`` > 0 if logarithmic)."""

    low: float
    high: float
    log: bool = True

    def share(self, value: float) -> float:
        """Return the position of a value, limited to -0.02..1.02."""
        low, high, value = (math.log(max(v, 1e-12)) if self.log else v for v in (self.low, self.high, value))
        return min(max((value - low) / (high - low), -0.02), 1.02)

    def ticks(self, most: int) -> tuple[float, ...]:
        """Return round values within the range, at most so many; at least one if the range has any."""
        if not self.log:
            step = 10.0 ** math.floor(math.log10(self.high - self.low))
            step = next(s * step for s in (0.1, 0.2, 0.5, 1.0, 2.0) if (self.high - self.low) / (s * step) <= most)
            first, last = math.ceil(self.low / step - 1e-9), math.floor(self.high / step + 1e-9)
            return tuple(number * step for number in range(first, last + 1))
        powers = range(math.floor(math.log10(self.low)), math.ceil(math.log10(self.high)) + 1)
        found: tuple[float, ...] = ()
        for digits in STEPS:
            values = (float(f"{digit * 10.0**power:.3g}") for power in powers for digit in digits)
            ticks = tuple(value for value in values if self.low <= value <= self.high)
            if len(ticks) > most and found:
                break
            found = ticks
        while len(found) > most:
            found = found[::2]
        return found or (float(f"{math.sqrt(self.low * self.high):.2g}"),)


def log_scale(values: Iterable[float], margin: float = 0.08) -> AxisScale:
    """Return the scale of positive values with a margin on both sides, at least a factor 1.5 wide."""
    known = [max(value, 1e-9) for value in values] or [1.0]
    low, high = math.log(min(known)), math.log(max(known))
    wide = max(high - low, math.log(1.5))
    middle = 0.5 * (low + high)
    half = wide * (0.5 + margin)
    return AxisScale(math.exp(middle - half), math.exp(middle + half))


def element(name: str, content: object = "", **attributes: object) -> Markup:
    """Return an element with escaped attributes and content; ``stroke_width=2`` is ``stroke-width``."""
    given = Markup("").join(
        Markup(' {}="{}"').format(key.rstrip("_").replace("_", "-"), _plain(value))
        for key, value in attributes.items()
        if value is not None
    )
    return Markup("<{0}{1}>{2}</{0}>").format(Markup(name), given, escape(content))


def join(parts: Iterable[Markup]) -> Markup:
    """Return elements one after the other."""
    return Markup("").join(parts)


def polyline(points: Floats, **attributes: object) -> Markup:
    """Return a line through points (N, 2), interrupted where a number is missing."""
    words, pen = [], False
    for x, y in np.round(points, 1).tolist():
        there = math.isfinite(x) and math.isfinite(y)
        if there:
            words.append(f"{'L' if pen else 'M'}{x:g} {y:g}")
        pen = there
    return element("path", d="".join(words), vector_effect="non-scaling-stroke", **attributes)


def place_labels(
    points: Sequence[tuple[float, float, str]],
    size: tuple[float, float],
    letter: float,
    height: float,
    free: Sequence[tuple[float, float, float, float]] = (),
) -> dict[str, tuple[float, float, str]]:
    """Return position and anchor of each label that fits beside its point without covering a point or a label.

    ``points``: x, y and text, the most important first. ``size`` of the drawing; ``letter``: mean width of a letter.
    ``free``: left, top, right and bottom of places that stay free.
    """
    taken = [*free, *((x - 5.0, y - 5.0, x + 5.0, y + 5.0) for x, y, _ in points)]
    placed: dict[str, tuple[float, float, str]] = {}
    for x, y, text in points:
        wide = letter * len(text)
        beside = [(x - 9.0 - wide, y + 4.0, "end"), (x + 9.0, y + 4.0, "start"),
                  (x - wide / 2.0, y + 8.0 + height, "middle"), (x - wide / 2.0, y - 9.0, "middle")]  # fmt: skip
        bases = [y - 9.0, y + 8.0 + height]
        if not placed:  # the most important one may be further away, its colour shows its point
            bases += [y - 9.0 - height, y + 8.0 + 2.0 * height]
        beside += [place for base in bases for place in ((x + 3.0 - wide, base, "end"), (x - 3.0, base, "start"))]
        for left, base, anchor in beside:
            box = (left, base - height, left + wide, base + 3.0)
            inside = box[0] >= 0.0 and box[2] <= size[0] and box[1] >= 0.0 and box[3] <= size[1]
            if inside and not any(_overlap(box, other) for other in taken):
                taken.append(box)
                placed[text] = ({"end": left + wide, "start": left, "middle": x}[anchor], base, anchor)
                break
    return placed


def _overlap(one: tuple[float, ...], other: tuple[float, ...]) -> bool:
    return one[0] < other[2] and other[0] < one[2] and one[1] < other[3] and other[1] < one[3]


def _plain(value: object) -> str:
    return f"{value:.5g}" if isinstance(value, float) else str(value)
