"""Study files: the tasks they define, and the errors reported before anything runs."""

import copy
import tomllib

import pytest

from evalkit.commands.study import config
from evalkit.core.errors import BadExperiment

GOOD = """
seeds = [0, 1]
method.use = "paper"
sequence = { use = "lab", laps = 0.05 }
response = [{ metric = "ate_rmse_m", scale = "log", lost = 0.5 }, { metric = "map_f1" }]

[[factor]]
name = "epsilon"
sets = "method.epsilon"
levels = [1e-6, 1e-4, 1e-2]
scale = "log"

[[factor]]
sets = "method.one_to_one"
levels = [true, false]

[[factor]]
name = "cell"
sets = ["method.local_map_cell_m", "mapper.resolution_m"]
levels = [0.05, 0.1]

[[factor]]
name = "stages"
[factor.levels]
"both" = { "method.scan_to_scan" = true }
"second" = { "method.scan_to_scan" = false }

[[design]]
name = "all"
kind = "grid"
factors = ["epsilon", "method.one_to_one", "cell", "stages"]

[[design]]
name = "alone"
kind = "curves"
factors = ["epsilon", "stages"]
seeds = [3]
with = { "method.local_map" = "grid" }

[[design]]
name = "between"
kind = "sobol"
factors = ["epsilon", "stages"]
points = 8
"""


def change_study(change):
    content = copy.deepcopy(tomllib.loads(GOOD))
    change(content)
    return content


def study(change=lambda content: None):
    return config.study_from_tables(change_study(change), "s.toml", "evalkit study s.toml")


def test_every_point_has_all_settings_and_its_own_key():
    made = study()
    grid, alone, between = made.designs
    assert (len(grid.points), len(alone.points), len(between.points)) == (24, 5, 8)
    last = grid.points[-1]
    assert last.method["epsilon"] == 1e-2
    assert last.method["one_to_one"] is False
    assert last.method["local_map_cell_m"] == last.mapper["resolution_m"] == 0.1
    assert last.method["scan_to_scan"] is False
    assert "seed" not in last.sequence
    assert len({point.key for point in grid.points}) == 24
    assert all(point.method["local_map"] == "grid" for point in alone.points)
    assert len(alone.points[0].levels) == 1


def test_points_between_levels_stay_within_the_range_and_among_the_names():
    between = study().designs[2]
    values = [point.method["epsilon"] for point in between.points]
    assert all(1e-6 <= value <= 1e-2 for value in values)
    assert len(set(values)) == 8
    assert {point.levels["stages"].label for point in between.points} == {"both", "second"}
    assert ((between.positions[:, 0] >= 0) & (between.positions[:, 0] <= 2)).all()


def test_every_run_is_one_task_and_tasks_on_one_sequence_are_neighbours():
    jobs = study().tasks()
    assert len({job.name for job in jobs}) == len(jobs)
    seeds = [job.arguments["sequence"]["seed"] for job in jobs]
    assert seeds == sorted(seeds)
    assert set(seeds) == {0, 1, 3}


def test_dealt_seeds_give_each_point_one_seed_in_turn():
    grid = study(lambda content: content["design"][0].update(deal=True, seeds=[4, 5, 6])).designs[0]
    assert [grid.runs(point) for point in grid.points[:4]] == [(4,), (5,), (6,), (4,)]


def drop(key):
    return lambda content: content.pop(key)


def factor(**entries):
    return lambda content: content["factor"][0].update(entries)


def design(**entries):
    return lambda content: content["design"][0].update(entries)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (drop("method"), r"s.toml: no table \[method\]"),
        (drop("factor"), r"no \[\[factor\]\]: a study needs at least one"),
        (drop("response"), r"no \[\[response\]\]"),
        (lambda c: c.update(factors=[]), "no key named 'factors' \\(did you mean 'factor'\\?\\)"),
        (lambda c: c["method"].update(use="ipc"), "no backend named 'ipc'"),
        (lambda c: c["response"][0].update(metric="ate"), "response 1: no metric named 'ate'"),
        (lambda c: c["response"][0].update(lost=0), "response 1: 'lost': found 0, expected a number \\(positive"),
        (lambda c: c.update(seeds=[]), "'seeds': found \\[\\], expected a list"),
        (factor(levels=[]), "factor 1 \\(epsilon\\): 'levels': found \\[\\], expected a list of at least two"),
        (factor(levels=[1e-4]), "'levels': found \\[0.0001\\], expected at least two that differ"),
        (factor(levels=[1e-4, 1e-6]), "expected numbers in rising order"),
        (factor(levels=[-1e-4, 1e-6]), "expected positive numbers on a log scale"),
        (factor(levels=[1e-6, "fine"]), "expected values of one type"),
        (factor(levels=[-1.0, 1.0], scale="linear"), "factor 'epsilon': method: parameter 'epsilon': found -1.0"),
        (factor(sets="epsilon"), "'sets': found 'epsilon', expected method.NAME"),
        (factor(sets="method.epsilom"), "no parameter named 'epsilom' \\(did you mean 'epsilon'\\?\\)"),
        (factor(sets="method.local_map"), "factor 'epsilon': method: parameter 'local_map': found 1e-06"),
        (factor(scale="cubic"), "'scale': found 'cubic', expected linear or log"),
        (factor(steps=3), "no key named 'steps'"),
        (lambda c: c["factor"][2].update(levels=[-0.05, 0.1]), "parameter 'local_map_cell_m': found -0.05"),
        (lambda c: c["factor"][3].update(levels={"a": {}, "b": {}}), "'levels.a': found {}, expected { NAME = VALUE"),
        (lambda c: c["factor"].append(c["factor"][0]), "two factors are named 'epsilon'"),
        (design(factors=["epsilom"]), "design 1 \\(all\\): no factor named 'epsilom' \\(did you mean 'epsilon'\\?\\)"),
        (design(factors=[]), "'factors': found \\[\\], expected a list of factors' names"),
        (design(kind="full"), "no kind of design named 'full'"),
        (design(deal="yes"), "'deal': found 'yes', expected true or false"),
        (design(points=3), "'points': found 3; a design 'grid' has none"),
        (design(kind="optimal"), "'points': found None, expected a whole number from 1"),
        (design(kind="optimal", points=5), "'points': found 5, expected more than 12, the columns of its model"),
        (design(kind="fractional", resolution=9), "'resolution': found 9, expected 3, 4 or 5"),
        (design(**{"with": {"method.local_map": "tiles"}}), "parameter 'local_map': found 'tiles', expected one of"),
        (design(seeds=[-1]), "design 1 \\(all\\): 'seeds': found \\[-1\\]"),
        (lambda c: c.update(envelope=[{"design": "alone"}]), "no grid design named 'alone'; known: all"),
        (
            lambda c: c.update(envelope=[{"design": "all", "x": "stages"}]),
            "'x': no factor with numbers named 'stages'; known: cell, epsilon",
        ),
        (lambda c: c["sequence"].update(laps=1e-9), "parameter 'laps'"),
        (design(**{"with": ["method.local_map"]}), "'with': found .*, expected a table of settings"),
        (design(**{"with": {"robot.wheel_m": 0.1}}), "no setting named 'robot.wheel_m'"),
        (lambda c: c["response"][0].update(scale="cubic"), "response 1: 'scale': found 'cubic', expected linear or"),
        (lambda c: c.update(envelope=[{"design": "all", "x": "cell", "y": "cell"}]), "'y': .* another factor than 'x'"),
        (factor(levels=[[1], [2]]), "'levels': found \\[1\\], expected numbers, texts, true or false"),
        (lambda c: c["factor"][3].update(name=""), "'name': found '', expected a text"),
        (lambda c: c["factor"][3].update(levels={"a": {"method.x": []}, "b": {}}), "expected values for .method.NAME"),
        (lambda c: c["factor"][3].update(scale="log"), "'scale': log is for numbers; remove the key"),
    ],
)
def test_errors_of_a_study_file_name_table_and_key(change, message):
    with pytest.raises(BadExperiment, match=message):
        study(change)


def test_two_factors_that_set_the_same_parameter_cannot_share_a_design():
    def twice(content):
        content["factor"].append({**content["factor"][0], "name": "again"})
        content["design"][0]["factors"].append("again")

    with pytest.raises(BadExperiment, match=r"'epsilon' and 'again' both set method\.epsilon; keep one"):
        study(twice)


def test_a_missing_study_file_is_an_error(tmp_path):
    with pytest.raises(BadExperiment, match="no such file"):
        config.load_study(tmp_path / "none.toml", "")
