"""The result of a run: status and cause (``run_status``), steps and cost; and its scores."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from evalkit.core.arrays import freeze
from evalkit.core.loop_closure import LoopClosure
from evalkit.core.path_correction import PathCorrection
from evalkit.core.pose import Pose
from evalkit.core.run_status import Cause, RunStatus
from evalkit.core.se2 import Floats
from evalkit.core.trajectory import Trajectory

if TYPE_CHECKING:
    from evalkit.core.grid import OccupancyGrid
    from evalkit.core.map_start import MapStart

STEP = np.dtype(
    [
        ("stamp_ns", "i8"), ("x", "f8"), ("y", "f8"), ("theta", "f8"),
        ("wall_ns", "i8"), ("cpu_ns", "i8"), ("conversion_ns", "i8"), ("harness_ns", "i8"), ("device_ns", "i8"),
        ("preparation_ns", "i8"),
        ("s2s_error", "f8"), ("s2s_iterations", "i4"), ("s2s_inliers", "i4"),
        ("s2m_error", "f8"), ("s2m_iterations", "i4"), ("s2m_inliers", "i4"),
        ("s2s_accepted", "i1"), ("s2s_converged", "i1"), ("s2m_accepted", "i1"), ("s2m_converged", "i1"),
        ("corrected", "i1"),
    ]
)  # fmt: skip
"""One scan of a run: answer ``start_from_base``, cost in ns, residuals in m (nan where a stage does not exist).

``device_ns``: time reported by the back end itself. A cost of 0 was not measured. ``accepted``: 1 where the answer of
the stage was accepted, 0 where its initial guess was kept; ``converged``: 1 or 0; both -1 where the stage does not
exist or does not report it. The reports of an odometry about itself fill the second stage (``s2m``). ``corrected``: 1
where a SLAM reports that it moved earlier poses, 0 that it did not, -1 where it does not report it.
"""


NO_STEPS = np.zeros(0, dtype=STEP)

DISTURBED = "disturbed"
"""Name of the runs that ``--rerun`` executes again because of their conditions, beside the statuses."""

MAX_PERCENT: Mapping[str, float] = {"other_percent": 5.0, "steal_percent": 2.0, "waited_percent": 5.0}
"""Beyond one of these a run was disturbed: its times say something about the machine too."""


@dataclass(frozen=True, slots=True)
class RunConditions:
    """The machine during a run; None: not known.

    ``load``: mean of the load averages over one minute before and after. ``mhz``: mean frequency. In percent of wall
    time: ``other_percent``, CPU time of other processes on the run's core; ``steal_percent``, time that the hypervisor
    took from it; ``waited_percent``, time the run's main thread was ready but not running. ``threads``: of the run's
    process at its end; ``busy_threads``: those that took at least 1 % of its CPU time. ``pools``: thread pools of the
    loaded libraries with their sizes, "" if not known.
    """

    load: float | None = None
    mhz: float | None = None
    other_percent: float | None = None
    steal_percent: float | None = None
    waited_percent: float | None = None
    threads: int | None = None
    busy_threads: int | None = None
    pools: str = ""

    def __post_init__(self) -> None:
        for item in fields(self):
            value = getattr(self, item.name)
            if item.name != "pools" and value is not None and not (0.0 <= value < np.inf):
                raise ValueError(f"{item.name}: expected a finite number from 0, got {value}")

    @property
    def disturbances(self) -> dict[str, float]:
        """What took more than a little of the run's core, in percent, by the names of ``MAX_PERCENT``."""
        taken = {name: getattr(self, name) or 0.0 for name in MAX_PERCENT}
        if (self.busy_threads or 1) > 1:
            del taken["waited_percent"]  # own threads wait for each other
        return {name: value for name, value in taken.items() if value > MAX_PERCENT[name]}

    @property
    def disturbed(self) -> bool:
        """Whether other processes or the hypervisor took more than a little of the run's core."""
        return bool(self.disturbances)

    def as_dict(self) -> dict[str, float | str | bool | None]:
        """All values with ``disturbed``, for JSON."""
        return {**asdict(self), DISTURBED: self.disturbed}


@dataclass(frozen=True, eq=False)
class RunResult:
    """How one run went: what the back end answered, what it cost, and why the run ended.

    ``steps`` (N,) of dtype ``STEP``: every scan answered before the end, whatever the status.
    ``expected``: number of scans in the sequence, 0 where it was not opened. ``reason``: the cause in words, with
    details; required unless the run completed. ``peak_memory_bytes``: largest resident set of the run's process.
    ``warm_up_scans``: scans given to a separate instance of the back end before timing starts. ``notes``: counts
    reported by the reader of the sequence. ``every``: the sequence holds one in ``every`` scans of the sensor.
    ``provenance``: when and on which machine the run was executed, with which versions and limits (JSON values).
    ``conditions``: what else the machine did meanwhile; None if the run was not executed. ``final``: the corrected
    ``start_from_base`` of all answered frames at the end, at the stamps of the steps, of a SLAM whose run is
    complete; ``loop_closures``: its candidates; ``final_cpu_ns``: CPU time of asking for both after the last scan.
    ``start``: where the first answer lies in the known map; None without a map. ``remarks``: what limited the answers,
    as the back end reports it. ``path_corrections``: of a SLAM that reports when it corrects, the path before and after
    its corrections; ``paths_left_out``: why not of all.
    """

    steps: NDArray[np.void]
    expected: int
    cause: Cause = Cause.COMPLETED
    reason: str = ""
    peak_memory_bytes: int = 0
    warm_up_scans: int = 0
    notes: Mapping[str, int] = field(default_factory=dict)
    every: int = 1
    provenance: Mapping[str, Any] = field(default_factory=dict)
    conditions: RunConditions | None = None
    final: Trajectory | None = None
    loop_closures: tuple[LoopClosure, ...] = ()
    final_cpu_ns: int = 0
    start: MapStart | None = None
    remarks: tuple[str, ...] = ()
    path_corrections: tuple[PathCorrection, ...] = ()
    paths_left_out: str = ""

    def __post_init__(self) -> None:
        freeze(self, "steps", self.steps, (None,), STEP)
        if self.cause != Cause.COMPLETED and not self.reason:
            raise ValueError(f"reason: a run that is {self.status} needs one")
        if self.final is not None and not np.array_equal(self.final.stamps_ns, self.steps["stamp_ns"]):
            raise ValueError(f"final: expected the stamps of {len(self.steps)} steps, got {len(self.final)} others")

    @property
    def status(self) -> RunStatus:
        """The status that belongs to the cause."""
        return self.cause.status

    @property
    def is_complete(self) -> bool:
        """Whether the run reached the end of its sequence."""
        return self.cause == Cause.COMPLETED

    @property
    def is_scorable(self) -> bool:
        """Whether metrics are computed for the run: it answered a scan or completed, and may be scored."""
        excluded = self.cause in (Cause.QUARANTINED, Cause.SCORING_FAILED) or self.status == RunStatus.INTERRUPTED
        return (len(self.steps) > 0 or self.is_complete) and not excluded

    @property
    def estimate(self) -> Trajectory:
        """The answers as a trajectory ``start_from_base``."""
        steps = self.steps
        poses = np.stack([steps["x"], steps["y"], steps["theta"]], axis=-1)
        return Trajectory(steps["stamp_ns"], poses, "start", "base")

    @property
    def with_final_answers(self) -> RunResult | None:
        """This run with the corrected poses in place of the answers; None where there are none."""
        if self.final is None:
            return None
        steps = self.steps.copy()
        steps["x"], steps["y"], steps["theta"] = self.final.poses.T
        return replace(self, steps=steps)


@dataclass(frozen=True, slots=True)
class Score:
    """The value of one metric and its support. Where ``value`` is None, ``reason`` is the cause."""

    value: float | None
    support: int = 0
    reason: str = ""

    def __post_init__(self) -> None:
        if self.value is None and not self.reason:
            raise ValueError("reason: a score without a value needs one")
        if self.value is not None and not np.isfinite(self.value):
            raise ValueError(f"value: not finite: {self.value}; use None with a reason")


@dataclass(frozen=True, slots=True)
class LostTrack:
    """A run lost the track ``at_s`` seconds after its first answer, and why in words.

    ``recovered_at_s``: from when on it was right again until its end; None if it was not, as far as is known.
    ``since_s``: where the wrong motion begins that ends at ``at_s``; not stored, None where it is not known.
    """

    at_s: float
    reason: str
    recovered_at_s: float | None = None
    since_s: float | None = field(default=None, compare=False)

    def __post_init__(self) -> None:
        if not np.isfinite(self.at_s) or not self.reason:
            raise ValueError(f"lost: expected a finite time and a reason, got {self.at_s} and {self.reason!r}")
        if self.recovered_at_s is not None and not self.at_s < self.recovered_at_s < np.inf:
            raise ValueError(f"recovered_at_s: expected a time after {self.at_s}, got {self.recovered_at_s}")


@dataclass(frozen=True, eq=False)
class FinalAlignment:
    """How the corrected poses of a SLAM were aligned to the truth; the fields are as those of ``Scores``."""

    world_from_start: Pose = field(default_factory=Pose)
    alignment: str = ""
    errors_m: Floats | None = None


@dataclass(frozen=True, eq=False)
class Scores:
    """The evaluation of one run: of its answers, and of a SLAM's corrected poses where it says so.

    ``by_metric``: one score per metric. ``world_from_start``: alignment used for errors, maps and drawings.
    ``alignment``: in words, how estimate and ground truth were aligned, or why not; "" without a true trajectory.
    ``grid``: the map built from the estimated trajectory, of a SLAM from the corrected one, None where there is none.
    ``errors_m`` (N,): distance to the truth at each of the run's steps after alignment, nan where unmatched; None
    without a true trajectory. ``lost``: when and why the run lost the track; None if it did not, as far as is known.
    ``final``: the alignment of the corrected poses, None where there are none. ``fit`` (K, 2): of scans in a known
    map, the position error predicted from their fit and the true one (m; nan where unknown); None without a map.
    """

    by_metric: Mapping[str, Score] = field(default_factory=dict)
    world_from_start: Pose = field(default_factory=Pose)
    alignment: str = ""
    grid: OccupancyGrid | None = None
    errors_m: Floats | None = None
    lost: LostTrack | None = None
    final: FinalAlignment | None = None
    fit: Floats | None = None

    @property
    def map_from_start(self) -> Pose:
        """The alignment of the trajectory that ``grid`` is drawn from."""
        return (self.final or self).world_from_start
