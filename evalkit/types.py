"""The values that cross evalkit's seams: frozen, checked once at birth, metres, radians, integer nanoseconds.

Frames follow REP-103 and REP-105: x forward, y left, right-handed; ``a_from_b`` takes coordinates in b to a.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from evalkit import se2
from evalkit.se2 import Floats, Stamps
from evalkit.tape import Span

Bools = NDArray[np.bool_]
Ints = NDArray[np.int64]

Status = Literal[
    "complete", "failed", "crashed", "timeout", "out-of-memory", "not-installed", "data-missing", "skipped"
]
"""How a run ended; "skipped": it was not made, and may be."""


@dataclass(frozen=True, slots=True)
class Pose:
    """A rigid motion of the plane, ``a_from_b``: x, y in metres, theta in radians within [-pi, pi)."""

    x: float = 0.0
    y: float = 0.0
    theta: float = 0.0

    def __post_init__(self) -> None:
        if not np.isfinite([self.x, self.y, self.theta]).all():
            raise ValueError(f"pose: not finite: ({self.x}, {self.y}, {self.theta})")
        object.__setattr__(self, "theta", float(se2.wrap(self.theta)))

    @classmethod
    def of(cls, row: ArrayLike) -> Pose:
        """The pose of a row (3,) of x, y, theta."""
        x, y, theta = np.asarray(row, dtype=np.float64)
        return cls(float(x), float(y), float(theta))

    @property
    def row(self) -> Floats:
        """x, y, theta as an array (3,)."""
        return np.array([self.x, self.y, self.theta])

    def __matmul__(self, other: Pose) -> Pose:
        """``a_from_c`` for ``a_from_b @ b_from_c``."""
        return Pose.of(se2.compose(self.row, other.row))

    def inverse(self) -> Pose:
        """``b_from_a``."""
        return Pose.of(se2.inverse(self.row))

    def transform(self, points: ArrayLike) -> Floats:
        """Points (N, 2) of frame b in frame a."""
        return se2.transform(self.row, points)


@dataclass(frozen=True, eq=False)
class Scan:
    """One revolution or sweep of a planar lidar, in the sensor's frame.

    ``stamp_ns``: time of the first beam. ``ranges`` (B,) in metres: finite within the limits, ``inf`` for no return,
    ``nan`` for invalid. ``angles`` (B,) in radians, counter-clockwise from the sensor's x axis, in the order the beams
    were fired. ``time_increment_ns``: time between two beams (0: all at once).
    """

    stamp_ns: int
    ranges: Floats
    angles: Floats
    range_min_m: float
    range_max_m: float
    time_increment_ns: int = 0

    def __post_init__(self) -> None:
        _freeze(self, "ranges", self.ranges, (None,))
        _freeze(self, "angles", self.angles, (len(self.ranges),))
        if not np.isfinite(self.angles).all():
            raise ValueError("angles: not finite")
        if not 0.0 <= self.range_min_m < self.range_max_m:
            raise ValueError(f"range limits: expected 0 <= min < max, got {self.range_min_m} and {self.range_max_m} m")
        if self.time_increment_ns < 0:
            raise ValueError(f"time_increment_ns: negative: {self.time_increment_ns}")
        finite = np.isfinite(self.ranges)
        outside = finite & ((self.ranges < self.range_min_m) | (self.ranges > self.range_max_m))
        if outside.any() or np.isneginf(self.ranges).any():
            beam = int(np.argmax(outside | np.isneginf(self.ranges)))
            raise ValueError(
                f"ranges: {self.ranges[beam]} m at beam {beam} lies outside "
                f"[{self.range_min_m}, {self.range_max_m}] m; mark no return as inf and invalid as nan"
            )

    @property
    def hits(self) -> Bools:
        """Which beams (B,) met something."""
        return np.isfinite(self.ranges)

    @property
    def no_returns(self) -> Bools:
        """Which beams (B,) met nothing within range."""
        return np.isposinf(self.ranges)

    @property
    def duration_ns(self) -> int:
        """Time from the first beam to the last."""
        return self.time_increment_ns * max(len(self.ranges) - 1, 0)

    def points(self) -> Floats:
        """The hits (N, 2) in the sensor frame, in firing order."""
        hits = self.hits
        return _polar(self.ranges[hits], self.angles[hits])

    def deskewed(self, base_from_sensor: Pose, start_from_end: Pose | None) -> Scan:
        """The same scan as if every beam had been fired at ``stamp_ns``, for a base that moves steadily meanwhile.

        ``start_from_end`` is the motion of the *base* from the first beam to the last; None: unknown, nothing changes.
        Hits move, no-returns turn, and the range limits widen where a moved hit needs it.
        """
        if start_from_end is None or len(self.ranges) < 2 or self.time_increment_ns == 0:
            return self
        share = np.arange(len(self.ranges)) / (len(self.ranges) - 1)
        start_from_beam = se2.fraction(start_from_end.row, share)
        sensor_from_moved = se2.compose(
            base_from_sensor.inverse().row, se2.compose(start_from_beam, base_from_sensor.row)
        )
        hits = self.hits
        moved = se2.transform_each(sensor_from_moved[hits], self.points())
        ranges, angles = self.ranges.copy(), self.angles + sensor_from_moved[:, 2]
        ranges[hits] = np.hypot(moved[:, 0], moved[:, 1])
        angles[hits] = np.arctan2(moved[:, 1], moved[:, 0])
        low = min(self.range_min_m, float(ranges[hits].min(initial=self.range_min_m)))
        high = max(self.range_max_m, float(ranges[hits].max(initial=self.range_max_m)))
        return Scan(self.stamp_ns, ranges, angles, low, high, 0)


@dataclass(frozen=True, eq=False)
class Cloud:
    """Points (N, 2) in metres in a named frame; never nan or inf; may be empty."""

    points: Floats
    frame: str = "base"

    def __post_init__(self) -> None:
        _freeze(
            self, "points", np.reshape(self.points, (0, 2)) if np.size(self.points) == 0 else self.points, (None, 2)
        )
        if not np.isfinite(self.points).all():
            row = int(np.argmax(~np.isfinite(self.points).all(axis=1)))
            raise ValueError(f"points: not finite at row {row}: {self.points[row].tolist()}")

    def __len__(self) -> int:
        return len(self.points)


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """One scan with all a back end may know about it.

    ``base_from_sensor``: where the lidar sits. ``odom_from_base``: the wheel odometry's pose of the base when the first
    beam was fired, None where a recording has none. ``start_from_end``: what the odometry says the base moved from
    the first beam to the last, None where unknown.
    """

    scan: Scan
    base_from_sensor: Pose = field(default_factory=Pose)
    odom_from_base: Pose | None = None
    start_from_end: Pose | None = None


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Poses (N, 3) ``parent_from_child`` at strictly increasing ``stamps_ns`` (N,)."""

    stamps_ns: Stamps
    poses: Floats
    parent: str = "world"
    child: str = "base"

    def __post_init__(self) -> None:
        stamps = np.array(self.stamps_ns, dtype=np.int64)
        if stamps.ndim != 1:
            raise ValueError(f"stamps_ns: expected shape (N,), got {stamps.shape}")
        if (backwards := np.flatnonzero(np.diff(stamps) <= 0)).size:
            raise ValueError(f"stamps_ns: not increasing at index {int(backwards[0]) + 1}")
        stamps.flags.writeable = False
        object.__setattr__(self, "stamps_ns", stamps)
        _freeze(self, "poses", np.reshape(self.poses, (0, 3)) if len(stamps) == 0 else self.poses, (len(stamps), 3))
        if not np.isfinite(self.poses).all():
            raise ValueError(f"poses: not finite at index {int(np.argmax(~np.isfinite(self.poses).all(axis=1)))}")

    def __len__(self) -> int:
        return len(self.stamps_ns)

    @property
    def duration_s(self) -> float:
        """Seconds from the first pose to the last."""
        return float(self.stamps_ns[-1] - self.stamps_ns[0]) * 1e-9 if len(self) else 0.0

    @property
    def path_m(self) -> float:
        """Metres travelled, summed from pose to pose."""
        return float(np.linalg.norm(np.diff(self.poses[:, :2], axis=0), axis=1).sum())

    def at(self, stamps_ns: ArrayLike) -> Floats:
        """The poses (K, 3) at given times, interpolated; ValueError outside the span."""
        return se2.interpolate(self.stamps_ns, self.poses, stamps_ns)

    def moved(self, new_from_parent: Pose, parent: str | None = None) -> Trajectory:
        """The same trajectory in another parent frame."""
        return Trajectory(
            self.stamps_ns, se2.compose(new_from_parent.row, self.poses), parent or self.parent, self.child
        )


@dataclass(frozen=True, eq=False)
class OccupancyGrid:
    """Log-odds (H, W) of occupancy, and which cells were ever touched by a beam.

    Row 0 is the lowest y, column 0 the lowest x; ``(origin_x, origin_y)`` is the lower left *corner* of cell (0, 0) in
    the world frame (m). 0 is as likely occupied as free: p = 1 / (1 + exp(-l)) (paper, eq. 10).
    """

    log_odds: NDArray[np.float32]
    observed: Bools
    resolution_m: float
    origin_x: float
    origin_y: float

    def __post_init__(self) -> None:
        _freeze(self, "log_odds", self.log_odds, (None, None), np.float32)
        _freeze(self, "observed", self.observed, self.log_odds.shape, np.bool_)
        if not self.resolution_m > 0.0:
            raise ValueError(f"resolution_m: expected a positive number, got {self.resolution_m}")

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        rows, columns = self.log_odds.shape
        return rows, columns

    def probability(self) -> Floats:
        """The probability of occupancy (H, W); 0.5 where nothing was seen."""
        with np.errstate(over="ignore"):  # a mapper without bounds: exp is inf where the probability is 0
            return np.asarray(1.0 / (1.0 + np.exp(-self.log_odds.astype(np.float64))))

    def occupied(self, threshold: float = 0.65) -> Bools:
        """Observed cells (H, W) with a probability above the threshold (map_server's default)."""
        return np.asarray(self.observed & (self.log_odds > _log_odds(threshold)))

    def free(self, threshold: float = 0.196) -> Bools:
        """Observed cells (H, W) with a probability below the threshold (map_server's default)."""
        return np.asarray(self.observed & (self.log_odds < _log_odds(threshold)))

    def centres(self, cells: Bools) -> Floats:
        """The centres (N, 2) in the world (m) of the cells marked in a mask (H, W)."""
        cell = np.argwhere(cells)[:, ::-1].astype(np.float64)  # column and row: x and y
        return np.asarray([self.origin_x, self.origin_y] + (cell + 0.5) * self.resolution_m)


@dataclass(frozen=True, eq=False)
class Relations:
    """Measured motions between pairs of times (Kuemmerle 2009): ``first_from_second`` (M, 3) of the robot's base."""

    first_ns: Stamps
    second_ns: Stamps
    first_from_second: Floats

    def __post_init__(self) -> None:
        _freeze(self, "first_ns", self.first_ns, (None,), np.int64)
        _freeze(self, "second_ns", self.second_ns, (len(self.first_ns),), np.int64)
        _freeze(self, "first_from_second", self.first_from_second, (len(self.first_ns), 3))

    def __len__(self) -> int:
        return len(self.first_ns)


@dataclass(frozen=True, eq=False)
class Truth:
    """What is known about a sequence beyond its scans; any part may be None.

    ``how`` says how it was made ("exact: simulated", "graph-optimised poses, ~3 cm"), for the reader of a report.
    ``plan``: a map of the place in a frame of its own, to be looked at: nothing is scored against it. ``spans``:
    distances measured with a tape.
    """

    how: str
    trajectory: Trajectory | None = None
    relations: Relations | None = None
    grid: OccupancyGrid | None = None
    plan: OccupancyGrid | None = None
    spans: tuple[Span, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class Iteration:
    """One step of an iterative registration: the error (m) and pairs before it, the pose after it, the pairs if traced.

    ``pairs`` (K, 2): indices into source and target, or None.
    """

    error: float
    inliers: int
    target_from_source: Pose
    pairs: Ints | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Match:
    """A registration's answer. Not converging is an answer, not an error.

    ``error``: the back end's own final error in metres (nan where it has none). ``inliers``: pairs it stands on.
    ``history``: one entry per iteration where the back end can tell.
    """

    target_from_source: Pose
    converged: bool
    iterations: int
    error: float
    inliers: int
    history: tuple[Iteration, ...] = ()


STEP = np.dtype(
    [
        ("stamp_ns", "i8"), ("x", "f8"), ("y", "f8"), ("theta", "f8"),
        ("wall_ns", "i8"), ("cpu_ns", "i8"), ("conversion_ns", "i8"), ("harness_ns", "i8"), ("device_ns", "i8"),
        ("s2s_error", "f8"), ("s2s_iterations", "i4"), ("s2s_inliers", "i4"),
        ("s2m_error", "f8"), ("s2m_iterations", "i4"), ("s2m_inliers", "i4"),
        ("s2s_believed", "i1"), ("s2s_converged", "i1"), ("s2m_believed", "i1"), ("s2m_converged", "i1"),
    ]
)  # fmt: skip
"""One scan of a run: answer ``start_from_base``, cost in ns, residuals in m (nan where a stage does not exist).

``device_ns`` is what the back end itself says it took; a cost of 0 is one nobody measured. ``believed``: 1 where the
stage's answer was taken, 0 where its guess was kept; ``converged``: 1 or 0; both -1 where there is no such stage or
nobody tells. An odometry that tells of itself is a second stage.
"""


@dataclass(frozen=True, eq=False)
class Run:
    """One back end over one sequence: what it answered, what it cost, and how it ended.

    ``steps`` (N,) of dtype ``STEP``: every scan answered before the end, kept whatever the status.
    ``expected``: scans in the sequence. ``peak_memory_bytes``: resident set of the run's process at its highest.
    ``every``: the sequence holds one in so many of the sensor's scans.
    """

    backend: str
    sequence: str
    status: Status
    reason: str
    steps: NDArray[np.void]
    expected: int
    peak_memory_bytes: int = 0
    warm_up_scans: int = 0
    notes: Mapping[str, int] = field(default_factory=dict)
    every: int = 1

    def __post_init__(self) -> None:
        _freeze(self, "steps", self.steps, (None,), STEP)
        if self.status != "complete" and not self.reason:
            raise ValueError(f"reason: a run that is {self.status} needs one")

    @property
    def estimate(self) -> Trajectory:
        """The answers as a trajectory ``start_from_base``."""
        steps = self.steps
        poses = np.stack([steps["x"], steps["y"], steps["theta"]], axis=-1)
        return Trajectory(steps["stamp_ns"], poses, "start", "base")


@dataclass(frozen=True, slots=True)
class Score:
    """One number of a run with what it stands on; ``value`` None means not meaningful here, and ``reason`` says why."""

    value: float | None
    support: int = 0
    reason: str = ""

    def __post_init__(self) -> None:
        if self.value is None and not self.reason:
            raise ValueError("reason: a score without a value needs one")
        if self.value is not None and not np.isfinite(self.value):
            raise ValueError(f"value: not finite: {self.value}; say None and why")


@dataclass(frozen=True, eq=False)
class Trial:
    """One row of a comparison: a contestant over a sequence, run, scored and mapped.

    ``contestant`` and ``sequence``: the labels in tables (``sequence`` without the seed). ``key``: content key of the
    results folder. ``command``: reproduces this row alone. ``world_from_start``: the alignment used for drawing and
    for the map. ``grid``: the map of the estimated trajectory, None where there is none. ``errors_m`` (N,): distance to
    the truth at each of ``run.steps`` after alignment, nan where unmatched; None without a true trajectory.
    ``alignment``: in words how estimate and truth were matched, or why not; "" without a true trajectory.
    ``processor``: of the machine the run was made on; "" where nobody knows.
    """

    key: str
    contestant: str
    backend: str
    backend_parameters: Mapping[str, bool | int | float | str]
    sequence: str
    dataset: str
    dataset_parameters: Mapping[str, bool | int | float | str]
    seed: int | None
    command: str
    run: Run
    truth: Truth
    scores: Mapping[str, Score]
    world_from_start: Pose = field(default_factory=Pose)
    grid: OccupancyGrid | None = None
    errors_m: Floats | None = None
    alignment: str = ""
    processor: str = ""


def _polar(ranges: Floats, angles: Floats) -> Floats:
    """The points (N, 2) of ranges (N,) and angles (N,): equation 1 of the paper, x forward."""
    return np.stack([ranges * np.cos(angles), ranges * np.sin(angles)], axis=-1)


def _log_odds(probability: float) -> np.float64:
    """Of a probability from 0 to 1; a float64, so that what is as probable in float32 is not rounded over it."""
    with np.errstate(divide="ignore"):
        return np.float64(np.log(probability) - np.log1p(-probability))


def _freeze(
    owner: object,
    name: str,
    value: ArrayLike,
    shape: tuple[int | None, ...],
    dtype: type | np.dtype[np.void] = np.float64,
) -> None:
    """Sets the field to a read-only array of that type, or says which field has the wrong shape."""
    array = np.array(value, dtype=dtype)
    if array.ndim != len(shape) or any(want not in (None, have) for want, have in zip(shape, array.shape, strict=True)):
        wanted = ", ".join("N" if size is None else str(size) for size in shape)
        raise ValueError(f"{name}: expected shape ({wanted}{',' if len(shape) == 1 else ''}), got {array.shape}")
    array.flags.writeable = False
    object.__setattr__(owner, name, array)
