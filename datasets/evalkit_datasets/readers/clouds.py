"""Read a folder of point clouds (PCD or PLY, one per scan) as a Sequence: a slice of heights of each."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from functools import partial
from pathlib import Path

import numpy as np

from evalkit.core.errors import BadData
from evalkit.core.ground_truth import Truth
from evalkit.core.scan import Frame, Scan
from evalkit.core.se2 import Floats
from evalkit.core.trajectory import Trajectory
from evalkit.io.timestamps import order_stamps
from evalkit.plugins.parameters import Parameter
from evalkit.plugins.result_files import read_trajectory
from evalkit.plugins.specs import DatasetSpec
from evalkit_datasets.parsing import cloud_slice, truth_files
from evalkit_datasets.parsing.cloud_files import SUFFIXES, read_cloud_file, stamps_of
from evalkit_datasets.parsing.cloud_slice import CloudSlice
from evalkit_datasets.parsing.range_minimum import RANGE_MIN
from evalkit_datasets.parsing.truth_files import TruthPaths
from evalkit_datasets.readers import reader_common


class Clouds:
    """The Sequence of a folder of clouds, in the order of the numbers in their names. Each cloud is read when needed.

    The numbers are taken as times (s, ms, us or ns) if they can be; else the clouds are 1 / ``rate_hz`` apart.
    """

    def __init__(
        self,
        path: str,
        relations: str = "",
        ground_truth: str = "",
        spans: str = "",
        odometry: str = "",
        rate_hz: float = 10.0,
        base_from_sensor: str = "0 0 0",
        height_min_m: float = CloudSlice.height_min_m,
        height_max_m: float = CloudSlice.height_max_m,
        beams: int = CloudSlice.beams,
        start: int = 0,
        every: int = 1,
        limit: int = 0,
        how: str = "",
        range_min_m: float = 0.0,
    ) -> None:
        self._slice = CloudSlice(height_min_m, height_max_m, beams).beyond("clouds", range_min_m)
        self._mounting = reader_common.parse_sensor_pose("clouds", base_from_sensor)
        files = _list_files(reader_common.check_exists("clouds", path))
        stamps = stamps_of([file.name for file in files], round(1e9 / rate_hz))
        order = order_stamps(stamps)
        which = reader_common.select_scans(start, every, limit)
        kept = order.keep[which]
        self._files, self._stamps = [files[at] for at in kept], stamps[kept]
        if not self._files:
            raise BadData(str(path), "", f"start {start} lies beyond its {len(files)} clouds", "start earlier")
        self._counts = {reader_common.REPEATED_STAMPS: order.repeated}
        self._poses: Floats = np.full((len(self), 3), np.nan)
        if odometry:
            poses = read_trajectory(odometry).trajectory
            joined, jumps = reader_common.join_jumps(poses.stamps_ns, poses.poses)
            self._counts |= jumps | reader_common.count_odometry_gaps(poses, self._stamps)
            self._poses = reader_common.odometry_at(Trajectory(poses.stamps_ns, joined, "odom", "base"), self._stamps)
        paths = TruthPaths(relations, ground_truth, spans, how)
        span = int(stamps.min()), int(stamps.max())
        self._truth, cut = truth_files.load_truth(paths, self._stamps, span)
        self._counts |= cut

    def __len__(self) -> int:
        return len(self._files)

    def frames(self) -> Iterator[Frame]:
        """Yield the slices in order of time; raises BadData for a file that is no cloud."""
        for file, stamp, row in zip(self._files, self._stamps.tolist(), self._poses, strict=True):
            ranges, angles = self._slice.cut(read_cloud_file(file))
            scan = Scan(stamp, ranges, angles, self._slice.range_min_m, self._slice.range_max_m)
            yield Frame(scan, self._mounting, reader_common.pose_or_none(row))

    def truth(self) -> Truth:
        """Return the truth of the files given."""
        return self._truth

    def notes(self) -> Mapping[str, int]:
        """Return the number of defects handled, by name."""
        return reader_common.drop_zeros(self._counts)


def _list_files(path: Path) -> list[Path]:
    """Return the clouds of a folder in the order of the numbers in their names, or the one file."""
    files = [path] if path.is_file() else [file for file in path.iterdir() if file.suffix.lower() in SUFFIXES]
    if not files:
        raise BadData(str(path), "", "no file .pcd or .ply in it", "give a folder with one point cloud per scan")
    return sorted(files, key=lambda file: ([int(digits) for digits in re.findall(r"\d+", file.name)], file.name))


SPEC = DatasetSpec(
    make=Clouds,
    summary="A folder of point clouds, one .pcd or .ply file per scan, sliced to the plane",
    sensor="a slice of heights of a 3D lidar",
    truth="files given as parameters",
    citation="PCD 0.7 (Point Cloud Library); PLY (Turk 1994)",
    licence="that of the recording",
    suffixes=SUFFIXES,
    parameters=(
        Parameter("path", "", "", "the folder, or one file"),
        *truth_files.PARAMETERS,
        Parameter("odometry", "", "", "wheel odometry as TUM (s, m, quaternion; odom_from_base), same clock"),
        Parameter("rate_hz", 10.0, "Hz", "clouds per second where the names hold no times", low=0.001, high=1000.0),
        Parameter("base_from_sensor", "0 0 0", "", "pose of the lidar on the base: 'x y theta' in m, m, rad"),
        *cloud_slice.PARAMETERS,
        RANGE_MIN,
        *reader_common.SELECTION,
    ),
    missing=partial(reader_common.describe_missing_files, "clouds"),
    thinned_by="every",
    choose=partial(reader_common.choose_parameters, "clouds"),
)
