"""Measured distances: known lengths, a map scaled as a whole, and walls found near their expected positions."""

import numpy as np
import pytest

from evalkit.core.ground_truth import Truth
from evalkit.core.measured_distances import Span, SpanEnd
from evalkit.core.pose import Pose
from evalkit.core.run_result import STEP, RunResult, Score
from evalkit.core.scan import Scan
from evalkit.metrics import spans
from evalkit.metrics.metric import Evidence, MatchedPoses, Unmatched

SECOND = 1_000_000_000


def at(seconds, x=0.0, y=0.0):
    return SpanEnd(x, y, round(seconds * SECOND))


NOT_MATCHED = Unmatched("not matched")


def run_of(x, scale=1.0):
    steps = np.zeros(len(x), STEP)
    steps["stamp_ns"] = np.arange(len(x)) * SECOND
    steps["x"] = scale * np.asarray(x)
    return RunResult(steps, len(x))


def scores(run, taped, mapped=(), matched=NOT_MATCHED):
    evidence = Evidence(run, Truth("by tape", spans=tuple(taped)), matched, mapped=mapped)
    return {metric.name: metric.compute(evidence) for metric in spans.METRICS}


TAPES = (Span("door to door", at(0), at(4), 4.0), Span("to the end", at(1), at(9), 8.0, 0.02))


def test_a_correct_path_has_the_measured_length() -> None:
    found = scores(run_of(np.arange(10.0)), TAPES)
    assert found["span_rmse_m"].value == pytest.approx(0.0, abs=1e-12)
    assert found["span_stretch_percent"].value == pytest.approx(0.0, abs=1e-9)
    assert found["span_answered_percent"].value == 100.0


def test_a_uniformly_scaled_map_gets_the_scale_as_error() -> None:
    found = scores(run_of(np.arange(10.0), 1.02), TAPES)
    assert found["span_stretch_percent"].value == pytest.approx(2.0)
    assert found["span_rmse_m"].value == pytest.approx(np.sqrt((0.08**2 + 0.16**2) / 2.0))
    assert found["span_worst_sigmas"].value == pytest.approx(8.0)


def test_the_scale_weighs_each_distance_by_its_variance() -> None:
    found = spans.SpanLengths(np.array([1.1, 2.0]), np.array([1.0, 2.0]), np.array([0.1, 0.2]))
    # weights 100 and 25: (100 * 1.1 + 25 * 4) / (100 * 1 + 25 * 4) - 1
    assert spans.fit_stretch(found) == pytest.approx(0.05)


def test_points_seen_from_the_robot_are_valid_end_points() -> None:
    # 1 m ahead at 0 s, 0.5 m to the left at 3 s
    tape = Span("corner to post", at(0, x=1.0), at(3, y=0.5), np.hypot(2.0, 0.5))
    assert scores(run_of(np.arange(10.0)), [tape])["span_rmse_m"].value == pytest.approx(0.0, abs=1e-12)


def scan_two_walls(width_m):
    """Return a scan of two walls across x, taken between them."""
    y = np.linspace(-1.0, 1.0, 200)
    x = np.concatenate([np.full(200, width_m - 2.0), np.full(200, -2.0)])
    y = np.concatenate([y, y])
    return Scan(0, np.hypot(x, y), np.arctan2(y, x), 0.0, 20.0), np.zeros(3)


@pytest.mark.parametrize("width_m", [4.9, 5.0, 5.2])
def test_walls_are_found_at_their_mapped_position_not_at_the_expected_one(width_m) -> None:
    tape = Span("wall to wall", SpanEnd(-2.1, 0.0), SpanEnd(3.1, 0.0), 5.0)
    found = scores(run_of([0.0, 0.0]), [tape], (scan_two_walls(width_m),))
    assert found["span_stretch_percent"].value == pytest.approx(100.0 * (width_m - 5.0) / 5.0, abs=1e-6)


def test_a_wall_given_in_the_world_frame_is_searched_at_its_aligned_position() -> None:
    tape = Span("robot to wall", at(0), SpanEnd(13.0, 5.0), 3.0)
    scan, _ = scan_two_walls(5.0)
    world = Pose(10.0, 5.0, 0.0)
    matched = MatchedPoses(np.zeros(1), np.zeros((1, 3)), np.zeros((1, 3)), "given", "", world)
    found = scores(run_of([0.0, 0.0]), [tape], ((scan, world.row),), matched)
    assert found["span_rmse_m"].value == pytest.approx(0.0, abs=1e-9)


def test_distances_outside_the_estimate_are_reported() -> None:
    nowhere = Span("no wall", SpanEnd(50.0, 50.0), SpanEnd(60.0, 50.0), 10.0)
    late = Span("too late", at(2), at(100), 5.0)
    found = scores(run_of(np.arange(10.0)), [TAPES[0], nowhere, late])
    assert found["span_answered_percent"].value == pytest.approx(100.0 / 3.0)
    assert found["span_rmse_m"].support == 1
    assert scores(run_of([0.0]), [late])["span_rmse_m"].reason == "the estimate covers none of 1 measured distances"
    assert scores(run_of([0.0]), [])["span_rmse_m"].reason == "no distance was measured with a tape"


def test_a_measured_distance_needs_a_length_and_a_precision() -> None:
    with pytest.raises(ValueError, match="metres"):
        Span("none", at(0), at(1), 0.0)
    with pytest.raises(ValueError, match="sigma_m"):
        Span("sure", at(0), at(1), 1.0, 0.0)
    with pytest.raises(ValueError, match="not finite"):
        SpanEnd(float("nan"))


def test_a_distance_whose_ends_coincide_in_the_estimate_is_0_m_long() -> None:
    found = scores(run_of([0.0, 0.0, 0.0]), [Span("still", at(0), at(2), 3.0)])
    assert found["span_rmse_m"].value == pytest.approx(3.0)


@pytest.mark.parametrize(
    ("count", "along_m", "beside_m", "found"),
    [(10, 0.29, 0.14, True), (9, 0.29, 0.14, False), (10, 0.31, 0.14, False), (10, 0.29, 0.16, False),
     (10, -0.29, -0.14, True), (10, -0.31, 0.0, False), (10, 0.0, -0.16, False)],
)  # fmt: skip
def test_a_wall_is_ten_hits_within_30_cm_along_the_tape_and_15_cm_beside_it(count, along_m, beside_m, found) -> None:
    tape = Span("robot to wall", at(0), SpanEnd(3.0, 0.0), 3.0)
    hits = np.tile([3.0 + along_m, beside_m], (count, 1))
    scan = Scan(0, np.hypot(*hits.T), np.arctan2(hits[:, 1], hits[:, 0]), 0.0, 20.0), np.zeros(3)
    answer = scores(run_of([0.0, 0.0]), [tape], (scan,))
    assert answer["span_answered_percent"] == Score(100.0 * found, 1)
    assert answer["span_rmse_m"].value == (pytest.approx(abs(along_m)) if found else None)
