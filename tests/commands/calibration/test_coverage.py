"""Shares measured from resampled runs, on runs of known distributions."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np

from evalkit.commands.calibration.coverage import Coverage, Verdicts, find_failures, measure_coverage, measure_verdicts
from evalkit.commands.calibration.page import build_document, format_markdown
from evalkit.commands.calibration.seed_runs import SeedRuns
from evalkit.metrics import METRICS
from evalkit.stats.bootstrap import BootstrapDraws

ATE = next(metric for metric in METRICS if metric.name == "ate_rmse_m")


def _runs(method, spread, within, seed, count=80):
    """Runs with a lognormal spread between them; the bootstrap within a run claims the spread ``within``."""
    rng = np.random.default_rng(seed)
    values = np.exp(rng.normal(0.0, spread, count))
    draws = [BootstrapDraws(value * np.exp(rng.normal(0.0, within, 2000)), 20.0) for value in values]
    return SeedRuns("world", method, ATE.name, tuple(values.tolist()), tuple(draws))


def test_narrow_intervals_within_runs_miss_and_intervals_over_runs_hold():
    found = _runs("a", 0.5, 0.05, 1)
    rng = np.random.default_rng(0)
    one, three = (measure_coverage(found, runs, rng, 200) for runs in (1, 3))
    assert one.within_median < 0.3
    assert (one.over_median, one.over_another, one.ratio) == (None, None, None)
    assert 0.9 <= three.over_median <= 1.0
    assert three.over_another < three.over_median


def test_equal_methods_get_verdicts_from_blocks_of_one_run_and_none_from_runs():
    pair = _runs("a", 0.5, 0.05, 1), _runs("b", 0.5, 0.05, 2)
    once = measure_verdicts(ATE, *pair, 1, np.random.default_rng(0), 100)
    five = measure_verdicts(ATE, *pair, 5, np.random.default_rng(0), 200)
    assert once.false_within > 0.5
    assert (once.false_over, once.power_over) == (0.0, (0.0, 0.0, 0.0))
    assert five.false_over <= 0.1


def test_a_large_difference_is_found_where_runs_hardly_differ():
    pair = _runs("a", 0.02, 0.02, 1), _runs("b", 0.02, 0.02, 2)
    found = measure_verdicts(ATE, *pair, 5, np.random.default_rng(0), 60)
    assert found.power_over[0] > 0.9
    assert found.power_over[1:] == (1.0, 1.0)


def test_shares_outside_the_limits_are_failures():
    def coverage(share):
        return [Coverage("w", "a", "m", runs, 0.6, 0.4, share, 0.5, 2.0) for runs in (3, 5)]

    def verdicts(share):
        return [Verdicts("w", ("a", "b"), "m", 2, 0.9, share, (0.0,), (0.0,))]

    assert find_failures(coverage(0.95), verdicts(0.04)) == []
    assert find_failures(coverage(0.85), verdicts(0.04)) == [
        "3 runs: intervals hold the median in 85.0 %", "5 runs: intervals hold the median in 85.0 %",
    ]  # fmt: skip
    assert find_failures(coverage(0.95), verdicts(0.1)) == ["2 runs: equal methods get a verdict in 10.0 %"]


def test_the_table_has_a_row_for_each_number_of_runs_and_the_page_is_complete():
    coverage = {
        "world": "w", "method": "a", "metric": "m", "within_median": 0.5, "within_another": 0.25,
        "over_median": None, "over_another": None, "ratio": None,
    }  # fmt: skip
    verdicts = {
        "world": "w", "methods": ["a", "b"], "metric": "m", "false_within": 0.24, "false_over": 0.0,
        "power_within": [0.1, 0.2, 0.5], "power_over": [0.0, 0.5, 1.0],
    }  # fmt: skip
    content = {
        "seeds": 80, "subsets": 100, "created": "2026-11-22", "command": "python -m x",
        "coverage": [coverage | {"runs": runs} for runs in (1, 2, 3, 5, 8)],
        "verdicts": [verdicts | {"runs": runs} for runs in (1, 2, 3, 5, 8)],
    }  # fmt: skip
    lines = format_markdown(content).splitlines()
    row = "| 8 | 50 (50-50) | - | 25 (25-25) | - | 24 (24-24) | 0 (0-0) | 0 (0-0) | 50 (50-50) | 100 (100-100) |"
    assert lines[6] == row
    assert [section.anchor for section in build_document(content).sections] == [
        "summary", "intervals", "verdicts", "method",
    ]  # fmt: skip


def test_the_documentation_shows_the_shipped_measurement_which_is_within_the_limits():
    root = Path(__file__).parents[3]
    content = json.loads((root / "docs/pages/assets/calibration.json").read_text(encoding="utf-8"))
    page = (root / "docs/pages/calibration.md").read_text(encoding="utf-8")
    assert format_markdown(content).strip() in page
    assert content["failures"] == []
    row = next(line for line in (root / "docs/pages/results.md").read_text(encoding="utf-8").splitlines()
               if line.startswith("| `calibration.json`"))  # fmt: skip
    assert set(re.findall(r"`(\w+)`", row.split(" | ")[2])) == set(content)
