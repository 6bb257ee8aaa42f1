"""The values over time that a score summarizes."""

from types import SimpleNamespace

import numpy as np
import pytest

from evalkit.core.ground_truth import Truth
from evalkit.core.run_result import STEP, RunResult
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
