"""Shares measured from resampled runs, on runs of known distributions."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest

from evalkit.commands.calibration.coverage import (
    Coverage,
    Verdicts,
    expected_coverage,
    find_failures,
    group_sequences,
    measure_coverage,
    measure_verdicts,
)
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
        return [Coverage("w", "a", "m", runs, 0.6, 0.4, share, 0.5, 2.0, 80) for runs in (3, 5)]

    def verdicts(share):
        return [Verdicts("w", ("a", "b"), "m", 2, 0.9, share, (0.0,), (0.0,))]

    assert find_failures(coverage(0.95), verdicts(0.04), ()) == []
    assert find_failures(coverage(0.85), verdicts(0.04), ()) == [
        "simulated worlds, 3 runs: intervals hold the median in 85.0 %",
        "simulated worlds, 5 runs: intervals hold the median in 85.0 %",
    ]
    assert find_failures(coverage(0.95), verdicts(0.1), ["w"]) == ["w, 2 runs: equal methods get a verdict in 10.0 %"]


def test_each_recording_has_limits_of_its_own_and_few_runs_raise_the_upper_one():
    def hold(sequence, share, population):
        return Coverage(sequence, "a", "m", 8, 0.6, 0.4, share, 0.5, 2.0, population)

    worlds = [hold("w1", 0.99, 80), hold("w2", 0.93, 80)]
    assert find_failures([*worlds, hold("r", 0.86, 40)], [], ["r"]) == [
        "r, 8 runs: intervals hold the median in 86.0 %"
    ]
    assert find_failures([hold("r", 0.98, 40)], [], ["r"]) == []
    assert find_failures([hold("r", 0.98, 4000)], [], ["r"]) == ["r, 8 runs: intervals hold the median in 98.0 %"]
    assert group_sequences(["w1", "r", "w2", "w1"], ["r"]) == {"simulated worlds": ["w1", "w2"], "r": ["r"]}


def test_an_exact_interval_holds_the_mean_of_few_runs_more_often():
    critical = 0.95 * np.sqrt(2.0 / (1.0 - 0.95**2))  # Student's t of two degrees of freedom has a closed form
    wider = critical / np.sqrt(1.0 - 3.0 / 12.0)
    assert expected_coverage(3, 12) == pytest.approx(wider / np.sqrt(wider**2 + 2.0))
    assert expected_coverage(3, 10**9) == pytest.approx(0.95)
    assert expected_coverage(2, 3) == 0.95
    rng, population = np.random.default_rng(0), np.random.default_rng(1).normal(5.0, 0.1, 20)
    found = SeedRuns("r", "a", ATE.name, tuple(np.exp(population - np.median(population)).tolist()), (None,) * 20)
    assert measure_coverage(found, 8, rng, 1000).over_median == pytest.approx(expected_coverage(8, 20), abs=0.02)


def test_the_table_has_a_row_for_each_number_of_runs_and_the_page_is_complete():
    coverage = {
        "sequence": "w", "method": "a", "metric": "m", "within_median": 0.5, "within_another": 0.25,
        "over_median": None, "over_another": None, "ratio": None, "population": 80,
    }  # fmt: skip
    verdicts = {
        "sequence": "w", "methods": ["a", "b"], "metric": "m", "false_within": 0.24, "false_over": 0.0,
        "power_within": [0.1, 0.2, 0.5], "power_over": [0.0, 0.5, 1.0],
    }  # fmt: skip
    content = {
        "seeds": 80, "subsets": 100, "recordings": ["r"], "skipped": ["q: not here"], "failures": ["a", "b"],
        "created": "2026-11-22", "command": "python -m x",
        "coverage": [coverage | {"runs": runs} for runs in (1, 2, 3, 5, 8)],
        "verdicts": [verdicts | {"runs": runs} for runs in (1, 2, 3, 5, 8)],
    }  # fmt: skip
    own = {"sequence": "r", "within_median": 0.75, "population": 40}
    content["coverage"] += [row | own for row in content["coverage"]]
    lines = format_markdown(content).splitlines()
    row = "8 | 50 (50-50) | - | 25 (25-25) | - | 24 (24-24) | 0 (0-0) | 0 (0-0) | 50 (50-50) | 100 (100-100) |"
    assert lines[6] == f"| simulated worlds | {row}"
    assert lines[11] == "| r | 8 | 75 (75-75) | - | 25 (25-25) | - | - | - | - | - | - |"
    assert (
        "r: a; m; subsets of 40 perturbed runs. An exact interval would hold the median of these in 95.3 % at 3, "
        "95.9 % at 5, 96.7 % at 8 runs." in lines
    )
    assert lines[-3:] == ["Skipped: q: not here.", "", "Outside the limits: a; b."]
    assert [section.anchor for section in build_document(content).sections] == [
        "summary", "intervals", "verdicts", "method",
    ]  # fmt: skip


@pytest.mark.checkout
def test_the_documentation_shows_the_shipped_measurement_whose_worlds_are_within_the_limits():
    root = Path(__file__).parents[3]
    content = json.loads((root / "docs/pages/assets/calibration.json").read_text(encoding="utf-8"))
    page = (root / "docs/pages/calibration.md").read_text(encoding="utf-8")
    assert format_markdown(content).strip() in page
    assert [one for one in content["failures"] if one.startswith("simulated worlds")] == []
    assert all(one in page for one in content["failures"])
    row = next(line for line in (root / "docs/pages/results.md").read_text(encoding="utf-8").splitlines()
               if line.startswith("| `calibration.json`"))  # fmt: skip
    assert set(re.findall(r"`(\w+)`", row.split(" | ")[2])) == set(content)
