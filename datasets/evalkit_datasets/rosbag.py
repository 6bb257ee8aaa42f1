"""A ROS bag as a Sequence: ROS 1 .bag, ROS 2 folder, .db3 or .mcap, read without ROS.

``scan.stamp_ns`` is the header's time (the first beam), not the time of recording. Ranges follow REP-117: inf is no
return; -inf, nan, zero, negative and anything under the sensor's minimum is invalid. Its maximum itself is no return,
too: drivers write it for beams that met nothing (2.5 % of the backpack's are exactly 60 m). A lidar mounted upside
down has its angles mirrored, so that base_from_sensor stays a motion of the plane.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from evalkit.core.arrays import Bools
from evalkit.core.errors import BadData
from evalkit.core.ground_truth import Truth
from evalkit.core.pose import Pose
from evalkit.core.scan import Frame, Scan
from evalkit.core.se2 import Floats, Stamps, between, compose
from evalkit.core.trajectory import Trajectory
from evalkit.io.timestamps import order_stamps
from evalkit.plugins.parameters import Parameter
from evalkit.plugins.specs import DatasetSpec
from evalkit_datasets import reader_common, rosbag_parser
from evalkit_datasets.buffers import PoseBuffer, sort_by_rank
from evalkit_datasets.rosbag_parser import Contents, Scans, Sweep
from evalkit_datasets.transforms import Mounting

BASE_FRAMES = ("base_link", "base_footprint", "base")


class RosBag:
    """The Sequence of one laser topic of a bag.

    Odometry "auto": the nav_msgs/Odometry topic, filled up by tf of the same two frames; without one, tf from "odom"
    to the base; else none. It is interpolated at the scan's first and last beam.
    """

    def __init__(
        self,
        path: str,
        topic: str = "",
        relations: str = "",
        reference: str = "",
        odometry: str = "auto",
        base_frame: str = "",
        base_from_sensor: str = "auto",
        start: int = 0,
        every: int = 1,
        limit: int = 0,
        how: str = "",
        spans: str = "",
    ) -> None:
        self._path = reader_common.existing("rosbag", path)
        which = reader_common.selection(start, every, limit)
        whole, contents = rosbag_parser.read(self._path, topic, which)
        self._counts = self._counted(whole, contents)
        self._scans = whole.chosen(which)
        if not len(self._scans):
            raise BadData(str(path), "", f"start {start} lies beyond its {len(whole)} scans", "start earlier")
        self._odometry, child = self._odometry_of(contents, odometry, base_frame)
        base = base_frame or child or self._likely_base(contents)
        self._mounting = (
            self._mounting_on(contents, base, bool(base_frame))
            if base_from_sensor == "auto"
            else Mounting(reader_common.sensor_pose("rosbag", base_from_sensor))
        )
        if self._odometry is not None and child != base:
            self._odometry = self._moved_to_base(contents, self._odometry, child, base)
        self._poses, self._motions = self._at_scans()
        how = how or ("files given by the user" if relations or reference or spans else "none")
        span = int(whole.stamps_ns[0]), int(whole.stamps_ns[-1])
        self._truth, cut = reader_common.truth_from_files(self.stamps_ns, span, relations, reference, how, spans)
        self._counts |= cut
        self._counts["invalid ranges (nan, zero, negative or under the minimum)"] = int(self._scans.invalid.sum())

    def __len__(self) -> int:
        return len(self._scans)

    @property
    def stamps_ns(self) -> Stamps:
        """The times (N,) of the scans taken."""
        return self._scans.stamps_ns

    def frames(self) -> Iterator[Frame]:
        """The scans in order of time, read from the file as they are asked for."""
        sweeps = sort_by_rank(rosbag_parser.sweeps(self._path, self._scans))
        for sweep, pose, motion in zip(sweeps, self._poses, self._motions, strict=True):
            angles = sweep.angles()
            if self._mounting.mirrored:
                angles = -angles
            limits = sweep.range_min_m, sweep.range_max_m
            scan = Scan(sweep.stamp_ns, _clean(sweep), angles, *limits, sweep.time_increment_ns)
            yield Frame(
                scan,
                self._mounting.base_from_sensor,
                reader_common.pose_or_none(pose),
                reader_common.pose_or_none(motion),
            )

    def truth(self) -> Truth:
        """Relations and reference trajectory of the files given; a bag itself holds none."""
        return self._truth

    def notes(self) -> Mapping[str, int]:
        """Defects met and handled, counted by name."""
        return reader_common.counted(self._counts)

    def _counted(self, whole: Scans, contents: Contents) -> dict[str, int]:
        if not len(whole):
            raise BadData(
                str(self._path),
                "",
                f"none of its {contents.damaged} laser messages makes sense (angles, limits or number of beams)",
                rosbag_parser.FETCH_AGAIN,
            )
        return {
            "scans out of order": whole.backwards,
            "scans with a repeated stamp left out": whole.repeated,
            "scans without a stamp, given the time of recording": contents.unstamped,
            "damaged messages left out": contents.damaged,
        }

    def _odometry_of(self, contents: Contents, wanted: str, base_frame: str) -> tuple[Trajectory | None, str]:
        """The odometry ``odom_from_child`` and the name of the child frame; (None, "") where there is none."""
        if wanted == "none":
            return None, ""
        key = None if wanted == "tf" else self._odometry_topic(contents, wanted)
        if key is None:
            parent, child = _odometry_frames(contents, base_frame)
            parts = _samples(contents, parent, child)
        else:
            _, parent, child = key
            parts = [contents.odometry[key], *(_samples(contents, parent, child) if wanted == "auto" else [])]
        if not parts and wanted == "tf":
            known = ", ".join(contents.tree.frames()) or "none"
            raise BadData(
                str(self._path), "odometry 'tf'", f"no moving transform from 'odom'; frames: {known}", "use 'none'"
            )
        return (_joined(parts), child) if parts else (None, "")

    def _odometry_topic(self, contents: Contents, wanted: str) -> tuple[str, str, str] | None:
        """The (topic, parent, child) of the odometry messages to use, None where "auto" finds none."""
        keys = sorted(contents.odometry)
        name = "odom" if wanted == "auto" else wanted.lstrip("/")
        named = [key for key in keys if key[0].lstrip("/") == name]
        if named or (wanted == "auto" and len(keys) <= 1):
            return next(iter(named or keys), None)
        raise BadData(
            str(self._path),
            f"odometry '{wanted}'",
            f"topics with odometry: {', '.join(key[0] for key in keys) or 'none'}",
            "choose with odometry: one of them, tf or none",
        )

    def _likely_base(self, contents: Contents) -> str:
        """A base frame by its usual name, the lidar itself where there is none."""
        frames = contents.tree.frames()
        return next((name for name in BASE_FRAMES if name in frames), self._scans.first_frame)

    def _mounting_on(self, contents: Contents, base: str, asked_for: bool) -> Mounting:
        sensor = self._scans.first_frame
        try:
            mounting = contents.tree.mounting(base, sensor, int(self.stamps_ns[0]))
        except ValueError as error:
            raise BadData(str(self._path), "", str(error), "choose a laser that scans level") from None
        if mounting is not None:
            return mounting
        if asked_for:
            known = ", ".join(contents.tree.frames()) or "none"
            raise BadData(
                str(self._path),
                f"base_frame '{base}'",
                f"no transforms lead from it to '{sensor}'; frames: {known}",
                "name another frame, or give parameter 'base_from_sensor'",
            )
        self._counts["no transform from the base to the lidar, taken as one"] = 1
        return Mounting(Pose())

    def _moved_to_base(self, contents: Contents, odometry: Trajectory, child: str, base: str) -> Trajectory:
        mounting = contents.tree.mounting(child, base, int(self.stamps_ns[0]))
        if mounting is None:
            raise BadData(
                str(self._path),
                f"base_frame '{base}'",
                f"no transforms lead from the odometry's frame '{child}' to it",
                f"use base_frame '{child}' or odometry 'none'",
            )
        return Trajectory(odometry.stamps_ns, compose(odometry.poses, mounting.base_from_sensor.row), "odom", "base")

    def _at_scans(self) -> tuple[Floats, Floats]:
        """The odometry's pose at the first beam (N, 3) and its motion to the last (N, 3), nan where unknown."""
        nothing = np.full((len(self), 3), np.nan)
        if self._odometry is None:
            return nothing, nothing
        self._counts |= reader_common.odometry_counts(self._odometry, self.stamps_ns)
        ends = self.stamps_ns + self._scans.durations_ns
        poses = reader_common.odometry_at(self._odometry, self.stamps_ns)
        motions = reader_common.odometry_at(self._odometry, ends)
        for some in reader_common.blocks(len(self)):
            motions[some] = between(poses[some], motions[some])
        motions[~_covered(self._odometry, self.stamps_ns, ends)] = np.nan
        return poses, motions


def _clean(sweep: Sweep) -> Floats:
    """The ranges with inf for no return and nan for invalid."""
    return np.where(sweep.near, np.nan, np.where(sweep.ranges >= sweep.range_max_m, np.inf, sweep.ranges))


def _covered(odometry: Trajectory, begins: Stamps, ends: Stamps) -> Bools:
    first, last = odometry.stamps_ns[0], odometry.stamps_ns[-1]
    return np.asarray((begins >= first) & (ends <= last) & (ends > begins))


def _odometry_frames(contents: Contents, base_frame: str) -> tuple[str, str]:
    """The two frames of the transform that is odometry: from "odom" to the base asked for, or the likeliest one."""
    children = [child for parent, child in contents.tree.moving if parent == rosbag_parser.ODOMETRY_FRAME]
    for name in (base_frame, *BASE_FRAMES, *sorted(children)):
        if name in children:
            return rosbag_parser.ODOMETRY_FRAME, name
    return rosbag_parser.ODOMETRY_FRAME, ""


def _samples(contents: Contents, parent: str, child: str) -> list[PoseBuffer]:
    """What tf tells of two frames; nothing where it is silent."""
    path = contents.tree.paths.get((parent, child))
    return [] if path is None else [path]


def _joined(parts: list[PoseBuffer]) -> Trajectory:
    """All poses in order of time, of equal times the first."""
    if len(parts) == 1 and (np.diff(parts[0].stamps_ns) > 0).all():  # as it should be
        return Trajectory(parts[0].stamps_ns, parts[0].poses, "odom", "base")
    stamps = np.concatenate([part.stamps_ns for part in parts])
    keep = order_stamps(stamps).keep
    return Trajectory(stamps[keep], np.concatenate([part.poses for part in parts])[keep], "odom", "base")


def _missing(path: str = "", **given: object) -> str:
    return reader_common.missing_files("rosbag", [("path", path), *reader_common.truth_files(given)])


SPEC = DatasetSpec(
    make=RosBag,
    summary="A ROS 1 or ROS 2 bag with LaserScan or MultiEchoLaserScan messages",
    sensor="as recorded; of several echoes of a beam the first, which is the nearest",
    truth="relations and a reference trajectory where files are given",
    citation="rosbags (Ternaris); sensor_msgs/LaserScan and REP-117",
    licence="as the recording's",
    suffixes=(".bag", ".db3", ".mcap"),
    parameters=(
        Parameter("path", "", "", "the bag: a .bag, .db3 or .mcap file, or the folder of a ROS 2 bag"),
        Parameter("topic", "", "", "the laser's topic; empty: the only one there is"),
        *reader_common.TRUTH,
        Parameter("odometry", "auto", "", "'auto', a topic of nav_msgs/Odometry, 'tf' or 'none'"),
        Parameter("base_frame", "", "", "the frame poses are given for; empty: the odometry's, else base_link"),
        Parameter("base_from_sensor", "auto", "", "where the lidar sits: 'auto' (tf) or 'x y theta' in m, m, rad"),
        *reader_common.SELECTION,
    ),
    missing=_missing,
    thinned_by="every",
)
