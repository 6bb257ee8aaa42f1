"""What a data set must keep, rule by rule, asked of its first frames in this process."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property
from itertools import islice, pairwise

import numpy as np

from evalkit.commands.validate.rules.rule import Broken, Conformance, NotApplicable, Rule, table, verdict
from evalkit.core.errors import DataMissing, EvalkitError
from evalkit.core.ground_truth import Truth
from evalkit.core.pose import Pose
from evalkit.core.scan import Frame
from evalkit.plugins import registry
from evalkit.plugins.address import address_of, spec_at
from evalkit.plugins.parameters import Value, resolve_parameters
from evalkit.plugins.protocols import Sequence
from evalkit.plugins.specs import DatasetSpec

COVERED = 0.5
"""Share of the frames that the truth must reach: recordings may begin before their reference does."""


class Bench:
    """A data set on the bench: opened once for most rules, because opening may be a simulation or a long file."""

    def __init__(self, spec: DatasetSpec, parameters: Mapping[str, Value], count: int) -> None:
        self.parameters, self.count, self.seeded = parameters, count, spec.seeded
        self._make = spec.make

    @cached_property
    def sequence(self) -> Sequence:
        """The one that most rules look at."""
        return self.opened()

    @cached_property
    def frames(self) -> list[Frame]:
        """The first frames of it."""
        return self.first(self.sequence)

    def opened(self, **changes: Value) -> Sequence:
        """A sequence of its own, with some parameters changed."""
        return self._make(**{**self.parameters, **changes})

    def first(self, sequence: Sequence) -> list[Frame]:
        """The frames of it that are looked at."""
        return list(islice(sequence.frames(), self.count))


def check(dataset: str | DatasetSpec, frames: int, parameters: Mapping[str, object]) -> Conformance:
    """What every rule finds about the first frames of a data set: a registered name, "module:SPEC", or a spec.

    Raises DataMissing where its files are not here, BadParameter or UnknownName for parameters.
    """
    address = address_of(dataset)
    spec = spec_at(address, DatasetSpec, registry.dataset)
    complete = resolve_parameters(address.label, spec.parameters, parameters)
    if why := spec.missing(**{name: value for name, value in complete.items() if name != "seed"}):
        raise DataMissing(address.label, "cannot be checked here", why)
    bench = Bench(spec, complete, frames)
    return Conformance(address.label, tuple(verdict(rule, bench) for rule in RULES.values()))


def opens(bench: Bench) -> str:
    """It opens, and gives frames with hits."""
    frames = bench.frames
    if not frames:
        raise Broken("there is no frame")
    strange = next((frame for frame in frames if not isinstance(frame, Frame)), None)
    if strange is not None:
        raise Broken(f"frames() gives a {type(strange).__name__}, expected an evalkit.Frame")
    hits = sum(int(frame.scan.hits.sum()) for frame in frames)
    if not hits:
        raise Broken(f"no beam of {len(frames)} frames met anything")
    return f"{hits // len(frames)} hits a scan"


def again(bench: Bench) -> str:
    """frames() twice, and a second object."""
    once = bench.frames
    _alike(once, bench.first(bench.sequence), "frames() called again")
    _alike(once, bench.first(bench.opened()), "a second object with the same parameters")
    return f"{len(once)} frames agree to the bit"


def seeds(bench: Bench) -> str:
    """Another seed."""
    if not bench.seeded:
        raise NotApplicable("it has no seed")
    seed = int(bench.parameters["seed"])
    other = bench.first(bench.opened(seed=seed + 1))
    if [_bits(frame) for frame in bench.frames] == [_bits(frame) for frame in other]:
        raise Broken(f"seeds {seed} and {seed + 1} give the same frames")
    return f"seeds {seed} and {seed + 1} differ"


def stamps(bench: Bench) -> str:
    """The order of time."""
    found = [frame.scan.stamp_ns for frame in bench.frames]
    for index, (before, now) in enumerate(pairwise(found)):
        if now <= before:
            raise Broken(f"frame {index + 2} is stamped {now} ns, the one before {before} ns")
    odd = next((stamp for stamp in found if not isinstance(stamp, (int, np.integer))), None)
    if odd is not None:
        raise Broken(f"a stamp is {odd!r}, expected whole nanoseconds")
    return f"{len(found)} stamps, {(found[-1] - found[0]) * 1e-9:.2f} s"


def length(bench: Bench) -> str:
    """How many frames it says there are."""
    said, found = len(bench.sequence), len(bench.frames)
    if found < min(said, bench.count) or found > said:
        raise Broken(f"len() says {said}, {found} frames came when {bench.count} were asked for")
    return f"len() says {said}, {found} were looked at"


def odometry(bench: Bench) -> str:
    """Wheel odometry, between scans and within them."""
    given = [frame.odom_from_base is not None for frame in bench.frames]
    within = [frame.start_from_end is not None for frame in bench.frames]
    if alone := sum(inside and not between for inside, between in zip(within, given, strict=True)):
        raise Broken(f"{alone} of {len(given)} frames have start_from_end but no odom_from_base")
    return f"in {sum(given)} of {len(given)} frames, within the scan in {sum(within)}"


def truth(bench: Bench) -> str:
    """What the estimates are held against."""
    known = bench.sequence.truth()
    if not isinstance(known, Truth):
        raise Broken(f"truth() answers a {type(known).__name__}, expected an evalkit.Truth")
    if not known.how:
        raise Broken("truth().how is empty: say how it was made, for the reader of a report")
    if known.trajectory is None:
        return f"no trajectory; {known.how}"
    found = np.array([frame.scan.stamp_ns for frame in bench.frames])
    span = known.trajectory.stamps_ns
    inside = float(((found >= span[0]) & (found <= span[-1])).mean()) if len(span) else 0.0
    if inside < COVERED:
        raise Broken(f"the true trajectory reaches {100 * inside:.0f} % of the frames: are both on the same clock?")
    return f"the true trajectory reaches {100 * inside:.0f} % of the frames; {known.how}"


def mounting(bench: Bench) -> str:
    """Where the lidar sits."""
    found = {frame.base_from_sensor for frame in bench.frames}
    if len(found) > 1:
        raise Broken(f"base_from_sensor changes: {len(found)} different ones in {len(bench.frames)} frames")
    pose = found.pop() if found else Pose()
    return f"({pose.x:.3f} m, {pose.y:.3f} m, {pose.theta:.3f} rad)"


def notes(bench: Bench) -> str:
    """Defects, counted by name."""
    found = bench.sequence.notes()
    for name, count in found.items():
        if not isinstance(name, str) or not isinstance(count, (int, np.integer)) or count < 0:
            raise Broken(f"notes() has {name!r}: {count!r}, expected a name and a count")
    return ", ".join(f"{name}: {count}" for name, count in found.items()) or "none"


def declared(bench: Bench) -> str:
    """Every parameter it declares can be given."""
    try:
        _ = bench.sequence
    except EvalkitError:
        raise
    except TypeError as error:
        raise Broken(f"make() refuses its own parameters: {error}") from error
    return f"takes {', '.join(bench.parameters) or 'none'}"


def _alike(once: list[Frame], other: list[Frame], how: str) -> None:
    if len(once) != len(other):
        raise Broken(f"{how} gives {len(other)} frames instead of {len(once)}")
    for index, (before, now) in enumerate(zip(once, other, strict=True)):
        if _bits(before) != _bits(now):
            raise Broken(f"{how} gives another frame {index + 1}")


def _bits(frame: Frame) -> tuple[object, ...]:
    scan = frame.scan
    return (
        scan.stamp_ns, scan.ranges.tobytes(), scan.angles.tobytes(), scan.time_increment_ns, scan.range_min_m,
        scan.range_max_m, frame.base_from_sensor, frame.odom_from_base, frame.start_from_end,
    )  # fmt: skip


RULES = table(
    Rule("parameters", "It is made from the parameters it declares.", declared),
    Rule("opens", "It gives frames whose beams meet something.", opens),
    Rule("again", "frames() may be called again and gives the same, as does a second object.", again),
    Rule("seeds", "Another seed gives other frames.", seeds),
    Rule("stamps", "Stamps are whole nanoseconds and strictly increasing.", stamps),
    Rule("length", "There are as many frames as len() says.", length),
    Rule("odometry", "Who knows the motion within a scan knows the motion between scans.", odometry),
    Rule("mounting", "The lidar stays where it is.", mounting),
    Rule("truth", "The truth says how it was made and lies on the clock of the scans.", truth),
    Rule("notes", "Defects are counts by name.", notes),
)
