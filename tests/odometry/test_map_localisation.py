"""Tracking in a known map: poses in the map are those of the simulation, a place that repeats is refused."""

import math
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from evalkit.core.errors import BadData, BadParameter, NotLocalised
from evalkit.core.grid import OccupancyGrid
from evalkit.core.ground_truth import Truth
from evalkit.core.known_map import KnownMap
from evalkit.core.map_start import MapStart
from evalkit.core.odometry_estimate import OdometryEstimate
from evalkit.core.pose import Pose
from evalkit.core.scan import Frame, Scan
from evalkit.io.map_server import read_rotated_map, write_map
from evalkit.odometry import map_localisation
from evalkit.odometry.frontend import complete_parameters
from evalkit.odometry.local_map import WallsAround
from evalkit.odometry.map_localisation import MapTracker, PlaceSearch, find_start, localise
from evalkit.odometry.map_search import SEARCH_POINTS, MapSearch, Place, thin_evenly
from evalkit.odometry.run_odometry import estimate_poses
from evalkit.plugins import registry
from evalkit.plugins.known_map import load_known_map, parse_start
from evalkit.plugins.parameters import Parameter
from evalkit.plugins.specs import OdometrySpec

CELL_M = 0.05
WALLS = [(-4.0, -3.0, 4.0, -3.0), (4.0, -3.0, 4.0, 1.0), (4.0, 1.0, 0.0, 1.0), (0.0, 1.0, 0.0, 4.0),
         (0.0, 4.0, -4.0, 4.0), (-4.0, 4.0, -4.0, -3.0)]  # fmt: skip
BOX = [(-3.0, -2.0, 3.0, -2.0), (3.0, -2.0, 3.0, 2.0), (3.0, 2.0, -3.0, 2.0), (-3.0, 2.0, -3.0, -2.0)]
PATH = [Pose(-2.0 + 0.1 * k, -1.0 + 0.05 * k, 0.3 + 0.04 * k) for k in range(12)]


class Drive:
    """A sequence of given frames."""

    def __init__(self, frames, grid=None):
        self._frames, self._grid = frames, grid

    def __len__(self):
        return len(self._frames)

    def frames(self):
        return iter(self._frames)

    def truth(self):
        return Truth("exact", grid=self._grid)

    def notes(self):
        return {}


def draw_map(folder: Path, walls) -> Path:
    """Write a map whose cells with walls through their middle are occupied, all others free."""
    log_odds = np.full((180, 200), -3.5, dtype=np.float32)
    for x0, y0, x1, y1 in walls:
        along = np.linspace(0.0, 1.0, 1000)[:, None]
        cells = np.floor((np.array([x0, y0]) + along * np.array([x1 - x0, y1 - y0]) + [5.025, 4.025]) / CELL_M).astype(
            int
        )
        log_odds[cells[:, 1], cells[:, 0]] = 3.5
    write_map(folder / "floor", OccupancyGrid(log_odds, np.ones(log_odds.shape, dtype=bool), CELL_M, -5.025, -4.025))
    return folder / "floor.yaml"


@pytest.fixture
def floor(tmp_path) -> Path:
    """The map of an L-shaped room."""
    return draw_map(tmp_path, WALLS)


def read_walls(path) -> KnownMap:
    known = load_known_map({"map": str(path)}, Drive([]))
    assert known is not None
    return known


def measure(pose, index, walls=WALLS, odometry=True):
    """Return the frame of a scan from a pose: a beam a degree, each to the nearest wall."""
    angles = np.radians(np.arange(360.0))
    ranges = np.full(360, np.inf)
    x, y = np.cos(angles + pose.theta), np.sin(angles + pose.theta)
    for x0, y0, x1, y1 in walls:
        dx, dy, px, py = x1 - x0, y1 - y0, x0 - pose.x, y0 - pose.y
        with np.errstate(divide="ignore", invalid="ignore"):
            along, share = (px * dy - py * dx) / (x * dy - y * dx), (px * y - py * x) / (x * dy - y * dx)
        ranges = np.where((along > 0.0) & (share >= 0.0) & (share <= 1.0), np.minimum(ranges, along), ranges)
    odom = Pose(7.0, 3.0, -1.0) @ pose if odometry else None
    return Frame(Scan(index * 100_000_000, ranges, angles, 0.05, 20.0), odom_from_base=odom)


def distance(one: Pose, other: Pose) -> float:
    """Return the distance of two poses in m, a radian as a metre."""
    return math.hypot(one.x - other.x, one.y - other.y) + abs((one.inverse() @ other).theta)


def track(floor, frames, name="distance-field", **reserved):
    """Return the localised run and the poses (N, 3) in the map, of a registration with its defaults."""
    spec = registry.backend(name)
    found = localise(
        spec, complete_parameters(name, spec, {}), {"map": str(floor), **reserved}, Drive(frames), floor.parent
    )
    assert found is not None
    answers = estimate_poses(found.make(), found.sequence.frames())
    return found, [found.start.map_from_start @ Pose.of(row) for row in answers]


@pytest.mark.parametrize("odometry", [True, False])
def test_the_start_is_found_in_the_whole_map_and_every_pose_is_the_true_one(floor, odometry):
    found, poses = track(floor, [measure(pose, k, odometry=odometry) for k, pose in enumerate(PATH)])
    assert (found.start.scans, found.start.after_s, found.start.searched) == (1, 0.0, True)
    assert max(distance(a, b) for a, b in zip(poses, PATH, strict=True)) < 0.03  # half a cell of the map


def test_a_given_start_is_corrected_by_the_first_scan(floor):
    start = PATH[0] @ Pose(0.1, -0.05, 0.03)
    text = f"{start.x},{start.y},{math.degrees(start.theta)}"
    found, _ = track(floor, [measure(PATH[0], 0)], map_start=text)
    assert not found.start.searched
    assert distance(found.start.map_from_start, PATH[0]) < 0.03


def test_scans_of_another_place_are_left_out_until_one_fits(floor):
    circle = [(math.cos(a), math.sin(a), math.cos(a + 0.2), math.sin(a + 0.2)) for a in np.arange(0.0, 6.3, 0.2)]
    strange = [measure(Pose(), k, circle, odometry=False) for k in range(5)]
    later = [measure(pose, 20 + k, odometry=False) for k, pose in enumerate(PATH)]
    found, poses = track(floor, strange + later)
    assert (found.start.scans, found.start.after_s) == (6, 2.0)
    assert distance(poses[0], PATH[0]) < 0.03


def test_a_place_that_looks_the_same_from_two_sides_is_ambiguous(tmp_path):
    known = read_walls(draw_map(tmp_path, BOX))
    frames = [measure(Pose(-1.0 + 0.3 * k, 0.5, 0.2), k, BOX) for k in range(6)]
    with pytest.raises(NotLocalised, match="ambiguous, two places fit alike"):
        find_start(known, frames)
    start = find_start(known, frames, given=Pose(-1.1, 0.4, 0.15))
    assert distance(start.map_from_start, Pose(-1.0, 0.5, 0.2)) < 0.03


def test_no_place_and_a_wrong_given_start_are_errors(floor):
    known = read_walls(floor)
    small = [tuple(0.3 * value for value in wall) for wall in WALLS]
    with pytest.raises(NotLocalised, match="no place in the map fits"):
        find_start(known, [measure(Pose(), 0, small)])
    with pytest.raises(NotLocalised, match="does not fit the map at the given start"):
        find_start(known, [measure(PATH[0], 0)], given=Pose(20.0, 20.0, 0.0))


def test_a_kidnapped_robot_is_found_again(floor, monkeypatch):
    monkeypatch.setattr(map_localisation, "LOST_SCANS", 3)
    away = [Pose(2.5 - 0.3 * k, -2.0 + 0.02 * k, 2.8) for k in range(8)]
    kept = Pose(7.0, 3.0, -1.0) @ PATH[-1]
    scans = [measure(pose, 12 + k).scan for k, pose in enumerate(away)]
    carried = [
        Frame(scan, odom_from_base=kept @ away[0].inverse() @ pose) for scan, pose in zip(scans, away, strict=True)
    ]
    _, poses = track(floor, [measure(pose, k) for k, pose in enumerate(PATH)] + carried)
    assert distance(poses[12], away[0]) > 1.0  # the wheels did not turn
    assert distance(poses[-1], away[-1]) < 0.05


@pytest.mark.parametrize(
    ("odom", "after_s", "due"),
    [(Pose(0.6), 0.0, True), (Pose(0.0, 0.0, 0.6), 0.0, True), (Pose(0.3, 0.3, 0.3), 9.0, False),
     (None, 0.9, False), (None, 1.0, True)],
)  # fmt: skip
def test_a_map_is_searched_again_after_half_a_metre_or_30_degrees_or_without_odometry_a_second(odom, after_s, due):
    search = PlaceSearch(SimpleNamespace())
    assert search._is_due(odom, 0)  # never searched
    search._tried = (None if odom is None else Pose(), 5 * 10**9)
    assert search._is_due(odom, round((5.0 + after_s) * 1e9)) == due


@pytest.mark.parametrize(("better", "jumps"), [(-0.05, False), (0.05, False), (0.2, True)])
def test_a_lost_track_jumps_only_to_a_place_that_fits_better_by_a_tenth(monkeypatch, better, jumps):
    """The scans fit by 0.3 where the track is, against 0.9 at the start: lost from the second on."""
    there = Pose(5.0, 5.0, 1.0)
    monkeypatch.setattr(map_localisation, "LOST_SCANS", 2)
    monkeypatch.setattr(
        map_localisation, "PlaceSearch", lambda _: SimpleNamespace(feed=lambda _frame: Place(there, 0.3 + better, 0.0))
    )
    standing = SimpleNamespace(update=lambda _frame: OdometryEstimate(Pose()))
    tracker = MapTracker(
        lambda _pose: standing, SimpleNamespace(score=lambda _points: 0.3), MapStart(Pose(), 1, 0.0, True, 0.9)
    )
    poses = [tracker.update(measure(Pose(), index)).pose for index in range(2)]
    assert poses == [Pose(), there if jumps else Pose()]


def test_a_back_end_that_reads_the_map_is_given_it_with_the_start(floor):
    names = {"map": "", "start_x_m": 0.0, "start_y_m": 0.0, "start_deg": 0.0, "beams": 60}
    spec = OdometrySpec(
        dict, "returns its parameters", "", "", parameters=tuple(Parameter(*each, "", "") for each in names.items())
    )
    frames = [measure(PATH[0], 0)]
    found = localise(spec, names, {"map": str(floor)}, Drive(frames), floor.parent)
    assert found is not None
    given: object = found.make()
    assert isinstance(given, dict)
    assert (given["map"], given["beams"]) == (str(floor), 60)
    assert distance(Pose(given["start_x_m"], given["start_y_m"], math.radians(given["start_deg"])), PATH[0]) < 0.03
    grid, _ = read_rotated_map(floor)
    of_truth = localise(spec, names, {"map": "truth"}, Drive(frames, grid), floor.parent)
    assert of_truth is not None
    made: object = of_truth.make()
    assert isinstance(made, dict)
    written, _ = read_rotated_map(Path(made["map"]))
    np.testing.assert_array_equal(written.occupied(), grid.occupied())


def test_maps_and_starts_that_cannot_be_used_are_errors(tmp_path):
    free = np.full((4, 4), -3.5, dtype=np.float32)
    write_map(tmp_path / "free", OccupancyGrid(free, np.ones((4, 4), dtype=bool), CELL_M, 0.0, 0.0))
    with pytest.raises(BadData, match="no occupied cell"):
        read_walls(tmp_path / "free.yaml")
    with pytest.raises(BadData, match="no true map"):
        load_known_map({"map": "truth"}, Drive([]))
    for text in ("1,2", "a,b,c", "1,2,nan"):
        with pytest.raises(BadParameter, match="map_start"):
            parse_start(text)
    assert parse_start("1,-2,90") == Pose(1.0, -2.0, math.pi / 2)


def test_a_start_survives_json_and_refuses_what_is_no_start():
    start = MapStart(Pose(1.0, 2.0, 0.5), 3, 0.2, True, 0.8)
    assert MapStart.of(start.as_dict()) == start
    for wrong in ({"scans": 0}, {"after_s": -1.0}, {"score": 1.5}, {"scans": 1.5}, {"searched": 1}):
        with pytest.raises(ValueError, match="expected"):
            MapStart.of(start.as_dict() | wrong)


def test_the_walls_around_a_robot_stay_until_it_has_moved_by_a_tenth_of_the_radius():
    walls = WallsAround(KnownMap(np.array([[5.0, 0.9], [5.0, 1.1]]), 0.05, "two cells"), Pose(), radius_m=1.0)
    near = walls.cloud(Pose(5.0, 0.0))
    assert near.points.tolist() == [[5.0, 0.9]]
    assert walls.cloud(Pose(5.06, 0.06)) is near
    assert walls.cloud(Pose(5.0, 0.11)).points.tolist() == [[5.0, 0.9], [5.0, 1.1]]


def test_the_walls_around_a_robot_are_taken_again_after_a_tenth_of_any_radius():
    walls = WallsAround(KnownMap(np.array([[5.0, 0.0]]), 0.05, "a cell"), Pose(1.0, 2.0, 0.0), radius_m=3.0)
    near = walls.cloud(Pose())
    assert walls.cloud(Pose(0.0, 0.29)) is near
    aside = walls.cloud(Pose(0.0, 1.0))
    assert walls.cloud(Pose(0.0, 1.29)) is aside
    near = walls.cloud(Pose())
    assert walls.cloud(Pose(0.31, 0.0)) is not near
    assert walls.cloud(Pose(1.01, -2.0)).points.tolist() == [[4.0, -2.0]]  # 2.99 m away
    assert len(walls.cloud(Pose(0.7, -2.0))) == 0  # 3.3 m


@pytest.mark.parametrize(("cells", "kept"), [(1, 1), (299, 299), (300, 300), (301, 151), (601, 201)])
def test_at_most_three_hundred_points_are_searched_evenly_chosen(cells, kept):
    points = np.column_stack([0.05 + 0.1 * np.arange(cells), np.full(cells, 0.05)])
    found = thin_evenly(points)
    assert (len(found), SEARCH_POINTS) == (kept, 300)
    np.testing.assert_allclose(np.diff(found[:, 0]), 0.1 * math.ceil(cells / 300))


@pytest.mark.parametrize(
    ("off", "found"),
    [(Pose(0.45, 0.0), True), (Pose(0.0, -0.45), True), (Pose(0.0, 0.0, math.radians(14.0)), True),
     (Pose(0.9, 0.0), False), (Pose(0.0, 0.9), False), (Pose(0.0, 0.0, math.radians(-21.0)), False)],
)  # fmt: skip
def test_a_given_start_is_corrected_within_half_a_metre_and_15_degrees(floor, off, found):
    points = measure(PATH[3], 0).points_in_base(None)
    place = MapSearch(read_walls(floor)).correct_place(points, PATH[3] @ off)
    assert (place is not None and distance(place.map_from_base, PATH[3]) < 0.04) == found


def test_a_place_is_found_to_a_hundredth_of_a_metre_and_a_quarter_of_a_degree(floor):
    """The search in cells of 10 cm alone would be off by up to 5 cm."""
    search = MapSearch(read_walls(floor))
    for pose in PATH[::3]:  # a given place has no rival
        place = search.correct_place(measure(pose, 0).points_in_base(None), pose @ Pose(0.17, -0.13, 0.06))
        assert place is not None
        assert not place.is_ambiguous
        left = pose.inverse() @ place.map_from_base
        assert math.hypot(left.x, left.y) < 0.025
        assert abs(left.theta) < math.radians(0.3)


def joined(odometry):
    """Return the x of the scans that are searched together after positions of the wheels."""
    search = PlaceSearch(SimpleNamespace())
    for x in odometry:
        search._join(np.zeros((1, 2)), Pose(x))
    return [pose.x for _, pose in search._scans]


def test_scans_ten_centimetres_apart_on_the_last_five_metres_are_joined_sixty_at_most():
    assert joined([0.0, 0.09, 0.2, 0.29]) == [0.09, 0.29]  # of scans nearer than 10 cm the newer ones
    assert joined([0.0, 2.0, 4.9]) == [0.0, 2.0, 4.9]
    assert joined([0.0, 2.0, 5.1]) == [2.0, 5.1]
    circle = [0.15 * (k % 2) for k in range(70)]
    assert len(joined(circle)) == 60


@pytest.mark.parametrize(("count", "searched"), [(10, 1), (9, 0)])
def test_a_scan_of_ten_points_is_searched(count, searched):
    search = PlaceSearch(SimpleNamespace(find_place=lambda _: None))
    angles = np.linspace(0.0, 3.0, count)
    frame = Frame(Scan(0, np.full(count, 5.0), angles, 0.05, 20.0), odom_from_base=Pose())
    assert search.feed(frame) is None
    assert search.trials == searched


@pytest.mark.parametrize(
    ("due", "says"), [(True, "after 40 searches in 40 scans"), (False, "after 0 searches in 2000")]
)
def test_a_start_is_given_up_after_40_searches_or_2000_scans(floor, monkeypatch, due, says):
    monkeypatch.setattr(map_localisation.MapSearch, "find_place", lambda *_: None)
    monkeypatch.setattr(PlaceSearch, "_is_due", lambda *_: due)
    ring = Scan(0, np.full(12, 5.0), np.linspace(0.0, 3.0, 12), 0.05, 20.0)
    frames = (Frame(replace(ring, stamp_ns=k), odom_from_base=Pose(0.2 * (k % 2))) for k in range(2100))
    with pytest.raises(NotLocalised, match=says):
        find_start(read_walls(floor), frames)


@pytest.mark.parametrize(("score", "lost"), [(0.55, False), (0.53, True)])
def test_a_track_is_lost_after_ten_scans_that_fit_by_less_than_sixty_percent_of_the_start(monkeypatch, score, lost):
    """The start fits by 0.9: 0.54 is the limit."""
    there = Place(Pose(5.0, 5.0, 1.0), 0.9, 0.0)
    monkeypatch.setattr(map_localisation, "PlaceSearch", lambda _: SimpleNamespace(feed=lambda _frame: there))
    standing = SimpleNamespace(update=lambda _frame: OdometryEstimate(Pose()))
    tracker = MapTracker(
        lambda _pose: standing, SimpleNamespace(score=lambda _points: score), MapStart(Pose(), 1, 0.0, True, 0.9)
    )
    poses = [tracker.update(measure(Pose(), index)).pose for index in range(10)]
    assert poses == [Pose()] * 9 + [there.map_from_base if lost else Pose()]
