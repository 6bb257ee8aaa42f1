"""Read a ROS bag as a Sequence: ROS 1 .bag, ROS 2 folder, .db3 or .mcap, without a ROS installation.

``scan.stamp_ns`` is the header's time (the first beam), not the time of recording. Ranges follow REP-117: inf is no
return; -inf, nan, zero, negative ranges and those below the sensor's minimum, or ``range_min_m`` if that is larger, are
invalid. The maximum itself is also no return: drivers write it for beams without an echo (2.5 % of the ranges of one
recording are exactly 60 m). A maximum of 0 or inf states none: it is 100 m then. The angles of a lidar mounted upside
down are mirrored, so that base_from_sensor is a motion of the plane.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import partial

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
from evalkit_datasets.parsing import cloud_slice, rosbag_parser, truth_files
from evalkit_datasets.parsing.bag_file import DAMAGED_MESSAGES, FETCH_AGAIN
from evalkit_datasets.parsing.buffers import PoseBuffer, sort_by_rank
from evalkit_datasets.parsing.cloud_slice import CloudSlice
from evalkit_datasets.parsing.columns_layout import LENGTH_UNITS
from evalkit_datasets.parsing.range_minimum import RANGE_MIN
from evalkit_datasets.parsing.rosbag_parser import BagScans, Contents
from evalkit_datasets.parsing.sweeps import Sweep, SweepOptions, parse_fields
from evalkit_datasets.parsing.transforms import Mounting, own_name, with_prefix_of
from evalkit_datasets.parsing.truth_files import TruthPaths
from evalkit_datasets.readers import reader_common

BASE_FRAMES = ("base_link", "base_footprint", "base")
NO_MOUNTING = "no transform from the base to the lidar, identity used"


class RosBag:
    """The Sequence of one laser topic of a bag.

    Odometry "auto" is the nav_msgs/Odometry topic, supplemented by tf between the same two frames; without such a
    topic, tf from "odom" to the base; else none. Jumps that no vehicle makes are taken out; the rest is interpolated at
    the first and the last beam of each scan.
    """

    def __init__(
        self,
        path: str,
        topic: str = "",
        relations: str = "",
        ground_truth: str = "",
        odometry: str = "auto",
        base_frame: str = "",
        base_from_sensor: str = "auto",
        start: int = 0,
        every: int = 1,
        limit: int = 0,
        how: str = "",
        spans: str = "",
        fields: str = "",
        height_min_m: float = CloudSlice.height_min_m,
        height_max_m: float = CloudSlice.height_max_m,
        beams: int = CloudSlice.beams,
        sweep_s: float = 0.0,
        range_min_m: float = 0.0,
        stamp_shift_s: float = 0.0,
        odometry_unit: str = "m",
    ) -> None:
        self._path = reader_common.check_exists("rosbag", path)
        cloud = CloudSlice(height_min_m, height_max_m, beams).beyond("rosbag", range_min_m)
        self._options = SweepOptions(cloud, parse_fields(fields), sweep_s, range_min_m, stamp_shift_s)
        which = reader_common.select_scans(start, every, limit)
        whole, contents = rosbag_parser.read_bag(self._path, topic, which, self._options, odometry)
        self._counts = self._count_defects(whole, contents)
        self._scans = whole.select(which)
        if not len(self._scans):
            raise BadData(str(path), "", f"start {start} lies beyond its {len(whole)} scans", "start earlier")
        self._odometry, child = self._find_odometry(contents, odometry, base_frame)
        if self._odometry is not None:
            metres = self._odometry.poses * np.array([LENGTH_UNITS[odometry_unit]] * 2 + [1.0])
            self._odometry = replace(self._odometry, poses=metres)
        base = base_frame or child or self._guess_base(contents)
        self._mounting = (
            self._find_mounting(contents, base, bool(base_frame))
            if base_from_sensor == "auto"
            else Mounting(reader_common.parse_sensor_pose("rosbag", base_from_sensor))
        )
        if self._odometry is not None and child != base:
            self._odometry = self._move_to_base(contents, self._odometry, child, base)
        self._poses, self._motions = self._interpolate_odometry()
        paths = TruthPaths(relations, ground_truth, spans, how)
        span = int(whole.stamps_ns[0]), int(whole.stamps_ns[-1])
        self._truth, cut = truth_files.load_truth(paths, self.stamps_ns, span)
        self._counts |= cut
        self._counts["invalid ranges (nan, zero, negative or below the minimum)"] = int(self._scans.invalid.sum())

    def __len__(self) -> int:
        return len(self._scans)

    @property
    def stamps_ns(self) -> Stamps:
        """Times (N,) of the scans taken, in ns."""
        return self._scans.stamps_ns

    def frames(self) -> Iterator[Frame]:
        """Yield the scans in order of time, read from the file one by one."""
        return self.frames_from(0)

    def frames_from(self, first: int) -> Iterator[Frame]:
        """Yield the scans from number ``first`` on."""
        scans = self._scans.select(slice(first, None))
        sweeps = sort_by_rank(rosbag_parser.iter_sweeps(self._path, scans, self._options))
        for sweep, pose, motion in zip(sweeps, self._poses[first:], self._motions[first:], strict=True):
            angles = sweep.angles()
            if self._mounting.mirrored:
                angles = -angles
            limits = sweep.range_min_m, sweep.range_max_m
            scan = Scan(sweep.stamp_ns, _mark_ranges(sweep), angles, *limits, sweep.time_increment_ns)
            yield Frame(
                scan,
                self._mounting.base_from_sensor,
                reader_common.pose_or_none(pose),
                reader_common.pose_or_none(motion),
            )

    def truth(self) -> Truth:
        """Return the truth of the files given; a bag itself contains none."""
        return self._truth

    def notes(self) -> Mapping[str, int]:
        """Return the number of defects handled, by name."""
        return reader_common.drop_zeros(self._counts)

    def _count_defects(self, whole: BagScans, contents: Contents) -> dict[str, int]:
        if not len(whole):
            found = f"all {contents.damaged} laser messages are implausible (angles, limits or number of beams)"
            if contents.missing and not contents.damaged:
                found = f"{whole.topic}: none of the {contents.missing} messages that its index lists is in it"
            raise BadData(str(self._path), "", found, FETCH_AGAIN)
        return {
            "scans out of order": whole.backwards,
            reader_common.REPEATED_STAMPS: whole.repeated,
            "scans without a stamp, given the time of recording": contents.unstamped,
            "odometry poses without a stamp, given the time of recording": sum(
                one.unstamped for one in contents.odometry.values()
            ),
            DAMAGED_MESSAGES: contents.damaged + contents.messages.damaged.total(),
            "laser messages that the index lists and the bag does not hold": contents.missing,
            **(contents.damage.count() if contents.damage else {}),
        }

    def _find_odometry(self, contents: Contents, wanted: str, base_frame: str) -> tuple[Trajectory | None, str]:
        """Return the odometry ``odom_from_child`` and the name of the child frame; (None, "") if there is none."""
        if wanted == "none":
            return None, ""
        key = None if wanted == "tf" else self._select_odometry_topic(contents, wanted)
        if key is None:
            parent, child = _select_odometry_frames(contents, base_frame, self._scans.first_frame)
            parts = _find_tf_poses(contents, parent, child)
        else:
            _, parent, child = key
            parts = [contents.odometry[key], *(_find_tf_poses(contents, parent, child) if wanted == "auto" else [])]
        if not parts and wanted == "tf":
            known = ", ".join(contents.tree.frames()) or "none"
            raise BadData(
                str(self._path), "odometry 'tf'", f"no moving transform from 'odom'; frames: {known}", "use 'none'"
            )
        return (_merge_poses(parts), child) if parts else (None, "")

    def _select_odometry_topic(self, contents: Contents, wanted: str) -> tuple[str, str, str] | None:
        """Return (topic, parent, child) of the odometry messages to use, None if "auto" finds none."""
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

    def _guess_base(self, contents: Contents) -> str:
        """Return the first base frame with a usual name, else the lidar's frame."""
        frames = contents.tree.frames()
        usual = with_prefix_of(self._scans.first_frame, BASE_FRAMES)
        return next((name for name in usual if name in frames), self._scans.first_frame)

    def _find_mounting(self, contents: Contents, base: str, required: bool) -> Mounting:
        sensor = self._scans.first_frame
        try:
            mounting = contents.tree.find_mounting(base, sensor, int(self.stamps_ns[0]))
        except ValueError as error:
            raise BadData(str(self._path), "", str(error), "choose a laser that scans horizontally") from None
        if mounting is not None:
            return mounting
        if required:
            known = ", ".join(contents.tree.frames()) or "none"
            raise BadData(
                str(self._path),
                f"base_frame '{base}'",
                f"no transforms from it to '{sensor}'; frames: {known}",
                "use another frame, or set parameter 'base_from_sensor'",
            )
        self._counts[NO_MOUNTING] = 1
        return Mounting(Pose())

    def _move_to_base(self, contents: Contents, odometry: Trajectory, child: str, base: str) -> Trajectory:
        mounting = contents.tree.find_mounting(child, base, int(self.stamps_ns[0]))
        if mounting is None:
            raise BadData(
                str(self._path),
                f"base_frame '{base}'",
                f"no transforms from the odometry's frame '{child}' to it",
                f"use base_frame '{child}' or odometry 'none'",
            )
        return Trajectory(odometry.stamps_ns, compose(odometry.poses, mounting.base_from_sensor.row), "odom", "base")

    def _interpolate_odometry(self) -> tuple[Floats, Floats]:
        """Return the odometry pose at the first beam (N, 3) and the motion to the last (N, 3), nan where unknown."""
        unknown = np.full((len(self), 3), np.nan)
        if self._odometry is None:
            return unknown, unknown
        joined, jumps = reader_common.join_jumps(self._odometry.stamps_ns, self._odometry.poses)
        self._odometry = replace(self._odometry, poses=joined)
        self._counts |= jumps | reader_common.count_odometry_gaps(self._odometry, self.stamps_ns)
        ends = self.stamps_ns + self._scans.durations_ns
        poses = reader_common.odometry_at(self._odometry, self.stamps_ns)
        motions = reader_common.odometry_at(self._odometry, ends)
        for rows in reader_common.split_rows(len(self)):
            motions[rows] = between(poses[rows], motions[rows])
        motions[~_is_covered(self._odometry, self.stamps_ns, ends)] = np.nan
        return poses, motions


def _mark_ranges(sweep: Sweep) -> Floats:
    """Return the ranges with inf for no return and nan for invalid ones."""
    return np.where(sweep.is_invalid, np.nan, np.where(sweep.ranges >= sweep.range_max_m, np.inf, sweep.ranges))


def _is_covered(odometry: Trajectory, begins: Stamps, ends: Stamps) -> Bools:
    first, last = odometry.stamps_ns[0], odometry.stamps_ns[-1]
    return np.asarray((begins >= first) & (ends <= last) & (ends > begins))


def _select_odometry_frames(contents: Contents, base_frame: str, sensor: str) -> tuple[str, str]:
    """Return the two frames of odometry from tf: "odom", and the given base or the first usual one.

    Both may have the prefix of a robot; that of the sensor comes first.
    """
    parents = with_prefix_of(sensor, [rosbag_parser.ODOMETRY_FRAME])
    parents += sorted({one for one, _ in contents.tree.moving if own_name(one) == rosbag_parser.ODOMETRY_FRAME})
    pairs = [(parent, child) for parent in parents for one, child in contents.tree.moving if one == parent]
    bases = [base_frame, *with_prefix_of(sensor, BASE_FRAMES)]
    usual = ((parent, child) for name in bases for parent, child in pairs if child == name)
    return next(usual, min(pairs, key=lambda pair: parents.index(pair[0]), default=(rosbag_parser.ODOMETRY_FRAME, "")))


def _find_tf_poses(contents: Contents, parent: str, child: str) -> list[PoseBuffer]:
    """Return the poses of tf between two frames, an empty list if there are none."""
    path = contents.tree.paths.get((parent, child))
    return [] if path is None else [path]


def _merge_poses(parts: list[PoseBuffer]) -> Trajectory:
    """Return all poses in order of time; of poses with equal stamps the first is kept."""
    if len(parts) == 1 and (np.diff(parts[0].stamps_ns) > 0).all():
        return Trajectory(parts[0].stamps_ns, parts[0].poses, "odom", "base")
    stamps = np.concatenate([part.stamps_ns for part in parts])
    keep = order_stamps(stamps).keep
    return Trajectory(stamps[keep], np.concatenate([part.poses for part in parts])[keep], "odom", "base")


SPEC = DatasetSpec(
    make=RosBag,
    summary="A ROS 1 or ROS 2 bag with LaserScan, MultiEchoLaserScan, PointCloud2 or other range messages",
    sensor="as recorded; of several echoes the nearest, of a point cloud a slice of heights",
    truth="files given as parameters",
    citation="rosbags (Ternaris); sensor_msgs/LaserScan and REP-117",
    licence="that of the recording",
    suffixes=(".bag", ".db3", ".mcap"),
    parameters=(
        Parameter("path", "", "", "the bag: a .bag, .db3 or .mcap file, or the folder of a ROS 2 bag"),
        Parameter("topic", "", "", "topic of the laser; empty: the only one"),
        *truth_files.PARAMETERS,
        Parameter("odometry", "auto", "", "'auto', a topic of nav_msgs/Odometry, 'tf' or 'none'"),
        Parameter("base_frame", "", "", "base frame of all poses; empty: that of the odometry, else base_link"),
        Parameter(
            "base_from_sensor", "auto", "", "pose of the lidar on the base: 'auto' (tf) or 'x y theta' in m, m, rad"
        ),
        Parameter(
            "fields",
            "",
            "",
            "where a message of another type holds the sweep: 'ranges=NAME angles=NAME "
            "range_unit=mm angle_unit=deg clockwise', or first=NAME step=NAME for even angles",
        ),
        *cloud_slice.PARAMETERS,
        Parameter(
            "sweep_s",
            0.0,
            "s",
            "time from the first beam to the last, where a scan's time_increment is 0 or wrong; 0: as recorded",
            low=0.0,
            high=10.0,
        ),
        RANGE_MIN,
        Parameter(
            "stamp_shift_s", 0.0, "s", "added to the stamps of the scans, where these are not the times of the odometry"
        ),
        Parameter(
            "odometry_unit",
            "m",
            "",
            "of the positions of the odometry, where it is not the metre",
            choices=tuple(LENGTH_UNITS),
        ),
        *reader_common.SELECTION,
    ),
    missing=partial(reader_common.describe_missing_files, "rosbag"),
    choose=partial(reader_common.choose_parameters, "rosbag"),
    thinned_by="every",
)
