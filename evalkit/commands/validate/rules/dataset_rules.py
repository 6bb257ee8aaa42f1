"""The rules of a data set, checked on its first frames in this process."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from functools import cached_property
from itertools import islice, pairwise

import numpy as np

from evalkit.commands.validate.rules.rule import (
    RuleBroken,
    RuleNotApplicable,
    RuleNotJudged,
    RuleReport,
    check_rules_once,
    require_accepted,
    rule_table,
)
from evalkit.core.errors import DataMissing, brief
from evalkit.core.ground_truth import Truth
from evalkit.core.pose import Pose
from evalkit.core.scan import Frame
from evalkit.core.trajectory import Trajectory
from evalkit.plugins.address import dataset_at, label_of
from evalkit.plugins.parameters import Value, resolve_parameters
from evalkit.plugins.protocols import Sequence
from evalkit.plugins.specs import DatasetSpec

COVERED = 0.5
"""The share of the frames that the truth must cover."""


MAX_SPAN_RAD = 4.0 * math.pi

MOVES_M = 0.05
OTHER_UNIT = 50.0
"""Truth and odometry that both move, one of them so many times as far, are not in the same unit."""


class DatasetFixture:
    """A data set under test, opened once for most rules because opening may run a simulation or read a long file."""

    def __init__(self, spec: DatasetSpec, parameters: Mapping[str, Value], count: int) -> None:
        self.parameters, self.count, self.seeded = parameters, count, spec.seeded
        self._make = spec.make

    @cached_property
    def sequence(self) -> Sequence:
        """The sequence that most rules use."""
        return self.open()

    @cached_property
    def frames(self) -> list[Frame]:
        """Its first frames. Raises RuleNotJudged if there are none, which breaks the rule opens alone."""
        if not (found := self.read(self.sequence)):
            raise RuleNotJudged("there is no frame, see the rule opens")
        return found

    def open(self, **changes: Value) -> Sequence:
        """A new sequence, with some parameters changed."""
        return self._make(**{**self.parameters, **changes})

    def read(self, sequence: Sequence) -> list[Frame]:
        """The first ``count`` frames of a sequence."""
        return list(islice(sequence.frames(), self.count))


def check(dataset: str | DatasetSpec, frames: int, parameters: Mapping[str, object]) -> RuleReport:
    """The results of all rules on the first frames of a data set: a registered name, "module:SPEC", or a spec.

    Where one exception ends several rules, it breaks the first of them alone; the others are not judged.
    Raises DataMissing if its files are not here, BadParameter or UnknownName for parameters.
    """
    spec = dataset_at(dataset)
    label = label_of(dataset, "this data set")
    complete = resolve_parameters(label, spec.parameters, parameters)
    if why := spec.missing(**{name: value for name, value in complete.items() if name != "seed"}):
        raise DataMissing(label, "cannot be checked here", why)
    fixture = DatasetFixture(spec, complete, frames)
    return RuleReport(label, check_rules_once(RULES, fixture))


def check_opens(fixture: DatasetFixture) -> str:
    """Its frames have returns."""
    try:
        frames = fixture.frames
    except RuleNotJudged:
        raise RuleBroken("there is no frame") from None
    strange = next((frame for frame in frames if not isinstance(frame, Frame)), None)
    if strange is not None:
        raise RuleBroken(f"frames() yields a {type(strange).__name__}, expected an evalkit.Frame")
    hits = sum(int(frame.scan.hits.sum()) for frame in frames)
    if not hits:
        raise RuleBroken(f"no beam of {len(frames)} frames has a return")
    return f"{hits // len(frames)} returns per scan"


def check_again(fixture: DatasetFixture) -> str:
    """A second call of frames() and a second object yield the same frames."""
    once = fixture.frames
    _require_equal(once, fixture.read(fixture.sequence), "frames() called again")
    _require_equal(once, fixture.read(fixture.open()), "a second object with the same parameters")
    return f"{len(once)} frames agree to the bit"


def check_seeds(fixture: DatasetFixture) -> str:
    """Another seed yields other frames."""
    if not fixture.seeded:
        raise RuleNotApplicable("it has no seed")
    seed = int(fixture.parameters["seed"])
    other = fixture.read(fixture.open(seed=seed + 1))
    if [_bits(frame) for frame in fixture.frames] == [_bits(frame) for frame in other]:
        raise RuleBroken(f"seeds {seed} and {seed + 1} give the same frames")
    return f"seeds {seed} and {seed + 1} differ"


def check_stamps(fixture: DatasetFixture) -> str:
    """Stamps are whole nanoseconds and strictly increasing."""
    stamps = [frame.scan.stamp_ns for frame in fixture.frames]
    for index, (before, now) in enumerate(pairwise(stamps)):
        if now <= before:
            raise RuleBroken(f"frame {index + 2} is stamped {now} ns, the one before {before} ns")
    odd = next((stamp for stamp in stamps if not isinstance(stamp, (int, np.integer))), None)
    if odd is not None:
        raise RuleBroken(f"a stamp is {odd!r}, expected whole nanoseconds")
    return f"{len(stamps)} stamps, {(stamps[-1] - stamps[0]) * 1e-9:.2f} s"


def check_length(fixture: DatasetFixture) -> str:
    """len() is the number of frames."""
    announced, count = len(fixture.sequence), len(fixture.frames)
    if count < min(announced, fixture.count) or count > announced:
        raise RuleBroken(f"len() is {announced}, but the first {fixture.count} frames are {count}")
    return f"len() is {announced}, {count} frames were read"


def check_angles(fixture: DatasetFixture) -> str:
    """The beams of a scan cover two turns at most, in radians."""
    spans = [float(np.ptp(frame.scan.angles)) for frame in fixture.frames if len(frame.scan.angles)]
    widest = max(spans, default=0.0)
    if widest > MAX_SPAN_RAD:
        raise RuleBroken(f"the angles of a scan span {widest:.4g} rad: are they in degrees?")
    return f"at most {math.degrees(widest):.1f} deg"


def check_odometry(fixture: DatasetFixture) -> str:
    """A frame with the motion within a scan also has the motion between scans."""
    for name in ("odom_from_base", "start_from_end"):
        values = [getattr(frame, name) for frame in fixture.frames]
        strange = next((one for one in values if one is not None and not isinstance(one, Pose)), None)
        if strange is not None:
            raise RuleBroken(f"{name} is {brief(strange)}, expected an evalkit.Pose or None")
    given = [frame.odom_from_base is not None for frame in fixture.frames]
    within = [frame.start_from_end is not None for frame in fixture.frames]
    if alone := sum(inside and not between for inside, between in zip(within, given, strict=True)):
        raise RuleBroken(f"{alone} of {len(given)} frames have start_from_end but no odom_from_base")
    return f"in {sum(given)} of {len(given)} frames, within the scan in {sum(within)}"


def check_truth(fixture: DatasetFixture) -> str:
    """The truth describes its origin and uses the clock of the scans."""
    known = fixture.sequence.truth()
    if not isinstance(known, Truth):
        raise RuleBroken(f"truth() returns a {type(known).__name__}, expected an evalkit.Truth")
    if not known.how:
        raise RuleBroken("truth().how is empty: describe how the truth was determined")
    if known.trajectory is None:
        return f"no trajectory; {known.how}"
    if not len(known.trajectory):
        raise RuleBroken("the true trajectory has no pose")
    which, inside = f"first {len(fixture.frames)} frames", _share_covered(known.trajectory, fixture.frames)
    if inside < COVERED:  # recordings may begin long before their reference
        which, inside = "frames", _share_covered(known.trajectory, fixture.sequence.frames())
    said = f"the true trajectory covers {100 * inside:.0f} % of the {which}"
    if inside < COVERED:
        raise RuleBroken(f"{said}: are both on the same clock?")
    _require_one_unit(fixture.frames, known.trajectory)
    return f"{said}; {known.how}"


def _share_covered(truth: Trajectory, frames: Iterable[Frame]) -> float:
    """Return the share of frames within the time of the truth; 0 without frames."""
    covered = [truth.stamps_ns[0] <= frame.scan.stamp_ns <= truth.stamps_ns[-1] for frame in frames]
    return float(np.mean(covered)) if covered else 0.0


def _require_one_unit(frames: list[Frame], truth: Trajectory) -> None:
    """Raise RuleBroken where the truth moves so much farther than the odometry, or less, that one is no metres."""
    within = [frame for frame in frames if truth.stamps_ns[0] <= frame.scan.stamp_ns <= truth.stamps_ns[-1]]
    known = [(frame.scan.stamp_ns, frame.odom_from_base) for frame in within if frame.odom_from_base is not None]
    if not known:
        return
    stamps = np.array([stamp for stamp, _ in known])
    measured = np.array([(pose.x, pose.y) for _, pose in known])
    true = np.stack([np.interp(stamps, truth.stamps_ns, truth.poses[:, axis]) for axis in (0, 1)], axis=1)
    far_m, true_m = (float(np.linalg.norm(path - path[0], axis=1).max()) for path in (measured, true))
    if min(far_m, true_m) > MOVES_M and not 1.0 / OTHER_UNIT < far_m / true_m < OTHER_UNIT:
        raise RuleBroken(
            f"in the same frames the truth moves by {true_m:.3g} m, the odometry by {far_m:.3g} m: is one in mm?"
        )


def check_mounting(fixture: DatasetFixture) -> str:
    """The mounting of the lidar does not change."""
    mountings = {frame.base_from_sensor for frame in fixture.frames}
    if len(mountings) > 1:
        raise RuleBroken(f"base_from_sensor changes: {len(mountings)} different values in {len(fixture.frames)} frames")
    pose = mountings.pop() if mountings else Pose()
    return f"({pose.x:.3f} m, {pose.y:.3f} m, {pose.theta:.3f} rad)"


def check_notes(fixture: DatasetFixture) -> str:
    """Defects are counts by name."""
    notes: object = fixture.sequence.notes()
    if not isinstance(notes, Mapping):
        raise RuleBroken(f"notes() returns a {type(notes).__name__}, expected a mapping of names to counts")
    for name, count in notes.items():
        if not isinstance(name, str) or not isinstance(count, (int, np.integer)) or count < 0:
            raise RuleBroken(f"notes() has {name!r}: {count!r}, expected a name and a count")
    return ", ".join(f"{name}: {count}" for name, count in notes.items()) or "none"


def check_parameters(fixture: DatasetFixture) -> str:
    """It can be created with the parameters it declares."""
    require_accepted(lambda: fixture.sequence)
    return f"accepts {', '.join(fixture.parameters) or 'none'}"


def _require_equal(once: list[Frame], other: list[Frame], how: str) -> None:
    if len(once) != len(other):
        raise RuleBroken(f"{how} yields {len(other)} frames instead of {len(once)}")
    for index, (before, now) in enumerate(zip(once, other, strict=True)):
        if _bits(before) != _bits(now):
            raise RuleBroken(f"{how} yields another frame {index + 1}")


def _bits(frame: Frame) -> tuple[object, ...]:
    scan = frame.scan
    return (
        scan.stamp_ns, scan.ranges.tobytes(), scan.angles.tobytes(), scan.time_increment_ns, scan.range_min_m,
        scan.range_max_m, frame.base_from_sensor, frame.odom_from_base, frame.start_from_end,
    )  # fmt: skip


RULES = rule_table(
    check_parameters, check_opens, check_again, check_seeds, check_stamps, check_length, check_angles, check_odometry,
    check_mounting, check_truth, check_notes,
)  # fmt: skip
