"""Track a robot in a known map: find the start, follow it with any registration, and find it again.

The start and the way back after a lost track are found by the harness, in the same way for all methods: branch and
bound over the whole map, with the scans of the last metres joined by wheel odometry, until one place fits and no other
nearly as well. In between, a registration matches each scan with the walls around the robot, in evalkit's front end.
An odometry or a SLAM runs as it is, from the same start; one with a parameter ``map`` is given the map and the start.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from functools import partial
from itertools import islice
from pathlib import Path
from typing import NamedTuple

import numpy as np

from evalkit.core.errors import NotLocalised
from evalkit.core.known_map import KnownMap
from evalkit.core.map_start import MapStart
from evalkit.core.odometry_estimate import OdometryEstimate
from evalkit.core.pose import Pose
from evalkit.core.scan import Frame
from evalkit.core.se2 import Floats
from evalkit.io.map_server import write_map
from evalkit.odometry import frontend
from evalkit.odometry.local_map import WallsAround, voxel_means
from evalkit.odometry.map_search import MapSearch, Place
from evalkit.plugins.changed_sequence import ChangedSequence
from evalkit.plugins.known_map import load_known_map, parse_start
from evalkit.plugins.parameters import MAP, MAP_START, TRUE_MAP, Value
from evalkit.plugins.protocols import Odometry, Sequence
from evalkit.plugins.specs import BackendSpec, RegistrationSpec

MAX_SEARCHED, MAX_TRIALS = 2000, 40
"""A start is searched in so many scans, with so many searches of the map."""

EVERY_M, EVERY_RAD, EVERY_S = 0.5, math.radians(30.0), 1.0
"""The map is searched again after this motion; without odometry, after this time."""

JOINED_M, JOINED_SCANS = 5.0, 60
"""Scans within this path are searched together, at most so many of them, each ``JOIN_EVERY_M`` after the last."""

JOIN_EVERY_M = 0.1

LOST_SHARE, LOST_SCANS, BETTER = 0.6, 10, 0.1
"""The track is lost where so many scans in a row have less than this share of the start's score. Another place must
have a score better by ``BETTER``."""


class PlaceSearch:
    """Searches a map for the place of a robot from its last scans; ``last`` is what the last search found."""

    def __init__(self, search: MapSearch) -> None:
        self._search = search
        self._scans: deque[tuple[Floats, Pose]] = deque(maxlen=JOINED_SCANS)
        self._tried: tuple[Pose | None, int] | None = None
        self.trials = 0
        self.last: Place | None = None

    def feed(self, frame: Frame) -> Place | None:
        """Take one frame; return its place if it is found and no other fits nearly as well."""
        odom, stamp = frame.odom_from_base, frame.scan.stamp_ns
        points = voxel_means(frame.points_in_base(frame.start_from_end), 0.05)
        if odom is None:
            self._scans.clear()
        self._join(points, odom or Pose())
        if not self._is_due(odom, stamp) or len(points) < frontend.FrontEndSettings.min_inliers:
            return None
        self._tried, self.trials = (odom, stamp), self.trials + 1
        base_from_odom = (odom or Pose()).inverse()
        joined = [(base_from_odom @ pose).transform(scan) for scan, pose in self._scans]
        self.last = self._search.find_place(np.concatenate(joined))
        return None if self.last is None or self.last.is_ambiguous else self.last

    def _join(self, points: Floats, odom: Pose) -> None:
        if self._scans and _distance_m(self._scans[-1][1], odom) < JOIN_EVERY_M:
            self._scans.pop()  # the robot hardly moved: the newer scan in place of the older
        self._scans.append((points, odom))
        while _distance_m(self._scans[0][1], odom) > JOINED_M:
            self._scans.popleft()

    def _is_due(self, odom: Pose | None, stamp_ns: int) -> bool:
        if self._tried is None:
            return True
        before, tried_ns = self._tried
        if odom is None or before is None:
            return stamp_ns - tried_ns >= EVERY_S * 1e9
        return _distance_m(before, odom) >= EVERY_M or abs((before.inverse() @ odom).theta) >= EVERY_RAD


def find_start(known: KnownMap, frames: Iterable[Frame], given: Pose | None = None) -> MapStart:
    """Return where the first scan with an answer lies in a map; ``given``: its approximate place, where known.

    Raises NotLocalised where no place fits, or where several do.
    """
    whole = MapSearch(known)
    search, first_ns, scans = PlaceSearch(whole), 0, 0
    for index, frame in enumerate(islice(frames, MAX_SEARCHED)):
        first_ns, scans = first_ns if index else frame.scan.stamp_ns, index + 1
        after_s = (frame.scan.stamp_ns - first_ns) * 1e-9
        if given is not None:
            points = frame.points_in_base(frame.start_from_end)
            place = whole.correct_place(points, given) if len(points) else None
            if place is None:
                raise NotLocalised(
                    known.name, "the first scan does not fit the map at the given start", "give another start"
                )
            return MapStart(place.map_from_base, 1, after_s, False, place.score)
        place = search.feed(frame)
        if place is not None:
            return MapStart(place.map_from_base, scans, after_s, True, place.score)
        if search.trials >= MAX_TRIALS:
            break
    raise NotLocalised(known.name, _describe_failure(search, scans), "give the start")


def _describe_failure(search: PlaceSearch, scans: int) -> str:
    place = search.last
    tried = f"after {search.trials} searches in {scans} scans"
    if place is None:
        return f"not localised: no place in the map fits the scans, {tried}"
    return f"not localised: ambiguous, two places fit alike (scores {place.score:.2f} and {place.rival:.2f}), {tried}"


class Localised(NamedTuple):
    """How a run goes on in a known map: the odometry to make, the sequence from the first located scan, the start."""

    make: Callable[[], Odometry]
    sequence: Sequence
    start: MapStart


def localise(
    spec: BackendSpec, values: Mapping[str, Value], reserved: Mapping[str, Value], sequence: Sequence, folder: Path
) -> Localised | None:
    """Find the start of a run in its known map; None where its sequence has none.

    ``values``: complete parameters of the back end. ``reserved``: parameters of the sequence with the map. ``folder``:
    where a true map is written for a back end that reads it. Raises NotLocalised, BadData or BadParameter.
    """
    known = load_known_map(reserved, sequence)
    if known is None:
        return None
    start = find_start(known, sequence.frames(), parse_start(str(reserved.get(MAP_START, ""))))
    if isinstance(spec, RegistrationSpec):
        make = partial(_make_tracker, spec, values, known, start)
    else:
        make = partial(frontend.make_odometry, spec, _with_map(spec, values, sequence, folder, known.name, start))
    return Localised(make, ChangedSequence(sequence, lambda _, frame: frame, start.scans - 1), start)


def _make_tracker(spec: RegistrationSpec, values: Mapping[str, Value], known: KnownMap, start: MapStart) -> Odometry:
    own = {each.name: values[each.name] for each in frontend.PARAMETERS}
    settings = frontend.FrontEndSettings(**own)  # type: ignore[arg-type]  # by name

    def make_front(map_from_start: Pose) -> Odometry:
        walls = WallsAround(known, map_from_start, settings.local_map_radius_m)
        return frontend.FrontEnd(*spec.make_stages(values), settings, walls)

    return MapTracker(make_front, MapSearch(known), start)


def _with_map(
    spec: BackendSpec, values: Mapping[str, Value], sequence: Sequence, folder: Path, name: str, start: MapStart
) -> Mapping[str, Value]:
    """Return the parameters with the map's file and the start, of those that a back end with a ``map`` declares."""
    if spec.map_use != "reads":
        return values
    names = {each.name for each in spec.parameters}
    grid = sequence.truth().grid if name == TRUE_MAP else None
    if grid is not None:
        write_map(folder / MAP, grid)
        name = str(folder / f"{MAP}.yaml")
    pose = start.map_from_start
    known: dict[str, Value] = {
        MAP: name,
        "start_x_m": pose.x,
        "start_y_m": pose.y,
        "start_deg": math.degrees(pose.theta),
    }
    return {**values, **{key: value for key, value in known.items() if key in names}}


class MapTracker:
    """An Odometry in a known map; its poses are ``start_from_base``, of the start that was found in the map.

    Where ``LOST_SCANS`` scans in a row fit the map worse than ``LOST_SHARE`` of the start, the map is searched for the
    robot as at the start, and the answer jumps to the place found.
    """

    def __init__(self, make_front: Callable[[Pose], Odometry], whole: MapSearch, start: MapStart) -> None:
        self._make_front, self._whole, self._start = make_front, whole, start
        self._map_from_front = start.map_from_start
        self._front = make_front(start.map_from_start)
        self._misfits = 0
        self._search: PlaceSearch | None = None

    def update(self, frame: Frame) -> OdometryEstimate:
        """Follow one scan."""
        estimate = self._front.update(frame)
        map_from_base = self._map_from_front @ estimate.pose
        points = frame.points_in_base(frame.start_from_end)
        score = self._whole.score(map_from_base.transform(points[:: max(len(points) // 100, 1)]))
        self._misfits = 0 if score >= LOST_SHARE * self._start.score else self._misfits + 1
        if self._misfits < LOST_SCANS:
            self._search = None
        else:
            self._search = self._search or PlaceSearch(self._whole)
            place = self._search.feed(frame)
            if place is not None and place.score >= score + BETTER:
                map_from_base, self._map_from_front = place.map_from_base, place.map_from_base
                self._front, self._misfits = self._make_front(map_from_base), 0
                self._front.update(frame)
        return replace(estimate, pose=self._start.map_from_start.inverse() @ map_from_base)


def _distance_m(one: Pose, other: Pose) -> float:
    """Return the distance between two poses."""
    return math.hypot(one.x - other.x, one.y - other.y)
