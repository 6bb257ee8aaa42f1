"""Lets an odometry tell whether its answer comes of a registration or is only the guess it started from.

A ``Registration`` need not: the front end knows. An odometry that tells nothing is reported as such.
"""

from __future__ import annotations

from typing import Literal, NamedTuple

Stage = Literal["s2s", "s2m"]
"""Scan to scan, and scan to map."""

UNTOLD = -1
GUESS_KEPT = 0
ACCEPTED = 1


class Registered(NamedTuple):
    """What a stage's registration came to; ``error`` in metres, nan where there is none."""

    accepted: bool
    converged: bool
    iterations: int
    error: float
    inliers: int


class _Told:
    """What was told during the present scan."""

    now = UNTOLD
    stages: dict[Stage, Registered] = {}  # noqa: RUF012 - replaced as a whole, never shared


def tell(accepted: bool) -> None:
    """Says of the present scan's answer whether it is a registration's; False: it is the guess."""
    _Told.now = ACCEPTED if accepted else GUESS_KEPT


def tell_stage(stage: Stage, registered: Registered) -> None:
    """Says of a stage within the present scan what the front end would hear of its own."""
    _Told.stages = {**_Told.stages, stage: registered}


def heard() -> int:
    """What was told since this was last asked: ACCEPTED, GUESS_KEPT or UNTOLD."""
    told, _Told.now = _Told.now, UNTOLD
    return told


def heard_of_stages() -> dict[Stage, Registered]:
    """What was told of stages since this was last asked."""
    told, _Told.stages = _Told.stages, {}
    return told
