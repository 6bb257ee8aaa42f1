import numpy as np
import pytest

from evalkit_datasets.worlds import floorplans
from evalkit_datasets.worlds.robot import RouteDrive

TEMPTING = ("doors", "wings", "symmetric-office")
PLANS = {
    name: floorplans.load_plan(name) for name in ("room", "lab", "loop", "corridor", "office", "long-loop", *TEMPTING)
}


@pytest.mark.parametrize("name", PLANS)
def test_a_route_keeps_30_cm_from_every_boundary(name):
    plan = PLANS[name]
    path = plan.route.poses_at(np.arange(0.0, plan.route.length_m, max(0.01, plan.route.length_m / 5_000)))
    assert plan.world.clearance(path[:, :2]).min() >= 0.3


@pytest.mark.parametrize(
    ("name", "length_m"),
    [
        ("room", 22.7),
        ("lab", 23.5),
        ("loop", 40.9),
        ("corridor", 20.9),
        ("office", 34.8),
        ("doors", 84.9),
        ("wings", 100.5),
        ("symmetric-office", 47.4),
        ("long-loop", 299.2),
    ],
)
def test_a_route_has_the_length_in_its_description(name, length_m):
    assert PLANS[name].route.length_m == pytest.approx(length_m, abs=0.1)


@pytest.mark.parametrize(
    ("name", "fastest_dps"), [("room", 69), ("lab", 69), ("loop", 69), ("corridor", 43), ("office", 69)]
)
def test_a_route_has_the_yaw_rate_in_its_description(name, fastest_dps):
    drive = RouteDrive(PLANS[name].route, 0.3)
    headings = np.unwrap(drive.poses(np.arange(0, drive.duration_ns, 10_000_000))[:, 2])
    assert np.degrees(np.abs(np.diff(headings)).max() / 0.01) == pytest.approx(fastest_dps, abs=0.5)


@pytest.mark.parametrize("name", ["room", "lab", "loop"])
def test_routes_have_straights_gentle_curves_and_quick_turns(name):
    curvature, length = np.abs(PLANS[name].route.sections[:, 3]), PLANS[name].route.sections[:, 4]
    kinds = [curvature == 0.0, (curvature > 0.0) & (curvature < 0.6), curvature >= 4.0]
    assert [bool(length[kind].sum() > 0.3) for kind in kinds] == [True, True, True]


def test_the_room_has_the_dimensions_of_the_paper():
    world = PLANS["room"].world
    np.testing.assert_array_equal(world.circles, [[2.0, 8.0, 1.5]])
    assert np.linalg.norm(world.segments[:, 2:] - world.segments[:, :2], axis=1).tolist() == [10.0] * 4


def test_the_corridor_shows_only_two_walls_longer_than_the_lidar_range():
    plan = PLANS["corridor"]
    assert len(plan.world.segments) == 2
    assert len(plan.world.circles) == 0
    x = plan.route.poses_at(np.arange(0.0, plan.route.length_m, 0.01))[:, 0]
    first, last = plan.world.segments[:, [0, 2]].min(), plan.world.segments[:, [0, 2]].max()
    assert min(x.min() - first, last - x.max()) > 12.2


@pytest.mark.parametrize("name", ["room", "lab", "loop", "office", "long-loop", *TEMPTING])
def test_no_beam_leaves_a_closed_world(name):
    plan, generator = PLANS[name], np.random.default_rng(0)
    path = plan.route.poses_at(np.repeat(np.arange(0.0, plan.route.length_m, 0.5), 90))
    assert np.isfinite(plan.world.cast(path[:, :2], generator.uniform(-np.pi, np.pi, len(path)))).all()


SEEN_M = 12.0


def ranges(name, pose):
    plan, bearings = PLANS[name], pose[2] + np.radians(np.arange(0.5, 360.0))
    return np.minimum(plan.world.cast(np.tile(pose[:2], (360, 1)), bearings), SEEN_M)


@pytest.mark.parametrize(
    ("name", "pose", "other", "same_beams"),
    [
        ("doors", [20.0, 1.0, 0.3], [26.0, 1.0, 0.3], 360),  # two doors farther
        ("wings", [5.0, 6.0, 1.0], [39.0, 6.0, 1.0], 340),  # some see the corridor through the doors
        ("symmetric-office", [3.0, 1.0, 0.0], [13.0, 11.0, np.pi], 360),
    ],
)
def test_two_places_of_a_tempting_world_look_the_same(name, pose, other, same_beams):
    difference = np.abs(ranges(name, np.array(pose)) - ranges(name, np.array(other)))
    assert (difference < 1e-6).sum() >= same_beams


def test_no_two_places_of_the_long_loop_look_the_same():
    rows = PLANS["long-loop"].route.poses_at(np.arange(0.0, 299.0, 1.0))
    scans = np.array([ranges("long-loop", row)[::4] for row in rows])
    different = (np.abs(scans[:, None] - scans[None]) > 0.1).sum(axis=-1)
    far = np.abs(np.arange(len(rows))[:, None] - np.arange(len(rows))[None]) > 2
    assert different[far].min() >= 5
