"""Intervals, paired differences and tests of a comparison, with results known from the construction of the records."""

from __future__ import annotations

import math
import re
from dataclasses import replace

import numpy as np
import pytest

from evalkit.metrics.series import SERIES
from evalkit.report import results_json as record
from evalkit.report.analysis.analysis import analyse
from evalkit.report.analysis.pairwise import compute_difference, separation
from evalkit.report.analysis.record_bootstrap import RecordBootstrap
from evalkit.report.analysis.sequence import analyse_sequence
from evalkit.report.html.appendix_tables import comparisons_table
from evalkit.report.html.method_colours import assign_strokes
from evalkit.report.html.report_page import render_report
from evalkit.stats.bootstrap import Series, bootstrap_score
from evalkit.stats.paired_tests import detectable_standard_errors
from evalkit.stats.ranks import FriedmanTest, NotTested

ATE = "ate_rmse_m"


def _of(comparison, method, metric=ATE, sequence="room"):
    cell = analyse_sequence(comparison, sequence).rankings[metric].of(method)
    assert cell is not None
    return cell


def with_scores(record, **changes):
    return replace(record, scores=replace(record.scores, **changes))


def _with_errors(record, errors_m):
    """Return a record with the given errors; its ATE is their root mean square."""
    ate = float(np.sqrt(np.mean(errors_m**2)))
    scores = {ATE: replace(record.scores.by_metric[ATE], value=ate)}
    return with_scores(record, errors_m=errors_m, by_metric=scores)


def test_a_constant_error_has_an_interval_without_width(record, build):
    comparison = build([_with_errors(record("a", "room", {ATE: 1.0}), np.full(60, 0.25))])
    found = _of(comparison, "a").interval
    assert found is not None
    assert (found.value, found.low, found.high, found.support) == pytest.approx((0.25, 0.25, 0.25, 60))


def test_both_methods_are_resampled_with_the_same_blocks(record, build):
    """b has twice the error of a on every scan: every draw of b is twice that of a, and the difference equals a."""
    errors = np.random.default_rng(2).gamma(4.0, 0.01, 60)
    comparison = build([
        _with_errors(record("a", "room", {ATE: 1.0}), errors),
        _with_errors(record("b", "room", {ATE: 1.0}), 2.0 * errors),
    ])  # fmt: skip
    own, between = _of(comparison, "a").interval, compute_difference(_of(comparison, "b"), _of(comparison, "a"))
    assert own is not None
    assert between is not None
    assert (between.interval.low, between.interval.high) == pytest.approx((own.low, own.high))
    assert between.resampled == "blocks"


def test_pairs_use_only_scans_answered_by_both(record, build):
    a, b = record("a", "room", {ATE: 0.02}), record("b", "room", {ATE: 0.03})
    partly = np.where(np.arange(60) < 40, 0.03, np.nan)
    comparison = build([with_scores(a, errors_m=np.full(60, 0.02)), with_scores(b, errors_m=partly)])
    bootstrap = RecordBootstrap(comparison.records, SERIES)
    assert [d and d.blocks for d in (bootstrap.draws(t, ATE) for t in comparison.records)] == [5.0, 5.0]
    assert len(bootstrap._shared_keys(comparison.records[0], ATE)) == 40


def test_errors_that_do_not_match_the_score_are_not_used(record, build):
    claimed = record("a", "room", {ATE: 0.02})
    comparison = build([with_scores(claimed, errors_m=3.0 * claimed.scores.errors_m)])
    assert _of(comparison, "a").interval is None


def test_too_few_values_have_no_interval():
    assert bootstrap_score(Series(np.arange(19), np.ones(19), "mean", 0.1), 1.0, np.random.default_rng(0)) is None


@pytest.mark.parametrize(
    ("statistic", "score"), [("mean", 2.5), ("rms", math.sqrt(7.5)), ("median", 2.5), ("inverse", 0.4)]
)
def test_draws_of_every_statistic_match_the_score(statistic, score):
    """1, 2, 3, 4 repeated: any ten blocks of 40 values have the same mean, root mean square and median."""
    series = Series(np.arange(400), np.tile([1.0, 2.0, 3.0, 4.0], 100), statistic, 0.25)
    found = bootstrap_score(series, score, np.random.default_rng(0))
    assert found is not None
    assert found.blocks == 10.0
    if statistic != "median":
        assert found.values == pytest.approx(np.full(2000, score))
    assert np.median(found.values) == pytest.approx(score, abs=0.5)


def test_runs_are_compared_by_students_t_on_their_ratios(record, build):
    """Ratios 1.2, 1.4 and 1.6 of a median of 0.5; t(0.995, 2) = 9.9248."""
    values = {"a": (0.5, 0.5, 0.5), "b": (0.6, 0.7, 0.8)}
    comparison = build([
        record(who, "room", {"map_f1": v}, seed=seed) for who, own in values.items() for seed, v in enumerate(own)
    ])  # fmt: skip
    found = compute_difference(_of(comparison, "b", "map_f1"), _of(comparison, "a", "map_f1"))
    assert found is not None
    logs = np.log([1.2, 1.4, 1.6])
    half = 9.9248 * logs.std(ddof=1) / math.sqrt(3)
    expected = [0.5 * (math.exp(logs.mean() + side) - 1.0) for side in (-half, half)]
    assert [found.interval.low, found.interval.high] == pytest.approx(expected, abs=1e-4)
    assert (found.resampled, found.runs, found.within) == ("runs", 3, None)


@pytest.mark.parametrize(
    ("better", "worse", "expected"), [(0.4, 0.42076, "clear"), (0.4, 0.41959, "within the margin")]
)
def test_a_difference_at_the_margin_has_one_size_from_both_sides(record, build, better, worse, expected):
    """2.08 cm and 1.96 cm around the margin of 5 % of 0.4 m, 2 cm; divided by the worse value both are below 5 %."""
    values = {"a": better, "b": worse}
    comparison = build([
        record(who, "room", {ATE: v * factor}, seed=seed)
        for who, v in values.items() for seed, factor in enumerate((0.9, 1.0, 1.1))
    ])  # fmt: skip
    a, b = _of(comparison, "a"), _of(comparison, "b")
    metric = next(one for one in comparison.metrics if one.name == ATE)
    assert separation(metric, a, b) == separation(metric, b, a) == expected


def test_the_same_results_give_the_same_numbers(demo):
    once, twice = (record.build_results(analyse(replace(demo))) for _ in range(2))
    assert once == twice
    assert {row["method"] for row in once["intervals"] if row["metric"] == ATE} >= {"paper", "plane", "wheel"}
    assert all(row["low"] <= row["high"] for row in once["intervals"])


def test_the_table_of_pairs_agrees_with_the_verdict(record, build):
    comparison = build([
        record(who, "room", {ATE: ate}, seed=seed)
        for who, ate in (("plane", 0.010), ("near", 0.0105), ("paper", 0.050)) for seed in (0, 1)
    ])  # fmt: skip
    found = analyse_sequence(comparison, "room").pairwise
    assert found is not None
    assert found.references == ("plane", "paper")
    said = {who: [entry and entry.verdict for entry in row] for who, row in found.rows}
    assert said["plane"] == [None, "better"]
    assert said["paper"] == ["worse", None]
    assert said["near"][0] in ("too small to matter", "no difference shown")


def _many(record, build, sequences, failed=()):
    """Three methods over a number of sequences: a always best, b 10 % worse, c twice as bad; failures of a by name."""
    made = []
    for number in range(sequences):
        for who, factor in (("a", 1.0), ("b", 1.1), ("c", 2.0)):
            broken = who == "a" and number in failed
            scores = {} if broken else {ATE: factor * (0.01 + 0.01 * number)}
            status = "crashed" if broken else "complete"
            made.append(record(who, f"s{number}", scores, status=status, reason="signal 11" if broken else ""))
    return build(made)


def test_over_ten_sequences_the_test_and_the_ranks_agree_with_hand_calculation(record, build):
    """All ten in one direction: p = 2 / 2^10, Holm over 3 tests; ranks 1, 2, 3; CD = 2.343 sqrt(3 * 4 / 60) = 1.048."""
    found = analyse(_many(record, build, 10)).significance
    assert isinstance(found.ranks, FriedmanTest)
    assert found.ranks.mean_ranks == (1.0, 2.0, 3.0)
    assert found.ranks.critical_difference == pytest.approx(1.048, abs=1e-3)
    duel = {d.method: d for d in found.comparisons}["c"]
    assert (duel.reference, duel.runs, duel.better, duel.worse, duel.verdict) == ("a", 10, 0, 10, "worse")
    assert duel.ratio == pytest.approx(2.0)
    assert duel.p == pytest.approx(2 * 2 / 2**10)
    assert duel.detectable == pytest.approx(1.0, abs=1e-6)


def _scatter(record, build, methods, runs):
    """The others have about the error of a: ratios of exp(0.1) and exp(-0.1) in turn, over runs of one sequence."""
    return build([
        record(who, "room", {ATE: 0.01 * np.exp(0.0 if who == "a" else 0.1 * (-1) ** seed)}, seed=seed)
        for who in methods for seed in range(runs)
    ])  # fmt: skip


def test_a_detectable_ratio_holds_beside_the_other_rows(record, build):
    """Of r rows, Holm's first one is at 5 %/r; over 12 runs the standard error is 0.1 sqrt(12/11) / sqrt(12)."""
    error = 0.1 / np.sqrt(11.0)
    for methods in ("ab", "abcd"):
        found = analyse(_scatter(record, build, methods, 12)).significance.comparisons
        rows = len(found)
        errors = detectable_standard_errors(11, alpha=0.05 / rows)
        own = [one for one in found if "a" in (one.method, one.reference)]
        assert len(own) == len(methods) - 1
        assert [one.detectable for one in own] == pytest.approx([np.exp(error * errors)] * len(own))


def test_runs_that_no_difference_would_be_shown_by_detect_none(record, build):
    """Six runs have p >= 2 / 2^6 = 0.031: enough for one row, not for two or more by Holm."""
    alone, several = (analyse(_scatter(record, build, methods, 6)) for methods in ("ab", "abc"))
    assert [np.isinf(one.detectable) for one in alone.significance.comparisons] == [False]
    assert {np.isinf(one.detectable) for one in several.significance.comparisons} == {True}
    assert {str(row[-1].text) for row in comparisons_table(several, assign_strokes("abc", ())).rows} == {"none"}


def test_the_probability_of_a_larger_error_is_compared_within_each_sequence(record, build):
    """b is always worse on two runs of the room, equal on four of the hall, which is harder: (2 * 1 + 4 * 0.5) / 6."""
    errors = {("a", "room"): 0.01, ("b", "room"): 0.02, ("a", "hall"): 1.0, ("b", "hall"): 1.0}
    made = [
        record(who, sequence, {ATE: error}, seed=seed)
        for (who, sequence), error in errors.items() for seed in range(2 if sequence == "room" else 4)
    ]  # fmt: skip
    (duel,) = analyse(build(made)).significance.comparisons
    assert (duel.method, duel.reference) == ("b", "a")
    assert duel.larger == pytest.approx(2.0 / 3.0)


def test_the_runs_of_the_quantiles_are_counted(record, build):
    """The quantiles of a are over ten runs of two sequences, those of b over one sequence: not the same data."""
    made = [record(who, "room", {ATE: 0.01}, seed=seed) for who in "ab" for seed in range(4)]
    made += [record("a", "hall", {ATE: 1.0}, seed=seed) for seed in range(6)]
    comparison = build(made)
    found = {one.method: one for one in analyse(comparison).significance.records}
    assert [(found[who].measured, found[who].sequences) for who in "ab"] == [(10, 2), (4, 1)]
    text = render_report(analyse(comparison))
    assert re.search(r"10 runs\s*<span class=\"extent\">2 sequences", text)


def test_five_runs_are_too_few_for_significance(record, build):
    found = analyse(_many(record, build, 5)).significance
    assert {duel.verdict for duel in found.comparisons} == {"too few runs"}
    assert found.ranks == NotTested("ranks with a critical difference need at least 8 data sets, found 5")


def test_sequences_of_one_data_set_are_one_row_of_the_ranks(record, build):
    """a is best on nine sequences and worst on a tenth, of the data set of the ninth, where it is in the middle."""
    runs = list(_many(record, build, 10).records)
    runs = [
        replace(run, spec=replace(run.spec, sequence=replace(run.spec.sequence, dataset="s8")))
        if run.sequence == "s9" else run
        for run in runs
    ]  # fmt: skip
    worse = [with_scores(run, by_metric={ATE: replace(run.scores.by_metric[ATE], value=0.3)})
             if (run.method, run.sequence) == ("a", "s9") else run for run in runs]  # fmt: skip
    found, other = (analyse(build(own)).significance for own in (runs, worse))
    assert isinstance(found.ranks, FriedmanTest)
    assert (found.ranks.data_sets, found.ranks.mean_ranks, len(found.sequences)) == (9, (1.0, 2.0, 3.0), 10)
    # means over s8 and s9: a sqrt(0.09 * 0.3) = 0.164, b sqrt(0.099 * 0.11) = 0.104, c sqrt(0.18 * 0.2) = 0.190
    assert isinstance(other.ranks, FriedmanTest)
    assert other.ranks.mean_ranks == pytest.approx(((8 + 2) / 9, (16 + 1) / 9, 3.0))
    fewer = [run for run in runs if run.sequence not in ("s6", "s7")]
    too_few = NotTested("ranks with a critical difference need at least 8 data sets, found 7")
    assert analyse(build(fewer)).significance.ranks == too_few


def test_ranks_of_equal_methods_do_not_differ_significantly(record, build):
    made = [record(who, f"s{number}", {ATE: 0.01 + 0.01 * number}) for number in range(8) for who in "abc"]
    for runs, words in (
        (made, "do not differ significantly, with p = 1 "),
        (_many(record, build, 8).records, "differ"),
    ):
        assert f"Ranks over 8 data sets {words}" in render_report(analyse(build(list(runs))))


def test_a_failed_run_has_the_worst_rank_and_is_never_left_out(record, build):
    found = analyse(_many(record, build, 10, failed=(0, 1, 2, 3, 4, 5))).significance
    record = {r.method: r for r in found.records}["a"]
    assert (record.finished, record.runs) == (4, 10)
    assert record.rank == pytest.approx((6 * 3 + 4 * 1) / 10)
    assert record.quantiles[1:] == (math.inf, math.inf)
    duel = next(d for d in found.comparisons if "a" in (d.method, d.reference))
    assert duel.runs == 10


def test_a_run_that_could_not_start_and_a_map_without_a_trajectory_are_no_losses(record, build):
    """b has twice the error on the six sequences where it is installed; the map of c has no error on any."""
    made = [record("a", f"s{number}", {ATE: 0.01 + 0.01 * number}) for number in range(10)]
    made += [record("b", f"s{number}", {ATE: 0.02 + 0.02 * number}) for number in range(6)]
    made += [
        record("b", f"s{number}", {}, status="not-installed", reason="no b", answered=0) for number in range(6, 10)
    ]
    made += [record("c", f"s{number}", {}, answered=0, expected=0) for number in range(10)]
    found = analyse(build(made)).significance
    (duel,) = found.comparisons
    assert (duel.method, duel.reference, duel.runs, duel.worse) == ("b", "a", 6, 6)
    assert duel.ratio == pytest.approx(2.0)
    assert {one.method: (one.runs, one.measured) for one in found.records} == {"a": (10, 10), "b": (6, 6), "c": (10, 0)}


def test_methods_that_agree_to_rounding_are_tied(record, build):
    made = [
        record(who, f"s{number}", {ATE: (0.01 + 0.01 * number) * factor})
        for number in range(10) for who, factor in (("a", 1.0), ("b", 1.0 + 1e-13))
    ]  # fmt: skip
    (duel,) = analyse(build(made)).significance.comparisons
    assert (duel.better, duel.worse, duel.p, duel.verdict) == (0, 0, 1.0, "no difference shown")
