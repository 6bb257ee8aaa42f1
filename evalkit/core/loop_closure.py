"""A loop closure: a candidate motion between two frames far apart in time, accepted or rejected by a SLAM method."""

from __future__ import annotations

from dataclasses import dataclass

from evalkit.core.pose import Pose

MAX_REASON = 200
"""Longest reason in characters."""


@dataclass(frozen=True, slots=True)
class LoopClosure:
    """One candidate: the method compared a frame with an earlier one and accepted or rejected the measured motion.

    ``stamp_ns``, ``other_stamp_ns``: first beams of the later and of the earlier frame, as given in the frames.
    ``other_from_base``: measured pose of the base at the later frame in the base at the earlier frame (m, rad); of a
    candidate that was rejected before it was measured, the pose that the method expected.
    ``accepted``: whether the method uses the motion now; a closure that was accepted and later withdrawn is rejected.
    ``reason``: why it was accepted or rejected, in a few words ("chi2 3.1 < 11.3", "score 0.41 < 0.55").
    ``found_again``: whether the method had lost its track and found its place again by this motion; None: not reported.
    """

    stamp_ns: int
    other_stamp_ns: int
    other_from_base: Pose
    accepted: bool
    reason: str
    found_again: bool | None = None

    def __post_init__(self) -> None:
        if self.other_stamp_ns >= self.stamp_ns:
            raise ValueError(f"other_stamp_ns: expected a time before {self.stamp_ns}, got {self.other_stamp_ns}")
        if not self.reason or len(self.reason) > MAX_REASON:
            raise ValueError(f"reason: expected 1 to {MAX_REASON} characters, got {len(self.reason)}")
