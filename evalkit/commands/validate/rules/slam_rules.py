"""The rules of a Slam beside those of an Odometry, on a drive that returns to its start with slipping wheels."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from evalkit.commands.validate.rules import odometry_rules
from evalkit.commands.validate.rules.odometry_fixture import OdometryFixture, validate_pose
from evalkit.commands.validate.rules.rule import RuleBroken, RuleNotApplicable, rule_table
from evalkit.commands.validate.rules.scenes import REACH_M, SimulatedDrive, distance_m, drive, format_pose
from evalkit.core import se2
from evalkit.core.loop_closure import LoopClosure
from evalkit.core.odometry_estimate import OdometryEstimate
from evalkit.core.pose import Pose
from evalkit.core.se2 import Floats, Stamps
from evalkit.core.trajectory import Trajectory
from evalkit.odometry.corrections import read_loop_closures, read_trajectory
from evalkit.odometry.run_odometry import answer_frame
from evalkit.plugins.protocols import NoAnswer, Slam

SCANS, SPEED, SLIP = 210, 1.2, 1.02
"""Four times around a circle of radius 1 m, at 1.2 m/s and 1.2 rad/s: 25 m, enough for methods that close a loop only
after a long path. The wheels measure 2 % too much.
"""

JUMP_M, JUMP_DEG = 0.05, 3.0
"""A step of the corrected path may differ from that of the answers by this much, beyond the jumps of the answers."""

MOVED_M, MOVED_DEG = 0.01, 0.5
"""A pose that changed by more was corrected."""

WORSE_M = 0.1
"""Corrected poses may be farther from the truth than the answers by this much, at the farthest."""

KEPT_BYTES = 1024.0
"""Bytes that a SLAM may keep for each frame of a standing robot: its stamp, its pose, its place in the graph."""


@dataclass(frozen=True, eq=False)
class Corrected:
    """What a Slam has after some frames."""

    stamps_ns: Stamps
    answers: Floats
    final: Trajectory
    closures: tuple[LoopClosure, ...]


class SlamFixture(OdometryFixture):
    """A Slam under test."""

    kept_bytes = KEPT_BYTES

    @cached_property
    def loop(self) -> SimulatedDrive:
        """The drive that returns to its start."""
        return drive(SCANS, SPEED, SPEED, odometry_gain=SLIP)

    @cached_property
    def first_run(self) -> Corrected:
        """What it has at the end of the loop, asked for then only."""
        return self._drive()[-1][0]

    @cached_property
    def watched(self) -> list[tuple[Corrected, OdometryEstimate]]:
        """What it has after each frame of the loop, and the answer to that frame."""
        return self._drive(after_each=True)

    def run_again(self) -> Corrected:
        """The same as ``first_run`` from a new object."""
        return self._drive()[-1][0]

    def _drive(self, after_each: bool = False) -> list[tuple[Corrected, OdometryEstimate]]:
        slam: Slam = self.make()  # type: ignore[assignment]  # the spec says so
        found, stamps, rows = [], [], []
        for frame in self.loop.frames:
            estimate = answer_frame(slam, frame)
            if isinstance(estimate, NoAnswer):
                continue
            stamps.append(frame.scan.stamp_ns)
            rows.append(validate_pose(estimate).row)
            if after_each or frame is self.loop.frames[-1]:
                found.append((_read(slam, stamps, rows), estimate))
        if not found:
            raise RuleBroken(f"it has no answer to the last of {SCANS} scans")
        return found


def _read(slam: Slam, stamps: list[int], rows: list[Floats]) -> Corrected:
    stamps_ns = np.array(stamps, dtype=np.int64)
    try:
        final, closures = read_trajectory(slam, stamps_ns), read_loop_closures(slam, stamps_ns)
    except (TypeError, ValueError) as error:
        raise RuleBroken(f"after {len(stamps)} frames: {error}") from error
    return Corrected(stamps_ns, np.array(rows), final, closures)


def check_final_stamps(fixture: SlamFixture) -> str:
    """After any frame, trajectory() has one finite pose for each answered frame, at its stamp."""
    return f"{len(fixture.watched)} times as many poses as answered frames, at their stamps"


def check_final_first(fixture: SlamFixture) -> str:
    """The first corrected pose stays the identity."""
    for corrected, _ in fixture.watched:
        first = Pose.of(corrected.final.poses[0])
        if distance_m(first, Pose()) > 1e-9:
            raise RuleBroken(
                f"after {len(corrected.stamps_ns)} frames the first corrected pose is {format_pose(first)}"
            )
    return f"the identity after each of {len(fixture.watched)} frames"


def check_final_continuous(fixture: SlamFixture) -> str:
    """The corrected path is continuous: its steps are those of the answers within 5 cm and 3 deg, but for jumps."""
    found = fixture.first_run
    own, answered = (se2.between(poses[:-1], poses[1:]) for poses in (found.final.poses, found.answers))
    beyond = _lengths(se2.between(answered, own)) - _jumps(answered)
    wrong = (beyond[:, 0] > JUMP_M) | (beyond[:, 1] > np.radians(JUMP_DEG))
    if wrong.any():
        at = int(np.argmax(wrong))
        moves = [f"({x:.2f} m, {y:.2f} m, {np.degrees(turn):.1f} deg)" for x, y, turn in (own[at], answered[at])]
        raise RuleBroken(f"from frame {at + 1} to {at + 2} it moves {moves[0]}, the answers {moves[1]}")
    observed = f"a step is at most {100 * max(beyond[:, 0].max(), 0.0):.1f} cm from that of the answers"
    nothing = "; it corrected nothing on this drive" if np.array_equal(found.final.poses, found.answers) else ""
    return observed + nothing


def check_final_on_track(fixture: SlamFixture) -> str:
    """Corrected poses are no farther from the truth than the answers, by more than 10 cm at the farthest."""
    found = fixture.first_run
    frames = {frame.scan.stamp_ns: row for frame, row in zip(fixture.loop.frames, fixture.loop.truth, strict=True)}
    truth = np.array([frames[int(stamp)] for stamp in found.stamps_ns])
    own, answered = (_distances(poses, truth).max() for poses in (found.final.poses, found.answers))
    observed = f"corrected poses are up to {100 * own:.1f} cm off, answers up to {100 * answered:.1f} cm"
    if own > answered + WORSE_M:
        raise RuleBroken(f"{observed}: are they start_from_base of the frames, in their order?")
    return observed


def check_final_deterministic(fixture: SlamFixture) -> str:
    """The same drive has the same corrected poses and loop closures, to the bit."""
    one, other = fixture.first_run, fixture.run_again()
    _require_same(one, other, "the same drive has")
    return f"{len(one.final)} corrected poses and {len(one.closures)} loop closures agree to the bit"


def check_final_read_only(fixture: SlamFixture) -> str:
    """Asking for corrected poses and loop closures changes no later answer, and no later correction."""
    asked, once = fixture.watched[-1][0], fixture.first_run
    if not np.array_equal(asked.answers, once.answers):
        at = int(np.argmax((asked.answers != once.answers).any(axis=1)))
        raise RuleBroken(
            f"asked after each frame, it answers {asked.answers[at].tolist()} at frame {at + 1}, else "
            f"{once.answers[at].tolist()}"
        )
    _require_same(once, asked, "asked after each frame, it has")
    return f"{len(once.answers)} answers and the corrected poses are the same"


def check_closures(fixture: SlamFixture) -> str:
    """Loop closures are between answered frames, given in the order of their later frame."""
    closures = fixture.first_run.closures
    if earlier := [at for at in range(1, len(closures)) if closures[at].stamp_ns < closures[at - 1].stamp_ns]:
        raise RuleBroken(f"loop closure {earlier[0] + 1} is of an earlier frame than the one before")
    accepted = sum(one.accepted for one in closures)
    return f"{len(closures)} candidates, {accepted} accepted, between answered frames"


def check_corrections(fixture: SlamFixture) -> str:
    """An update reports a correction where it moves an earlier pose by more than 1 cm or 0.5 deg, and only there."""
    if all(estimate.corrected is None for _, estimate in fixture.watched):
        raise RuleNotApplicable("it reports no corrections; the frames of accepted loop closures count")
    count = 0
    for (before, _), (after, estimate) in zip(fixture.watched[:-1], fixture.watched[1:], strict=True):
        moved = _largest_change(before.final.poses, after.final.poses[: len(before.final)])
        is_moved = moved[0] > MOVED_M or moved[1] > np.radians(MOVED_DEG)
        if is_moved != bool(estimate.corrected):
            reported = "a correction" if estimate.corrected else "none"
            what = f"{100 * moved[0]:.1f} cm and {np.degrees(moved[1]):.1f} deg"
            raise RuleBroken(f"frame {len(after.final)} moves earlier poses by up to {what} and reports {reported}")
        count += is_moved
    return f"{count} updates move earlier poses and report it"


def _require_same(one: Corrected, other: Corrected, how: str) -> None:
    if not np.array_equal(one.final.poses, other.final.poses):
        at = int(np.argmax((one.final.poses != other.final.poses).any(axis=1)))
        raise RuleBroken(
            f"{how} another corrected pose at frame {at + 1}: {other.final.poses[at].tolist()}, "
            f"{one.final.poses[at].tolist()}"
        )
    if one.closures != other.closures:
        raise RuleBroken(f"{how} other loop closures: {len(other.closures)} candidates, {len(one.closures)} before")


def _lengths(motions: Floats) -> Floats:
    """Lengths (N, 2) of motions (N, 3) in m and rad."""
    return np.stack([np.hypot(motions[:, 0], motions[:, 1]), np.abs(motions[:, 2])], axis=1)


def _jumps(steps: Floats) -> Floats:
    """The larger change (N, 2) from a step (N, 3) to the one before or after, in m and rad: an answer that jumps."""
    change = _lengths(se2.between(steps[:-1], steps[1:]))
    none = np.zeros((1, 2))
    return np.asarray(np.maximum(np.concatenate([none, change]), np.concatenate([change, none])))


def _distances(poses: Floats, truth: Floats) -> Floats:
    """Distances (N,) in m, turns at the lever ``REACH_M``, as ``scenes.distance_m``."""
    wrong = se2.between(truth, poses)
    return np.asarray(np.hypot(wrong[:, 0], wrong[:, 1]) + REACH_M * np.abs(wrong[:, 2]))


def _largest_change(before: Floats, after: Floats) -> tuple[float, float]:
    """The largest change of a pose in m and in rad."""
    shift = np.hypot(*(after[:, :2] - before[:, :2]).T)
    return float(shift.max()), float(np.abs(se2.wrap(after[:, 2] - before[:, 2])).max())


RULES = odometry_rules.RULES | rule_table(
    check_final_stamps, check_final_first, check_final_continuous, check_final_on_track, check_final_deterministic,
    check_final_read_only, check_closures, check_corrections,
)  # fmt: skip
