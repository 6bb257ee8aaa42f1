"""The search of a tuning: spaces, points, equal budgets, comparison of points, and separate worlds."""

import json
import math
import signal
import time
import tomllib
from types import SimpleNamespace

import numpy as np
import pytest

from evalkit.commands.tune import search_loop, trial
from evalkit.commands.tune.config import load_tuning, make_tuning_tables, tuning_from_tables
from evalkit.commands.tune.objective import find_best_candidate, find_pareto_front, score_candidate
from evalkit.commands.tune.search import Search
from evalkit.commands.tune.space import Space, list_own_parameters, make_declared_factors
from evalkit.config.experiment_file import experiment_from_tables
from evalkit.config.experiment_toml import format_experiment
from evalkit.core.errors import BadExperiment
from evalkit.design import run_points
from evalkit.odometry import frontend
from evalkit.plugins import registry
from evalkit.plugins.parameters import Parameter

FILE = """
points = 16
objective = { metric = "ate_rmse_m", lost = 1.0 }

[[method]]
use = "embedded"
search.epsilon = { levels = [1e-7, 1e-1], scale = "log" }
search.max_iterations = [10, 20, 40, 80]
search.one_to_one = [true, false]

[[method]]
use = "paper"
search.max_correspondence_m = [0.1, 1]

[[training]]
use = "lab"
laps = 0.05
seeds = [0, 1]
confirm = [2, 3, 4, 5]

[[held-out]]
use = "lab"
laps = 0.05
seeds = [6, 7]

[[held-out]]
use = "room"
laps = 0.05
"""


def plan(text=FILE):
    return tuning_from_tables(tomllib.loads(text), "some.toml", "some", "evalkit tune some.toml")


def result(error, status="complete"):
    scores = {"ate_rmse_m": error, "cpu_median_ms": None if error is None else 1.0}
    return {"status": status, "reason": "why", "cpu_s": 0.5, "scores": scores, "why": dict.fromkeys(scores, "none")}


class Known:
    """Executor that computes tasks by a known function of parameters and seed, and counts them."""

    def __init__(self, error):
        self.error, self.asked = error, []

    def __call__(self, jobs):
        self.asked += jobs
        return {job.name: result(self.error(job.arguments)) for job in jobs}


def off(arguments):
    """Return a made-up error: least at epsilon 1e-4 and at a largest distance of 0.3 m, doubled by every decade."""
    parameters = arguments["parameters"]
    decades = math.log10(parameters["epsilon"] / 1e-3), 10.0 * (parameters["max_correspondence_m"] - 0.3)
    return 0.01 * 2.0 ** (abs(decades[0]) + abs(decades[1])) * (1.0 + 0.01 * (arguments["sequence"]["seed"] % 3))


def test_the_search_finds_and_chooses_the_minimum_of_a_known_function():
    embedded, paper = search_loop.run_search(plan(), Known(off))
    assert embedded.tuned
    assert embedded.default.error == pytest.approx(0.02 * math.sqrt(1.01))
    assert abs(math.log10(float(embedded.best.candidate.values["epsilon"]) / 1e-3)) < 0.35
    assert embedded.ratio is not None
    assert embedded.ratio.high < 0.7
    assert paper.best is paper.default
    assert not paper.tuned  # the default is already the minimum
    assert paper.why == "default kept: no point was better in the search"


def test_every_back_end_gets_the_same_budget_and_the_default_first():
    asked = Known(off)
    found = search_loop.run_search(plan(), asked)
    for one in found:
        assert [len(one.tried), one.tried[0].candidate.found] == [16, "default"]
        assert len({each.candidate.key for each in one.tried}) == 16
    runs = [job.arguments["backend"] for job in asked.asked if job.arguments["sequence"]["seed"] < 2]
    assert runs.count("embedded") == runs.count("paper") == 32
    seeds = {job.arguments["sequence"]["seed"] for job in asked.asked}
    assert seeds == {0, 1, 2, 3, 4, 5}  # never a held-out seed
    assert search_loop.count_runs(plan()) == 2 * (32 + 8)


def test_the_same_tuning_evaluates_the_same_points():
    names = []
    for _ in range(2):
        asked = Known(off)
        search_loop.run_search(plan(), asked)
        names.append([job.name for job in asked.asked])
    assert names[0] == names[1]


def test_a_lucky_point_does_not_survive_fresh_seeds():
    def luck(arguments):
        spread = np.random.default_rng([int(1e9 * arguments["parameters"]["epsilon"]), arguments["sequence"]["seed"]])
        return 0.02 * math.exp(0.5 * spread.standard_normal())

    one = search_loop.run_search(plan(), Known(luck))[0]
    assert one.best.error < 0.8 * one.default.error
    assert not one.tuned
    assert one.why == "default kept: the gain of the best point is within noise on fresh seeds"


def test_a_back_end_that_always_fails_keeps_its_default_and_is_marked_as_failed():
    one = search_loop.run_search(plan(), lambda jobs: {job.name: result(None, "failed") for job in jobs})[0]
    assert one.failed
    assert one.default.error == 1.0  # the worst value that counts
    assert one.default.lost == ("failed: why", "failed: why")
    assert not one.tuned


def test_fewer_lost_runs_come_before_a_smaller_error():
    space = plan().methods[0].space
    start, objective = space.start(), plan().objective
    sure = score_candidate(start, [result(0.3), result(0.3)], objective)
    bold = score_candidate(start, [result(0.001), result(1.5)], objective)
    assert bold.error == pytest.approx(math.sqrt(0.001))
    assert bold.lost == ("", "ATE RMSE 1.5 m")
    assert find_best_candidate([bold, sure]) is sure
    assert (
        find_best_candidate([sure, score_candidate(start, [result(0.3), result(0.3)], objective)]) is sure
    )  # a tie goes to the first one


def test_a_space_smaller_than_the_budget_is_evaluated_completely_and_once():
    backend = registry.backend("embedded")
    default = frontend.complete_parameters("embedded", backend, {})
    parameters = [p for p in backend.parameters if p.name in ("error", "one_to_one")]
    factors, left = make_declared_factors(parameters, default)
    search = Search(Space(factors, default), 20)
    first = search.next([], None)
    assert left == {}
    assert len({candidate.key for candidate in first}) == len(first) == 6
    assert search.next(first, first[0]) == ()


def test_steps_stay_within_the_bounds_and_repeat_no_point():
    space, tried = plan().methods[0].space, []
    search = Search(space, 40, seed=3)
    while candidates := search.next(tried, tried[-1] if tried else None):
        tried += candidates
    assert len({candidate.key for candidate in tried}) == 40
    for candidate in tried:
        assert 1e-7 <= candidate.values["epsilon"] <= 1e-1
        assert candidate.values["max_iterations"] in (10, 20, 40, 80)


def test_parameters_of_the_front_end_are_not_tuned():
    names = {
        parameter.name
        for name in ("paper", "kiss-icp")
        for parameter in list_own_parameters(registry.find_backend(name))
    }
    assert not names & {"prior", "deskew", "local_map", "keyframes", "min_inliers"}
    with pytest.raises(BadExperiment, match=r"method 1 \(embedded\): search.keyframes: .*same for all methods"):
        plan(FILE.replace("search.max_iterations", "search.keyframes"))


def test_a_space_has_declared_bounds_or_a_decade_around_the_default():
    parameters = (
        Parameter("share", 0.5, "", "bounded", low=0.0, high=1.0),
        Parameter("radius_m", 0.2, "m", "open", low=0.05),
        Parameter("points", 8, "", "open", low=4),
        Parameter("off", 0.0, "", "open"),
        Parameter("kernel", "none", "", "choices", choices=("none", "tukey")),
    )
    factors, left = make_declared_factors(parameters, {parameter.name: parameter.default for parameter in parameters})
    assert {factor.name: factor.numbers for factor in factors} == {
        "share": (0.0, 1.0), "radius_m": (0.05, 2.0), "points": (4.0, 8.0, 16.0, 32.0), "kernel": None,
    }  # fmt: skip
    assert left == {"off": "its default is 0 and it has no bounds: name its levels"}
    assert [factor.scale for factor in factors] == ["linear", "log", "linear", "linear"]


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("seeds = [6, 7]", "seeds = [1]", r"held-out \(lab\): lab with seed 1 is in training too \(lab\)"),
        ("seeds = [6, 7]", "seeds = [5]", r"lab with seed 5 is in training too"),
        ("confirm = [2, 3, 4, 5]", "confirm = [1, 2, 3, 4]", "seed 1 is searched with too"),
        (
            "confirm = [2, 3, 4, 5]",
            'confirm = [2, 3, 4, 5]\n[[training]]\nuse = "lab"\nlabel = "lab again"\nlaps = 0.1\nseeds = [4]',
            "seed 4 is searched with too",
        ),
        ("confirm = [2, 3, 4, 5]", "confirm = [2]", "it takes 4 runs in all"),
        ('metric = "ate_rmse_m"', 'metric = "map_f1"', "objective: no error of a trajectory"),
        ('metric = "ate_rmse_m"', 'metric = "span_rmse_m"', "objective: no error of a trajectory"),
        ("points = 16", "points = 1", "'points': found 1, expected a whole number from 2"),
        ("search.max_correspondence_m = [0.1, 1]", "search.max_correspondence_m = [-1, 1]", "found -1.0, expected"),
        ("search.max_correspondence_m", "search.no_such", "no parameter named 'no_such'"),
        ('use = "paper"', 'use = "paper"\nlabel = "embedded tuned"', "tuned methods end in ' tuned'"),
        ('use = "room"', 'use = "roam"', r"held-out 2: no dataset named 'roam'"),
    ],
)
def test_an_unfair_or_wrong_tuning_file_is_an_error(old, new, told):
    with pytest.raises(BadExperiment, match=told):
        plan(FILE.replace(old, new))


def test_a_recording_used_for_training_cannot_be_held_out_under_another_label(tmp_path):
    log = tmp_path / "own.log"
    log.write_text("FLASER 3 1.0 1.0 1.0 0 0 0 0 0 0 0.0 host 0.0\n")
    same = [{"use": "carmen", "path": str(log)}]
    other = [{"use": "carmen", "label": "other", "path": str(tmp_path / "x" / ".." / "own.log")}]
    (tmp_path / "x").mkdir()
    content = tomllib.loads(FILE)
    content["training"] += same
    content["held-out"] = other
    with pytest.raises(BadExperiment, match=r"own\.log is in training too"):
        tuning_from_tables(content, "some.toml", "some", "evalkit tune some.toml")


def test_a_missing_tuning_file_is_an_error_with_a_remedy(tmp_path):
    with pytest.raises(BadExperiment, match="no such file; give the path of a tuning"):
        load_tuning(tmp_path / "none.toml", "none", "evalkit tune none.toml")


def test_back_ends_named_on_the_command_line_get_equal_budgets():
    made = tuning_from_tables(
        make_tuning_tables(["embedded", "paper"], ["lab"], ["room"], 8, {"laps": "0.05"}), "evalkit tune", "x", "y"
    )
    assert [one.label for one in made.methods] == ["embedded", "paper"]
    assert made.training[0].sequence.parameters["laps"] == 0.05
    assert [sequence.label for sequence in made.held_out] == ["room"]


def test_data_sets_named_on_the_command_line_have_parameters_of_their_own():
    tables = make_tuning_tables(["embedded"], ["lab laps=0.1", "lab laps=0.2"], [], 8, {"laps": "0.05", "rate_hz": "5"})
    made = tuning_from_tables(tables, "evalkit tune", "x", "y")
    assert [one.sequence.label for one in made.training] == ["lab laps=0.1", "lab laps=0.2"]
    own = [(one.sequence.parameters["laps"], one.sequence.parameters["rate_hz"]) for one in made.training]
    assert own == [(0.1, 5.0), (0.2, 5.0)]
    assert [one.parameters["laps"] for one in made.held_out] == [0.1, 0.2]


def test_the_held_out_experiment_contains_default_and_tuned_methods_and_is_read_back():
    made = plan()
    found = search_loop.run_search(made, Known(off))
    text = format_experiment(search_loop.make_held_out_experiment(made, found, "tuned.toml"))
    back = experiment_from_tables(tomllib.loads(text), "tuned.toml", "tuned", "compare tuned.toml")
    assert [tunable.label for tunable in back.methods] == ["embedded", "embedded tuned", "paper"]
    assert dict(back.methods[1].parameters) == dict(found[0].best.candidate.values)
    assert back.sequences == made.held_out
    assert (back.mapper, back.limits) == (made.mapper, made.limits)


def test_the_pareto_front_has_the_points_that_no_other_dominates():
    costs = np.array([1.0, 2.0, 3.0, 2.0, 4.0, 1.0, 0.5])
    errors = np.array([5.0, 3.0, 3.0, 4.0, 1.0, 5.0, np.inf])
    assert find_pareto_front(costs, errors).tolist() == [True, True, False, False, True, True, False]


def test_a_run_beyond_its_cpu_time_has_failed_with_its_reason(strangers, monkeypatch):
    monkeypatch.setattr(trial, "CHECK_EVERY_S", 0.05)
    parameters = {"fault": "spin", "at": 1}
    sequence = {p.name: p.default for p in registry.dataset("straight").parameters}
    begun = time.monotonic()
    told = trial.run_trial(0.2, "faulty", parameters, "straight", sequence, "log-odds", ["ate_rmse_m"], "")
    assert told["status"] == "failed"
    assert "more than 0.2 s of CPU time" in told["reason"]
    assert time.monotonic() - begun < 600.0  # without a limit it would not end


def test_the_first_run_on_a_sequence_is_not_charged_with_its_simulation(strangers, monkeypatch):
    class SlowAtFirst:
        def __init__(self, sequence):
            self.sequence, self.begun = sequence, False

        def __len__(self):
            return len(self.sequence)

        def __getattr__(self, name):
            return getattr(self.sequence, name)

        def frames(self):
            if not self.begun:
                self.begun = True
                used_s[0] += 1.5
                if callable(check := signal.getsignal(signal.SIGALRM)):
                    check(signal.SIGALRM, None)
            return self.sequence.frames()

    used_s = [0.0]  # on a clock of this test
    monkeypatch.setattr(trial, "time", SimpleNamespace(process_time=lambda: used_s[0]))
    sequence = {p.name: p.default for p in registry.dataset("straight").parameters}
    slow = SlowAtFirst(registry.dataset("straight").make(**sequence))
    monkeypatch.setattr(run_points, "_load_sequence", lambda *_: slow)
    parameters = {p.name: p.default for p in registry.backend("wheel-odometry").parameters}
    told = trial.run_trial(
        1.0, "wheel-odometry", parameters, "straight", sequence, "log-odds", ["ate_rmse_m", "pair_error"], ""
    )
    assert told["status"] == "complete", told["reason"]
    assert told["scores"]["pair_error"] is not None, told["why"]


def test_keys_of_tasks_change_with_their_arguments():
    made = plan()
    tunable, run = made.methods[0], made.search_runs[0]
    keys = {made.task(tunable, one, run).key for one in Search(tunable.space, 4).next([], None)}
    assert len(keys) == 2
    assert json.dumps(dict(made.task(tunable, tunable.space.start(), run).arguments))
