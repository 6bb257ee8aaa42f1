"""The rules of an Odometry, each checked on a short drive through a known room."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np

from evalkit.commands.validate.rules.odometry_fixture import OdometryFixture, answer_row, last_pose
from evalkit.commands.validate.rules.odometry_state_rules import ODOMETRY_STATE_RULES
from evalkit.commands.validate.rules.registration_rules import UNIT_TOLERANCE, check_turn
from evalkit.commands.validate.rules.resource_rules import RESOURCE_RULES
from evalkit.commands.validate.rules.rule import (
    RuleBroken,
    RuleNotApplicable,
    RuleNotJudged,
    is_refusal,
    require_own_process,
    rule_table,
)
from evalkit.commands.validate.rules.scenes import (
    BEAMS,
    SimulatedDrive,
    distance_m,
    drive,
    format_pose,
    without_hits,
)
from evalkit.core.errors import EvalkitError, format_exception
from evalkit.core.pose import Pose
from evalkit.core.scan import Frame
from evalkit.odometry.corrections import read_remarks

ON_TRACK_M = 0.25
"""Largest error after 0.6 m and 0.6 rad: two voxels of a usual map, its turn measured at 4 m."""

MAX_REMAINING = 0.5
"""The largest share of the error from a wheel slip of 20 % that may remain."""

BEAM_SHARE = 0.3
"""The share of a scan's duration by which answers may be late; without deskewing it is one half."""

STAMPS_M = 1e-3
"""Tolerance (m, rad) of answers at another time: stamps in seconds, in double precision, are known to 0.2 us."""

QUARTER_TURN = Pose(0.2, 0.1, math.pi / 2.0)


def check_starts(fixture: OdometryFixture) -> str:
    """It is created from its parameters and returns finite poses."""
    odometry = fixture.make()
    answers = np.array([answer_row(odometry, frame) for frame in drive(8).frames])
    if np.isnan(answers).all():
        raise RuleBroken("it has no answer to any of 8 scans")
    try:
        read_remarks(odometry)
    except (TypeError, ValueError) as error:
        raise RuleBroken(str(error)) from error
    return f"{int(np.isfinite(answers[:, 0]).sum())} poses for {len(answers)} scans"


def check_first(fixture: OdometryFixture) -> str:
    """The first answer is the identity."""
    for name, simulated in (("moving", drive(8)), ("standing", drive(8, standing=8))):
        answers = fixture.run(simulated.frames)
        answer = Pose.of(answers[np.isfinite(answers[:, 0])][0])
        if distance_m(answer, Pose()) > 1e-9:
            raise RuleBroken(
                f"{name}, with the wheel odometry at (10, -5, 1): the first answer is {format_pose(answer)}"
            )
    return "the identity, independent of the start of the wheel odometry"


def check_follows(fixture: OdometryFixture) -> str:
    """It tracks a drive with exact wheel odometry."""
    simulated = drive()
    try:
        return _on_track(fixture, simulated, "with true wheel odometry")
    except RuleBroken as broken:
        answer, odom = last_pose(fixture.run(simulated.frames)), simulated.frames[-1].odom_from_base
        step = Pose.of(simulated.truth[-2]).inverse() @ end_pose(simulated)
        others = {"the motion since the scan before": step, "odom_from_base": odom}
        for name, other in others.items():
            if other is not None and distance_m(answer, other) < distance_m(step, Pose()) / 2.0:
                raise RuleBroken(str(broken), f"the answer is {name}: return start_from_base") from None
        raise


def check_moves(fixture: OdometryFixture) -> str:
    """It corrects wheel odometry that is 20 % too long."""
    if fixture.role == "baseline":
        raise RuleNotApplicable("its role is 'baseline': it does not use the scans")
    simulated = drive(odometry_gain=1.2)
    driven, wheels = end_pose(simulated), _odometry_motion(simulated)
    answer = last_pose(fixture.run(simulated.frames))
    slip, left = distance_m(wheels, driven), distance_m(answer, driven)
    if left > MAX_REMAINING * slip:
        follows_wheels = distance_m(answer, wheels) < MAX_REMAINING * slip
        why = ": are the scans used? Normals of points at z = 0 are vertical and constrain nothing"
        raise RuleBroken(
            f"wheel odometry 20 % too long is {100 * slip:.0f} cm off at 4 m, the answer {100 * left:.0f} cm"
            + (why if follows_wheels else "")
        )
    return f"of {100 * slip:.0f} cm of wheel slip {100 * left:.1f} cm remained"


def check_metres(fixture: OdometryFixture) -> str:
    """A drive of 0.6 m ahead is returned as 0.6 m ahead."""
    simulated = drive(turn_radps=0.0)
    wanted = end_pose(simulated).x
    answer = last_pose(fixture.run(simulated.frames))
    length = math.hypot(answer.x, answer.y)
    if abs(length - wanted) > max(UNIT_TOLERANCE * wanted, 0.1):
        millimetres = abs(length / 1000.0 - wanted) < UNIT_TOLERANCE * wanted
        raise RuleBroken(
            f"{wanted:g} m was returned as {length:.4g}", "the answer is in millimetres?" if millimetres else ""
        )
    if answer.x < 0.0:
        raise RuleBroken(
            f"{wanted:g} m ahead was returned as {format_pose(answer)}",
            "the answer is the inverse, base_from_start instead of start_from_base?",
        )
    return f"{wanted:g} m was returned as {length:.4f}"


def check_radians(fixture: OdometryFixture) -> str:
    """A left turn is returned as a positive angle in radians."""
    simulated = drive(turn_radps=0.5)
    return check_turn(last_pose(fixture.run(simulated.frames)), end_pose(simulated))


def check_first_beam(fixture: OdometryFixture) -> str:
    """Answers are the poses at the first beam of each scan."""
    # after standing, the end of a sweep is ahead of its beginning
    simulated = drive(20, 0.6, 0.5, standing=4)
    answers = fixture.run(simulated.frames)
    known = answers[np.isfinite(answers[:, 0])]
    if len(known) and distance_m(Pose.of(known[0]), Pose()) > 1e-9:
        raise RuleNotJudged("the first answer is not the identity, see the rule first")
    answers = answers[-8:]
    late = []
    for answer, truth, then in zip(answers[:-1], simulated.truth[-8:-1], simulated.truth[-7:], strict=True):
        if np.isnan(answer).any():
            continue
        scan = Pose.of(truth).inverse() @ Pose.of(then)
        off = Pose.of(truth).inverse() @ Pose.of(answer)
        late.append((off.x * scan.x + off.y * scan.y) / (scan.x**2 + scan.y**2))
    if not late:
        raise RuleBroken("it has no answer to any of the last 7 scans")
    share = float(np.mean(late))
    if abs(share) > BEAM_SHARE:
        raise RuleBroken(
            f"on average the answers are {share:+.2f} of a scan's duration away from its first beam "
            "(0.5: a scan that is not deskewed; 1: the pose of its last beam; -1: the answer to the scan before)"
        )
    return f"{share:+.2f} of a scan's duration away from its first beam"


def check_mounting(fixture: OdometryFixture) -> str:
    """Answers are poses of the base, for any mounting of the lidar."""
    return _on_track(fixture, drive(base_from_sensor=QUARTER_TURN), "with the lidar turned by 90 degrees")


def check_without_odometry(fixture: OdometryFixture) -> str:
    """Without wheel odometry it tracks the drive, or raises an evalkit error."""
    simulated = drive(odometry_gain=None)
    try:
        return _on_track(fixture, simulated, "without wheel odometry")
    except EvalkitError as error:
        raise RuleNotApplicable(f"it requires wheel odometry: {error}") from error


def check_odometry_gap(fixture: OdometryFixture) -> str:
    """It bridges a gap in the wheel odometry."""
    simulated = drive()
    silent = tuple(
        replace(frame, odom_from_base=None, start_from_end=None) if index in (6, 7) else frame
        for index, frame in enumerate(simulated.frames)
    )
    return _on_track(fixture, replace(simulated, frames=silent), "with two scans without wheel odometry")


def check_no_hits(fixture: OdometryFixture) -> str:
    """It continues after scans without returns."""
    simulated = drive()
    blind = tuple(without_hits(frame) if index in (6, 7) else frame for index, frame in enumerate(simulated.frames))
    return _on_track(fixture, replace(simulated, frames=blind), "with two scans without hits")


def check_no_hits_first(fixture: OdometryFixture) -> str:
    """It continues after a first scan without returns."""
    simulated = drive()
    blind = (without_hits(simulated.frames[0]), *simulated.frames[1:])
    fixture.run(blind)
    return "returns finite poses"


def check_all_at_once(fixture: OdometryFixture) -> str:
    """It tracks scans with simultaneous beams."""
    return _on_track(fixture, drive(sweeping=False), "with time_increment_ns = 0")


def check_equal_stamps(fixture: OdometryFixture) -> str:
    """Two scans with the same stamp give an answer or an exception, not a crash."""
    simulated = drive(6)
    third = simulated.frames[3]
    repeated = replace(third, scan=replace(third.scan, stamp_ns=simulated.frames[2].scan.stamp_ns))
    try:
        fixture.run((*simulated.frames[:3], repeated, *simulated.frames[4:]))
    except Exception as error:
        if not is_refusal(error):
            raise
        return format_exception(error)
    return "returns finite poses"


def check_fresh(fixture: OdometryFixture) -> str:
    """Two objects do not share state."""
    one, other = drive(8), drive(8, 0.2, -0.3)
    alone = fixture.run(one.frames)
    first, second = fixture.make(), fixture.make()
    answers = []
    for frame, between in zip(one.frames, other.frames, strict=True):
        answers.append(answer_row(first, frame))
        answer_row(second, between)
    if not np.array_equal(alone, answers, equal_nan=True):
        raise RuleBroken("a second object on another drive changes the answers of the first one: they share state")
    return "two objects used alternately answer as each alone"


def check_deterministic(fixture: OdometryFixture) -> str:
    """The same drive has the same answers, to the bit."""
    simulated = drive(10)
    once = fixture.run(simulated.frames)
    for _ in range(2):
        if not np.array_equal(once, again := fixture.run(simulated.frames), equal_nan=True):
            scan = int(np.argmax((once != again).any(axis=1)))
            raise RuleBroken(
                f"the same drive has another answer at scan {scan + 1}: {again[scan].tolist()}, before "
                f"{once[scan].tolist()}"
            )
    return "3 new objects agree to the bit"


def check_read_only(fixture: OdometryFixture) -> str:
    """It does not write to its arguments."""
    require_own_process(fixture.runs_in)
    simulated = drive(4)
    before = [frame.scan.ranges.tobytes() + frame.scan.angles.tobytes() for frame in simulated.frames]
    try:
        fixture.run(simulated.frames)
    except ValueError as error:
        if "read-only" in str(error) or "not writeable" in str(error):
            raise RuleBroken(f"it writes to a scan ({error}): use a copy") from error
        raise
    if [frame.scan.ranges.tobytes() + frame.scan.angles.tobytes() for frame in simulated.frames] != before:
        raise RuleBroken("a scan changed in the call: use a copy")
    return "all scans are unchanged after the call"


def check_stamps(fixture: OdometryFixture) -> str:
    """The same drive at another time has the same answers: stamps from 1970 on, before, and across 2^31 and 2^32 ns."""
    begin_ns = fixture.short.frames[0].scan.stamp_ns
    for first_ns in (1_700_000_000_123_456_789, -3_000_000_000, 2**31 - 150_000_000, 2**32 - 150_000_000):
        moved = [
            replace(frame, scan=replace(frame.scan, stamp_ns=frame.scan.stamp_ns - begin_ns + first_ns))
            for frame in fixture.short.frames
        ]
        try:
            answers = fixture.run(moved)
        except EvalkitError as error:
            raise RuleBroken(f"with stamps from {first_ns} ns on: {format_exception(error)}") from error
        off = np.nan_to_num(answers, nan=1e9) - np.nan_to_num(fixture.first_answers, nan=1e9)
        if (largest := float(np.abs(off).max())) > STAMPS_M:
            raise RuleBroken(
                f"with stamps from {first_ns} ns on, answers differ by up to {largest:.2g} m or rad",
                "subtract stamps as 64-bit integers before you convert them: 32 bits or floats cannot hold them",
            )
    return "the answers do not depend on the time of the first stamp"


def check_values(fixture: OdometryFixture) -> str:
    """It tracks scans with nan and inf among the ranges; one beam or 20,000 give an answer or an exception."""
    simulated = drive(6)
    rng = np.random.default_rng(fixture.seed)
    for name, chosen in (("nan", np.nan), ("inf", np.inf)):
        holed = tuple(
            replace(
                frame, scan=replace(frame.scan, ranges=np.where(rng.random(BEAMS) < 0.3, chosen, frame.scan.ranges))
            )
            for frame in simulated.frames
        )
        _on_track(fixture, replace(simulated, frames=holed), f"with 30 % of the ranges {name}", 0.5 * ON_TRACK_M + 0.4)
    refused: list[str] = []
    for rows in (np.arange(1), np.repeat(np.arange(BEAMS), 56)):
        frames = tuple(
            replace(frame, scan=replace(frame.scan, ranges=frame.scan.ranges[rows], angles=frame.scan.angles[rows],
                                        time_increment_ns=0))
            for frame in simulated.frames
        )  # fmt: skip
        try:
            fixture.run(_note_each(fixture, frames, f"a scan of {len(rows)} beams"))
        except Exception as error:
            if not is_refusal(error):
                raise
            refused.append(f"{len(rows)} beams: {format_exception(error)}")
    return "; ".join(refused) or "it answers scans with holes, with one beam and with 20,160 beams"


def _note_each(fixture: OdometryFixture, frames: Iterable[Frame], step: str) -> Iterator[Frame]:
    """Yield the frames, each with its own limit of time."""
    for frame in frames:
        fixture.note_progress(step)
        yield frame


def end_pose(simulated: SimulatedDrive) -> Pose:
    """The true pose at the last scan's first beam."""
    return Pose.of(simulated.truth[-1])


def _odometry_motion(simulated: SimulatedDrive) -> Pose:
    begin, end = simulated.frames[0].odom_from_base, simulated.frames[-1].odom_from_base
    return begin.inverse() @ end if begin is not None and end is not None else Pose()


def _on_track(fixture: OdometryFixture, simulated: SimulatedDrive, how: str, within_m: float = ON_TRACK_M) -> str:
    answer, truth = last_pose(fixture.run(simulated.frames)), end_pose(simulated)
    left = truth.inverse() @ answer
    gap = f"{100 * math.hypot(left.x, left.y):.1f} cm and {math.degrees(abs(left.theta)):.1f} deg off after 0.6 m"
    if distance_m(answer, truth) > within_m:
        raise RuleBroken(f"{how}: {gap}: {format_pose(answer)} instead of {format_pose(truth)}")
    return f"{how}: {gap}"


RULES = rule_table(
    check_starts, check_first, check_follows, check_moves, check_metres, check_radians, check_first_beam,
    check_mounting, check_without_odometry, check_odometry_gap, check_no_hits, check_no_hits_first, check_all_at_once,
    check_equal_stamps, check_stamps, check_values, check_fresh, check_deterministic, check_read_only, *RESOURCE_RULES,
    *ODOMETRY_STATE_RULES,
)  # fmt: skip
