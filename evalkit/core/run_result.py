"""One run from worker to page: status, steps, cost and scores."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from evalkit.core.arrays import freeze
from evalkit.core.grid import OccupancyGrid
from evalkit.core.ground_truth import Truth
from evalkit.core.pose import Pose
from evalkit.core.se2 import Floats
from evalkit.core.trajectory import Trajectory

Status = Literal[
    "complete", "failed", "crashed", "timeout", "out-of-memory", "not-installed", "data-missing", "skipped"
]


"""How a run ended; "skipped": it was not made, and may be."""


STEP = np.dtype(
    [
        ("stamp_ns", "i8"), ("x", "f8"), ("y", "f8"), ("theta", "f8"),
        ("wall_ns", "i8"), ("cpu_ns", "i8"), ("conversion_ns", "i8"), ("harness_ns", "i8"), ("device_ns", "i8"),
        ("s2s_error", "f8"), ("s2s_iterations", "i4"), ("s2s_inliers", "i4"),
        ("s2m_error", "f8"), ("s2m_iterations", "i4"), ("s2m_inliers", "i4"),
        ("s2s_accepted", "i1"), ("s2s_converged", "i1"), ("s2m_accepted", "i1"), ("s2m_converged", "i1"),
    ]
)  # fmt: skip


"""One scan of a run: answer ``start_from_base``, cost in ns, residuals in m (nan where a stage does not exist).

``device_ns`` is what the back end itself says it took; a cost of 0 is one nobody measured. ``accepted``: 1 where the
stage's answer was taken, 0 where its guess was kept; ``converged``: 1 or 0; both -1 where there is no such stage or
nobody tells. An odometry that tells of itself is a second stage.
"""


@dataclass(frozen=True, eq=False)
class RunResult:
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
        freeze(self, "steps", self.steps, (None,), STEP)
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
    """One row of a comparison: a method over a sequence, run, scored and mapped.

    ``method`` and ``sequence``: the labels in tables (``sequence`` without the seed). ``key``: content key of the
    results folder. ``command``: reproduces this row alone. ``world_from_start``: the alignment used for drawing and
    for the map. ``grid``: the map of the estimated trajectory, None where there is none. ``errors_m`` (N,): distance to
    the truth at each of ``run.steps`` after alignment, nan where unmatched; None without a true trajectory.
    ``alignment``: in words how estimate and truth were matched, or why not; "" without a true trajectory.
    ``processor``: of the machine the run was made on; "" where nobody knows.
    """

    key: str
    method: str
    backend: str
    backend_parameters: Mapping[str, bool | int | float | str]
    sequence: str
    dataset: str
    dataset_parameters: Mapping[str, bool | int | float | str]
    seed: int | None
    command: str
    run: RunResult
    truth: Truth
    scores: Mapping[str, Score]
    world_from_start: Pose = field(default_factory=Pose)
    grid: OccupancyGrid | None = None
    errors_m: Floats | None = None
    alignment: str = ""
    processor: str = ""
