"""Checks of an acceptance report from results written by hand: answers, known motions, times, paths and maps."""

import math
from dataclasses import replace

import numpy as np
import pytest

from evalkit.commands.validate import charts, level_answers, level_costs, level_maps, level_trajectories, run_paths
from evalkit.commands.validate.acceptance import AcceptanceLevel, Check
from evalkit.commands.validate.comparison_terms import ComparisonTerms, choose_margin, format_margin
from evalkit.commands.validate.difference_causes import name_causes
from evalkit.commands.validate.known_motion import judge_gap, known_motion_checks, peer_check
from evalkit.core.ground_truth import Truth
from evalkit.core.loop_closure import LoopClosure
from evalkit.core.pose import Pose
from evalkit.core.run_status import RunStatus
from evalkit.core.trajectory import Trajectory
from evalkit.execution.sandbox import ENDED

TERMS = ComparisonTerms("mine", "paper", "exact", 0.5)
SINGLE = replace(TERMS, margin="float32")
KILLED = {ENDED: "killed by signal 11"}


def said(checks):
    return [(one.outcome, one.observed) for one in checks]


def shifted(record, metres, first=0):
    """The run with its path moved along x from one scan on."""
    steps = record.result.steps.copy()
    steps["x"][first:] += metres
    return replace(record, result=replace(record.result, steps=steps))


@pytest.fixture
def reference(record):
    return record("paper", "room", {"map_f1": 0.8})


def trajectories(mine, reference, margin=(1e-4, 0.0), terms=TERMS, perturbed=None, **others):
    runs = {"room, seed 0": {"mine": mine, "paper": reference, **others}}
    margins = {"room, seed 0": margin} if margin else {}
    return level_trajectories.trajectories_level(runs, margins, perturbed or {}, terms).checks


def test_a_path_beyond_the_margin_is_found_at_its_first_scan(reference):
    same = trajectories(reference, reference)
    assert {one.outcome for one in same} == {"passed"}
    assert same[0].observed == "1 of 1 runs complete, 60 scans answered"
    assert same[2].detail == "the errors are equal to the bit"
    away_m = shifted(shifted(replace(reference, truth=Truth("none")), 0.5, 30), 0.25, 59)
    left = trajectories(away_m, reference)[1]  # 60 scans of 0.1 mm: 6 mm allowed
    away = "beyond the margin from scan 31 (3.0 s) on; largest distance 0.75 m, at 5.9 s; at the end 0.75 m"
    assert (left.outcome, left.observed, left.margin.partition(":")[0]) == ("failed", away, "0.006 m")
    single = trajectories(away_m, reference, terms=SINGLE)[1]
    assert (single.outcome, single.observed) == ("informative", away.partition("; ")[2])
    assert len(trajectories(away_m, reference, margin=None)) == len(same) - 1


@pytest.mark.parametrize(
    ("errors_m", "outcome"),
    [([3.0], "not shown"), ([2.9, 3.0, 3.1], "failed"), ([1.0, 1.0, 7.0], "not shown"), ([0.9, 0.9, 0.9], "passed")],
)
def test_a_larger_error_fails_only_if_runs_show_it_whose_scans_drift_together(record, errors_m, outcome):
    """Losses beside 1 m: 2 m with a spread of 0.1 m over three runs, then 2 m with 3.5 m (t = 2.92: 5.8 m wide)."""
    runs = {
        f"room, seed {seed}": {
            "mine": record("mine", "room", {}, error_m=error_m, seed=seed),
            "paper": record("paper", "room", {}, error_m=1.0, seed=seed),
        }
        for seed, error_m in enumerate(errors_m)
    }
    checks = level_trajectories.trajectories_level(runs, {}, {}, TERMS).checks
    assert [one.outcome for one in checks if one.name.startswith("error of the path")] == [outcome]


def test_slams_are_compared_by_their_corrected_paths_and_closures(reference):
    stamps = reference.result.steps["stamp_ns"]

    def close(last_m=0.0, accepted=True):
        poses = reference.result.estimate.poses.copy()
        poses[-1, 0] += last_m
        loops = (LoopClosure(int(stamps[30]), int(stamps[5]), Pose(), accepted, "chi2 0.1"),)
        final = Trajectory(stamps, poses, "start", "base")
        return replace(reference, result=replace(reference.result, final=final, loop_closures=loops))

    path, corrected, closures = trajectories(close(), close())[1:4]
    assert [each.name for each in (path, corrected, closures)] == [
        "the path of paper", "the corrected path of paper", "the loop closures of paper"
    ]  # fmt: skip
    assert [each.outcome for each in (path, corrected, closures)] == ["passed"] * 3
    assert closures.observed == "candidates: 1, accepted: 1"
    path, corrected, closures = trajectories(close(0.5, accepted=False), close())[1:4]
    assert [each.outcome for each in (path, corrected, closures)] == ["passed", "failed", "failed"]
    assert corrected.observed.startswith("beyond the margin from scan 60 (5.9 s) on; largest distance 0.5 m")
    assert closures.observed == "1 differ; first 3.0 s with 0.5 s: rejected, but accepted by paper"
    other = trajectories(close(), reference)[2]
    assert (other.outcome, other.observed) == ("not applicable", "only mine has corrected poses")


def test_a_path_in_single_precision_is_as_close_as_one_more_perturbed_copy_may_be(reference):
    """Of copies 1 mm and 2 mm off: exp(ln sqrt(2) mm + t ln 2 sqrt(3/2)) with t = tan(0.45 pi) is 0.3007 m."""
    reference = replace(reference, truth=Truth("none"))
    poses = np.stack([reference.result.steps[name] for name in ("x", "y", "theta")], axis=1)
    paths = [poses + np.array([off, 0.0, 0.0]) for off in (1e-3, 2e-3)] + [np.full_like(poses, math.nan)]
    perturbed = {"room, seed 0": {"stamps_ns": reference.result.steps["stamp_ns"], "paths": np.array(paths)}}
    for off, outcome in ((0.29, "passed"), (0.31, "failed")):
        found = trajectories(shifted(reference, off), reference, None, SINGLE, perturbed)[1]
        assert (found.outcome, found.observed) == (outcome, f"{off:g} m apart (RMS over the run)")
        assert found.margin.startswith("0.3 m: ")
        assert "over 2 copies of the sequence with ranges perturbed by rounding: 0.001, 0.002 m" in found.detail
    ended = trajectories(reference, reference, None, SINGLE, {"room, seed 0": KILLED})[1]
    assert (ended.outcome, ended.observed) == ("failed", "mine (or paper) did not finish: killed by signal 11")


def test_a_run_that_broke_and_a_truth_that_is_missing_are_said(record, reference):
    broken = record("paper", "room", {}, status=RunStatus.CRASHED, reason="signal 11", answered=2)
    found = trajectories(broken, reference)
    assert said(found) == [("failed", "crashed: signal 11")]
    assert found[0].detail == "2 of 60 scans answered"
    unknown = replace(reference, truth=Truth("none"))
    found = trajectories(unknown, unknown, None, replace(TERMS, peers=("ndt",)), ndt=unknown)
    assert said(found)[1:] == [("not applicable", "no true path to compare with")] * 2


def test_a_peer_is_larger_smaller_or_has_no_run(record, reference):
    terms = replace(TERMS, peers=("ndt",))
    worse = record("paper", "room", {}, error_m=2.0)
    observed = trajectories(reference, reference, None, terms, ndt=worse)[-1].observed
    assert ": smaller; difference" in observed
    assert ": larger; difference" in trajectories(worse, reference, None, terms, ndt=reference)[-1].observed
    missing = record("ndt", "room", {}, status=RunStatus.NOT_INSTALLED, reason="needs a compiler", answered=0)
    found = trajectories(reference, reference, None, terms, ndt=missing)[-1]
    assert (found.outcome, found.observed) == ("not applicable", "ndt has no run: needs a compiler")


def test_paths_without_a_common_scan_have_no_distance(record, reference):
    steps = reference.result.steps.copy()
    steps["stamp_ns"] += 1
    later = replace(reference, result=replace(reference.result, steps=steps))
    assert [len(one) for one in run_paths.path_distances(reference, later)] == [0, 0]


def maps(runs, margin=None, mappers=("log-odds", "log-odds"), mapped=None):
    margins = dict.fromkeys(runs, margin) if margin else {}
    return level_maps.maps_level(runs, margins, mapped or {}, mappers, TERMS).checks


def scored(record, seed, f1):
    return record("paper", "room", {"map_f1": f1}, seed=seed)


def test_maps_are_compared_by_their_cells_and_their_walls(record, reference):
    cells, walls = maps({"room, seed 0": {"mine": reference, "paper": reference}}, (1e-3, 0.0))
    assert cells.outcome == "passed"
    assert cells.observed.startswith("0 of ")
    assert cells.observed.endswith(" cells are a wall in one map only; 0 have different values")
    assert said([walls]) == [
        ("informative", "F1 at 10 cm 0.800, paper 0.800; one run shows no variation: give more --seeds")
    ]
    unknown = maps({"room, seed 0": {"mine": reference, "paper": reference}})[0]
    assert unknown.outcome == "informative"  # without a margin of the path no cell can be judged
    no_grid = replace(reference, scores=replace(reference.scores, grid=None))
    assert maps({"room, seed 0": {"mine": no_grid, "paper": reference}}) == ()


@pytest.mark.parametrize(
    ("own", "outcome", "hint"),
    [
        ((0.80, 0.90), "passed", "no loss was observed"),
        ((0.90, 0.91), "passed", "no loss was observed"),  # better on both, by amounts too different for an interval
        ((0.20, 0.30), "failed", "its loss is shown to exceed the margin"),
        ((0.79, 0.85), "not shown", None),
    ],
)
def test_a_loss_of_walls_is_judged_against_the_reference_s_own_variation(record, own, outcome, hint):
    runs = {
        f"room, seed {seed}": {"mine": scored(record, seed, f1), "paper": scored(record, seed, known)}
        for seed, (f1, known) in enumerate(zip(own, (0.8, 0.9), strict=True))
    }
    found = maps(runs)[-1]
    assert found.outcome == outcome
    assert hint in (None, found.detail)
    assert found.margin == "0.035: 0.5 of the standard deviation of paper over 2 seeds"
    assert len(maps({place: {**both, "mine": scored(record, 0, None)} for place, both in runs.items()})) == 2


def test_a_back_end_without_a_mapper_and_a_mapper_that_ends_are_said():
    found = maps({}, mappers=("", "log-odds"), mapped={"room": KILLED})
    assert said(found) == [
        ("failed", " (or log-odds) did not finish: killed by signal 11"),
        ("not applicable", "the back end brings no mapper; name one with --mapper"),
    ]


def test_figures_are_drawn_of_what_is_there(record, reference):
    both = {"mine": reference, "paper": reference}
    level = AcceptanceLevel(3, "", "", (), {"records": {"room, seed 0": both, "room, seed 1": both}})
    titles = [one.title for one in charts.figures(level, "mine", "paper", "exact")]
    assert titles == ["room, seed 0: paths", "room: distance between both paths"]
    missing = record("paper", "room", {}, status=RunStatus.CRASHED, reason="signal 11", answered=0, truth=False)
    alone = AcceptanceLevel(3, "", "", (), {"records": {"room": {"mine": missing}}})
    assert charts.figures(alone, "mine", "paper", "exact") == []
    for runs, count in ((both, 3), ({"mine": reference, "paper": missing}, 0), ({"mine": reference}, 0)):
        level = AcceptanceLevel(4, "", "", (), {"records": {"room": runs}})
        assert len(charts.figures(level, "mine", "paper", "exact")) == count
    none = AcceptanceLevel(1, "", "", (), {"results": {}, "peers": {}})
    assert charts.figures(none, "mine", "paper", "exact") == []
    peers = {"ndt": {"room": {"rows": WRONG}}, "ill": {"room": KILLED}}
    level = AcceptanceLevel(1, "", "", (), {"results": {"room": pairs()}, "peers": peers})
    answers, truth = charts.figures(level, "mine", "paper", "exact")
    assert (b"to ndt" in answers.svg, b"ndt" in truth.svg, b"to ill" in answers.svg) == (True, True, False)
    level = AcceptanceLevel(1, "", "", (), {"results": {"room": pairs(truth=np.full((4, 3), math.nan))}, "peers": {}})
    assert len(charts.figures(level, "mine", "paper", "exact")) == 1  # no truth, no second figure


RIGHT = np.array([[0.1, 0.0, 0.01], [0.2, 0.1, 0.02], [0.3, -0.1, 0.0], [0.1, 0.2, -0.01]])
WRONG = RIGHT + np.array([0.1, 0.0, 0.0])
UNANSWERED = np.full((4, 3), math.nan)


def pairs(a=RIGHT, b=RIGHT, truth=RIGHT):
    """Four registrations of 100 points with residuals of 2 cm: a noise level of 2 mm, and of 1 mrad at 2 m."""
    return {"truth": truth, "a": a, "b": b, "stage": ["s2s", "s2s-disturbed"] * 2, "residual_m": np.full(4, 0.02),
            "points": np.full(4, 100.0), "radius_m": np.full(4, 2.0), "alone": True}  # fmt: skip


def test_an_answer_that_is_missing_fails_and_an_unknown_motion_says_nothing():
    assert known_motion_checks({"room": pairs(truth=UNANSWERED)}, TERMS) == []
    b = np.concatenate([RIGHT[:3], UNANSWERED[:1]])
    found = known_motion_checks({"room": pairs(b=b)}, TERMS)
    assert [(one.outcome, one.detail) for one in found] == [("failed", "1 pairs have no answer")] * 2
    assert found[0].margin == "0.001 m: 0.5 of the noise level, mean residual / sqrt(points)"
    assert found[1].margin == "0.0005 rad: 0.5 of the noise level, mean residual / sqrt(points)"


def test_a_peer_is_compared_over_near_guesses_that_both_answered():
    found = peer_check("ndt", {"room": pairs()}, {"room": {"rows": WRONG}}, TERMS)
    assert found.on == "room, near guesses"
    apart = "answers lie 0.1 m apart (median; 95 % within 0.1 m)"
    assert found.observed == f"{apart}, with a bias beyond the margin in x"
    assert found.detail.startswith("means over 2 pairs: x ")
    ended = peer_check("ndt", {"room": pairs()}, {"room": KILLED}, TERMS)
    assert said([ended]) == [("not applicable", "ndt did not finish: killed by signal 11")]
    silent = peer_check("ndt", {"room": pairs()}, {"room": {"rows": UNANSWERED}}, TERMS)
    assert said([silent]) == [("not applicable", "no pair was answered by both")]


def test_a_peer_with_too_few_answers_to_exclude_a_bias_is_not_called_biased():
    """Two differences of 0 and 2 mm: 1 mm +- 6.31 mm (Student, 1 degree of freedom), with a margin of 1 mm."""
    few = RIGHT + np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [2e-3, 0.0, 0.0], [0.0, 0.0, 0.0]])
    found = peer_check("ndt", {"room": pairs()}, {"room": {"rows": few}}, TERMS)
    assert found.observed.endswith(", too few pairs to exclude a bias")
    same = peer_check("ndt", {"room": pairs()}, {"room": {"rows": RIGHT}}, TERMS)
    assert same.observed.endswith(", without a bias")


def test_a_loss_near_its_margin_asks_for_more_data():
    assert judge_gap(0.3, 0.2, 0.4, 0.3, 50)[1].startswith("more data would show which")
    assert judge_gap(0.0, -math.inf, math.inf, 0.3, 1)[1].startswith("more data would show which")


def times(cpu=(2e6, 4e6), wall=None, device=None, conversion=0, period=5e6):
    """Ten scans of each of several methods, all of one time in nanoseconds."""
    rows = {"cpu_ns": cpu, "wall_ns": wall or cpu, "device_ns": device or [0] * len(cpu)}
    table = {name: np.repeat(np.array(values)[:, None], 10, axis=1) for name, values in rows.items()}
    return table | {"conversion_ns": np.full((len(cpu), 10), conversion), "period_ns": period}


def costs(scans, registrations=("mine", "paper"), pair_times=None, records=None, compiled=()):
    given = pair_times or {}, ["mine", "paper"], registrations, records or {}, TERMS, compiled
    return level_costs.costs_level(scans, *given).checks


def test_times_are_told_by_the_clock_that_measured_them(reference, tmp_path):
    own, pace, ratio = costs({"room": times(conversion=1e6)})
    assert own.observed.startswith(
        "2 ms (95 % 2, at most 2) of CPU time; 2 ms (95 % 2, at most 2) by the wall clock; 50 %"
    )
    assert (pace.outcome, pace.margin) == ("passed", "5 ms between two scans")
    assert pace.observed == (
        "keeps up: 95 % of the scans within 2 ms (wall clock), 5 ms between two scans; 0.0 % took longer"
    )
    assert ratio.observed.startswith("0.5 times as long (CPU; quartiles 0.5 to 0.5): 2 ms, paper 4 ms")
    board, pace, ratio = costs({"room": times(cpu=(0, 4e6), wall=(9e6, 4e6), device=(7e6, 0))})
    assert board.observed.startswith("7 ms (95 % 7, at most 7) of device time; 9 ms")
    assert pace.outcome == "failed"
    assert pace.observed == (
        "does not keep up: 95 % of the scans within 7 ms (its own measurement), 5 ms between two scans; "
        "100.0 % took longer"
    )
    assert ratio.observed == "device and CPU times cannot be compared"
    first_alone = times(cpu=(0, 4e6), wall=(9e6, 4e6), device=(7e6, 0), conversion=1e6)
    first_alone["cpu_ns"][0, 0], first_alone["device_ns"][0, 0] = 1e5, 0
    board, _, ratio = costs({"room": first_alone})
    assert board.observed == ("7 ms (95 % 7, at most 7) of device time; 9 ms (95 % 9, at most 9) by the wall clock")
    assert ratio.observed == "device and CPU times cannot be compared"
    remote = costs({"room": times(cpu=(0, 4e6), wall=(3e6, 4e6))})[0]
    assert remote.observed.startswith("3 ms (95 % 3, at most 3) of wall clock time")
    both = costs({"room": times(device=(1e6, 0))})[0]
    assert "; 1 ms (95 % 1, at most 1) by its own measurement, the rest is communication" in both.observed
    ended = costs({"room": KILLED}, pair_times={"room": KILLED, "lab": times()})
    assert ended[0].observed == "the measurement did not finish: killed by signal 11"
    far = "one registration from a guess 5 or 30 cm off, compared with paper"
    assert [(one.name, one.on) for one in ended[1:]] == [(far, "lab")]
    (tmp_path / "mine.so").write_bytes(b"no library")
    assert costs({}, compiled=[tmp_path / "mine.so"]) == ()
    heavy = replace(reference, result=replace(reference.result, peak_memory_bytes=256 * 2**20))
    none = replace(reference, result=replace(reference.result, peak_memory_bytes=0))
    (memory,) = costs({}, records={"lab": {"mine": none}, "room": {"mine": heavy, "paper": heavy}})
    assert memory.observed == "256 MiB with interpreter and data (paper 256 MiB)"
    (alone,) = costs({}, records={"room": {"mine": heavy}})
    assert alone.observed == "256 MiB with interpreter and data"


def drawn(clear=None, limits=0, where="", start="", crowded=0, mispaired=0, scales=0, parameters=0, **evidence):
    """Drawn questions with a first difference of well separated points in a quantity; ``evidence``: of their family."""
    first = clear and {"quantity": clear, "kind": "different", "what": "w", "scan": 1, "stage": "clear",
                       "iteration": None}  # fmt: skip
    none = {"asked": 0, "wrong": 0, "what": "", "first": None, "fields": {}, "unanswered": 0, "recounted": 0,
            "mispaired": 0, "counted": True, "largest_m": 0.0, "allowed_m": 0.0, "excepted": 0}  # fmt: skip
    families = {"clear": none | {"asked": 4, "wrong": int(bool(clear)), "what": "points", "first": first} | evidence,
                "limits": none | {"asked": 4, "wrong": limits, "what": "a limit", "first": first},
                "points": none | {"wrong": crowded, "mispaired": mispaired}, "sizes": none,
                "scales": none | {"wrong": scales, "what": "far away"},
                "parameters at once": none | {"wrong": parameters, "what": "epsilon = 0"}}  # fmt: skip
    margin = {"metres": 1e-9, "radians": 1e-9}
    found = {"families": families, "where": where, "start": start, "margin": margin, "questions": 8, "fields": {}}
    return {"seed 1": {"exact": found}}


UNNAMED = Check("equal to paper", "room", "failed", "equal", "7 pairs against 6; not both report their pairs")


@pytest.mark.parametrize(
    ("questions", "cause"),
    [
        (drawn(start="the guess is not used", where="only where x is above 3"), "another start: the guess is not used"),
        (drawn(where="only where x is above 3"), "answers differ only where x is above 3"),
        (drawn("pairs", recounted=1), "even well separated points give another number of pairs"),
        (drawn("answer", recounted=1), "even well separated points give another number of pairs"),
        (drawn("pairs", recounted=1, mispaired=1), "the points that are used or their neighbours differ: even well "
                                                   "separated points give another number of pairs"),
        (drawn("pose"), "the step, or the motion of the points, differs: well separated points give as many pairs, but "
                        "other answers"),
        (drawn("answer", counted=False), "well separated points give as many pairs, but other answers"),
        (drawn(limits=1), "the outlier rule or the search of neighbours differs: well separated points give equal "
                          "answers, pairs near the limits do not"),
        (drawn(crowded=1, mispaired=1), "the neighbours differ: well separated points give equal answers, crowded ones "
                                        "do not"),
        (drawn(crowded=1), "well separated points give equal answers, crowded ones do not"),
        (drawn(), ""),
        (drawn(scales=1), "of the drawn questions only scales differ, first far away"),
        (drawn(scales=1, parameters=1), ""),
        (drawn("iterations"), ""),
        (drawn("answer", unanswered=1), ""),
    ],
)  # fmt: skip
def test_a_difference_without_a_name_gets_it_from_the_drawn_questions(questions, cause):
    named, other = name_causes([UNNAMED, replace(UNNAMED, observed="units")], questions, TERMS)
    assert named.observed == (f"{UNNAMED.observed}; {cause}" if cause else UNNAMED.observed)
    assert other.observed == "units"
    assert name_causes([UNNAMED], {"seed 1": KILLED}, TERMS) == [UNNAMED]


def test_numbers_of_pairs_of_the_last_answer_alone_name_no_rule():
    last = replace(UNNAMED, observed="pair 1, answer: different: 7 pairs against 6; not both report their iterations")
    (named,) = name_causes([last], drawn(limits=1), TERMS)
    assert named.observed.removeprefix(last.observed) == (
        "; well separated points give equal answers, pairs near the limits do not"
    )


def test_pairs_that_differ_before_a_step_are_not_explained_by_it():
    early = replace(
        UNNAMED, observed="pair 1, iteration 1, pairs: different: 7 pairs against 6; not both report their pairs"
    )
    assert name_causes([early], drawn("pose"), TERMS) == [early]


def test_drawn_questions_are_checked_by_family():
    (ended,) = level_answers._drawn_checks("seed 1", KILLED, TERMS)
    assert ended.observed == "mine (or paper) did not finish: killed by signal 11"
    wrong, equal = level_answers._drawn_checks("seed 1", drawn("pose")["seed 1"], TERMS)
    assert (wrong.outcome, wrong.observed) == ("failed", "1 of 4 questions differ; first points: pose: different: w")
    assert (equal.outcome, equal.observed) == ("passed", "4 questions, all answers are equal")


def test_what_single_precision_excuses_is_said():
    rounded = drawn(largest_m=3e-6, allowed_m=4e-5, excepted=1)["seed 1"]
    found = level_answers._drawn_checks("seed 1", {"float32": rounded["exact"]}, SINGLE)[0]
    assert found.observed == (
        "4 questions, all answers are within single-precision rounding: at most 3e-06 m apart where 4e-05 m are "
        "allowed; 1 beyond that, where rounding decides the answer"
    )
    comparison = {
        "equivalent": True, "level": "answers", "n": 4, "questions": 8, "unanswered": 0, "beyond_rounding": 0,
        "excepted": 2, "first": None, "classes": {}, "margin": {"metres": 1e-4, "radians": 1e-5, "origin": "float32"},
        "intervals": [{"unit": "m", "worst": -1.9e-4}],
    }  # fmt: skip
    found = level_answers._equality("room", {"float32": comparison}, SINGLE, "pair")
    assert (found.outcome, found.observed) == (
        "passed", "within single-precision rounding: largest difference 0.00019 m; 2 of 8 answers lie beyond the "
                  "margin, where rounding decides the answer",
    )  # fmt: skip
    plain = level_answers._equality("room", {"exact": {**comparison, "excepted": 0}}, TERMS, "pair")
    assert plain.observed == "largest difference 0.00019 m"


def test_how_many_fields_are_equal_is_said_and_how_many_rounding_excuses():
    comparison = {"fields": {}, "equal_fields": 103, "excused_fields": 0}
    found = level_answers._field_checks({"room": {"float32": comparison}}, SINGLE)[0]
    assert found.observed.endswith("agree, where they are reported, in 103 questions with an equal pose")
    found = level_answers._field_checks({"room": {"float32": comparison | {"excused_fields": 25}}}, SINGLE)[0]
    assert found.observed.endswith("equal pose; in 25 more one of them differs, where rounding decides it")
    assert level_answers._field_checks({"room": {"float32": comparison | {"equal_fields": 0}}}, SINGLE) == []


def test_a_field_that_differs_is_named_with_its_first_answer_and_both_values():
    first = {"iterations": {"scan": 2, "stage": "s2m", "what": "2, expected 1"}}
    comparison = {"fields": {"pose": 3, "iterations": 22}, "first_fields": first, "questions": 132}
    (found,) = level_answers._field_checks({"room": {"exact": comparison}}, TERMS)
    assert found.observed == (
        "iterations differs from paper where the pose is equal: room: 22 of 132 answers, first scan 2 (scan to map): "
        "2, expected 1"
    )
    (found,) = level_answers._field_checks({"room": {"float32": comparison}}, SINGLE)
    assert (
        "single-precision rounding, which may decide this field too (if so, --except 'iterations=sin" in found.observed
    )


def make_poses_comparison(worst_m, worst_rad):
    """Two odometries whose mean difference lies within 1e-9 m and rad, with their largest differences."""
    pairs = (("m", worst_m), ("rad", worst_rad))
    return {
        "equivalent": True, "level": "trajectories", "margin": {"metres": 1e-9, "radians": 1e-9},
        "intervals": [{"unit": unit, "worst": worst, "margin": 1e-9} for unit, worst in pairs],
    }  # fmt: skip


@pytest.mark.parametrize(
    ("worst", "said"),
    [
        ((1e-9, -1e-10), "within 1e-09 m and 1e-09 rad"),
        ((-1.4e-9, 2e-10), "within 1e-09 m and 1e-09 rad in the mean (single poses at most 1.4e-09 m apart)"),
        (
            (1.4e-9, 3e-9),
            "within 1e-09 m and 1e-09 rad in the mean (single poses at most 1.4e-09 m and 3e-09 rad apart)",
        ),
    ],
)
def test_poses_beyond_a_margin_that_only_their_mean_keeps_are_said(worst, said):
    assert format_margin({"room": {"exact": make_poses_comparison(*worst)}}, "exact") == said


def test_answers_that_rounding_decides_are_said_with_their_number():
    intervals = [{"unit": "m", "worst": 5.7e-3, "margin": 1e-4}, {"unit": "rad", "worst": 1e-7, "margin": 1e-5}]
    compared = {
        "equivalent": False, "level": "answers", "margin": {"metres": 1e-4, "radians": 1e-5}, "intervals": intervals,
        "beyond_rounding": 0, "unanswered": 0, "excepted": 2, "questions": 132,
    }  # fmt: skip
    assert format_margin({"room": {"float32": compared}}, "float32") == (
        "within the single-precision rounding margin (0.0001 m and 1e-05 rad; rounding decides 2 of 132 answers, at "
        "most 0.0057 m apart)"
    )


def test_without_results_no_margin_is_chosen():
    assert choose_margin({"room": KILLED}, ["exact", "float32"]) == "exact"
    assert format_margin({"room": KILLED}, "exact") == "within no margin: no question was answered"
    rounded = {"room": {"exact": {"first": {"kind": "rounding"}, "equivalent": False, "level": "answers"}}}
    assert choose_margin(rounded, ["exact", "float32"]) == "exact"
