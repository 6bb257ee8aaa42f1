"""Where a run begins in a known map, and how that place was found."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from evalkit.core.pose import Pose


@dataclass(frozen=True, slots=True)
class MapStart:
    """The pose ``map_from_start`` of the base at the first scan with an answer.

    ``scans``: scans of the sequence until the place was known, that one included: 1 is the first. ``after_s``: time
    from the first scan of the sequence to that one. ``searched``: False where the start was given. ``score``: how well
    the scans fit the map there, 0 to 1. ``rival``: the best score of another place, 0 where none came near.
    """

    map_from_start: Pose
    scans: int
    after_s: float
    searched: bool
    score: float
    rival: float = 0.0

    def __post_init__(self) -> None:
        if self.scans < 1 or not 0.0 <= self.after_s < math.inf:
            raise ValueError(f"scans, after_s: expected at least 1 and a finite time, got {self.scans}, {self.after_s}")
        if not (0.0 <= self.score <= 1.0 and 0.0 <= self.rival <= 1.0):
            raise ValueError(f"score, rival: expected 0 to 1, got {self.score} and {self.rival}")

    def as_dict(self) -> dict[str, Any]:
        """All values, for JSON; the pose as [x, y, theta] (m, m, rad)."""
        return asdict(self) | {"map_from_start": self.map_from_start.row.tolist()}

    @classmethod
    def of(cls, content: Mapping[str, Any]) -> MapStart:
        """Return the start that ``as_dict`` has written; raises TypeError, KeyError or ValueError."""
        if type(content["scans"]) is not int or type(content["searched"]) is not bool:
            raise ValueError("expected a whole number of scans, and true or false")
        return cls(**{**content, "map_from_start": Pose.of(content["map_from_start"])})
