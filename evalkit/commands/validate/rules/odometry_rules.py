"""What an Odometry must keep, rule by rule, each asked with a short drive through a known room."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import replace

import numpy as np

from evalkit.commands.validate.rules.memory_leak import grown_bytes
from evalkit.commands.validate.rules.registration_rules import NEAR_ENOUGH, turn_in_radians
from evalkit.commands.validate.rules.rule import Broken, NotApplicable, Rule, raised, table
from evalkit.commands.validate.rules.scenes import Drive, away, drive, told, without_hits
from evalkit.core.errors import EvalkitError
from evalkit.core.pose import Pose
from evalkit.core.scan import Frame
from evalkit.core.se2 import Floats
from evalkit.odometry.run_odometry import checked_estimate
from evalkit.plugins.protocols import NoAnswer, Odometry
from evalkit.plugins.specs import Role

ON_TRACK_M = 0.25
"""At the end of 0.6 m and 0.6 rad: two voxels of a usual map, its turn felt half a room away."""

MENDED = 0.5
"""At most this share of a wheel slip of 20 % may be left."""

BEAM_SHARE = 0.3
"""By which share of a scan's duration the answers may be late: half a scan is a scan that was not deskewed."""

LEAK_BYTES = 100_000
"""Per scan of a robot that stands still: half a gigabyte in 5,000 scans."""

QUARTER_TURN = Pose(0.2, 0.1, math.pi / 2.0)


class Bench:
    """A back end on the bench: makes it, and follows drives with a fresh one each."""

    def __init__(self, make: Callable[[], Odometry], role: Role = "") -> None:
        self.make = make
        self.role = role

    def follow(self, frames: Iterable[Frame]) -> Floats:
        """Its answers (N, 3) to the frames; nan where it has none."""
        odometry = self.make()
        return np.array([answered(odometry, frame) for frame in frames])


def answered(odometry: Odometry, frame: Frame) -> Floats:
    """Its answer (3,) to one frame; nan where it says that it has none."""
    try:
        return sound(odometry.update(frame)).row
    except NoAnswer:
        return np.full(3, np.nan)


def last(answers: Floats) -> Pose:
    """The answer to the last scan."""
    if np.isnan(answers[-1]).any():
        raise Broken("it has no answer to the last scan")
    return Pose.of(answers[-1])


def sound(answer: object) -> Pose:
    """The pose of an estimate, if it is a finite one; Broken otherwise."""
    try:
        return checked_estimate(answer).pose
    except (TypeError, ValueError) as error:
        raise Broken(str(error)) from error


def starts(bench: Bench) -> str:
    """It can be made, and answers a pose."""
    made = drive(8)
    if np.isnan(answers := bench.follow(made.frames)).all():
        raise Broken("it has no answer to any of 8 scans")
    return f"{int(np.isfinite(answers[:, 0]).sum())} poses for {len(answers)} scans"


def first(bench: Bench) -> str:
    """The first answer."""
    for name, made in (("moving", drive(8)), ("standing", drive(8, standing=8))):
        answers = bench.follow(made.frames)
        answer = Pose.of(answers[np.isfinite(answers[:, 0])][0])
        if away(answer, Pose()) > 1e-9:
            raise Broken(f"{name}, with the wheel odometry at (10, -5, 1): the first answer is {told(answer)}")
    return "the identity, wherever the wheel odometry begins"


def follows(bench: Bench) -> str:
    """A drive with true wheel odometry."""
    return _on_track(bench, drive(), "with true wheel odometry")


def moves(bench: Bench) -> str:
    """A drive with wheels that slip."""
    if bench.role == "baseline":
        raise NotApplicable("its role is 'bar': it is what others have to beat")
    made = drive(odometry_gain=1.2)
    wheels = drive_end(made).inverse() @ _wheels(made)
    answer = last(bench.follow(made.frames))
    slip, left = away(wheels, Pose()), away(answer, drive_end(made))
    if left > MENDED * slip:
        raise Broken(
            f"wheels that overstate by 20 % are {100 * slip:.0f} cm off half a room away, the answer is "
            f"{100 * left:.0f} cm off: is the scan looked at? Normals of points at z = 0 stand upright and hold nothing"
        )
    return f"of {100 * slip:.0f} cm of wheel slip {100 * left:.1f} cm were left"


def metres(bench: Bench) -> str:
    """How far it went, straight ahead."""
    made = drive(turn_radps=0.0)
    wanted = drive_end(made).x
    answer = last(bench.follow(made.frames))
    found = math.hypot(answer.x, answer.y)
    if abs(found - wanted) > max(NEAR_ENOUGH * wanted, 0.1):
        millimetres = abs(found / 1000.0 - wanted) < NEAR_ENOUGH * wanted
        raise Broken(
            f"{wanted:g} m came back as {found:.4g}" + (": the answer is in millimetres?" if millimetres else "")
        )
    if answer.x < 0.0:
        raise Broken(f"{wanted:g} m ahead came back as {told(answer)}: base_from_start instead of start_from_base?")
    return f"{wanted:g} m came back as {found:.4f}"


def radians(bench: Bench) -> str:
    """How far it turned, and which way."""
    made = drive(turn_radps=0.5)
    return turn_in_radians(last(bench.follow(made.frames)).theta, drive_end(made).theta)


def first_beam(bench: Bench) -> str:
    """When its poses are meant: after standing, a sweep's end is ahead of its beginning."""
    made = drive(20, 0.6, 0.5, standing=4)
    answers = bench.follow(made.frames)[-8:]
    late = []
    for answer, truth, then in zip(answers[:-1], made.truth[-8:-1], made.truth[-7:], strict=True):
        if np.isnan(answer).any():
            continue
        scan = Pose.of(truth).inverse() @ Pose.of(then)
        off = Pose.of(truth).inverse() @ Pose.of(answer)
        late.append((off.x * scan.x + off.y * scan.y) / (scan.x**2 + scan.y**2))
    if not late:
        raise Broken("it has no answer to any of the last 7 scans")
    share = float(np.mean(late))
    if abs(share) > BEAM_SHARE:
        raise Broken(
            f"on average the answers are {share:+.2f} of a scan's duration away from its first beam "
            "(0.5: a scan that is not deskewed; 1: the pose of its last beam)"
        )
    return f"{share:+.2f} of a scan's duration away from its first beam"


def mounting(bench: Bench) -> str:
    """A lidar that sits aside and looks to the left."""
    return _on_track(bench, drive(base_from_sensor=QUARTER_TURN), "with the lidar turned by 90 degrees")


def without_odometry(bench: Bench) -> str:
    """A recording without wheel odometry."""
    made = drive(odometry_gain=None)
    try:
        return _on_track(bench, made, "without wheel odometry")
    except EvalkitError as error:
        raise NotApplicable(f"it says that it needs wheel odometry: {error}") from error


def odometry_gap(bench: Bench) -> str:
    """Wheel odometry that falls silent for two scans."""
    made = drive()
    silent = tuple(
        replace(frame, odom_from_base=None, start_from_end=None) if index in (6, 7) else frame
        for index, frame in enumerate(made.frames)
    )
    return _on_track(bench, replace(made, frames=silent), "with two scans without wheel odometry")


def no_hits(bench: Bench) -> str:
    """Scans of nothing but no-returns."""
    made = drive()
    blind = tuple(without_hits(frame) if index in (6, 7) else frame for index, frame in enumerate(made.frames))
    return _on_track(bench, replace(made, frames=blind), "with two scans without hits")


def no_hits_first(bench: Bench) -> str:
    """A first scan of nothing but no-returns."""
    made = drive()
    blind = (without_hits(made.frames[0]), *made.frames[1:])
    bench.follow(blind)
    return "answers finite poses"


def at_once(bench: Bench) -> str:
    """Scans whose beams are all fired at once."""
    return _on_track(bench, drive(sweeping=False), "with time_increment_ns = 0")


def equal_stamps(bench: Bench) -> str:
    """Two scans with one stamp."""
    made = drive(6)
    third = made.frames[3]
    twin = replace(third, scan=replace(third.scan, stamp_ns=made.frames[2].scan.stamp_ns))
    try:
        bench.follow((*made.frames[:3], twin, *made.frames[4:]))
    except Broken:
        raise
    except Exception as error:  # noqa: BLE001 - refusing is allowed, and it is the back end's own exception
        return raised(error)
    return "answers finite poses"


def fresh(bench: Bench) -> str:
    """Two objects in turns."""
    one, other = drive(8), drive(8, 0.2, -0.3)
    alone = bench.follow(one.frames)
    first, second = bench.make(), bench.make()
    answers = []
    for frame, between in zip(one.frames, other.frames, strict=True):
        answers.append(answered(first, frame))
        answered(second, between)
    if not np.array_equal(alone, answers, equal_nan=True):
        raise Broken("a second object that follows another drive changes the first one's answers: they share state")
    return "two objects in turns answer as each alone"


def deterministic(bench: Bench) -> str:
    """The same drive, followed by fresh objects."""
    made = drive(10)
    once = bench.follow(made.frames)
    for _ in range(2):
        if not np.array_equal(once, again := bench.follow(made.frames), equal_nan=True):
            scan = int(np.argmax((once != again).any(axis=1)))
            raise Broken(f"the same drive has another answer at scan {scan + 1}: {again[scan]} and before {once[scan]}")
    return "3 fresh objects agree to the bit"


def read_only(bench: Bench) -> str:
    """Its arguments."""
    made = drive(4)
    before = [frame.scan.ranges.tobytes() + frame.scan.angles.tobytes() for frame in made.frames]
    try:
        bench.follow(made.frames)
    except ValueError as error:
        if "read-only" in str(error) or "not writeable" in str(error):
            raise Broken(f"it tries to write into a scan ({error}): work on a copy") from error
        raise
    if [frame.scan.ranges.tobytes() + frame.scan.angles.tobytes() for frame in made.frames] != before:
        raise Broken("a scan is not the same after the call: work on a copy")
    return "all scans are the same after the call"


def memory(bench: Bench) -> str:
    """What stays behind of each scan of a robot that stands still."""
    frame = drive(1, standing=1).frames[0]
    odometry = bench.make()
    stamps = iter(range(frame.scan.stamp_ns, 2**62, 100_000_000))
    return grown_bytes(
        lambda: answered(odometry, replace(frame, scan=replace(frame.scan, stamp_ns=next(stamps)))), LEAK_BYTES
    )


def drive_end(made: Drive) -> Pose:
    """The true pose at the last scan's first beam."""
    return Pose.of(made.truth[-1])


def _wheels(made: Drive) -> Pose:
    begin, end = made.frames[0].odom_from_base, made.frames[-1].odom_from_base
    return begin.inverse() @ end if begin is not None and end is not None else Pose()


def _on_track(bench: Bench, made: Drive, how: str) -> str:
    answer, truth = last(bench.follow(made.frames)), drive_end(made)
    left = truth.inverse() @ answer
    gap = f"{100 * math.hypot(left.x, left.y):.1f} cm and {math.degrees(abs(left.theta)):.1f} deg off after 0.6 m"
    if away(answer, truth) > ON_TRACK_M:
        raise Broken(f"{how}: {gap}: {told(answer)} instead of {told(truth)}")
    return f"{how}: {gap}"


RULES = table(
    Rule("starts", "It is made from its parameters and answers finite poses.", starts),
    Rule("first", "The first answer is the identity.", first),
    Rule("follows", "It follows a drive whose wheel odometry is true.", follows),
    Rule("moves", "It mends wheels that overstate every motion by 20 %.", moves),
    Rule("metres", "A drive of 0.6 m ahead comes back as 0.6 m ahead.", metres),
    Rule("radians", "A turn to the left comes back as a positive angle in radians.", radians),
    Rule("first-beam", "Answers are the poses when a scan's first beam was fired.", first_beam),
    Rule("mounting", "Poses are the base's, however the lidar is mounted.", mounting),
    Rule("without-odometry", "Without wheel odometry it follows, or says that it needs it.", without_odometry),
    Rule("odometry-gap", "It bridges a gap in the wheel odometry.", odometry_gap),
    Rule("no-hits", "It survives scans without a single hit, and goes on.", no_hits),
    Rule("no-hits-first", "It survives a first scan without a single hit.", no_hits_first),
    Rule("all-at-once", "It follows scans whose beams are fired at once.", at_once),
    Rule("equal-stamps", "Two scans with one stamp: an answer or an exception, never a crash.", equal_stamps),
    Rule("fresh", "Two objects do not share state.", fresh),
    Rule("deterministic", "The same drive has the same answers, to the bit.", deterministic),
    Rule("read-only", "It does not write into its arguments.", read_only),
    Rule("memory", "Scans of a robot that stands still leave no memory behind.", memory),
)
