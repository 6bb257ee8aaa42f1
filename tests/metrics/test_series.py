"""The values over time that a score summarizes."""

from types import SimpleNamespace

import numpy as np
import pytest

from evalkit.core.ground_truth import Relations, Truth
from evalkit.core.pose import Pose
from evalkit.core.run_result import STEP, FinalAlignment, RunResult, Scores
from evalkit.core.trajectory import Trajectory
from evalkit.metrics import drift
from evalkit.metrics.series import SERIES


@pytest.mark.parametrize("origin_ns", [0, 1_700_000_000_000_000_000])
def test_the_errors_of_segments_are_spread_over_the_time_of_their_starts(origin_ns):
    """25 m at 1 m/s, estimated 2 % too long; the last segment of 1 m starts at 24 m."""
    x = np.arange(251) * 0.1
    steps = np.zeros(len(x), dtype=STEP)
    steps["stamp_ns"], steps["x"] = origin_ns + np.arange(len(x)) * 100_000_000, 1.02 * x
    truth = Trajectory(steps["stamp_ns"], np.column_stack([x, 0.0 * x, 0.0 * x]))
    found = SERIES["drift_percent"](SimpleNamespace(result=RunResult(steps, len(steps)), truth=Truth("exact", truth)))
    np.testing.assert_allclose(found.values, 2.0)
    longest = [length for length in drift.LENGTHS_M if length <= 25.0]
    count = sum(int((25.0 - length) / drift.START_EVERY_M + 1e-9) + 1 for length in longest)
    assert len(found.values) == count
    assert found.period_s == pytest.approx((25.0 - min(longest)) / count)
    assert (np.diff(found.keys) > 0).all()  # in the order of time, of the same start the shorter segment first


STAMPS = 5_000_000_000 + np.arange(40) * 100_000_000


def make_run(count=40, truth=None, errors_m=None, final=None, cpu_ns=()):
    """Return a run of 1 m/s along x at 10 Hz with its scores."""
    steps = np.zeros(count, dtype=STEP)
    steps["stamp_ns"], steps["x"] = STAMPS[:count], 0.1 * np.arange(count)
    steps["cpu_ns"] = cpu_ns if len(cpu_ns) else 0
    own = Trajectory(STAMPS[:count], np.column_stack([steps["x"], np.zeros((count, 2))]), "start", "base")
    result = RunResult(steps, count, final=own if final else None)
    alignment = FinalAlignment(Pose(), "", np.asarray(errors_m)) if final == "aligned" else None
    return SimpleNamespace(
        result=result, truth=truth or Truth("none"), scores=Scores({}, errors_m=errors_m, final=alignment)
    )


def test_errors_and_cpu_times_are_series_of_their_scans():
    errors, cpu = np.linspace(0.0, 0.39, 40), 1_000_000 * np.arange(40)
    errors[[3, 7]] = np.nan
    ate = SERIES["ate_rmse_m"](make_run(errors_m=errors))
    known = np.isfinite(errors)
    assert (ate.statistic, ate.period_s) == ("rms", pytest.approx(0.1))
    assert (ate.keys.tolist(), ate.values.tolist()) == (STAMPS[known].tolist(), errors[known].tolist())
    for name, statistic in (("cpu_median_ms", "median"), ("real_time_factor", "inverse")):
        found = SERIES[name](make_run(cpu_ns=cpu))
        assert (found.statistic, found.period_s) == (statistic, pytest.approx(0.1))
        np.testing.assert_allclose(found.values, np.arange(40.0), atol=1e-9)  # ms
        assert found.keys.tolist() == STAMPS.tolist()


def test_fewer_than_twenty_values_unknown_errors_and_unmeasured_times_have_no_series():
    for count, exists in ((19, False), (20, True)):
        run = make_run(count, errors_m=np.ones(count), cpu_ns=np.full(count, 1_000_000))
        assert [SERIES[name](run) is not None for name in ("ate_rmse_m", "cpu_median_ms")] == [exists, exists]
    assert SERIES["cpu_median_ms"](make_run()) is None
    assert SERIES["ate_rmse_m"](make_run()) is None
    assert SERIES["ate_rmse_m"](make_run(errors_m=np.ones(39))) is None
    assert SERIES["drift_percent"](make_run()) is None
    still = Truth("exact", Trajectory(STAMPS, np.zeros((40, 3))))
    assert SERIES["drift_percent"](make_run(truth=still)) is None


def test_the_errors_of_relations_are_those_of_their_part_in_the_order_of_the_first_time():
    """Measured 1 m, 2 m and 3 m too long; the last is not covered, the first in the list is the later one."""
    first, second = STAMPS[[20, 0, 0]], np.array([STAMPS[30], STAMPS[39], STAMPS[39] + 1])
    metres = np.array([1.0 + 1.0, 3.9 + 2.0, 3.9 + 3.0])
    truth = Truth("measured", relations=Relations(first, second, np.column_stack([metres, np.zeros((3, 2))])))
    for part, keys, values in (("all", [1, 0], [2.0, 1.0]), ("short", [1, 0], [2.0, 1.0]), ("long", [], [])):
        found = SERIES[f"relations_{part}_mean_m"](make_run(truth=truth))
        assert (found.keys.tolist(), found.statistic, found.period_s) == (keys, "mean", None)
        np.testing.assert_allclose(found.values, values)
    assert SERIES["relations_all_mean_m"](make_run()) is None
    none = Truth("measured", relations=Relations(first[:0], second[:0], np.zeros((0, 3))))
    assert SERIES["relations_all_mean_m"](make_run(truth=none)) is None


def test_corrected_poses_have_the_series_of_their_own_errors_where_they_are_aligned():
    own, errors = np.ones(40), np.full(40, 0.5)
    found = SERIES["final_ate_rmse_m"](make_run(errors_m=errors, final="aligned"))
    assert found.values.tolist() == errors.tolist()
    assert SERIES["final_ate_rmse_m"](make_run(errors_m=own)) is None
    assert SERIES["final_ate_rmse_m"](make_run(errors_m=own, final="only poses")) is None
