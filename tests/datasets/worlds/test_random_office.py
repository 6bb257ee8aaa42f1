"""The random office: plans are reproducible, different, drivable and not degenerate; no settings are chosen on it."""

import hashlib
import tomllib
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from evalkit.config.experiment_file import load_experiment
from evalkit.core import se2
from evalkit.plugins import registry
from evalkit_datasets.worlds import synthetic
from evalkit_datasets.worlds.floorplans import load_plan
from evalkit_datasets.worlds.random_office import draw_office

REPORTS = Path(__file__).parents[3] / "reports"
SEEDS = range(200)


def digest(plan):
    parts = (plan.world.segments, plan.world.circles, plan.route.corners)
    return hashlib.sha256(b"".join(part.tobytes() for part in parts)).hexdigest()[:12]


@pytest.fixture(scope="module")
def plans():
    return [draw_office(seed) for seed in SEEDS]


def test_the_same_seed_draws_the_same_plan(plans):
    assert [digest(draw_office(seed)) for seed in range(9)] == [digest(plan) for plan in plans[:9]]


def test_published_plans_do_not_change(plans):
    """On no machine and with no version of numpy."""
    assert [digest(plan) for plan in plans[:3]] == ["a28861300732", "50f8bdb4066b", "f380ce498f9e"]


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


def test_the_size_of_plans_and_routes_is_bounded(plans):
    for plan in plans:
        corners = plan.world.segments.reshape(-1, 2)
        width, depth = np.ptp(corners, axis=0)
        assert 8.0 < min(width, depth) <= max(width, depth) < 20.0
        assert 24.0 < plan.route.length_m < 46.0
        assert len(plan.world.segments) + len(plan.world.circles) < 400
        assert plan.route.corners[:, 2].min() >= 0.4


def rooms_entered(plan):
    """Return how often the route leaves a hallway: wall on both sides within 0.65 m, as in a door."""
    path = plan.route.poses_at(np.arange(0.0, plan.route.length_m, 0.02))
    beside = [plan.world.cast(path[:, :2], path[:, 2] + side) for side in (0.5 * np.pi, -0.5 * np.pi)]
    narrow = np.maximum(*beside) < 0.65
    return int(sum(after and not before for before, after in pairwise(narrow)))


def test_the_route_passes_at_least_four_doors(plans):
    """In and out of two rooms."""
    assert min(rooms_entered(plan) for plan in plans[:60]) >= 4


def observed(plan, step_m=0.5, beams=72):
    """Return the least share of beams, over all places of the route, that fix the position in some direction."""
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
    return np.linalg.eigvalsh(np.einsum("kbi,kbj->kij", per_scan, per_scan) / beams)[:, 0].min()


def test_both_directions_are_observable_everywhere(plans):
    assert observed(load_plan("corridor")) < 0.01
    for seed, plan in enumerate(plans[:45]):
        assert observed(plan) > 0.05, seed


def test_no_beam_leaves_the_building(plans):
    generator = np.random.default_rng(0)
    for plan in plans[:30]:
        path = plan.route.poses_at(np.repeat(np.arange(0.0, plan.route.length_m, 1.0), 60))
        assert np.isfinite(plan.world.cast(path[:, :2], generator.uniform(-np.pi, np.pi, len(path)))).all()


def test_the_sequence_of_a_seed_has_the_plan_of_the_seed():
    for seed in (0, 7):
        sequence = synthetic.RANDOM_OFFICE.make(seed=seed, laps=0.05)
        assert digest(sequence.plan) == digest(draw_office(seed))
        assert len(sequence) == len(list(sequence.frames()))


def test_no_settings_are_chosen_on_it():
    """So that every method can be judged there."""
    for name in registry.names("backends"):
        assert "random-office" not in registry.backend(name).tuned_on, name
    for file in sorted(REPORTS.glob("*.toml")):
        content = file.read_text(encoding="utf-8")
        assert "random-office" not in [one["use"] for one in tomllib.loads(content).get("training", ())], file.name
        assert not any("random-office" in line for line in content.splitlines() if line.startswith("tuned_on")), (
            file.name
        )


def test_every_method_of_the_default_report_runs_on_it():
    experiment = load_experiment(REPORTS / "default.toml")
    methods = {run.method.label for run in experiment.runs() if run.sequence.dataset == "random-office"}
    assert methods == {method.label for method in experiment.methods}
