"""Rank agreement against SciPy's Spearman correlation and known orders."""

import numpy as np
import pytest

from evalkit.commands.metric_validation.rank_agreement import MapScores, compute_agreement, reference_free_metrics

NAMES = [metric.name for metric in reference_free_metrics()]


def rows(world, errors, score, perturbation="drift"):
    """Return maps with these errors and every metric as a function of the error."""
    return [
        MapScores(world, perturbation, 1.0, error, {name: score(name, error) for name in NAMES}) for error in errors
    ]


def compute_ranks(*groups):
    everything = [row for group in groups for row in group]
    return {one.metric: one for one in compute_agreement(everything, np.random.default_rng(0))}


def test_perfect_agreement_is_one_and_the_sign_changes_if_higher_is_better():
    agreement = compute_ranks(
        rows("lab", np.arange(1.0, 9.0), lambda name, error: -error if name == "wall_share_percent" else error)
    )
    assert [one.overall.value for one in agreement.values()] == pytest.approx([1.0] * len(NAMES))
    assert next(m for m in reference_free_metrics() if m.name == "wall_share_percent").better == "higher"
    assert agreement["map_entropy"].overall.low > 0.5


def test_correlations_are_computed_within_worlds():
    # in each world the order agrees; over both worlds together it would be reversed
    small = rows("lab", np.arange(1.0, 7.0), lambda _, error: 100.0 + error)
    large = rows("office", np.arange(11.0, 17.0), lambda _, error: error)
    one = compute_ranks(small, large)["corners"]
    assert one.overall.value == pytest.approx(1.0)
    assert one.overall.support == 12
    assert [one.value for one in one.by_world.values()] == pytest.approx([1.0, 1.0])
    assert list(one.by_world) == ["lab", "office"]


def test_reverse_order_in_one_of_two_perturbations_is_reported_separately():
    clean = rows("lab", [0.0], lambda *_: 0.0, "clean")
    good = rows("lab", np.arange(1.0, 6.0), lambda _, error: error, "drift")
    bad = rows("lab", np.arange(1.0, 6.0), lambda _, error: -error, "scale")
    one = compute_ranks(clean, good, bad)["corners"]
    assert one.by_perturbation["drift"].value == pytest.approx(1.0)
    assert one.by_perturbation["scale"].value == pytest.approx(-1.0)
    assert -0.5 < one.overall.value < 0.5


def test_missing_or_constant_values_have_no_correlation():
    agreement = compute_ranks(rows("lab", np.arange(6.0), lambda name, _: None if name == "corners" else 7.0))
    assert agreement["corners"].overall is None
    assert agreement["map_entropy"].overall is None
    assert list(agreement)[-1] in NAMES
