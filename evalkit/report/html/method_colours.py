"""Colour, dashes and mark of each method: the colour follows from its name, unless another of the report has that one.

A dark page shows lighter ones: ``--hue-0`` to ``--hue-4`` in ``templates/page.css``.
"""

from __future__ import annotations

import zlib
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

# Okabe and Ito, "Color Universal Design" (2008), and a brown that differs from them in lightness: the largest distance
# between any two under simulated deuteranopia, protanopia and tritanopia. Black is kept for the ground truth.
HUES = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#5b3a29")
DASHES: tuple[tuple[float, ...], ...] = (
    (), (6.0, 2.0), (1.5, 1.5), (6.0, 2.0, 1.5, 2.0), (10.0, 3.0), (3.0, 3.0), (10.0, 2.0, 2.0, 2.0), (1.5, 4.0),
)  # fmt: skip
MARKS = ("o", "s", "^", "D", "v", "P", "X", "*")
"""Marks of points, in the notation of matplotlib, in the order of ``DASHES``."""

TRUTH = "#000000"
BAR = "#7a7a7a"


@dataclass(frozen=True, slots=True)
class Stroke:
    """Colour and dashes of a line (lengths on and off in points; () is solid)."""

    colour: str
    dash: tuple[float, ...] = ()

    @property
    def css(self) -> str:
        """The colour on a page, which has lighter ones in the dark."""
        return f"var(--hue-{HUES.index(self.colour)})" if self.colour in HUES else "var(--grey)"

    @property
    def mark(self) -> str:
        """The mark of its points: another one for each method of the same colour."""
        return MARKS[DASHES.index(self.dash)] if self.dash in DASHES else MARKS[0]


Strokes = Mapping[str, Stroke]
"""The stroke of every method, by its name."""


def assign_strokes(methods: Iterable[str], baselines: Iterable[str] = ()) -> Strokes:
    """Return a stroke for every method: the colour by its name, or a free one where that is taken; baselines are grey.

    Where no colour is free, the least used one is shared, with other dashes. Names choose in alphabetical order, so
    strokes do not depend on the order of the methods.
    """
    grey = set(baselines)
    chosen: dict[str, Stroke] = {}
    waiting = []
    for label in sorted(set(methods) - grey):
        own = Stroke(HUES[zlib.crc32(label.encode()) % len(HUES)])
        if own in chosen.values():
            waiting.append(label)
        else:
            chosen[label] = own
    for label in waiting:
        uses = Counter(stroke.colour for stroke in chosen.values())
        colour = min(HUES, key=lambda hue: uses[hue])
        chosen[label] = Stroke(colour, DASHES[uses[colour] % len(DASHES)])
    return chosen | {label: Stroke(BAR, (4.0, 2.0)) for label in grey}
