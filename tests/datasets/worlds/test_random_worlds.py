"""Worlds drawn from a seed: plans are reproducible, different and drivable; no settings are chosen on them."""

import hashlib
import tomllib
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from scipy import ndimage

from evalkit.config.experiment_file import load_experiment
from evalkit.core import se2
from evalkit.plugins import registry
from evalkit_datasets.worlds.floorplans import load_plan
from evalkit_datasets.worlds.synthetic import DRAWN_WORLDS
from evalkit_datasets.worlds.true_map import build_true_grid

REPORTS = Path(__file__).parents[3] / "reports"
SEEDS = range(150)


@dataclass(frozen=True)
class Bounds:
    """What is promised of all plans of a kind: digests of the first three, and bounds.

    ``side_m`` of the surrounding rectangle, ``area_m2`` of that rectangle, ``route_m``, number of boundaries, share of
    beams that return anywhere on the route, and doors that the route passes.
    """

    digests: list[str]
    side_m: tuple[float, float]
    area_m2: tuple[float, float]
    route_m: tuple[float, float]
    boundaries: int
    returns: float
    doors: int


KINDS = {
    "random-office": Bounds(
        ["a28861300732", "50f8bdb4066b", "f380ce498f9e"], (8.0, 20.0), (90.0, 260.0), (24.0, 46.0), 400, 0.95, 4
    ),
    "random-home": Bounds(
        ["92998fc704f1", "f2f8dd418f07", "ebcb04b34782"], (6.0, 15.0), (60.0, 120.0), (24.0, 58.0), 260, 0.95, 6
    ),
    "random-warehouse": Bounds(
        ["a7ddff828cd8", "241ee8750368", "79706feab588"], (15.0, 34.0), (250.0, 950.0), (38.0, 80.0), 800, 0.6, 0
    ),
}


def digest(plan):
    parts = (plan.world.segments, plan.world.circles, plan.route.corners)
    return hashlib.sha256(b"".join(part.tobytes() for part in parts)).hexdigest()[:12]


@pytest.fixture(scope="module", params=KINDS)
def kind(request):
    return request.param


@pytest.fixture(scope="module")
def plans(kind):
    return [DRAWN_WORLDS[kind](seed) for seed in SEEDS]


def test_all_kinds_of_drawn_worlds_are_tested():
    assert KINDS.keys() == DRAWN_WORLDS.keys()


def test_the_same_seed_draws_the_same_plan(kind, plans):
    assert [digest(DRAWN_WORLDS[kind](seed)) for seed in range(9)] == [digest(plan) for plan in plans[:9]]


def test_published_plans_do_not_change(kind, plans):
    """On no machine and with no version of numpy."""
    assert [digest(plan) for plan in plans[:3]] == KINDS[kind].digests


def test_other_seeds_draw_other_plans(plans):
    assert len({digest(plan) for plan in plans}) == len(plans)
    assert len({round(plan.route.length_m, 3) for plan in plans}) > 0.9 * len(plans)


def test_the_route_keeps_40_cm_from_every_boundary(plans):
    for seed, plan in enumerate(plans):
        path = plan.route.poses_at(np.arange(0.0, plan.route.length_m, 0.05))
        assert plan.world.clearance(path[:, :2]).min() >= 0.4, seed


def test_the_route_ends_where_it_began_and_has_no_jump(plans):
    for plan in plans:
        path = plan.route.poses_at(np.linspace(0.0, plan.route.length_m * (1.0 - 1e-12), 2_000))
        steps = se2.between(path, np.roll(path, -1, axis=0))
        assert np.abs(steps[:-1, :2]).max() < 0.05
        np.testing.assert_allclose(steps[-1], 0.0, atol=1e-6)


def test_the_size_of_plans_and_routes_is_bounded(kind, plans):
    bounds = KINDS[kind]
    for plan in plans:
        sides = np.ptp(plan.world.segments.reshape(-1, 2), axis=0)
        assert bounds.side_m[0] <= sides.min() <= sides.max() <= bounds.side_m[1]
        assert bounds.area_m2[0] <= np.prod(sides) <= bounds.area_m2[1]
        assert bounds.route_m[0] < plan.route.length_m < bounds.route_m[1]
        assert len(plan.world.segments) + len(plan.world.circles) < bounds.boundaries
        assert plan.route.corners[:, 2].min() >= 0.4


def doors_passed(plan):
    """Return how often the route has wall on both sides within 0.65 m, as in a door."""
    path = plan.route.poses_at(np.arange(0.0, plan.route.length_m, 0.02))
    beside = [plan.world.cast(path[:, :2], path[:, 2] + side) for side in (0.5 * np.pi, -0.5 * np.pi)]
    narrow = np.maximum(*beside) < 0.65
    return int(sum(after and not before for before, after in pairwise(narrow)))


def test_the_route_passes_doors(kind, plans):
    """In an office in and out of two rooms, in a home through all rooms."""
    assert min(doors_passed(plan) for plan in plans[:60]) >= KINDS[kind].doors


def look_around(plan, step_m=0.5, beams=72):
    """Return, over all places of the route, the least share of beams that fix the position in some direction.

    And the least share of beams that return.
    """
    path = plan.route.poses_at(np.arange(0.0, plan.route.length_m, step_m))
    origins, bearings = (
        np.repeat(path[:, :2], beams, axis=0),
        np.tile(np.arange(beams) * 2.0 * np.pi / beams, len(path)),
    )
    distance = plan.world.cast(origins, bearings + 0.01)
    directions = np.stack([np.cos(bearings + 0.01), np.sin(bearings + 0.01)], axis=1)
    seen = distance < 12.0
    normals = np.zeros((len(origins), 2))
    normals[seen] = plan.world.normals(origins[seen] + distance[seen, None] * directions[seen])
    per_scan = normals.reshape(len(path), beams, 2)
    fixed = np.linalg.eigvalsh(np.einsum("kbi,kbj->kij", per_scan, per_scan) / beams)[:, 0].min()
    return fixed, seen.reshape(len(path), beams).mean(axis=1).min()


def test_both_directions_are_observable_everywhere(kind, plans):
    assert look_around(load_plan("corridor"))[0] < 0.01
    for seed, plan in enumerate(plans[:45]):
        fixed, returns = look_around(plan)
        assert fixed > 0.05, seed
        assert returns > KINDS[kind].returns, seed


def test_only_a_warehouse_has_walls_out_of_range():
    farthest = {}
    for name, draw in DRAWN_WORLDS.items():
        returns = [look_around(draw(seed))[1] for seed in range(6)]
        farthest[name] = max(returns)
    assert farthest["random-warehouse"] < 0.95 < min(farthest["random-office"], farthest["random-home"])


def test_no_beam_leaves_the_building(plans):
    generator = np.random.default_rng(0)
    for plan in plans[:30]:
        path = plan.route.poses_at(np.repeat(np.arange(0.0, plan.route.length_m, 1.0), 60))
        assert np.isfinite(plan.world.cast(path[:, :2], generator.uniform(-np.pi, np.pi, len(path)))).all()


def test_nothing_crosses_an_outer_wall(plans):
    """The outer walls are the first closed outline of a plan."""
    for seed, plan in enumerate(plans):
        walls = plan.world.segments
        ends = int(np.flatnonzero((walls[:, 2:] == walls[0, :2]).all(axis=1))[0]) + 1
        outer, others = walls[:ends, None], walls[None, ends:]
        sides = [turn(outer, others[..., :2]) * turn(outer, others[..., 2:])]
        sides += [turn(others, outer[..., :2]) * turn(others, outer[..., 2:])]
        assert not ((sides[0] < -1e-9) & (sides[1] < -1e-9)).any(), seed


def turn(walls, points):
    """Return on which side of walls points are."""
    along, to_points = walls[..., 2:] - walls[..., :2], points - walls[..., :2]
    return along[..., 0] * to_points[..., 1] - along[..., 1] * to_points[..., 0]


@pytest.mark.parametrize("seed", range(6))
def test_a_robot_of_30_cm_reaches_all_rooms_of_a_home(seed):
    """Free space that a robot can be in is one piece, but for gaps behind furniture: the flat is not cut in two."""
    plan = DRAWN_WORLDS["random-home"](seed)
    path = plan.route.poses_at(np.arange(0.0, plan.route.length_m, 0.2))
    grid = build_true_grid(plan.world, 0.05, path[:, :2])
    roomy = ndimage.distance_transform_edt(grid.observed & ~grid.occupied()) * 0.05 > 0.15
    regions, count = ndimage.label(roomy)
    sizes = ndimage.sum_labels(roomy, regions, range(1, count + 1))
    assert sizes.max() > 0.9 * sizes.sum()
    assert sizes.max() * 0.05**2 > 25.0
    walls = plan.world.segments.reshape(-1, 2)
    cells = grid.centres(grid.observed)
    assert (np.ptp(cells, axis=0) > np.ptp(walls, axis=0) - 0.1).all()  # all outer walls are seen


def test_a_home_is_furnished_more_densely_than_an_office():
    """Boundaries for each square metre."""

    def density(name):
        plans = [DRAWN_WORLDS[name](seed) for seed in range(30)]
        return np.median(
            [
                (len(one.world.segments) + len(one.world.circles))
                / np.prod(np.ptp(one.world.segments.reshape(-1, 2), axis=0))
                for one in plans
            ]
        )

    assert density("random-home") > 1.3 * density("random-office")


def test_racks_repeat_in_two_of_three_warehouses():
    """Their posts have one radius, and their distance along a rack is the same."""
    for seed in range(9):
        circles = DRAWN_WORLDS["random-warehouse"](seed).world.circles
        posts = circles[np.isclose(circles[:, 2], 0.05)]
        assert (len(posts) > 30) == (seed % 3 != 2), seed


def test_the_sequence_of_a_seed_has_the_plan_of_the_seed(kind):
    for seed in (0, 7):
        sequence = registry.dataset(kind).make(seed=seed, laps=0.05)
        assert digest(sequence.plan) == digest(DRAWN_WORLDS[kind](seed))
        assert len(sequence) == len(list(sequence.frames()))


def test_no_settings_are_chosen_on_them(kind):
    """So that every method can be judged there."""
    for name in registry.names("backends"):
        assert kind not in registry.backend(name).tuned_on, name
    for file in sorted(REPORTS.glob("*.toml")):
        content = file.read_text(encoding="utf-8")
        assert kind not in [one["use"] for one in tomllib.loads(content).get("training", ())], file.name
        assert not any(kind in line for line in content.splitlines() if line.startswith("tuned_on")), file.name


def test_every_method_of_the_default_report_runs_on_them_with_the_same_seeds(kind):
    experiment = load_experiment(REPORTS / "default.toml")
    own = [run for run in experiment.runs() if run.sequence.label == kind]
    assert {run.method.label for run in own} == {method.label for method in experiment.methods}
    assert {run.seed for run in own} == set(range(6))
