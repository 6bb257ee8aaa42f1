"""A finding of the inspection: a defect or notable property of a recording, and what to do about it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Literal

from evalkit.plugins.parameters import Value

Level = Literal["problem", "warning", "note"]

MAX_OFFSET_S = 0.02
"""A larger clock offset moves a scan by a visible distance."""

FIELDS = "fields=ranges=ranges first=angle_min step=angle_increment"
"""The parameter of the bag reader that names the fields of a LaserScan, to add a unit or a direction to them."""


@dataclass(frozen=True, slots=True)
class InspectionFinding:
    """A defect or notable property: severity, stream, observation, and what to do ("" if nothing).

    ``mend``: name and value of the parameter of the bag reader that mends a problem, None unless there is just one; of
    ``fields``, the word to add.
    """

    level: Level
    about: str
    what: str
    advice: str = ""
    mend: tuple[str, Value] | None = None


problem = partial(InspectionFinding, "problem")
warning = partial(InspectionFinding, "warning")
note = partial(InspectionFinding, "note")


def format_count(count: int, noun: str) -> str:
    """Return a count with its noun: "1 gap", "3 gaps"."""
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"
