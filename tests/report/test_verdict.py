"""The sentences of the verdict state what the numbers support."""

import math
import re
from dataclasses import replace

import numpy as np
import pytest

from evalkit.core.run_result import LostTrack
from evalkit.metrics import METRICS
from evalkit.metrics.validated import load_validation
from evalkit.report.analysis.analysis import analyse
from evalkit.report.analysis.pairwise import RELATION_ACCURACY, is_clearly_worse, noise_floor
from evalkit.report.analysis.ranking import mark
from evalkit.report.analysis.scores import Spread
from evalkit.report.analysis.sequence import analyse_sequence
from evalkit.report.analysis.statements.pills import Pill
from evalkit.report.analysis.statements.verdict import compute_verdict
from evalkit.report.formatting import format_gap, format_losses, join_words
from evalkit.report.html.dot_plot import draw_dots
from evalkit.report.html.method_colours import assign_strokes
from evalkit.report.results_json import build_results


def verdict(comparison, sequence="room"):
    return compute_verdict(comparison, analyse_sequence(comparison, sequence))


def _verdict_text(comparison):
    return " ".join(verdict(comparison).sentences).replace("\u00a0", " ")


def _overview(comparison):
    return [sentence.replace("\u00a0", " ") for sentence in analyse(comparison).overview]


def _seeds(record, name, values, metric="ate_rmse_m", **more):
    return [record(name, "room", {metric: value}, seed=seed, **more) for seed, value in enumerate(values)]


def test_a_clear_winner_is_named_with_its_lead(record, build):
    comparison = build([*_seeds(record, "a", [0.010, 0.011, 0.012]), *_seeds(record, "b", [0.020, 0.022, 0.024])])
    found = verdict(comparison, "room")
    assert (found.outcome, found.leaders, found.counts) == ("winner", ("a",), True)
    said = _verdict_text(comparison)
    assert re.search(r"a wins on ATE RMSE: 11 mm \(95 % interval \d+ to 1\d\); the runner-up, b, has 22 mm", said)
    assert "2.0 times as much; over 3 pairs of runs, the difference is 11.0 mm (99 % interval 11.0" in said


def test_a_lead_that_reverses_in_one_seed_gives_no_winner(record, build):
    comparison = build([*_seeds(record, "a", [0.010, 0.011, 0.025]), *_seeds(record, "b", [0.019, 0.022, 0.024])])
    assert verdict(comparison, "room").outcome == "tied"
    assert "On ATE RMSE, a (11 mm (95 % interval " in _verdict_text(comparison)
    assert re.search(
        r"over 3 pairs of runs, b is worse by \d+\.\d mm \(99 % interval −9\.4 to 166\.2\)", _verdict_text(comparison)
    )
    assert "which may be chance; about 11 runs of each would settle a difference of this" in _verdict_text(comparison)


def test_a_lead_in_every_seed_wins_even_if_the_seeds_overlap(record, build):
    comparison = build([*_seeds(record, "a", [0.010, 0.011, 0.020]), *_seeds(record, "b", [0.019, 0.022, 0.042])])
    assert (verdict(comparison, "room").outcome, verdict(comparison, "room").leaders) == ("winner", ("a",))


@pytest.mark.parametrize(("other", "outcome"), [(1.049, "tied"), (1.051, "winner")])
def test_a_winner_is_better_by_at_least_five_percent(record, build, other, outcome):
    comparison = build([*_seeds(record, "a", [1.0, 1.0]), *_seeds(record, "b", [other, other])])
    assert verdict(comparison, "room").outcome == outcome


def test_pairs_that_contradict_the_order_of_the_medians_give_no_winner(record, build):
    """Medians 4 and 4.2 m, but b is better in six of seven pairs: log-ratios of -0.36 on average with t = 3.0."""
    a, b = [1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0], [0.5, 1.0, 1.5, 4.2, 4.3, 5.0, 5.8]
    comparison = build([*_seeds(record, "a", a), *_seeds(record, "b", b)])
    assert verdict(comparison).outcome == "tied"
    said = _verdict_text(comparison)
    assert re.search(r"a is better by the medians, b over 7 pairs of runs, by 1\.2\d\d m \(97 % interval 0\.\d", said)
    assert "worse by" not in said
    assert "chance" not in said
    assert not is_clearly_worse(comparison.metrics[0], *(analyse_sequence(comparison, "room").deciding.ranked[::-1]))


def test_a_lead_of_a_millimetre_is_a_tie(record, build):
    comparison = build([*_seeds(record, "a", [0.0100, 0.0110]), *_seeds(record, "b", [0.0115, 0.01265])])
    assert verdict(comparison, "room").outcome == "tied"
    assert "are tied: they are at most 2 mm apart, which does not matter here." in _verdict_text(comparison)
    third = build([*comparison.records, *_seeds(record, "c", [0.0113, 0.01243])])
    assert "Worse by at most 2 mm, which does not matter here: b." in _verdict_text(third)
    assert "statistically" not in f"{_verdict_text(third)} {_overview(third)}"
    large = build([*_seeds(record, "a", [1.0, 1.1]), *_seeds(record, "b", [1.04, 1.144])])
    assert "at most 5 % apart, which does not matter here" in _verdict_text(large)


def test_a_difference_too_small_to_matter_is_stated_with_an_interval_beyond_that(record, build):
    """Log-ratios with a standard error of 0.00515, t(0.995, 2) = 9.925: 1.0524 times their mean of 1.12, or of 1.18."""
    first, near, far = [0.01] * 3, [0.0111, 0.0112, 0.0113], [0.0117, 0.0118, 0.0119]
    for third, said in ((near, "2 mm"), (far, "2 mm (interval up to 2.4 mm)")):
        runs = {"a": first, "b": [0.0105] * 3, "c": [0.0111] * 3, "d": third}
        comparison = build([one for name, values in runs.items() for one in _seeds(record, name, values)])
        assert f"Worse by at most {said}, which does not matter here: c and d." in _verdict_text(comparison)
        pair = build([*_seeds(record, "a", first), *_seeds(record, "d", third)])
        assert f"they are at most {said} apart, which does not matter here" in _verdict_text(pair)


def test_differences_below_the_noise_of_the_relations_are_a_tie(record, build):
    """Twice 30 mm by the root of their number: 12 mm of 25 relations; from 144 on the 5 mm that all may share."""

    def compare(other_mm, relations):
        values = {"a": 51.0, "b": other_mm}
        runs = [
            record(name, "room", {"relations_mean_m": 1e-3 * one}, seed=seed, answered=relations, expected=relations)
            for name, one in values.items()
            for seed in range(3)
        ]
        return build(runs)

    for relations, floor_mm, said in ((25, 12.0, "12 mm"), (144, 5.0, "5.0 mm"), (400, 5.0, "5.0 mm")):
        near, far = (compare(51.0 + floor_mm + more, relations) for more in (-0.1, 0.1))
        assert verdict(near).outcome == "tied"
        why = f"differ by less than the accuracy of the ground truth ({said} over {relations} relations)"
        assert why in _verdict_text(near)
        assert verdict(far).leaders == ("a",)


def test_errors_of_the_relations_hardly_ever_make_a_difference_above_the_floor(record, build):
    """Two methods 0.5 m wrong in independent directions: the error of an axis by the root of half the number."""
    rng, count = np.random.default_rng(0), 100
    one, other = (0.5 * np.exp(2j * np.pi * rng.random((4000, count))) for _ in range(2))
    axis_m = RELATION_ACCURACY["m"] / math.sqrt(math.pi / 2.0)  # of errors with that mean length
    relations = axis_m * (rng.normal(size=(4000, count)) + 1j * rng.normal(size=(4000, count)))
    apart = np.abs(one + relations).mean(axis=1) - np.abs(other + relations).mean(axis=1)
    assert apart.std() == pytest.approx(math.sqrt(2.0 / count) * axis_m, rel=0.05)
    (metric,) = (one for one in build([record("a", "room", {})]).metrics if one.name == "relations_mean_m")
    assert noise_floor(metric, count) == pytest.approx(0.006)
    assert np.mean(np.abs(apart) > noise_floor(metric, count)) < 0.1


def test_two_seeds_that_scatter_as_much_as_they_differ_give_no_decision(record, build):
    """Student's t with one degree of freedom asks for 64 standard errors; two pairs of runs have no interval."""
    near = build([*_seeds(record, "a", [0.90, 0.92], "map_f1"), *_seeds(record, "b", [0.80, 0.80], "map_f1")])
    assert verdict(near, "room").outcome == "tied"
    assert "over 2 pairs of runs, b is worse by 0.1100, which may be chance" in _verdict_text(near)
    assert "about 3 runs of each would settle a difference of this size" in _verdict_text(near)


@pytest.mark.parametrize("other", [0.080, 17.0])
def test_one_run_each_gives_an_order_and_no_verdict(record, build, other):
    """The bootstrap within the runs excludes zero; one run each still shows nothing about a next one."""
    pair = (("a", 0.051), ("b", other), ("paper", 20.0), ("wheel", 0.049))
    comparison = build([record(n, "room", {"ate_rmse_m": v}, seed=None) for n, v in pair])
    found = verdict(comparison)
    assert (found.outcome, found.leaders, found.counts) == ("one run", (), False)
    said = _verdict_text(comparison)
    takes = "which takes 6 or more (nuisance = 5)"  # a recording: its runs are perturbed
    assert f"One run each gives an order and no verdict, {takes}. On ATE RMSE: wheel (49 mm (95" in said
    assert "% interval of this run " in said
    assert "The reference method: paper has 20.00 m, place 4 of 4 in this order." in said
    whole = f"{said} {' '.join(_overview(comparison))}"
    assert "No sequence has both ground truth and repeated runs to compare" in whole
    assert "It does not say what another run would give, so there is no verdict." in whole
    assert not {"wins", "winner", "loses", "ahead", "behind", "tied", "Worse"} & set(whole.replace(",", "").split())
    (ranking,) = (analyse_sequence(comparison, "room").deciding,)
    assert {mark(ranking, name) for name, _ in pair} == {"not comparable"}


def test_repeated_runs_are_not_described_as_single(record, build):
    comparison = build([*_seeds(record, "a", [0.010, 0.011, 0.012]), *_seeds(record, "b", [0.020, 0.022, 0.024])])
    said = f"{_verdict_text(comparison)} {' '.join(_overview(comparison))}"
    assert "of this run " not in said
    assert "One run each" not in said
    assert "Numbers are medians over up to 3 runs." in said


def test_the_higher_value_wins_where_higher_is_better(record, build):
    comparison = build([*_seeds(record, "a", [0.90, 0.91], "map_f1"), *_seeds(record, "b", [0.70, 0.71], "map_f1")])
    assert verdict(comparison, "room").leaders == ("a",)


def test_a_method_with_a_lost_run_cannot_win(record, build):
    crash = record("a", "room", {"ate_rmse_m": 0.001}, seed=1, status="crashed", reason="signal 11", answered=9)
    a = [record("a", "room", {"ate_rmse_m": 0.001}, seed=0), crash]
    comparison = build([*a, *_seeds(record, "b", [0.02, 0.03]), *_seeds(record, "c", [0.5, 0.75])])
    assert verdict(comparison, "room").leaders == ("b",)
    assert _verdict_text(comparison).startswith("5 of 6 runs finished. Did not finish: a (1 of 2 crashed).")


def test_a_method_without_a_score_on_one_seed_cannot_win(record, build):
    comparison = build([*_seeds(record, "a", [0.001, None]), *_seeds(record, "b", [0.02, 0.03])])
    assert verdict(comparison, "room").outcome == "single"


def test_a_loss_of_the_reference_method_is_stated(record, build):
    comparison = build([*_seeds(record, "paper", [0.048, 0.050]), *_seeds(record, "plane", [0.010, 0.010])])
    assert "The reference method: paper loses, with 49 mm against 10 mm: 4.9 times as much." in _verdict_text(
        comparison
    )
    assert "The reference method, paper, loses 1 of 1 (room)." in _overview(comparison)


def test_a_method_worse_than_wheel_odometry_is_reported(record, build):
    values = {"wheel": (0.4, 0.41, 0.4), "a": (2, 3, 2.5), "b": (1, 1, 1), "c": (0.3, 0.5, 0.6)}
    comparison = build([one for name, own in values.items() for one in _seeds(record, name, own)])
    assert "Worse than wheel alone (400 mm): a (2.50 m) and b (1.00 m)." in _verdict_text(comparison)
    assert "Worse than wheel alone: a on room and b on room." in _overview(comparison)


def test_the_baseline_is_not_ranked_in_runtime(record, build):
    names = (("wheel", 0.01), ("a", 1.0), ("b", 5.0))
    comparison = build([record(n, "room", {"ate_rmse_m": v, "cpu_median_ms": v}, seed=None) for n, v in names])
    assert "CPU time per scan, median: a (1.00 ms) to b (5.00 ms)." in _verdict_text(comparison)


def test_a_degenerate_sequence_is_named_and_not_counted(record, build):
    comparison = build([*_seeds(record, "a", [0.01, 0.01]), *_seeds(record, "b", [0.5, 0.5])])
    cards = {"room": replace(comparison.sequences["room"], degenerate="A corridor without ends.")}
    comparison = replace(comparison, sequences=cards)
    found = verdict(comparison, "room")
    assert (found.outcome, found.leaders, found.counts) == ("degenerate", (), False)
    assert "Degenerate geometry: A corridor without ends." in _verdict_text(comparison)
    assert " wins " not in _verdict_text(comparison)
    assert "Not counted: room (degenerate geometry)." in _overview(comparison)


def _maps(record, build, runs=3, **measures):
    """Runs without ground truth that differ by 1 %; per method: halves apart (m), variance across walls (1000 cm2),
    cleared share and S2M residual (m).
    """
    names = ("split_distance_m", "mom_cm2", "cleared_percent", "s2m_m")

    def scaled(values, seed):
        pairs = zip(names, values, (1.0, 1000.0, 100.0, 1.0), strict=True)
        return {name: None if value is None else value * scale * (1 + 0.01 * seed) for name, value, scale in pairs}

    return build([
        record(n, "room", scaled(v, seed or 0), seed=seed, truth=False)
        for n, v in measures.items() for seed in (range(runs) if runs > 1 else (None,))
    ])  # fmt: skip


LOST_MAPS = {"lost": (0.10, 0.09, 0.30, 0.08), "a": (0.12, 0.02, 0.05, 0.03), "b": (0.2, 0.03, 0.04, 0.04)}


def test_a_lead_in_the_distance_of_the_halves_alone_gives_no_winner(record, build):
    comparison = _maps(record, build, **LOST_MAPS)
    found = verdict(comparison, "room")
    assert (found.outcome, found.leaders, found.counts) == ("disagreement", (), False)
    assert (
        "The map metrics disagree: lost has the smallest distance between the halves of the run, a the least scatter "
        "across orthogonal walls and the lowest S2M residual, b the fewest hits in cleared space."
    ) in _verdict_text(comparison)
    assert mark(analyse_sequence(comparison, "room").deciding, "lost") == "not comparable"
    once = _maps(record, build, runs=1, **LOST_MAPS)
    assert verdict(once).outcome == "one run"
    assert "disagree" not in _verdict_text(once)


def test_a_map_best_in_every_metric_leads(record, build):
    comparison = _maps(record, build, a=(0.10, 0.02, 0.04, 0.03), b=(0.20, 0.03, 0.05, 0.04))
    found = verdict(comparison, "room")
    assert (found.outcome, found.leaders, found.counts) == ("winner", ("a",), False)
    assert "The other map metrics agree." in _verdict_text(comparison)
    assert "compares maps only. Limitations: global warp." in _verdict_text(comparison)
    validated = load_validation().agreement_of("split_distance_m")
    assert f"Spearman correlation with that error was {validated.overall.value:.2f}" in _verdict_text(comparison)
    assert verdict(_maps(record, build, runs=1, a=(0.10, 0.02, 0.04, 0.03), b=(0.2, 0.3, 0.5, 0.4))).leaders == ()


def test_a_map_tied_in_one_metric_and_worse_in_another_is_not_marked_as_tied(record, build):
    other = {"b": (0.1005, 0.02, 0.04, 0.03), "c": (0.1, 0.09, 0.04, 0.03)}
    comparison = _maps(record, build, a=(0.10, 0.02, 0.04, 0.03), **other)
    found = verdict(comparison)
    assert (found.outcome, found.leaders) == ("tied", ("a", "b"))
    deciding = analyse_sequence(comparison, "room").deciding
    assert [mark(deciding, name) for name in "abc"] == ["tied", "tied", "undecided"]
    dots = draw_dots(analyse(comparison), assign_strokes(comparison.method_labels, ())).replace("\u00a0", " ")
    assert "c on room: 101 mm, not tied in every map metric" in dots
    assert "b on room: 102 mm, tied with the best" in dots


def test_a_map_metric_without_value_leaves_the_map_undecided(record, build):
    comparison = _maps(record, build, a=(0.10, 0.02, None, 0.03), b=(0.20, 0.03, None, 0.04))
    assert verdict(comparison, "room").outcome == "disagreement"
    assert "Without ground truth there is no leader: free-space violation has no value." in _verdict_text(comparison)


def test_without_ground_truth_worse_than_odometry_requires_every_metric(record, build):
    wheel = (0.10, 0.02, 0.04, 0.03)
    one = _maps(record, build, wheel=wheel, a=(0.20, 0.01, 0.05, 0.04))
    every = _maps(record, build, wheel=wheel, a=(0.20, 0.03, 0.05, 0.04))
    once = _maps(record, build, runs=1, wheel=wheel, a=(0.20, 0.03, 0.05, 0.04))
    assert "than wheel alone" not in _verdict_text(one) + _verdict_text(once)
    assert "Worse map than wheel alone, in every map metric: a." in _verdict_text(every)


def test_a_recording_is_judged_by_its_perturbed_runs(record, build):
    """Without ground truth, every map metric agrees in each of six perturbed runs; fewer give no verdict."""

    def perturbed(run):
        sequence = replace(run.spec.sequence, perturbed=True)
        return replace(run, spec=replace(run.spec, sequence=sequence))

    plain = _maps(record, build, runs=6, a=(0.10, 0.02, 0.04, 0.03), b=(0.20, 0.03, 0.05, 0.04))
    comparison = replace(plain, records=tuple(map(perturbed, plain.records)))
    assert verdict(comparison).outcome == "winner"
    fewer = replace(comparison, records=tuple(run for run in comparison.records if run.spec.seed != 5))
    assert verdict(fewer).outcome != "winner"
    score = analyse_sequence(comparison, "room").deciding.of("a")
    assert score.spread == Spread(pytest.approx(0.10), pytest.approx(0.105), 6, "perturbed")
    said = _verdict_text(comparison)
    assert "a is ahead on halves of the run apart: 103 mm (100 to 105 in 6 repeated runs)" in said
    assert "The spread is that of 6 runs of this recording, all under small perturbations (a later start" in said
    assert "repeated runs)" not in _verdict_text(plain)
    assert "perturb" not in _verdict_text(plain)
    assert "spread is that of" not in _verdict_text(plain)
    assert analyse_sequence(plain, "room").deciding.of("a").spread.kind == "interval"

    def lose(count):
        found = replace(comparison, records=tuple(
            replace(run, scores=replace(run.scores, lost=LostTrack(9.0, "a jump")))
            if run.method == "a" and run.seed < count else run for run in comparison.records
        ))  # fmt: skip
        return verdict(found).leaders, _verdict_text(found)

    assert lose(0)[0] == ("a",)
    assert "Lost the track" not in lose(0)[1]
    assert lose(1)[0] == lose(3)[0] == ()  # a loss in one perturbed run counts as one in one seed does
    assert "Lost the track and not ranked: a in 1 of 6, at 9 s (a jump)." in lose(1)[1]
    assert "Lost the track and not ranked: a in 3 of 6, first at 9 s (a jump)." in lose(3)[1]


def test_methods_that_found_a_lost_track_again_are_counted(record, build):
    losses = [LostTrack(9.0, "a jump", 20.0), LostTrack(12.0, "slip"), None]
    runs = [
        replace(run, scores=replace(run.scores, lost=lost))
        for run, lost in zip(_seeds(record, "a", [0.01, 0.011, 0.012]), losses, strict=True)
    ]
    comparison = build([*runs, *_seeds(record, "b", [0.02, 0.021, 0.022])])
    score = analyse_sequence(comparison, "room").deciding.of("a")
    assert (score.lost_runs, score.found_runs) == (2, 1)
    said = _verdict_text(comparison)
    assert "Lost the track and not ranked: a in 2 of 3, first at 9 s, 1 found again (a jump)." in said
    assert format_losses(replace(score, expected=1, lost_runs=1)) == "at 9 s, found at 20 s"
    assert format_losses(replace(score, lost_runs=1)) == "in 1 of 3, at 9 s, found at 20 s"
    assert format_losses(replace(score, lost=None)) == ""


def test_methods_that_lost_the_track_are_not_ranked(record, build):
    """The lost run has the better error; it is neither best nor tied, and the best of the others wins."""

    def runs(name, values, at_s=None):
        own = _seeds(record, name, values)
        gone = None if at_s is None else LostTrack(at_s, "4.89 m in one scan.")
        return [*own[:-1], replace(own[-1], scores=replace(own[-1].scores, lost=gone))]

    held = [*runs("b", [0.02, 0.021, 0.022]), *runs("c", [0.05, 0.052, 0.055])]
    comparison = build([*runs("a", [0.001, 0.001, 0.001], 212.4), *held])
    assert verdict(comparison).leaders == ("b",)
    assert "Lost the track and not ranked: a in 1 of 3, at 212 s (4.89 m in one scan)." in _verdict_text(comparison)
    ranking = analyse_sequence(comparison, "room").deciding
    assert [mark(ranking, name) for name in "abc"] == ["lost", "best", "worse"]
    assert "Lost the track" not in _verdict_text(build(held))

    wheel = runs("wheel", [0.4, 0.41, 0.42])
    gone = build([*runs("a", [0.5, 0.5, 0.5], 9.0), *runs("b", [0.4, 0.4, 0.4], 3.0), *wheel])
    assert (verdict(gone).outcome, verdict(gone).leaders) == ("single", ())  # the wheels held it
    assert "Only wheel has 410 mm" in _verdict_text(gone)
    assert analyse(gone).answer.title == "Only wheel is ranked: a and b lost the track."
    all_gone = build([*runs("a", [0.5, 0.5, 0.5], 9.0), *runs("b", [0.4, 0.4, 0.4], 3.0)])
    assert verdict(all_gone).outcome == "lost"
    assert "No method held the track. Lost the track and not ranked: a in 1 of 3, at 9 s (" in _verdict_text(all_gone)
    assert analyse(all_gone).answer.title == "No method held the track: there is no answer."
    assert "No method held the track" not in _verdict_text(comparison)


@pytest.mark.parametrize(
    ("metric", "seeds", "why"),
    [
        ("ate_rmse_m", 1, "no repeated runs"),
        ("split_distance_m", 1, "no ground truth and no repeated runs"),
        ("split_distance_m", 3, "no ground truth"),
    ],
)
def test_the_reason_that_a_sequence_does_not_count_is_the_one_that_applies(record, build, metric, seeds, why):
    runs = [record(n, "room", {metric: 0.1 + s / 99}, seed=s) for n in "ab" for s in range(seeds)]
    assert f"Not counted: room ({why})." in _overview(build(runs))


def test_a_doubt_about_the_data_is_in_the_verdict_the_answer_and_the_results(record, build):
    comparison = build(_seeds(record, "a", [0.010, 0.011, 0.012]))
    doubtful = {"room": replace(comparison.sequences["room"], warnings=("heading 0 deg: check it",))}
    found = replace(comparison, sequences=doubtful)
    assert "Doubt about the data: heading 0 deg: check it." in _verdict_text(found)
    assert analyse(found).answer.pills[0] == Pill("room: heading 0 deg: check it", "warn")
    assert build_results(analyse(found))["sequences"]["room"]["warnings"] == ("heading 0 deg: check it",)


def test_settings_chosen_on_the_data_do_not_count(record, build):
    comparison = build([*_seeds(record, "a", [0.010, 0.011, 0.012]), *_seeds(record, "b", [0.020, 0.022, 0.024])])
    tuned = {**comparison.methods, "a": replace(comparison.methods["a"], tuned_on=("room", "elsewhere"))}
    found = replace(comparison, methods=tuned)
    assert verdict(found).outcome == "single"
    assert analyse(found).answer.title == "Only b is ranked: settings of a were chosen on these data."
    both = {name: replace(card, tuned_on=("room",)) for name, card in comparison.methods.items()}
    none = replace(comparison, methods=both)
    assert analyse(none).answer.title == "No method is ranked: settings of a and b were chosen on these data."
    assert "No method is ranked on ATE RMSE, so there is no winner. " in _verdict_text(none)
    assert "Not ranked, because settings were chosen on these data: a." in _verdict_text(found)
    assert mark(analyse_sequence(found, "room").deciding, "a") == "not comparable"
    assert "settings were chosen" not in _verdict_text(comparison)


@pytest.mark.parametrize(("short", "percent"), [(97, "97 %"), (40, "")])
def test_relations_that_are_mostly_short_are_named_as_what_they_measure(record, build, short, percent):
    """Of 100 relations a run so many span less than 10 s."""
    metrics = {metric.name: metric for metric in METRICS}
    supports = {"relations_all_mean_m": 100, "relations_short_mean_m": short}

    def run(name, seed):
        made = record(name, "room", dict.fromkeys(supports, 0.1), seed=seed)
        scores = {key: replace(made.scores.by_metric[key], support=count) for key, count in supports.items()}
        return replace(made, scores=replace(made.scores, by_metric=scores))

    runs = [run(name, seed) for name in "ab" for seed in range(3)]
    said = _verdict_text(replace(build(runs), metrics=tuple(metrics[name] for name in supports)))
    words = "of these relations span less than 10 s: they measure local motion, not drift."
    assert (f"{percent} {words}" in said) == bool(percent)
    assert (words in said) == bool(percent)


def test_one_list_of_the_best_maps(record, build):
    """``b`` is tied with ``a`` between the halves of the run and clearly worse in the S2M residual."""
    maps = {"a": (0.10, 0.02, 0.04, 0.03), "c": (0.1004, 0.02, 0.04, 0.03), "b": (0.1002, 0.02, 0.04, 0.06)}
    comparison = _maps(record, build, **maps)
    assert verdict(comparison).leaders == ("a", "c")
    said = "Not clearly worse in any map metric: a and c. Clearly worse in one of them: b (S2M residual)."
    assert said in _verdict_text(comparison)
    assert "lso tied" not in _verdict_text(comparison)


def test_short_relations_decide_where_every_method_lost_the_long_ones(record, build):
    metrics = {metric.name: metric for metric in METRICS}
    names = ("relations_all_mean_m", "relations_short_mean_m", "relations_long_mean_m")

    def compare(long_m):
        table = tuple(metrics[name] for name in names)
        runs = [
            record(who, "room", dict(zip(names, (error + long_m, error, long_m), strict=True)), seed=seed)
            for who, error in (("a", 0.1), ("b", 0.2)) for seed in range(3)
        ]  # fmt: skip
        return analyse_sequence(replace(build(runs), metrics=table), "room").deciding.metric.name

    assert [compare(long_m) for long_m in (0.5, 3.0)] == ["relations_all_mean_m", "relations_short_mean_m"]


@pytest.mark.parametrize(
    ("values", "marks"),
    [
        ({"a": (0.1, 0.11, 0.12), "b": (0.2, 0.22, 0.24), "c": (0.3, 0.33, 0.36)}, ["best", "worse", "worse"]),
        ({"a": (0.1, 0.11, 0.12), "b": (0.1, 0.12, 0.11), "c": (0.3, 0.33, 0.36)}, ["tied", "tied", "worse"]),
        ({"a": (0.1,), "b": (0.2,), "c": (0.3,)}, ["not comparable"] * 3),
        ({"a": (0.1, None, 0.12), "b": (0.2, 0.22, 0.24), "c": (0.3, 0.33, 0.36)}, ["not comparable", "best", "worse"]),
    ],
)
def test_marks_follow_from_runs(record, build, values, marks):
    comparison = build([one for name, own in values.items() for one in _seeds(record, name, own)])
    ranking = analyse_sequence(comparison, "room").deciding
    assert [mark(ranking, name) for name in values] == marks
    assert mark(ranking, "nobody") == "not comparable"


def test_a_method_that_kept_most_guesses_is_named_and_not_ranked(record, build):
    shares = {"a": (0.01, 60.0), "b": (0.02, 12.0), "c": (0.03, 9.0)}
    comparison = build([
        record(who, "room", {"ate_rmse_m": ate, "guess_kept_percent": kept}, seed=seed)
        for who, (ate, kept) in shares.items() for seed in (0, 1)
    ])  # fmt: skip
    said = _verdict_text(comparison)
    assert verdict(comparison, "room").leaders == ("b",)
    assert "Methods that kept the initial guess: a on 60 % of the scans and b on 12 % of the scans." in said
    assert "Not ranked, because of too few registrations: a." in said
    assert "c on" not in said


def test_a_method_is_quoted_on_what_limited_it(record, build):
    runs = [record("a", "room", {"ate_rmse_m": 0.1}, seed=seed) for seed in range(3)]
    noted = [("no room for 7 voxels: raise voxels (256).", "no loop closed"), (), ("no room for 9 voxels",)]
    full = [replace(run, result=replace(run.result, remarks=one)) for run, one in zip(runs, noted, strict=True)]
    said = "Remark of a in 2 of 3 runs, for example: no room for 7 voxels: raise voxels (256); no loop closed."
    assert said in _verdict_text(build([*full, record("b", "room", {"ate_rmse_m": 0.2})]))
    assert "Remark of a: no room for 9 voxels." in _verdict_text(build(full[2:]))
    assert "Remark" not in _verdict_text(build(runs))


def test_damaged_data_are_reported_above_one_percent(record, build):
    def make_noted(notes):
        made = record("a", "room", {"ate_rmse_m": 0.1})
        return _verdict_text(build([replace(made, result=replace(made.result, notes=notes))]))

    assert "damaged" not in make_noted({"scans out of order": 60, "rear-laser lines ignored": 60})
    assert "The data are damaged: 30 damaged lines dropped (50 % of the scans)." in make_noted(
        {"damaged lines dropped": 30}
    )


def test_a_method_that_could_not_start_has_not_failed(demo):
    first = _overview(demo)[0]
    assert first.startswith(
        "16 of 23 runs finished. Did not finish: <script>alert(1)</script> (1 of 3 crashed, 1 of 3 "
    )
    assert first.endswith("Could not start: all runs on intel (data missing) and absent (3 of 3 not installed).")


def test_an_interrupted_run_is_left_out_and_a_failed_one_costs_the_rank(record, build):
    runs = [*_seeds(record, "a", [0.010, 0.011, 0.012]), *_seeds(record, "b", [0.020, 0.022, 0.024, 0.023])]

    def ending(status):
        return build([*runs, record("a", "room", {}, seed=3, status=status, reason="no space left on device")])

    said = _verdict_text(ending("interrupted"))
    assert said.startswith("7 of 8 runs finished. Left out: a (1 of 4 interrupted).")
    assert "a wins on ATE RMSE: 11 mm" in said
    assert "over 3 pairs of runs" in said
    assert "wins" not in _verdict_text(ending("crashed"))
    none = build([*runs[3:], record("a", "room", {}, status="interrupted", reason="no space left on device")])
    assert analyse(none).answer.title == "Only b is ranked: a did not run."


def test_a_method_slower_than_the_sensor_is_named(demo):
    assert "Slower than the sensor on more than 1 % of the scans: <script>alert(1)</script> on room." in _overview(demo)


def test_an_empty_comparison_claims_nothing(build):
    said = _overview(build([]))
    assert said[0] == "There were no runs."
    assert all("No method is clearly worse" not in sentence and "No run took" not in sentence for sentence in said)
    assert all("was run once" not in sentence for sentence in said)


@pytest.mark.parametrize("status", ["complete", "not-installed"])
def test_a_baseline_alone_is_not_compared(record, build, status):
    alone = record("wheel", "room", {"ate_rmse_m": 0.4}, status="complete")
    other = record("a", "room", {}, status="not-installed", reason="no module", answered=0)
    comparison = build([alone] if status == "complete" else [other])
    said = " ".join(_overview(comparison))
    claims = ("No method is clearly worse", "No run took", "Slower", "can be compared with")
    assert not any(claim in said for claim in claims)
    assert "Worse" not in _verdict_text(comparison)


@pytest.mark.parametrize(
    ("value", "best", "words"),
    [(0.5, 0.1, "5.0 times as much"), (0.15, 0.1, "50 % more"), (1.001, 1, "less than 1 % more")],
)
def test_gaps_are_formatted_as_ratios(demo, value, best, words):
    assert format_gap(demo.metrics[0], value, best) == words


def test_a_gap_across_zero_is_formatted_as_a_difference(demo):
    assert format_gap(demo.metrics[0], 0.5, -0.25).replace("\u00a0", " ") == "750 mm more"


def test_lists_are_formatted_as_sentences():
    assert [join_words(words) for words in ("", "a", "ab", "abc")] == ["none", "a", "a and b", "a, b and c"]


def test_times_of_different_processors_give_a_warning(record, build):
    scores = {"ate_rmse_m": 0.01, "cpu_median_ms": 1.0}

    def on_processor(run, processor):
        return replace(run, result=replace(run.result, provenance={"processor": processor}))

    processors = {"a": "X1", "b": "X2", "c": "X1"}
    on = [on_processor(record(name, "room", scores), cpu) for name, cpu in processors.items()]
    said = "Times were measured on different processors and cannot be compared: "
    assert f"{said}a and c on X1 and b on X2." in _verdict_text(build(on))
    assert said not in _verdict_text(build([on_processor(one, "X1") for one in on]))
    untimed = on[1].result.steps.copy()
    untimed["wall_ns"] = 0
    assert said not in _verdict_text(build([on[0], replace(on[1], result=replace(on[1].result, steps=untimed)), on[2]]))


def test_a_leader_needs_a_lead_over_every_method(record, build):
    runs = {"a": [0.010, 0.011, 0.012], "b": [0.0101, 0.0111, 0.0121], "c": [0.5, 0.51, 0.52]}
    comparison = build([one for name, values in runs.items() for one in _seeds(record, name, values)])
    found = verdict(comparison, "room")
    assert (found.outcome, found.leaders) == ("tied", ("a", "b"))  # a lead over c alone is not enough
    assert any("against every other method" in sentence for sentence in _overview(comparison))


def _sentence_cases(record, build):
    """Comparisons by name, each of three runs of a and b, plain but for one thing."""

    def compare(a, b, **others):
        values = {"a": a, "b": b, **others}
        return [one for name, own in values.items() for one in _seeds(record, name, own)]

    def ending(runs, status, reason, answered):
        return [*runs, record("c", "room", {}, status=status, reason=reason, answered=answered)]

    clear = compare([0.010, 0.011, 0.012], [0.020, 0.022, 0.024])
    crash = {"status": "crashed", "reason": "signal 11", "answered": 9}
    lost = [run for name in "ab" for run in (*_seeds(record, name, [0.1]), record(name, "room", {}, seed=1, **crash))]
    costs = [
        record(n, "room", {"ate_rmse_m": 0.01 * (1 + n.encode()[0] + s), "cpu_median_ms": 1.0 + s}, seed=s, ms=ms)
        for n, ms in (("a", 1.0), ("b", 500.0)) for s in range(3)
    ]  # fmt: skip
    degenerate = build(clear)
    cards = {"room": replace(degenerate.sequences["room"], degenerate="A corridor.")}
    return {
        "clear": build(clear),
        "crash": build(ending(clear, "crashed", "signal 11", 9)),
        "absent": build(ending(clear, "not-installed", "no module", 0)),
        "degenerate": replace(degenerate, sequences=cards),
        "empty": build([record(n, "room", {"corners": 4.0}) for n in "ab"]),
        "alone": build(_seeds(record, "a", [0.1, 0.1, 0.1])),
        "none whole": build(lost),
        "chance": build(compare([0.01, 0.02, 0.03], [0.05, 0.02, 0.04])),
        "near": build(compare([1.00, 1.02, 0.99], [1.02, 0.99, 1.03])),
        "wild": build(compare([1.0, 3.0], [1.15, 2.87])),
        "equal": build(compare([0.01, 0.02, 0.03], [0.01, 0.02, 0.03])),
        "reference wins": build(compare([0.2, 0.2, 0.2], [0.3, 0.3, 0.3], paper=[0.1, 0.1, 0.1])),
        "reference loses": build(compare([0.2, 0.2, 0.2], [0.3, 0.3, 0.3], paper=[0.4, 0.4, 0.4])),
        "reference ties": build(compare([0.2, 0.2, 0.2], [0.3, 0.3, 0.3], paper=[0.2, 0.2, 0.2])),
        "reference first": build(compare([0.02, 0.03, 0.04], [0.3, 0.3, 0.3], paper=[0.03, 0.02, 0.02])),
        "reference fails": build([*clear, record("paper", "room", {}, **crash)]),
        "worse than wheel": build(compare([0.2, 0.2, 0.2], [0.5, 0.5, 0.5], wheel=[0.3, 0.3, 0.3])),
        "better than wheel": build(compare([0.1, 0.1, 0.1], [0.2, 0.2, 0.2], wheel=[0.3, 0.3, 0.3])),
        "wheel fails": build([*clear, record("wheel", "room", {}, **crash)]),
        "costs": build(costs),
    }


@pytest.mark.parametrize(
    ("sentence", "where", "not_where"),
    [
        ("Did not finish: c (1 of 1 crashed).", "crash", "clear"),
        ("Could not start: c (1 of 1 not installed).", "absent", "crash"),
        ("Degenerate geometry: A corridor. The order below is not a ranking.", "degenerate", "clear"),
        ("the last of the finished methods, b,", "degenerate", "clear"),
        ("Not counted: room (degenerate geometry).", "degenerate", "clear"),
        ("Not counted: room (no value).", "empty", "clear"),
        ("No headline metric has a value here, so there is no ranking.", "empty", "clear"),
        ("No sequence has both ground truth and repeated runs to compare", "empty", "clear"),
        ("there is no other ranked method to compare with.", "alone", "clear"),
        ("No method is ranked on ATE RMSE, so there is no winner.", "none whole", "clear"),
        ("a wins on ATE RMSE", "clear", "chance"),
        ("a wins 1 (room)", "clear", "chance"),
        ("are tied: ", "near", "chance"),
        ("are not told apart by these runs: ", "chance", "near"),
        ("all ranked methods are tied on 1 sequence (room)", "near", "reference ties"),
        ("the best methods are tied on 1 sequence (room)", "reference ties", "near"),
        ("too few runs show a leader on 1 sequence (room)", "chance", "near"),
        ("which may be chance", "chance", "equal"),
        ("runs of each would settle a difference of this size", "chance", "near"),
        ("these runs can detect a difference of", "near", "wild"),
        ("these runs do not even detect a value twice as large", "wild", "near"),
        ("they are equal to every printed digit", "equal", "chance"),
        ("The reference method: paper wins.", "reference wins", "reference ties"),
        ("The reference method, paper, wins 1 of 1 (room).", "reference wins", "reference ties"),
        ("The reference method: paper loses, with 400 mm against 200 mm", "reference loses", "reference ties"),
        ("The reference method, paper, loses 1 of 1 (room).", "reference loses", "reference ties"),
        ("The reference method: paper is tied with the best, a.", "reference ties", "reference wins"),
        ("The reference method, paper, is tied with the best on 1 of 1 (room).", "reference ties", "reference loses"),
        ("paper has the best value, but not by a clear difference.", "reference first", "reference wins"),
        ("paper is not ranked: 0 of 1 runs finished.", "reference fails", "reference loses"),
        ("paper, is not comparable on 1 of 1 (room).", "reference fails", "reference loses"),
        ("The reference method", "reference loses", "clear"),
        ("Worse than wheel alone (300 mm): b (500 mm).", "worse than wheel", "better than wheel"),
        ("No method is clearly worse than wheel alone", "better than wheel", "worse than wheel"),
        ("No method can be compared with wheel alone", "wheel fails", "better than wheel"),
        ("wheel has no value here, so there is no baseline to beat.", "wheel fails", "better than wheel"),
        ("Wheel odometry alone is not among the methods", "clear", "better than wheel"),
        ("CPU time per scan, median: a (2.00 ms) to b (2.00 ms).", "costs", "clear"),
        ("Slower than the sensor on more than 1 % of the scans: b on room.", "costs", "clear"),
        ("No run took more CPU time than the scan period on more than 1 % of its scans.", "clear", "costs"),
        ("Numbers are medians over up to 3 runs.", "clear", "empty"),
        ("Each sequence was run once", "empty", "clear"),
    ],
)
def test_each_sentence_appears_only_where_it_holds(record, build, sentence, where, not_where):
    cases = _sentence_cases(record, build)
    said = {name: f"{_verdict_text(cases[name])} {' '.join(_overview(cases[name]))}" for name in (where, not_where)}
    assert sentence in said[where]
    assert sentence not in said[not_where]
