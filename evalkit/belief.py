"""Lets an odometry tell whether its answer comes of a registration or is only the guess it started from.

A ``Registration`` need not: the front end knows. An odometry that tells nothing is reported as such.
"""

from __future__ import annotations

UNTOLD = -1
GUESS_KEPT = 0
BELIEVED = 1


class _Told:
    """What was told during the present scan."""

    now = UNTOLD


def tell(believed: bool) -> None:
    """Says of the present scan's answer whether it is a registration's; False: it is the guess."""
    _Told.now = BELIEVED if believed else GUESS_KEPT


def heard() -> int:
    """What was told since this was last asked: BELIEVED, GUESS_KEPT or UNTOLD."""
    told, _Told.now = _Told.now, UNTOLD
    return told
