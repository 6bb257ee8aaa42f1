"""The table of all metrics: complete cards, unique names, and a value or a reason for every kind of run."""

from __future__ import annotations

import gc
import json
import math
import weakref
from dataclasses import asdict, replace

import numpy as np
import pytest

from evalkit import metrics
from evalkit.core.errors import NotInstalled
from evalkit.core.ground_truth import Truth
from evalkit.core.run_result import STEP, RunResult, Score
from evalkit.core.run_status import Cause
from evalkit.core.scan import Scan
from evalkit.core.trajectory import Trajectory
from evalkit.metrics.metric import Evidence, Metric, cached, make_metrics, make_score, place_hits
from evalkit.metrics.trajectory import match_trajectories


def run(poses: list[tuple[float, float, float]]) -> RunResult:
    steps = np.zeros(len(poses), STEP)
    steps["stamp_ns"] = np.arange(len(poses)) * 100_000_000
    for column, name in enumerate(("x", "y", "theta")):
        steps[name] = [pose[column] for pose in poses]
    return RunResult(steps, 100, Cause.EXCEPTION, "it broke")


def evidence(of: RunResult, truth: Truth) -> Evidence:
    return Evidence(of, truth, match_trajectories(of.estimate, truth.trajectory))


def own_metric(compute, name: str = "own") -> Metric:
    return Metric(name, "own", "m", "lower", "drift", "Own.", "none", "everything", compute)


@pytest.fixture
def registered(monkeypatch):
    """Metrics that another package registers, by the name of the entry point."""
    known: dict[str, Metric] = {}
    monkeypatch.setattr(metrics.registry, "names", lambda kind: list(known))
    monkeypatch.setattr(metrics.registry, "load", lambda kind, name, wanted: known[name])
    return known


def test_metrics_of_other_packages_follow_those_of_evalkit(registered) -> None:
    registered["lab"] = own_metric(lambda _: Score(1.0, 1))
    assert metrics.all_metrics() == (*metrics.METRICS, registered["lab"])


@pytest.mark.parametrize("taken", ["ate_rmse_m", "own"])
def test_a_metric_with_the_name_of_another_does_not_replace_it(registered, taken) -> None:
    registered |= {"a": own_metric(lambda _: Score(1.0, 1)), "b": own_metric(lambda _: Score(2.0, 1), taken)}
    with pytest.raises(NotInstalled, match=f"^b: there is another metric of the name {taken}; rename it in its Metric"):
        metrics.all_metrics()


@pytest.mark.parametrize("returned", [3.0, None, (3.0, 1)])
def test_a_metric_that_returns_no_score_has_none_and_says_why(returned) -> None:
    found = metrics.compute_scores(evidence(run([]), Truth("none")), [own_metric(lambda _: returned)])["own"]
    reason = f"could not be computed: TypeError: it returns a {type(returned).__name__}, expected a Score"
    assert (found.value, found.reason) == (None, reason)


def test_a_score_of_numpy_numbers_can_be_written_as_json() -> None:
    score = Score(np.float32(0.5), np.int64(3))
    found = metrics.compute_scores(evidence(run([]), Truth("none")), [own_metric(lambda _: score)])["own"]
    assert json.dumps(asdict(found)) == '{"value": 0.5, "support": 3, "reason": ""}'


def test_names_are_unique_and_every_card_is_complete() -> None:
    names = [metric.name for metric in metrics.METRICS]
    assert len(names) == len(set(names))
    for metric in metrics.METRICS:
        assert metric.label, metric.name
        assert metric.definition.endswith("."), metric.name
        assert metric.source, metric.name
        assert metric.limitations, metric.name


def test_names_end_in_the_unit_of_their_values() -> None:
    endings = {
        "m": "_m",
        "deg": "_deg",
        "%": "_percent",
        "ms": "_ms",
        "MiB": "_mib",
        "deg/m": "_deg_per_m",
        "m2": "_m2",
    }
    for metric in metrics.METRICS:
        if metric.unit in endings and not metric.name.endswith("drift_deg_per_turn"):
            assert metric.name.endswith(endings[metric.unit]), metric.name


def test_about_ten_metrics_are_headline_metrics_and_each_has_a_direction() -> None:
    leading = [metric for metric in metrics.METRICS if metric.headline]
    assert 8 <= len(leading) <= 12
    assert all(metric.better for metric in leading)


def test_a_run_without_answers_gets_a_reason_from_every_metric_except_the_answer_rate() -> None:
    truth = Truth("exact", Trajectory(np.arange(5) * 100_000_000, np.zeros((5, 3))))
    found = metrics.compute_scores(evidence(run([]), truth))
    assert list(found) == [metric.name for metric in metrics.METRICS]
    told = {name: score.value for name, score in found.items() if score.value is not None}
    assert told == {"answered_percent": 0.0, "covered_percent": 0.0}


def test_a_sequence_without_ground_truth_gets_a_reason_from_every_metric_that_needs_it() -> None:
    found = metrics.compute_scores(evidence(run([(0.0, 0, 0), (1.0, 0, 0)]), Truth("none")))
    reasons = {"ate_rmse_m": "no ground-truth trajectory", "drift_percent": "no ground-truth trajectory"}
    reasons |= {"relations_all_mean_m": "no measured relations", "map_f1": "no ground-truth map"}
    assert {name: found[name].reason for name in reasons} == reasons
    assert found["answered_percent"].value == 2.0


@pytest.mark.filterwarnings("error")
def test_a_diverged_estimate_is_scored_without_a_warning() -> None:
    truth = Truth("exact", Trajectory(np.arange(3) * 100_000_000, np.array([[0.0, 0, 0], [1, 0, 0], [2, 1, 0]])))
    found = metrics.compute_scores(evidence(run([(0.0, 0, 0), (1e200, 0, 0), (-1e300, 3, 0)]), truth))
    assert found["ate_rmse_m"] == Score(None, 3, "not finite: the estimate has diverged")


def test_a_third_party_metric_is_scored_like_a_built_in_one() -> None:
    card: Metric = replace(metrics.METRICS[0], name="scans", compute=lambda seen: make_score(len(seen.run.steps), 1))
    of = run([(0.0, 0, 0)])
    assert metrics.compute_scores(evidence(of, Truth("none")), [card]) == {"scans": Score(1.0, 1)}


def test_a_value_that_is_not_finite_is_not_a_score() -> None:
    assert make_score(math.nan, 7).value is None
    assert make_score(np.float64(2.0), 7) == Score(2.0, 7)


def test_shared_intermediate_results_are_computed_once_and_released_with_the_evidence() -> None:
    looks = []

    @cached
    def look(seen: Evidence) -> int:
        looks.append(seen.run.expected)
        return len(looks)

    one, other = evidence(run([]), Truth("none")), evidence(run([]), Truth("none"))
    assert [look(one), look(one), look(other), look(one)] == [1, 1, 2, 1]
    gone = weakref.ref(one)
    del one
    gc.collect()
    assert gone() is None


@pytest.mark.parametrize(
    ("name", "limits"),
    [("mme_nat", "within 0.5 m of a hit; mean over those of at most 1,000 places that have 5 hits"),
     ("drift_percent", "segments start every 0.1 m of true path"), ("covered_percent", "at most 1 s apart"),
     ("map_awd_m", "over squares of 1 m in which both maps have 5 wall cells"), ("map_ssim", "up to 3 whole cells"),
     ("map_wall_offset_m", "within 0.5 m of one"), ("map_corner_ospa_m", "(order 1, cutoff 0.5 m)"),
     ("closures_wrong", "within 0.2 m and 5 deg"), ("closure_recall_percent", "within 5 m of path"),
     ("map_com", "within 0.2 m of an occupied cell"), ("revisit_mean_m", "within 1 m of each other"),
     ("revisit_within_percent", "at most 0.15 m and 0.02 rad"), ("span_rmse_m", "within 0.3 m along the tape")],
)  # fmt: skip
def test_the_card_of_a_metric_states_its_limits(name: str, limits: str) -> None:
    (card,) = (metric for metric in metrics.METRICS if metric.name == name)
    assert limits in card.definition


def test_a_metric_has_three_digits_and_is_no_headline_unless_its_card_says_so() -> None:
    plain = Metric("m", "metric", "m", "lower", "drift", "definition", "source", "limits", metrics.METRICS[0].compute)
    assert (plain.digits, plain.headline, plain.slam_only, plain.no_value) == (3, False, False, ())


def test_a_card_without_a_function_and_a_function_without_a_card_are_refused() -> None:
    compute = metrics.METRICS[0].compute
    with pytest.raises(KeyError, match="no function for pair_error"):
        make_metrics("pairs", {})
    with pytest.raises(KeyError, match="of_nothing"):
        make_metrics("pairs", {"pair_error": compute, "of_nothing": compute})
    (card,) = make_metrics("pairs", {"pair_error": compute})
    assert (card.label, card.digits, card.better) == ("pair error", 5, "lower")


def test_the_hits_of_a_scan_are_placed_by_each_pose_that_is_asked_for() -> None:
    scan, pose = (
        Scan(0, np.array([1.0, np.inf, 2.0]), np.radians([0.0, 45.0, 90.0]), 0.1, 9.0),
        np.array([5.0, 6.0, 0.0]),
    )
    assert place_hits((scan, pose)) == pytest.approx(np.array([[6.0, 6.0], [5.0, 8.0]]))
    assert place_hits((scan, np.array([0.0, 0.0, np.pi / 2.0]))) == pytest.approx(np.array([[0.0, 1.0], [-2.0, 0.0]]))
    pose[0] = 7.0
    assert place_hits((scan, pose)) == pytest.approx(np.array([[8.0, 6.0], [7.0, 8.0]]))
