"""Errors relative to measured relations: hand calculations, symmetry, and the published recordings."""

from __future__ import annotations

import gzip
import os
from pathlib import Path

import numpy as np
import pytest

from evalkit.core import se2
from evalkit.core.ground_truth import Relations, Truth
from evalkit.core.run_result import STEP, RunResult, Score
from evalkit.core.se2 import Floats, Stamps
from evalkit.core.trajectory import Trajectory
from evalkit.metrics import relations
from evalkit.metrics.metric import Evidence

SECOND = 1_000_000_000


def evidence_of(estimate: Trajectory, measured: Relations | None) -> Evidence:
    steps = np.zeros(len(estimate), STEP)
    steps["stamp_ns"] = estimate.stamps_ns
    for column, name in enumerate(("x", "y", "theta")):
        steps[name] = estimate.poses[:, column]
    run = RunResult(steps, len(steps))
    return Evidence(run, Truth("measured", relations=measured))


def scores(estimate: Trajectory, measured: Relations | None) -> dict[str, Score]:
    evidence = evidence_of(estimate, measured)
    return {metric.name: metric.compute(evidence) for metric in relations.METRICS}


def make_straight_line(seconds: int) -> Trajectory:
    """Return a trajectory of one metre per second along x."""
    stamps = np.arange(seconds + 1) * SECOND
    return Trajectory(stamps, np.array([[1e-9 * stamp, 0.0, 0.0] for stamp in stamps]))


def make_relations(*rows: tuple[float, float, float, float, float]) -> Relations:
    """Build relations from rows t1, t2 (s), x, y, theta."""
    table = np.array(rows)
    return Relations((table[:, 0] * SECOND).astype(np.int64), (table[:, 1] * SECOND).astype(np.int64), table[:, 2:])


def test_mean_and_standard_deviation_equal_a_hand_calculation() -> None:
    measured = make_relations(
        (0, 2, 2.1, 0, 0), (1, 4, 3.0, 0.3, 0), (0, 20, 21, 0, 0), (3.5, 4.5, 1, 0, np.radians(4))
    )
    found = scores(make_straight_line(30), measured)
    assert found["relations_short_mean_deg"].value == pytest.approx(4 / 3)
    assert found["relations_long_mean_m"].value == pytest.approx(1.0)
    assert (found["relations_long_mean_m"].support, found["relations_short_mean_m"].support) == (1, 3)
    # turning 4 deg over 1 m: 0 m in one order of the pair, 2 sin(2 deg) m in the other
    errors = np.array([0.1, 0.3, np.sin(np.radians(2.0))])
    assert found["relations_short_mean_m"].value == pytest.approx(errors.mean())
    assert found["relations_short_sd_m"].value == pytest.approx(errors.std())
    assert found["relations_all_mean_m"].value == pytest.approx((errors.sum() + 1.0) / 4)


def test_our_error_is_independent_of_the_order_of_the_pair_and_the_published_ones_are_not() -> None:
    rng = np.random.default_rng(0)
    estimated, measured = rng.normal(size=(50, 3)), rng.normal(size=(50, 3))
    back = se2.inverse(estimated), se2.inverse(measured)
    assert relations.symmetric_errors(*back) == pytest.approx(relations.symmetric_errors(estimated, measured))

    def metres(errors: Floats) -> Floats:
        return np.asarray(np.linalg.norm(errors[:, :2], axis=1))

    forward = metres(relations.ordered_errors(estimated, measured))
    assert metres(relations.componentwise_errors(estimated, measured)) == pytest.approx(forward)
    assert metres(relations.cartographer_errors(estimated, measured)) == pytest.approx(
        metres(relations.ordered_errors(*back))
    )
    assert np.abs(metres(relations.ordered_errors(*back)) - forward).max() > 0.1


def test_errors_are_independent_of_the_frame_and_of_the_time_origin() -> None:
    measured = make_relations((0, 2, 2.1, 0, 0.1), (1, 4, 3.0, 0.3, 0), (0, 20, 21, 0, 0))
    here = scores(make_straight_line(30), measured)
    moved = Trajectory(
        make_straight_line(30).stamps_ns + 5 * SECOND, se2.compose([5.0, 5.0, 2.0], make_straight_line(30).poses)
    )
    later = Relations(measured.first_ns + 5 * SECOND, measured.second_ns + 5 * SECOND, measured.first_from_second)
    there = scores(moved, later)
    for name, score in here.items():
        assert there[name].value == pytest.approx(score.value), name


def test_relations_outside_the_estimate_or_in_its_gaps_count_as_unanswered() -> None:
    estimate = Trajectory(np.array([0, 1, 2, 8, 9]) * SECOND, np.zeros((5, 3)))
    measured = make_relations((0, 1.5, 0, 0, 0), (1, 5, 0, 0, 0), (2, 8, 0, 0, 0), (8, 10, 0, 0, 0))
    found = scores(estimate, measured)
    assert found["relations_answered_percent"] == Score(50.0, 4)
    assert found["relations_all_mean_m"] == Score(0.0, 2)
    assert found["relations_long_mean_m"].reason == "the estimate covers none of 0 long relations"


def test_missing_relations_or_answers_give_a_reason() -> None:
    nothing = Trajectory(np.zeros(0, np.int64), np.zeros((0, 3)))
    assert scores(make_straight_line(3), None)["relations_all_mean_m"].reason == "no measured relations"
    found = scores(nothing, make_relations((0, 1, 0, 0, 0)))
    assert found["relations_all_mean_m"].reason == "the estimate covers none of 1 relations"
    assert found["relations_answered_percent"].value == 0.0


def recorded(name: str) -> tuple[Path, Trajectory, Relations]:
    folder = Path(os.environ.get("EVALKIT_DATA", "")) / name
    if "EVALKIT_DATA" not in os.environ or not (folder / f"{name}.relations").exists():
        pytest.skip(f"recorded data not here: {name} (set EVALKIT_DATA)")
    rows = np.loadtxt(folder / f"{name}-gmapping.tum")
    poses = np.column_stack([rows[:, 1:3], 2.0 * np.arctan2(rows[:, 6], rows[:, 7])])
    table = np.loadtxt(folder / f"{name}.relations")
    measured = Relations(nanoseconds(table[:, 0]), nanoseconds(table[:, 1]), table[:, [2, 3, 7]])
    return folder, Trajectory(nanoseconds(rows[:, 0]), poses), measured


def nanoseconds(seconds: Floats) -> Stamps:
    return np.round(np.asarray(seconds) * 1e6).astype(np.int64) * 1000


def test_gmapping_on_fr079_has_the_known_errors() -> None:
    _, estimate, measured = recorded("fr079")
    found = scores(estimate, measured)
    assert found["relations_all_mean_m"].value == pytest.approx(0.060, abs=0.001)
    assert found["relations_all_sd_m"].value == pytest.approx(0.042, abs=0.001)
    assert found["relations_answered_percent"].value == pytest.approx(99.8, abs=0.1)


def test_gmapping_on_intel_has_the_known_errors() -> None:
    """Its poses are seconds apart. As in the published evaluation, odometry carries the nearest pose to each stamp."""
    folder, sparse, measured = recorded("intel")
    with gzip.open(folder / "intel-merged.clf.gz", "rt") as file:
        words = [row.split() for row in file if row.startswith("ODOM ")]
    table = np.array([[float(w[-3]), *map(float, w[1:4])] for w in words])
    stamps, kept = np.unique(nanoseconds(table[:, 0]), return_index=True)
    odom = Trajectory(stamps, table[kept, 1:])
    ends = np.unique(np.concatenate([measured.first_ns, measured.second_ns]))
    ends = ends[(ends >= odom.stamps_ns[0]) & (ends <= odom.stamps_ns[-1])]
    nearest = np.abs(sparse.stamps_ns[:, None] - ends[None]).argmin(axis=0)
    moved = se2.between(odom.at(sparse.stamps_ns[nearest].clip(stamps[0], stamps[-1])), odom.at(ends))
    found = scores(Trajectory(ends, se2.compose(sparse.poses[nearest], moved)), measured)
    assert found["relations_all_mean_m"].value == pytest.approx(0.051, abs=0.002)
    assert found["relations_all_sd_m"].value == pytest.approx(0.052, abs=0.002)


def test_both_published_error_forms_are_in_the_table_and_ours_is_their_mean() -> None:
    rng = np.random.default_rng(3)
    measured = make_relations(*([k, k + 3, *(0.1 * rng.normal(size=3) + [3.0, 0.0, 0.0])] for k in range(20)))
    found = scores(make_straight_line(30), measured)
    theirs = [found[f"relations_{form}_mean_m"].value for form in ("kuemmerle", "cartographer")]
    assert found["relations_all_mean_m"].value == pytest.approx(np.mean(theirs))
    assert theirs[0] != pytest.approx(theirs[1], rel=0.01)


def test_squared_errors_equal_a_hand_calculation() -> None:
    found = scores(
        make_straight_line(30), make_relations((0, 2, 2.1, 0, 0), (0, 10, 10.3, 0, np.radians(2)), (3, 4, 1, 0, 0))
    )
    squares = np.array([0.01, 0.09, 0.0])
    assert found["relations_square_mean_m2"].value == pytest.approx(squares.mean())
    assert found["relations_square_sd_m2"].value == pytest.approx(squares.std())
    assert found["relations_square_mean_deg2"].value == pytest.approx(4 / 3)
    assert found["relations_square_mean_m2"].support == 3


def test_relations_over_ten_seconds_in_either_order_are_long() -> None:
    measured = make_relations((0, 9.99, 0, 0, 0), (0, 10, 0, 0, 0), (10, 0, 0, 0, 0), (9.5, 0, 0, 0, 0))
    assert relations.select_part(measured, "short").tolist() == [True, False, False, True]
    assert relations.select_part(measured, "long").tolist() == [False, True, True, False]
    assert relations.select_part(measured, "all").all()


def test_the_estimate_covers_relations_in_gaps_of_two_seconds_at_most() -> None:
    estimate = Trajectory(np.array([0, 2_000_000_000, 4_000_000_001]), np.zeros((3, 3)))
    covered = relations.compute_estimated_motions(estimate, make_relations((0, 1, 0, 0, 0), (1, 3, 0, 0, 0)))[1]
    assert covered.tolist() == [True, False]
