"""Colour and dashes of each method, the same in every table and figure."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

# Okabe and Ito, "Color Universal Design" (2008): black is kept for the ground truth, yellow is darkened for white
# paper, and a dark brown is added, which differs from all others in lightness.
HUES = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#a89400", "#5b3a29")
DASHES: tuple[tuple[float, ...], ...] = ((), (6.0, 2.0), (1.5, 1.5), (6.0, 2.0, 1.5, 2.0))
TRUTH = "#000000"
BAR = "#7a7a7a"


@dataclass(frozen=True, slots=True)
class Stroke:
    """Colour and dashes of a line (lengths on and off in points; () is solid)."""

    colour: str
    dash: tuple[float, ...] = ()


def assign_strokes(methods: Iterable[str], baselines: Iterable[str] = ()) -> Mapping[str, Stroke]:
    """Return a stroke for every method: hues first, then dashes; baselines are grey and dashed."""
    grey = set(baselines)
    chosen: dict[str, Stroke] = {}
    for index, label in enumerate(label for label in methods if label not in grey):
        chosen[label] = Stroke(HUES[index % len(HUES)], DASHES[index // len(HUES) % len(DASHES)])
    return chosen | {label: Stroke(BAR, (4.0, 2.0)) for label in grey}
