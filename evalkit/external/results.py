"""Results computed elsewhere as methods: poses (``file:poses.tum``) or a map (``file:map.yaml``), also out of bags."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import fields
from functools import partial
from pathlib import Path

import numpy as np

from evalkit.core.errors import BackendFailed
from evalkit.core.loop_closure import LoopClosure
from evalkit.core.odometry_estimate import OdometryEstimate
from evalkit.core.pose import Pose
from evalkit.core.scan import Frame
from evalkit.core.timing import Cost
from evalkit.core.trajectory import Trajectory
from evalkit.external import maps
from evalkit.external.declaration import NOT_DECLARED, compute_digest, find_missing, override_defaults, split_words
from evalkit.plugins.parameters import Parameter
from evalkit.plugins.protocols import NoAnswer
from evalkit.plugins.result_files import parse_address, read_trajectory
from evalkit.plugins.specs import BackendSpec, RecordedOdometrySpec, RecordedSlamSpec

COMPUTED_ELSEWHERE = Cost(withheld=frozenset({"wall", "cpu"}))

PARAMETERS = (
    Parameter("poses_of", "base", "", "frame of the poses in the file", choices=("base", "sensor")),
    Parameter("max_gap_s", 1.0, "s", "interpolate between poses at most this far apart", low=0.0),
    Parameter("tolerance_s", 0.02, "s", "otherwise take the nearest pose within this time of the scan",
              low=0.0),
)  # fmt: skip

MIN_PATH_M, MAX_OFF = 1.0, 2.0
"""Paths are compared where the wheel odometry drives this far, and have a unit within this factor."""

BEYOND_ROBOTS_M_S = 60.0


def scheme(rest: str) -> BackendSpec:
    """Make the spec of ``file:ADDRESS [NAME=VALUE ...]``: a map, else a trajectory.

    ADDRESS: a TUM file, a map (*.yaml), or results in a bag: ``run.mcap?topic=/pose``, ``?tf=map,base_link``,
    ``?map=/map``. ``?final=ADDRESS`` (``&final=ADDRESS`` behind another) names the corrected poses of a SLAM.
    """
    name = f"file:{rest}"
    path, *words = split_words(name, rest)
    address = parse_address(path)
    file = address.path.resolve()
    if file.suffix in maps.SUFFIXES or address.is_map:
        return maps.map_spec(name, file, address.query.get("map", ""), words)
    query = "".join(f"?{key}={value}" for key, value in address.query.items())
    final = parse_address(address.final).path.resolve() if address.final else None
    files = (file, final) if final else (file,)
    online = RecordedOdometrySpec(
        make=partial(PosesFromFile, f"{file}{query}"),
        summary=f"poses computed elsewhere, read from {file.name}{query}",
        citation=NOT_DECLARED,
        licence=NOT_DECLARED,
        guess="unknown: it was computed elsewhere",
        parameters=override_defaults(name, PARAMETERS, words),
        missing=partial(find_missing, *files),
        digest=compute_digest(*files, words=f"{query}{address.final}"),
        addresses=tuple(each for each in (f"{file}{query}", address.final) if each),
    )
    if final is None:
        return online
    values = {each.name: getattr(online, each.name) for each in fields(online)}
    make = partial(CorrectedPosesFromFiles, address.final, f"{file}{query}")
    summary = f"{online.summary}; corrected poses from {address.final}"
    return RecordedSlamSpec(**{**values, "make": make, "summary": summary})


class PoseFile:
    """The trajectory of a file, asked for the base's pose at the times of scans; nothing is extrapolated."""

    def __init__(self, address: str, poses_of: str, max_gap_s: float, tolerance_s: float) -> None:
        self._name, self._trajectory = Path(address).name, read_trajectory(address).trajectory
        self._of_sensor = poses_of == "sensor"
        self._max_gap_ns, self._tolerance_ns = round(max_gap_s * 1e9), round(tolerance_s * 1e9)

    def find(self, stamp_ns: int, base_from_sensor: Pose) -> Pose:
        """Return ``world_from_base`` at a time; raises NoAnswer where the file has no pose near it."""
        found = self._pose_at(stamp_ns)
        return found @ base_from_sensor.inverse() if self._of_sensor else found

    def _pose_at(self, stamp_ns: int) -> Pose:
        stamps = self._trajectory.stamps_ns
        right = int(np.searchsorted(stamps, stamp_ns))
        near = [index for index in (right - 1, right) if 0 <= index < len(stamps)]
        gap_ns = int(stamps[near[-1]] - stamps[near[0]])
        if len(near) == 2 and gap_ns <= self._max_gap_ns:
            return Pose.of(self._trajectory.at([stamp_ns])[0])
        nearest = min(near, key=lambda index: abs(int(stamps[index]) - stamp_ns))
        if abs(int(stamps[nearest]) - stamp_ns) <= self._tolerance_ns:
            return Pose.of(self._trajectory.poses[nearest])
        first, last = stamps[0] * 1e-9, stamps[-1] * 1e-9
        raise NoAnswer(
            f"{self._name} has no pose near {stamp_ns * 1e-9:.3f} s; it reaches from {first:.3f} s to {last:.3f} s"
        )


class PosesFromFile:
    """An Odometry that returns the poses of a file; its times have no meaning and are withheld.

    A scan without a pose in the file raises NoAnswer.
    """

    def __init__(self, address: str, *, poses_of: str, max_gap_s: float, tolerance_s: float) -> None:
        self._file = PoseFile(address, poses_of, max_gap_s, tolerance_s)
        self._world_from_start: Pose | None = None
        self._answers: list[tuple[int, Pose, Pose | None]] = []

    def update(self, frame: Frame) -> OdometryEstimate:
        """Look the pose up; raises NoAnswer where the file has no pose near the scan's first beam."""
        world_from_base = self._file.find(frame.scan.stamp_ns, frame.base_from_sensor)
        self._answers.append((frame.scan.stamp_ns, world_from_base, frame.odom_from_base))
        if self._world_from_start is None:
            self._world_from_start = world_from_base
            return OdometryEstimate(Pose(), cost=COMPUTED_ELSEWHERE)
        return OdometryEstimate(self._world_from_start.inverse() @ world_from_base, cost=COMPUTED_ELSEWHERE)

    def remarks(self) -> tuple[str, ...]:
        """Say where the file is not in metres, by the path of the wheel odometry or else by the speed."""
        if len(self._answers) < 2:
            return ()
        path_m = _measure_path(pose for _, pose, _ in self._answers)
        seconds = (self._answers[-1][0] - self._answers[0][0]) * 1e-9
        wheels_m = _measure_path(pose for _, _, pose in self._answers if pose is not None)
        whole = all(pose is not None for _, _, pose in self._answers) and wheels_m > MIN_PATH_M
        if not whole:
            speed = f"its poses move at {path_m / seconds:.0f} m/s, faster than any robot"
            return (f"{speed}: mm or cm taken for m?",) if path_m > BEYOND_ROBOTS_M_S * seconds else ()
        for unit, share in (("mm", 1000), ("cm", 100)):
            if 1.0 / MAX_OFF < path_m / (share * wheels_m) < MAX_OFF:
                what = f"its path is {path_m:.0f} m, that of the wheel odometry {wheels_m:.1f} m: lengths in {unit}"
                return (f"{what}? Divide x and y by {share}",)
        return ()


def _measure_path(poses: Iterable[Pose]) -> float:
    """Return the length (m) of a path."""
    rows = np.array([(pose.x, pose.y) for pose in poses]).reshape(-1, 2)
    return float(np.hypot(*np.diff(rows, axis=0).T).sum())


class CorrectedPosesFromFiles:
    """A Slam that returns the poses of one file as its answers, and those of another as corrected poses."""

    def __init__(self, final: str, address: str, *, poses_of: str, max_gap_s: float, tolerance_s: float) -> None:
        self._online = PosesFromFile(address, poses_of=poses_of, max_gap_s=max_gap_s, tolerance_s=tolerance_s)
        self._final, self._name = PoseFile(final, poses_of, max_gap_s, tolerance_s), f"file:{address}"
        self._answered: list[tuple[int, Pose]] = []

    def update(self, frame: Frame) -> OdometryEstimate:
        """Look the pose up; raises NoAnswer where the first file has no pose near the scan's first beam."""
        estimate = self._online.update(frame)
        self._answered.append((frame.scan.stamp_ns, frame.base_from_sensor))
        return estimate

    def remarks(self) -> tuple[str, ...]:
        """Say where the first file is not in metres."""
        return self._online.remarks()

    def trajectory(self) -> Trajectory:
        """Return the corrected poses; raises BackendFailed where the second file has none for an answered scan."""
        try:
            poses = [self._final.find(*answered) for answered in self._answered]
        except NoAnswer as error:
            remedy = "write a corrected pose for every scan, or set max_gap_s or tolerance_s"
            raise BackendFailed(self._name, str(error), remedy) from None
        start_from_world = poses[0].inverse()
        rows = np.array([(start_from_world @ pose).row for pose in poses])
        rows[0] = 0.0  # exactly
        return Trajectory(np.array([stamp for stamp, _ in self._answered]), rows, "start", "base")

    def loop_closures(self) -> tuple[LoopClosure, ...]:
        """Return none: a file of poses holds none."""
        return ()
