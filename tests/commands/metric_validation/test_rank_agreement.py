"""How a metric ranks maps: against SciPy's Spearman, by hand, and in the right direction."""

import numpy as np
import pytest
from scipy import stats

from evalkit.commands.metric_validation.rank_agreement import Row, ranks, reference_free, spearman

NAMES = [metric.name for metric in reference_free()]


def rows(world, errors, score, way="drift"):
    """Maps with these errors, every metric a function of the error."""
    return [Row(world, way, 1.0, error, {name: score(name, error) for name in NAMES}) for error in errors]


def found(*groups):
    everything = [row for group in groups for row in group]
    return {rank.metric: rank for rank in ranks(everything, np.random.default_rng(0))}


def test_the_correlation_is_scipys_ties_included():
    rng = np.random.default_rng(1)
    a, b = rng.integers(0, 5, (7, 30)), rng.normal(size=(7, 30))
    expected = [stats.spearmanr(x, y).statistic for x, y in zip(a, b, strict=True)]
    assert spearman(a.astype(float), b) == pytest.approx(expected)
    assert np.isnan(spearman(np.ones(5), np.arange(5.0)))


def test_a_metric_that_follows_has_one_and_higher_is_better_is_turned_round():
    told = found(
        rows("lab", np.arange(1.0, 9.0), lambda name, error: -error if name == "wall_share_percent" else error)
    )
    assert [rank.overall.value for rank in told.values()] == pytest.approx([1.0] * len(NAMES))
    assert told["wall_share_percent"].flipped
    assert told["map_entropy"].overall.low > 0.5


def test_worlds_are_never_compared_with_one_another():
    # in each world the metric follows; thrown together it would run the wrong way round
    small = rows("lab", np.arange(1.0, 7.0), lambda _, error: 100.0 + error)
    large = rows("office", np.arange(11.0, 17.0), lambda _, error: error)
    rank = found(small, large)["corners"]
    assert rank.overall.value == pytest.approx(1.0)
    assert rank.overall.support == 12
    assert [one.value for one in rank.by_world.values()] == pytest.approx([1.0, 1.0])
    assert list(rank.by_world) == ["lab", "office"]


def test_the_wrong_way_round_in_one_way_of_two_is_told_way_by_way():
    clean = rows("lab", [0.0], lambda *_: 0.0, "clean")
    good = rows("lab", np.arange(1.0, 6.0), lambda _, error: error, "drift")
    bad = rows("lab", np.arange(1.0, 6.0), lambda _, error: -error, "scale")
    rank = found(clean, good, bad)["corners"]
    assert rank.by_way["drift"].value == pytest.approx(1.0)
    assert rank.by_way["scale"].value == pytest.approx(-1.0)
    assert -0.5 < rank.overall.value < 0.5


def test_a_metric_without_values_or_without_differences_has_no_correlation():
    told = found(rows("lab", np.arange(6.0), lambda name, _: None if name == "corners" else 7.0))
    assert told["corners"].overall is None
    assert told["map_entropy"].overall is None
    assert list(told)[-1] in NAMES
