"""The answer names a winner, its cost and its losses only where the numbers support it."""

import re
from dataclasses import replace

import numpy as np
import pytest

from evalkit.core.run_result import LostTrack, RunConditions
from evalkit.core.run_status import Cause
from evalkit.metrics import all_metrics
from evalkit.report.analysis.analysis import analyse
from evalkit.report.formatting import format_amount, format_milliseconds
from evalkit.report.html.cost_plot import draw_scatter
from evalkit.report.html.dot_plot import draw_dots
from evalkit.report.html.method_colours import assign_strokes
from evalkit.report.html.report_page import render_report
from evalkit.stats.runs import paired_runs


@pytest.fixture
def runs(record):
    """Return ``runs(method, sequence, errors, ...)``: one run a seed, with errors of that size."""

    def make(method, sequence, errors, metric="ate_rmse_m", ms=1.0, **more):
        scores = [{metric: error, "cpu_median_ms": ms} for error in errors]
        return [record(method, sequence, one, seed=seed, error_m=0.02, **more) for seed, one in enumerate(scores)]

    return make


def answer(comparison):
    return analyse(comparison).answer


def title(comparison):
    return answer(comparison).title


def subtitle(comparison):
    return answer(comparison).subtitle.replace("\u00a0", " ")


def pills(comparison):
    return [pill.text for pill in answer(comparison).pills]


@pytest.fixture
def three(runs):
    """``a`` leads on room and hall, ``b`` on lab; ``b`` is eight times cheaper; ``c`` is ten times worse."""
    errors = {"a": (0.01, 0.02, 0.01), "b": (0.02, 0.01, 0.02), "c": (0.1, 0.1, 0.1)}
    return [
        run
        for method, own in errors.items()
        for sequence, error in zip(("room", "lab", "hall"), own, strict=True)
        for run in runs(method, sequence, (error, 1.1 * error), ms={"a": 8.0, "b": 1.0, "c": 2.0}[method])
    ]


def test_an_answer_without_a_recording_that_counts_says_so(build, three):
    def told(runs, *simulated, tuned_on=()):
        made = build(runs)
        cards = {label: replace(card, simulated=label in simulated) for label, card in made.sequences.items()}
        methods = {**made.methods, "a": replace(made.methods["a"], tuned_on=tuned_on)}
        return [text for text in pills(replace(made, sequences=cards, methods=methods)) if "simulated" in text]

    assert told(three, "room", "lab", "hall") == ["only simulated data count"]
    assert told(three, "room", "lab") == []
    assert told(three, "room", "hall", tuned_on=("lab",)) == ["only simulated data count for a"]  # it wins there
    assert told(three, "room", "lab", tuned_on=("lab",)) == []
    single = [run for run in three if run.sequence != "hall" or run.method == "a"]
    assert told(single, "room", "lab") == ["only simulated data count"]  # one method alone is no comparison
    assert told([run for run in three if run.method == "a"], "room", "lab", "hall") == []  # nothing counts


def test_the_winner_is_named_with_its_counts_cost_losses_and_the_cheapest(build, three):
    found = answer(build(three))
    assert found.title == "Take a: best or tied on 2 of 3 data sets; next best: b, 1 of 3."
    assert (found.winners, found.emphasis, found.standings[1].method) == (("a",), "a", "b")
    assert subtitle(build(three)) == (
        "8.0 ms a scan here. It loses only lab (21 mm against 10 mm). Cheapest matcher: b, 1.0 ms, 1.3 times the error."
    )
    (loss,) = found.losses
    assert (loss.sequence, loss.own, loss.best) == ("lab", pytest.approx(0.021), pytest.approx(0.0105))
    assert [(one.method, one.led, one.counted) for one in found.standings] == [("a", 2, 3), ("b", 1, 3), ("c", 0, 3)]
    assert found.common == "a"  # all ran everywhere, and it leads most often
    assert [one.relative.error for one in found.standings] == pytest.approx([1.0, 2 ** (1 / 3), 500 ** (1 / 3)])
    assert [one.relative.cpu for one in found.standings] == pytest.approx([1.0, 1 / 8, 1 / 4])


def test_a_tie_counts_for_both(build, runs):
    both = [*runs("a", "room", (0.010, 0.011)), *runs("b", "room", (0.0105, 0.0112))]
    comparison = build(
        [*both, *runs("c", "room", (0.5, 0.5)), *runs("a", "lab", (0.5, 0.5)), *runs("b", "lab", (1, 1))]
    )
    found = answer(comparison)
    assert {one.method: one.led for one in found.standings} == {"a": 2, "b": 1, "c": 0}
    assert found.title == "Take a: best or tied on 2 of 2 data sets; next best: b, 1 of 2."
    assert "loses" not in found.subtitle
    assert "cheapest" not in found.subtitle.lower()  # all cost the same


def test_tied_winners_are_all_named_and_the_cheapest_of_them(build, runs):
    one = [*runs("a", "room", (0.010, 0.011), ms=4.0), *runs("b", "room", (0.0105, 0.0112)), *runs("c", "room", (1, 1))]
    comparison = build(one)
    assert title(comparison) == "Take a or b: tied for the best on room."
    assert subtitle(comparison) == "A scan takes 4.0 ms with a and 1.0 ms with b. Cheapest of them: b."


def test_the_cost_is_that_on_the_data_sets_that_count(build, runs):
    """A single run elsewhere, which gives no verdict, takes a hundred times as long."""
    counted = [*runs("a", "room", (0.010, 0.011), ms=4.0), *runs("b", "room", (0.5, 0.55), ms=2.0)]
    elsewhere = [*runs("a", "hall", (0.1,), ms=400.0), *runs("b", "hall", (0.1,), ms=200.0)]
    assert subtitle(build([*counted, *elsewhere])).startswith("4.0 ms a scan here.")


def test_nobody_is_ahead_if_all_are_tied(build, runs):
    comparison = build([*runs("a", "room", (0.01, 0.011)), *runs("b", "room", (0.01, 0.011))])
    found = answer(comparison)
    assert found.title == "No method is ahead: all 2 methods are tied on room."
    assert (found.winners, found.subtitle, found.cheapest) == ((), "", None)


def test_nobody_is_ahead_if_more_than_three_lead_equally_often(build, runs):
    tied = [run for method in "abcd" for run in runs(method, "room", (0.010, 0.011))]
    assert title(build([*tied, *runs("z", "room", (1, 1))])) == ("No method is ahead: 4 methods are each tied on room.")


def test_one_method_alone_wins_nothing(build, record, runs):
    comparison = build([*runs("a", "room", (0.01, 0.02)), *runs("b", "room", (0.5, None))])
    assert title(comparison) == "Only a is ranked: b did not complete every run with a value."
    gone = {"status": "data-missing", "reason": "no odometry", "answered": 0}
    absent = [record("wheel", "room", {}, seed=seed, **gone) for seed in range(2)]
    lost = [
        replace(run, scores=replace(run.scores, lost=LostTrack(9.0, "a jump")))
        for run in runs("a", "hall", (0.01, 0.02))
    ]  # a ranked method is not among those that are not
    found = build([*runs("a", "room", (0.01, 0.02)), *absent, *lost])
    assert title(found) == "Only a is ranked: wheel did not run."
    assert answer(comparison).winners == ()


@pytest.mark.parametrize("how", ["crashed", "lost", "interrupted", "tuned"])
def test_the_one_method_that_holds_where_others_fail_leads_there(build, three, how):
    """On hall, one of two runs of ``b`` and of ``c`` fails, or the machine ends both, and only ``a`` is ranked."""
    ends = {(name, "hall", seed) for name in "bc" for seed in ((0, 1) if how == "interrupted" else (1,))}
    causes = {"crashed": Cause.EXIT_CODE, "interrupted": Cause.MACHINE_FAULT}
    failed = [
        replace(run, scores=replace(run.scores, lost=LostTrack(9.0, "a jump"))) if how == "lost"
        else replace(run, result=replace(run.result, cause=causes[how], reason="it ended"))
        if how in causes else run
        for run in three if (run.method, run.sequence, run.seed) in ends
    ]  # fmt: skip
    kept = [run for run in three if (run.method, run.sequence, run.seed) not in ends]
    comparison = build([*kept, *failed])
    if how == "tuned":
        chosen = {name: replace(card, tuned_on=("hall",)) for name, card in comparison.methods.items() if name != "a"}
        comparison = replace(comparison, methods={**comparison.methods, **chosen})
    found = analyse(comparison)
    counts = how in ("crashed", "lost")
    assert [one.sequence for one in found.answer.contests] == ["room", "lab", *["hall"] * counts]
    assert {one.method: one.led for one in found.answer.standings} == {"a": 1 + counts, "b": 1, "c": 0}
    assert ("one method alone is ranked on 1 sequence (hall)" in found.overview[1]) == counts
    assert ("Not counted: hall (one ranked method)." in found.overview) == (not counts)
    assert ("the only one ranked" in str(draw_dots(found, assign_strokes("abc", ())))) == counts
    alone = replace(comparison, records=tuple(run for run in comparison.records if run.sequence == "hall"))
    assert title(alone).startswith("Only a is ranked: ")


def test_the_dot_of_a_lost_track_is_a_cross_also_where_settings_were_chosen(build, three):
    gone = [
        replace(run, scores=replace(run.scores, lost=LostTrack(9.0, "a jump")))
        if (run.method, run.sequence, run.seed) == ("b", "hall", 0) else run for run in three
    ]  # fmt: skip
    for runs, words, shape in (
        (three, "settings chosen here: not counted", "tuned"),
        (gone, "lost the track in 1 of 2, at 9 s; settings chosen here: not counted", "lost"),
    ):
        made = build(runs)
        tuned = replace(made, methods={**made.methods, "b": replace(made.methods["b"], tuned_on=("hall",))})
        drawn = str(draw_dots(analyse(tuned), assign_strokes("abc", ()))).replace("\u00a0", " ")
        (dot,) = re.findall(r"<title>b on hall: [^<]*</title>.*?</svg></svg>", drawn)
        assert f", {words}</title>" in dot
        assert f'class="dot {shape}"' in dot


def test_without_a_finished_run_there_is_no_answer(build, record):
    failed = [record(name, "room", {}, status="failed", reason="it broke", answered=0) for name in "ab"]
    comparison = build(failed)
    assert title(comparison) == "No run finished: there is no answer."
    assert pills(comparison) == ["a did not finish room (failed)", "b did not finish room (failed)", "0 of 2 runs"]


def test_single_runs_give_no_verdict(build, record):
    runs = [record(name, "room", {"map_f1": value}, seed=None) for name, value in (("a", 0.9), ("b", 0.2))]
    expected = "No method is ahead: each ran once, and a verdict takes 5 more runs, slightly perturbed (nuisance = 5)."
    assert title(build(runs)) == expected
    with_interval = [record(n, "room", {"ate_rmse_m": v}, seed=3) for n, v in (("a", 0.051), ("b", 0.080))]
    assert title(build(with_interval)) == "No method is ahead: a verdict takes repeated runs."


def test_a_leader_that_is_not_told_apart_is_not_called_the_best(build, runs):
    """b has twice the error of a in three runs that scatter as much; c is clearly worse."""
    first, second = runs("a", "room", (0.010, 0.010, 0.010)), runs("b", "room", (0.011, 0.020, 0.040))
    comparison = build([*first, *second, *runs("c", "room", (1.0, 1.0, 1.0))])
    assert title(comparison) == "a leads on room, but is not told apart from b by these runs."
    assert answer(comparison).winners == ("a",)


def test_several_leaders_that_are_not_told_apart_are_joined_by_and(build, runs):
    """a and b are tied; three runs do not show that c is worse. Only a recommendation says "a or b"."""
    errors = {"a": (0.0100,) * 3, "b": (0.0101,) * 3, "c": (0.011, 0.020, 0.040), "d": (1.0,) * 3}
    comparison = build([run for one in errors for run in runs(one, "room", errors[one])])
    assert title(comparison) == "a and b lead on room, but are not told apart from c by these runs."


def test_a_data_set_on_which_no_run_finished_is_not_counted_for_this_reason(build, record, three):
    failed = [record(who, "yard", {}, status="failed", reason="ValueError: x", answered=0) for who in "ab"]
    assert "Not counted: yard (no run finished)." in analyse(build([*three, *failed])).overview


def test_methods_that_too_few_runs_tell_from_the_leader_are_named_over_several_data_sets(build, runs):
    """a is the best on room and hall, but two runs do not show that b is worse; on cave they tell no method apart."""
    errors = {"a": (0.010, 0.0101), "b": (0.011, 0.040), "c": (1.0, 1.1)}
    places = {"room": "abc", "hall": "abc", "cave": "ab"}
    comparison = build([run for where, own in places.items() for one in own for run in runs(one, where, errors[one])])
    found = analyse(comparison)
    assert found.answer.title == "a leads on 2 of 2 data sets, but is not told apart from b by these runs."
    assert (found.answer.winners, found.answer.undecided, found.answer.emphasis) == (("a",), ("b",), "a")
    assert "not counted: cave (not told apart)" in pills(comparison)
    assert "Not counted: cave (not told apart)." in found.overview
    clear = {"a": (0.01, 0.01), "b": (0.02, 0.02), "c": (0.03, 0.03)}
    more = [run for where in ("yard", "attic") for one in "abc" for run in runs(one, where, clear[one])]
    words = "Take a: best or tied on 4 of 4 data sets; no other method on any."  # however room and hall end
    assert title(build([*comparison.records, *more])) == words


@pytest.mark.parametrize(("scatter", "p"), [(0.339, 0.0215), (0.25, 0.0066)])
def test_a_lead_on_one_of_five_data_sets_must_be_one_among_five_tests(build, runs, scatter, p):
    """On room b has 1.65 times the error of a, more or less in six runs; on the others both are tied."""
    signs = np.array([1.0, -1.0, 1.0, -1.0, 1.0, -1.0])
    room = [*runs("a", "room", [0.01] * 6), *runs("b", "room", 0.01 * np.exp(0.5 + scatter * signs))]
    places = ("hall", "lab", "cave", "yard")
    others = [run for where in places for one, way in (("a", 0.03), ("b", -0.03))
              for run in runs(one, where, 0.01 * np.exp(way * signs))]  # fmt: skip
    assert paired_runs([0.01] * 6, 0.01 * np.exp(0.5 + scatter * signs)).p == pytest.approx(p, abs=1e-4)
    assert title(build(room)) == "Take a: best on room."  # at 97 %, as every verdict
    best, apart = "Take a: best on room.", "a leads on room, but is not told apart from b by these runs."
    assert title(build([*room, *others])) == (best if p < 0.05 / 5 else apart)


def test_each_of_several_winners_has_its_own_number_of_data_sets(build, runs):
    """a and b are tied on room and lab; on hall, where settings of a were chosen, c is better than b."""
    errors = {"room": (0.01, 0.0102, 0.1), "lab": (0.01, 0.0102, 0.1), "hall": (0.01, 0.02, 0.01)}
    made = build([
        run for where, own in errors.items() for name, error in zip("abc", own, strict=True)
        for run in runs(name, where, (error, 1.1 * error))
    ])  # fmt: skip
    found = replace(made, methods={**made.methods, "a": replace(made.methods["a"], tuned_on=("hall",))})
    assert title(found) == (
        "Take a or b: each best or tied on 2 of 2 and 2 of 3 data sets that count for them; next best: c, 1 of all 3."
    )
    assert subtitle(found).startswith("Settings of a were chosen on hall. A scan takes ")


def test_a_method_is_not_recommended_that_leads_less_often_where_another_one_counts_too(build, runs):
    """Not all ran everywhere: ``d`` did, and is the worst."""

    def compare(errors):
        return build([
            run for where, own in errors.items() for name, error in {**own, "d": 0.1}.items()
            for run in runs(name, where, (error, 1.1 * error))
        ])  # fmt: skip

    alone = {"lab": {"a": 0.01}, "hall": {"b": 0.01}}
    either = {"room": {"a": 0.01, "b": 0.02}, "attic": {"a": 0.02, "b": 0.01}}
    found = compare({**alone, **either, "yard": {"a": 0.02, "b": 0.02, "c": 0.01}})
    assert title(found) == (
        "No method is ahead: a is best or tied on 2 of 4 data sets that count for it, but c leads more often where "
        "both count."
    )
    assert subtitle(found) == "a did not run on hall. Only yard counts for all methods: c is best there."
    assert (answer(found).winners, answer(found).rivals, answer(found).emphasis) == (("a",), ("c",), "")
    found = compare({**alone, "room": {"a": 0.01, "b": 0.02}, "yard": {"a": 0.01, "b": 0.01}, "cave": {"b": 0.01}})
    assert title(found) == (
        "Take a: best or tied on 3 of 3 data sets that count for it; b leads as often, but another one leads more "
        "often where both count."
    )


def test_methods_that_lead_as_often_on_other_numbers_of_data_sets_have_no_common_one(build, runs):
    """Settings of a were chosen on hall, where z is the best; on room all others are better than z."""
    room = [run for method in "abcd" for run in runs(method, "room", (0.010, 0.011))]
    hall = [run for method in "abcd" for run in runs(method, "hall", (1.0, 1.1))]
    made = build([*room, *hall, *runs("z", "room", (1.0, 1.1)), *runs("z", "hall", (0.010, 0.011))])
    assert title(made) == "No method is ahead: all 5 methods are best or tied on 1 of 2 data sets."
    tuned = replace(made, methods={**made.methods, "a": replace(made.methods["a"], tuned_on=("hall",))})
    assert title(tuned) == "No method is ahead: all 5 methods are best or tied on 1 data set."


def test_of_many_that_lead_as_often_the_one_that_no_paired_test_beats_is_named(build, runs):
    """By 1 mm: all four are tied on both data sets, and a is better in 16 of 16 runs."""
    errors = {"a": 0.005, "b": 0.006, "c": 0.006, "d": 0.006, "z": 0.03}
    found = answer(build([
        run for where in ("room", "lab") for name, error in errors.items()
        for run in runs(name, where, [error * (1.0 + 0.01 * seed) for seed in range(8)])
    ]))  # fmt: skip
    assert {one.method: one.led for one in found.standings} == {"a": 2, "b": 2, "c": 2, "d": 2, "z": 0}
    assert found.title == (
        "Take a: best or tied on 2 of 2 data sets; 3 methods lead as often, but the paired tests find better methods."
    )


@pytest.mark.parametrize(("error_m", "named"), [(0.02, True), (0.015, False)])
def test_no_next_best_is_named_that_a_paired_test_calls_worse_than_another(build, runs, error_m, named):
    """Settings of ``a`` were chosen on hall; ``b`` leads there, where ``c`` did not run, and ``a`` on the others."""
    errors = {"a": 0.01, "b": 0.02, "c": error_m, "d": 0.1}
    made = build([
        run for where, own in {"room": "abcd", "lab": "abcd", "yard": "abcd", "hall": "abd"}.items() for name in own
        for run in runs(name, where, [errors[name] * (1.0 + 0.01 * seed) for seed in range(8)])
    ])  # fmt: skip
    tuned = replace(made, methods={**made.methods, "a": replace(made.methods["a"], tuned_on=("hall",))})
    best = "Take a: best or tied on 3 of 3 data sets that count for it"
    assert title(tuned) == (f"{best}; next best: b, 1 of all 4." if named else f"{best}.")


def test_an_undecided_data_set_does_not_count(build, record, three):
    undecided = [record(name, "cave", {"map_f1": value}, seed=None) for name, value in (("a", 0.9), ("b", 0.2))]
    comparison = build([*three, *undecided])
    assert title(comparison) == "Take a: best or tied on 2 of 3 data sets; next best: b, 1 of 3."
    assert "not counted: cave" in pills(comparison)
    assert "not counted: " not in " ".join(pills(build(three)))


def test_a_data_set_on_which_settings_were_chosen_does_not_count_for_that_method(build, three):
    comparison = build(three)
    tuned = {**comparison.methods, "a": replace(comparison.methods["a"], tuned_on=("room", "hall"))}
    found = answer(replace(comparison, methods=tuned))
    assert {one.method: (one.led, one.counted) for one in found.standings} == {"a": (0, 1), "b": (3, 3), "c": (0, 3)}
    assert found.title == "Take b: best or tied on 3 of 3 data sets; no other method on any."
    assert found.standing("a").left_out == ("room", "hall")
    assert [one.left_out for one in found.contests] == [("a",), (), ("a",)]
    assert "settings of a chosen on room and hall: not counted there" in [pill.text for pill in found.pills]
    assert "chosen" not in " ".join(pills(comparison))
    two = {**tuned, "a": replace(tuned["a"], tuned_on=("room",)), "c": replace(tuned["c"], tuned_on=("hall",))}
    assert title(replace(comparison, methods=two)) == (
        "Take b: best or tied on 2 of 3 data sets; next best: a, 1 of 2 that count for it."
    )
    assert subtitle(replace(comparison, methods=two)).startswith(
        "Settings of a were chosen on room. Where both count: 1 of 2 against 1 of 2. 1.0 ms"
    )
    cheap = {**comparison.methods, "b": replace(comparison.methods["b"], tuned_on=("hall",))}
    told = subtitle(replace(comparison, methods=cheap))  # on room twice and on lab half the error of a
    assert re.search(r"Cheapest matcher: b, 0\.1[23] times the time, 1\.0 times the error on 2 of 3\.$", told)
    chosen = {"a": ("room",), "b": ("hall",), "c": ("room", "hall")}
    many = {name: replace(card, tuned_on=chosen[name]) for name, card in comparison.methods.items()}
    told = [text for text in pills(replace(comparison, methods=many)) if "chosen" in text]
    assert told == ["settings of 3 methods chosen on data shown here: not counted there"]


def test_the_title_says_that_fewer_data_sets_count_for_the_winner_and_why(build, runs, three, record):
    """``a`` leads on room, yard and attic; its settings were chosen on hall, and it did not run on lab: ``b`` leads."""
    absent = {"status": "data-missing", "reason": "no odometry", "answered": 0}
    gone = [record("a", "lab", {}, seed=seed, **absent) for seed in range(2)]
    more = [
        run for where in ("yard", "attic") for name, error in (("a", 0.01), ("b", 0.02), ("c", 0.1))
        for run in runs(name, where, (error, 1.1 * error))
    ]  # fmt: skip
    comparison = build([*(run for run in three if (run.method, run.sequence) != ("a", "lab")), *gone, *more])
    cards = {**comparison.methods, "a": replace(comparison.methods["a"], tuned_on=("hall",))}
    comparison = replace(comparison, methods=cards)
    assert title(comparison) == (
        "Take a: best or tied on 3 of 3 data sets that count for it; next best: b, 2 of all 5."
    )
    assert subtitle(comparison).startswith(
        "Its settings were chosen on hall. It did not run on lab. Where both count: 3 of 3 against 0 of 3. "
    )


def test_degenerate_data_do_not_count_and_are_compared_with_the_baseline(build, runs, three):
    wheels, lost = runs("wheel", "corridor", (0.1, 0.1)), runs("a", "corridor", (0.5, 0.5))
    won = runs("a", "corridor", (0.01, 0.01))

    def degenerate(records):
        made = build([*three, *records])
        card = replace(made.sequences["corridor"], degenerate="no walls ahead")
        return replace(made, sequences={**made.sequences, "corridor": card})

    assert title(degenerate([*wheels, *lost])).startswith("Take a: best or tied on 2 of 3 data sets")
    assert pills(degenerate([*wheels, *lost]))[0] == "corridor is degenerate: no method beats wheel"
    assert pills(degenerate([*wheels, *won]))[0] == "corridor is degenerate: not counted"
    tuned = degenerate([*wheels, *won])
    cards = {**tuned.methods, "a": replace(tuned.methods["a"], tuned_on=("corridor",))}
    assert pills(replace(tuned, methods=cards))[0] == "corridor is degenerate: not counted"
    assert pills(degenerate([*wheels[:1], *won[:1]]))[0] == "corridor is degenerate: not counted"


def test_a_lost_track_is_named_except_where_the_geometry_explains_it(build, three):
    def lost_on(sequence, found_s=None):
        records = [
            replace(run, scores=replace(run.scores, lost=LostTrack(28.4, "it slipped", found_s)))
            if (run.method, run.sequence) == ("c", sequence)
            else run
            for run in three
        ]
        made = build(records)
        return pills(
            replace(made, sequences={**made.sequences, "hall": replace(made.sequences["hall"], degenerate="x")})
        )

    assert "c lost the track on lab (in 2 of 2, first at 28 s)" in lost_on("lab")
    assert "c lost the track on lab (in 2 of 2, first at 28 s, 2 found again)" in lost_on("lab", 40.2)
    assert not any("lost" in text for text in lost_on("hall"))


def test_the_number_of_methods_that_lost_the_track_says_where_losses_are_not_counted(build, three):
    def lost_on(*sequences):
        lost = LostTrack(28.4, "it slipped")
        made = build([
            replace(run, scores=replace(run.scores, lost=lost)) if run.sequence in sequences else run for run in three
        ])  # fmt: skip
        return pills(
            replace(made, sequences={**made.sequences, "hall": replace(made.sequences["hall"], degenerate="x")})
        )

    assert "3 methods lost the track on a sequence: a, b, c" in lost_on("lab")
    assert "3 methods lost the track outside hall: a, b, c" in lost_on("lab", "hall")


def test_only_degenerate_data_rank_nobody(build, runs):
    made = build([*runs("a", "hall", (0.1, 0.1)), *runs("b", "hall", (0.5, 0.5))])
    made = replace(made, sequences={"hall": replace(made.sequences["hall"], degenerate="no walls")})
    assert title(made) == "No method is ranked: the geometry of hall does not determine the pose."
    both = build([*made.records, *runs("a", "room", (0.1, 0.1)), *runs("b", "room", (0.5, 0.5))])
    both = replace(both, sequences={**both.sequences, **made.sequences})
    chosen = {name: replace(card, tuned_on=("room",)) for name, card in both.methods.items()}
    assert title(replace(both, methods=chosen)) == (
        "No method is ranked: settings of a and b were chosen on these data; the geometry of hall does not determine "
        "the pose."
    )
    one = {**both.methods, "b": chosen["b"]}
    assert title(replace(both, methods=one)) == "Only a is ranked: settings of b were chosen on these data."


def test_data_on_which_all_are_tied_do_not_count(build, three, runs):
    """A flat data set gives every method a point: it tells none apart."""
    tied = [run for method in "abc" for run in runs(method, "flat", (0.1, 0.11))]
    flat = build([*three, *tied])
    assert title(flat) == title(build(three))
    assert {one.method: (one.led, one.counted) for one in answer(flat).standings} == {
        "a": (2, 3), "b": (1, 3), "c": (0, 3),
    }  # fmt: skip
    assert "not counted: flat (all tied)" in pills(flat)
    assert "Not counted: flat (all tied)." in analyse(flat).overview
    often = [
        *tied,
        *(
            replace(run, scores=replace(run.scores, lost=LostTrack(28.4, "it slipped")))
            for run in runs("d", "flat", (9.0, 9.0))
        ),
    ]
    assert {one.method: (one.led, one.counted) for one in answer(build([*three, *often])).standings} == {
        "a": (3, 4), "b": (2, 4), "c": (1, 4), "d": (0, 1),
    }  # fmt: skip
    alone = answer(build([*tied, *(run for method in "abc" for run in runs(method, "level", (0.2, 0.21)))]))
    assert alone.title == "No method is ahead: all 3 methods are best or tied on 2 of 2 data sets."
    assert {(one.led, one.counted) for one in alone.standings} == {(2, 2)}


def test_no_method_that_leads_is_named_as_its_own_rival(build, runs):
    """a beats b, and c beats both, over the runs that two of them have; all three lead wherever they ran."""
    wobble = (1.0, 1.01, 0.99, 1.02, 0.98, 1.005, 0.995, 1.0)
    alike = {"a": 0.01, "b": 0.0115, "d": 0.03}
    errors = {"room": {"a": 0.006, "b": 0.0068, "c": 0.005, "d": 0.03}, "lab": alike, "yard": alike}
    records = [
        run for sequence, values in errors.items() for method, error in values.items()
        for run in runs(method, sequence, tuple(error * one for one in wobble))
    ]  # fmt: skip
    made = answer(build(records))
    assert {one.method: one.led for one in made.standings} == {"a": 3, "b": 3, "c": 1, "d": 0}
    assert (made.winners, made.rivals) == (("a",), ("c",))
    assert made.title == (
        "No method is ahead: a is best or tied on 3 of 3 data sets, but c has smaller errors in paired tests."
    )


def test_a_data_set_where_a_method_had_no_input_does_not_count_for_it(build, record, three):
    absent = {"status": "data-missing", "reason": "no odometry", "answered": 0}
    kept = [run for run in three if (run.method, run.sequence) != ("b", "lab")]
    none = [record("b", "lab", {}, seed=seed, **absent) for seed in range(2)]
    failed = [record("b", "lab", {}, seed=seed, status="failed", reason="it broke") for seed in range(2)]
    assert (answer(build([*kept, *none])).standing("b").led, answer(build([*kept, *none])).standing("b").counted) == (
        0,
        2,
    )
    assert answer(build([*kept, *failed])).standing("b").counted == 3


def test_a_method_is_not_recommended_where_the_paired_tests_find_another_one_better(build, runs):
    """``a`` is best on lab and yard, where ``b`` did not run; on room ``b`` is better in 8 of 8 runs, by 1 mm."""

    def compare(error_m, count):
        errors = {"lab": {"a": 0.01, "c": 0.02}, "yard": {"a": 0.01, "c": 0.02},
                  "room": {"a": 0.006, "b": error_m, "c": 0.03}}  # fmt: skip
        return [
            run for sequence, own in errors.items() for method, error in own.items()
            for run in runs(method, sequence, [error * (1.0 + 0.01 * seed) for seed in range(count)])
        ]  # fmt: skip

    found = analyse(build(compare(0.005, 8)))
    assert found.answer.title == (
        "No method is ahead: a is best or tied on 3 of 3 data sets, but b has smaller errors in paired tests."
    )
    (test,) = [one for one in found.significance.comparisons if {one.method, one.reference} == {"a", "b"}]
    assert (test.reference, test.runs, test.verdict) == ("a", 8, "better")
    assert (found.answer.winners, found.answer.rivals, found.answer.emphasis) == (("a",), ("b",), "")
    plots = (draw_dots, draw_scatter)
    assert not any("series led" in str(draw(found, assign_strokes("abc", ()))) for draw in plots)  # none in its colour
    taken = analyse(build(compare(0.005, 5)))
    assert all("series led" in str(draw(taken, assign_strokes("abc", ()))) for draw in plots)
    words = "Take a: best or tied on 3 of 3 data sets; next best: b, 1 of 1 that counts for it."
    assert title(build(compare(0.005, 5))) == words  # the test needs six runs
    assert title(build(compare(0.0059, 8))) == words  # less than 5 %
    assert not answer(build(compare(0.005, 5))).rivals
    lost = [
        replace(run, scores=replace(run.scores, lost=LostTrack(9.0, "a jump"))) if run.seed < 2 else run
        for run in runs("a", "hall", (0.1, 0.11, 0.12))
    ]
    assert subtitle(build([*compare(0.005, 8), *lost])) == (
        "Only room counts for all methods: b and a are best or tied there. a lost the track on hall (2 of 3 runs)."
    )
    assert "It lost the track on hall (2 of 3 runs)." in subtitle(build([*compare(0.005, 5), *lost]))


def test_errors_and_times_are_divided_by_those_of_one_method_on_the_same_data(build, runs):
    """``c`` ran on the easy data set alone, with twice the error and twice the time of ``a`` there."""
    errors = {"room": {"a": 0.01, "b": 0.03, "c": 0.02}, "hall": {"a": 0.1, "b": 0.3}, "lab": {"a": 0.1, "b": 0.3}}
    made = [
        run for sequence, own in errors.items() for method, error in own.items()
        for run in runs(method, sequence, (error, 1.1 * error), ms=100.0 * error)
    ]  # fmt: skip
    found = answer(build(made))
    relative = found.standing("c").relative
    assert (found.common, relative.shared) == ("a", 1)
    assert (relative.error, relative.cpu) == pytest.approx((2.0, 2.0))
    assert found.standing("b").relative.error == pytest.approx(3.0)
    gone = [
        replace(run, scores=replace(run.scores, lost=LostTrack(9.0, "a jump")))
        if (run.method, run.sequence) == ("c", "room") else run
        for run in made
    ]  # fmt: skip
    assert answer(build(gone)).standing("c").relative == relative  # the error of a lost run is an error


MAPS = ("split_distance_m", "mom_cm2", "cleared_percent", "s2m_m")


def test_maps_decide_only_without_ground_truth_and_only_if_they_agree(build, record, three):
    def draw(method, values, **more):
        scores = dict(zip(MAPS, values, strict=True))
        return [record(method, "bag", scores, seed=seed, truth=False, **more) for seed in (0, 1)]

    agreed = [*draw("a", (0.1, 1.0, 1.0, 0.01)), *draw("b", (0.2, 2.0, 2.0, 0.02))]
    found = answer(build(agreed))
    assert found.title == "Take a: the best map of bag, which has no ground truth."
    assert found.by_maps
    assert "times the error" not in found.subtitle
    opposed = [*draw("a", (0.1, 1.0, 2.0, 0.02)), *draw("b", (0.2, 2.0, 1.0, 0.01))]
    assert title(build(opposed)) == "No method is ahead: without ground truth, the map metrics disagree."
    assert not answer(build([*three, *agreed])).by_maps
    assert "not counted: bag" in pills(build([*three, *agreed]))


@pytest.fixture
def in_map(record):
    """Return ``in_map(method, percent, split_m)``: runs in a known map without truth, that also have drawn maps."""

    def make(method, percent, split_m, seeds=4):
        maps = dict.fromkeys(MAPS, split_m)
        return [
            record(method, "bag", {**maps, "map_wrong_percent": percent + 0.1 * seed}, seed=seed, truth=False)
            for seed in range(seeds)
        ]  # fmt: skip

    return make


def test_the_fit_to_a_known_map_decides_without_truth_and_not_the_maps_drawn(build, in_map, three):
    """The method that leaves the known map, half of its positions wrong, draws the more consistent one."""
    runs = [*in_map("a", 2.0, 0.2), *in_map("slam", 50.0, 0.1)]

    def measured(records):
        by_fit = next(metric for metric in all_metrics() if metric.name == "map_wrong_percent")
        return replace(build(records), metrics=(*build(records).metrics, by_fit))

    found = answer(measured(runs))
    assert found.title == "Take a: best on bag by the fit to the known map."
    assert (found.winners, found.by_maps) == (("a",), False)
    assert subtitle(measured(runs)).startswith("Wrong by map fit: 2.2 % against 50.2 % of slam.")
    close = [*in_map("a", 2.0, 0.2), *in_map("slam", 2.9, 0.1)]  # less than a percentage point: not measured better
    assert title(measured(close)) == "No method is ahead: all 2 methods are tied on bag by the fit to the known map."
    assert title(measured([*three, *runs])) == title(build(three))  # data with ground truth count more


def test_maps_that_few_runs_do_not_tell_apart_are_not_tied(build, record):
    """The maps of ``b`` are 1.1 to 60 times as bad as those of ``a``: two runs do not show a difference."""
    measured = {"a": (0.03, 0.03), "b": (0.033, 1.9)}
    runs = [
        record(method, "bag", dict.fromkeys(MAPS, value), seed=seed, truth=False)
        for method, values in measured.items() for seed, value in enumerate(values)
    ]  # fmt: skip
    assert title(build(runs)) == "No method is ahead: too few runs to tell the methods apart."


def test_a_busy_machine_is_named_and_an_idle_one_is_not(build, three):
    def under(*conditions):
        known = (*conditions, *[RunConditions(load=15.2)] * (len(three) - len(conditions)))
        return pills(build([
            replace(run, result=replace(run.result, conditions=own)) for run, own in zip(three, known, strict=True)
        ]))  # fmt: skip

    low = RunConditions(load=0.26, other_percent=7.04)
    once = "busy machine: 1 of 18 runs disturbed, 1 by other programs: 7.0 % of the core"
    assert once in under(low)
    most = "busy machine: 3 of 18 runs disturbed, 2 by waiting: up to 40 % of the time"
    others = RunConditions(steal_percent=2.4, waited_percent=40.0), RunConditions(waited_percent=6.0)
    assert most in under(low, *others)
    equal = "busy machine: 2 of 18 runs disturbed, 1 by other programs: 7.0 % of the core"
    assert equal in under(low, others[0])
    absent = replace(three[0].result, cause=Cause.DATA_MISSING, reason="fetch it", conditions=low)
    runs = [replace(three[0], result=replace(three[0].result, conditions=low)), replace(three[1], result=absent)]
    assert "busy machine: 1 of 1 runs disturbed, 1 by other programs: 7.0 % of the core" in pills(build(runs))
    threads = RunConditions(waited_percent=40.0, busy_threads=2)  # its threads wait for each other
    calm = [*under(RunConditions(other_percent=0.5)), *under(threads), *pills(build(three))]
    assert not any("busy" in text for text in calm)


def test_what_is_missing_is_one_pill(build, record, three):
    absent = [record("z", "lab", {}, status="not-installed", reason="no module", answered=0)]
    gone = [record("a", "cave", {}, seed=None, status="data-missing", reason="no folder", answered=0)]
    assert pills(build([*three, *absent, *gone]))[-2:] == ["missing here: cave and z", "18 of 20 runs"]
    assert pills(build(three)) == ["18 runs"]


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.00642, "6.4 mm"), (0.00996, "10 mm"), (0.376, "376 mm"), (1.0, "1.00 m"), (6.768, "6.77 m"), (812.3, "812 m")],
)
def test_errors_are_printed_in_millimetres_below_a_metre(demo, value, text):
    metres, percent = demo.metrics[0], demo.metrics[1]
    assert format_amount(metres, value).replace("\u00a0", " ") == text
    assert format_amount(percent, 0.5).replace("\u00a0", " ") == "0.50 %"


def test_times_are_printed_with_two_digits():
    times = (0.00352, 0.0099, 0.724, 0.997, 8.06, 9.96, 118.2)
    texts = [format_milliseconds(value).replace("\u00a0", " ") for value in times]
    assert texts == ["0.0035 ms", "0.0099 ms", "0.72 ms", "1.0 ms", "8.1 ms", "10 ms", "118 ms"]


def test_a_short_time_is_no_zero_in_a_sentence_nor_in_the_page_tables(build, runs, demo):
    """Wheel odometry takes 3.5 us a scan; a percentage that small stays zero."""
    times = next(metric for metric in all_metrics() if metric.name == "cpu_median_ms")
    assert [format_amount(times, value) for value in (0.00352, 0.0)] == ["0.0035\u00a0ms", "0.00\u00a0ms"]
    assert format_amount(demo.metrics[1], 0.00352) == "0.00\u00a0%"
    short = build([run for name in "ab" for run in runs(name, "room", (0.01, 0.02), ms=0.00352)])
    page = render_report(analyse(short))
    assert "0.0035" in page
    assert "0.00<" not in page
