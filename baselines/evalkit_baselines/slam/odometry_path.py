"""The path in the continuous frame ``odom`` of the front end, and its correction by the keyframes."""

from __future__ import annotations

import numpy as np

from evalkit.core import se2
from evalkit.core.pose import Pose
from evalkit.core.se2 import Floats
from evalkit.core.trajectory import Trajectory


class OdometryPath:
    """The poses ``odom_from_base`` of all scans and ``odom_from_keyframe`` of all keyframes."""

    def __init__(self) -> None:
        self._stamps_ns: list[int] = []
        self._odom_from_base: list[Floats] = []
        self._keyframe_of: list[int] = []
        self._odom_from_keyframe: list[Floats] = []

    @property
    def last(self) -> Pose | None:
        """Pose of the last scan."""
        return Pose.of(self._odom_from_base[-1]) if self._odom_from_base else None

    @property
    def last_ns(self) -> int | None:
        """Stamp of the last scan."""
        return self._stamps_ns[-1] if self._stamps_ns else None

    @property
    def last_keyframe(self) -> Pose | None:
        """Pose of the last keyframe."""
        return Pose.of(self._odom_from_keyframe[-1]) if self._odom_from_keyframe else None

    def add_keyframe(self, odom_from_keyframe: Pose) -> None:
        """Add a keyframe, before the scan that it is of."""
        self._odom_from_keyframe.append(odom_from_keyframe.row)

    def add(self, stamp_ns: int, odom_from_base: Pose) -> None:
        """Add a scan, which belongs to the last keyframe."""
        self._stamps_ns.append(stamp_ns)
        self._odom_from_base.append(odom_from_base.row)
        self._keyframe_of.append(len(self._odom_from_keyframe) - 1)

    def correct(self, corrected: Floats) -> Trajectory:
        """Return all poses ``start_from_base`` by the corrected keyframes (K, 3).

        Between two keyframes the correction is distributed by the driven distance.
        """
        if not self._stamps_ns:
            return Trajectory(np.zeros(0, dtype=np.int64), np.zeros((0, 3)), "start", "base")
        odom = np.array(self._odom_from_base)
        keyframe = np.array(self._keyframe_of)
        odom_from_keyframe = np.array(self._odom_from_keyframe)
        since = se2.between(odom_from_keyframe[keyframe], odom)
        poses = se2.compose(corrected[keyframe], since)
        following = np.minimum(keyframe + 1, len(corrected) - 1)
        arrived = se2.compose(corrected[:-1], se2.between(odom_from_keyframe[:-1], odom_from_keyframe[1:]))
        missing = np.concatenate([se2.between(arrived, corrected[1:]), np.zeros((1, 3))])[keyframe]
        step = np.linalg.norm(odom_from_keyframe[following, :2] - odom_from_keyframe[keyframe, :2], axis=1)
        turn = np.abs(se2.wrap(odom_from_keyframe[following, 2] - odom_from_keyframe[keyframe, 2]))
        share = (np.hypot(since[:, 0], since[:, 1]) + np.abs(since[:, 2])) / np.maximum(step + turn, 1e-9)
        poses = se2.compose(poses, np.clip(share, 0.0, 1.0)[:, None] * missing)
        return Trajectory(np.array(self._stamps_ns), poses, "start", "base")
