"""The sentences say what the numbers say, and no more."""

from dataclasses import replace

import pytest

from evalkit.report.summary import gap, joined, overview, verdict


def _said(comparison, sequence="room"):
    return " ".join(verdict(comparison, sequence).sentences).replace("\u00a0", " ")


def _overview(comparison):
    verdicts = [verdict(comparison, label) for label in comparison.sequence_labels]
    return [sentence.replace("\u00a0", " ") for sentence in overview(comparison, verdicts)]


def _seeds(trial, name, values, metric="ate_rmse_m", **more):
    return [trial(name, "room", {metric: value}, seed=seed, **more) for seed, value in enumerate(values)]


def test_a_clear_winner_is_named_with_its_lead(trial, build):
    comparison = build([*_seeds(trial, "a", [0.010, 0.011, 0.012]), *_seeds(trial, "b", [0.020, 0.022, 0.024])])
    found = verdict(comparison, "room")
    assert (found.outcome, found.leaders, found.counts) == ("winner", ("a",), True)
    expected = "a wins on ATE RMSE: 0.011 m (0.010 to 0.012); the runner-up, b, has 0.022 m (0.020 to 0.024), "
    assert expected + "2.0 times as much." in _said(comparison)


def test_overlapping_seeds_make_no_winner(trial, build):
    comparison = build([*_seeds(trial, "a", [0.010, 0.011, 0.020]), *_seeds(trial, "b", [0.019, 0.022, 0.024])])
    assert verdict(comparison, "room").outcome == "level"
    assert "No clear winner on ATE RMSE" in _said(comparison)
    assert "overlap over their seeds" in _said(comparison)


def test_relations_closer_than_their_own_noise_make_no_winner(trial, build):
    near = build([trial(n, "room", {"relations_mean_m": v}, seed=None) for n, v in (("a", 0.051), ("b", 0.080))])
    far = build([trial(n, "room", {"relations_mean_m": v}, seed=None) for n, v in (("a", 0.051), ("b", 0.082))])
    assert verdict(near, "room").outcome == "level"
    assert "differ by less than the truth can tell (0.030 m)" in _said(near)
    assert verdict(far, "room").leaders == ("a",)
    assert "One run each" in _said(far)


def test_the_same_gap_in_metres_of_drift_is_a_win(trial, build):
    comparison = build([trial(n, "room", {"ate_rmse_m": v}, seed=None) for n, v in (("a", 0.051), ("b", 0.080))])
    assert verdict(comparison, "room").leaders == ("a",)


def test_higher_wins_where_higher_is_better(trial, build):
    comparison = build([*_seeds(trial, "a", [0.90, 0.91], "map_f1"), *_seeds(trial, "b", [0.70, 0.71], "map_f1")])
    assert verdict(comparison, "room").leaders == ("a",)


def test_whoever_lost_a_run_cannot_win_by_the_others(trial, build):
    crash = trial("a", "room", {"ate_rmse_m": 0.001}, seed=1, status="crashed", reason="signal 11", answered=9)
    a = [trial("a", "room", {"ate_rmse_m": 0.001}, seed=0), crash]
    comparison = build([*a, *_seeds(trial, "b", [0.02, 0.03]), *_seeds(trial, "c", [0.5, 0.6])])
    assert verdict(comparison, "room").leaders == ("b",)
    assert _said(comparison).startswith("5 of 6 runs finished. Did not finish: a (1 of 2 crashed).")


def test_a_score_that_is_not_meaningful_on_one_seed_cannot_win(trial, build):
    comparison = build([*_seeds(trial, "a", [0.001, None]), *_seeds(trial, "b", [0.02, 0.03])])
    assert verdict(comparison, "room").outcome == "unrivalled"


def test_a_loss_of_the_papers_method_is_said_plainly(trial, build):
    comparison = build([*_seeds(trial, "paper", [0.048, 0.050]), *_seeds(trial, "plane", [0.010, 0.010])])
    assert "The paper's method: paper loses, with 0.049 m against 0.010 m: 4.9 times as much." in _said(comparison)
    assert "The paper's method, paper, loses 1 of 1 (room)." in _overview(comparison)


def test_worse_than_wheel_odometry_is_said(trial, build):
    comparison = build([*_seeds(trial, "wheel", [0.4, 0.41]), *_seeds(trial, "a", [2, 3]), *_seeds(trial, "b", [1, 1])])
    assert "Worse than wheel alone (0.405 m): a (2.500 m) and b (1.000 m)." in _said(comparison)
    assert "Worse than wheel alone: a on room and b on room." in _overview(comparison)


def test_the_bar_does_not_compete_in_runtime(trial, build):
    names = (("wheel", 0.01), ("a", 1.0), ("b", 5.0))
    comparison = build([trial(n, "room", {"ate_rmse_m": v, "cpu_median_ms": v}, seed=None) for n, v in names])
    assert "CPU time per scan, median: best a (1.00 ms), worst b (5.00 ms)." in _said(comparison)


def test_a_degenerate_sequence_is_named_and_not_counted(trial, build):
    comparison = build([*_seeds(trial, "a", [0.01, 0.01]), *_seeds(trial, "b", [0.5, 0.5])])
    cards = {"room": replace(comparison.sequences["room"], degenerate="A corridor without ends.")}
    comparison = replace(comparison, sequences=cards)
    found = verdict(comparison, "room")
    assert (found.outcome, found.leaders, found.counts) == ("degenerate", (), False)
    assert "Degenerate by design: A corridor without ends." in _said(comparison)
    assert " wins " not in _said(comparison)
    assert "Not counted as wins or losses: room (degenerate geometry)." in _overview(comparison)


def test_maps_without_truth_decide_nothing_overall(trial, build):
    pair = (("a", 0.1), ("b", 0.4))
    comparison = build([trial(n, "room", {"map_entropy": v}, seed=None, truth=False) for n, v in pair])
    assert not verdict(comparison, "room").counts
    assert "compares maps only, and is blind to global warp." in _said(comparison)


def test_what_could_not_start_is_no_failure_of_the_contestant(demo):
    first = _overview(demo)[0]
    assert first.startswith(
        "16 of 23 runs finished. Did not finish: <script>alert(1)</script> (1 of 3 crashed, 1 of 3 "
    )
    assert first.endswith("Could not start: absent (3 of 3 not installed) and plane (1 of 5 data missing).")


def test_whoever_is_slower_than_the_sensor_is_named(demo):
    assert "Slower than the sensor in more than 1 % of the scans: <script>alert(1)</script> on room." in _overview(demo)


@pytest.mark.parametrize(("value", "best", "words"), [(0.5, 0.1, "5.0 times as much"), (0.15, 0.1, "50 % more")])
def test_gaps_are_told_as_people_say_them(demo, value, best, words):
    assert gap(demo.metrics[0], value, best) == words


def test_a_gap_across_zero_is_told_as_a_difference(demo):
    assert gap(demo.metrics[0], 0.5, -0.25).replace("\u00a0", " ") == "0.750 m more"


def test_lists_read_like_sentences():
    assert [joined(words) for words in ("", "a", "ab", "abc")] == ["none", "a", "a and b", "a, b and c"]
