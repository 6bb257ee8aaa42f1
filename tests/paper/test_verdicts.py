"""Every verdict is computed, and every one can be "not reproduced"."""

import inspect

import pytest

from evalkit_paper import verdicts
from evalkit_paper.chapter import Finding, Judgement
from evalkit_paper.page import findings_section

NOT_REPRODUCED = {
    "judge": (False, "yes", "no"),
    "judge_formula": (0.1,),
    "judge_correction": (0.0, 0.9, "the other sign"),
    "judge_subsets": (480.0, 108.0),
    "judge_error": (50.0, 5.0),
    "judge_error_time": (4.0, 5.0),
    "judge_free_space": (1.0,),
    "judge_stages": (["fit", "find"], ["find", "fit"]),
    "judge_number": (4.4,),
    "judge_convergence": (0.9, 0.0, ""),
    "judge_extents": (10.0, 14.0),
    "judge_overlap": ({1.0: 1.0, 0.7: 0.5}, {1.0: 1.0, 0.7: 0.5}, 0.7, "near pairs"),
    "judge_initial_guess": (0.5, 0.001),
    "judge_two_stages": ([1.0, 2.0], 0.9),
    "judge_steady": ({"5 Hz": (0.01, 0.025), "10 Hz": (0.02, 0.04)}, ""),
    "judge_low": (1.2,),
    "judge_spikes": (2, 2, 0.5, 1),
    "judge_map": ({"paper": 0.2, "odometry": 0.1}, 0.9),
    "judge_difference": ([0.1, -0.1, 0.05], "a better map"),
    "judge_loops": (3.0, 1.5, "mean distance"),
    "judge_light": (10.0, 66.0),
    "judge_study": (0, 5),
    "judge_cells": ({"0.05": 0.90, "0.1": 0.89},),
    "judge_open_choices": ({"bounds": (0.1, 0.3)},),
    "judge_slow": ([True, False],),
    "judge_fast": ([False, False],),
    "judge_real_time": (0.5,),
}

OTHERWISE = {
    "judge_formula": [((1e-12,), "reproduced")],
    "judge_correction": [((1.0, 1.0, "x"), "reproduced"), ((0.5, 1.0, "x"), "reproduced with a correction")],
    "judge_error": [((1.0, 9.0), "reproduced"), ((50.0, 1.0), "reproduced with a correction")],
    "judge_error_time": [((1.0, 1.0), "not determined by the text"), ((1.0, 9.0), "reproduced with a correction")],
    "judge_number": [((2.9,), "reproduced"), ((2.9, "the mean"), "reproduced with a correction")],
    "judge_overlap": [(({1.0: 1.0, 0.7: 1.0}, {}, 0.7, "x"), "reproduced"),
                      (({1.0: 1.0, 0.7: 0.9}, {1.0: 1.0, 0.7: 1.0}, 0.7, "x"), "reproduced with a correction")],
    "judge_steady": [(({"5 Hz": (0.021, 0.029)}, ""), "reproduced"),
                     (({"5 Hz": (0.021, 0.029), "10 Hz": (0.021, 0.031)}, ""), "not determined by the text")],
    "judge_spikes": [((1, 2, 0.5, 0), "reproduced"), ((1, 2, 9.0, 0), "not reproduced"),
                     ((0, 2, 0.0, 0), "not reproduced")],
    "judge_difference": [(([0.1, 0.11, 0.09], "x"), "reproduced"), (([0.1, 0.1], "x"), "not reproduced")],
    "judge_two_stages": [(([0.006, 0.008], 0.009), "reproduced"),
                         (([0.006, 0.009], 0.009), "not determined by the text"),
                         (([0.002, 0.008], 0.009), "not determined by the text")],
    "judge_study": [((2, 5), "not determined by the text")],
    "judge_cells": [(({"0.05": 0.90, "0.2": 0.64},), "not determined by the text")],
    "judge_open_choices": [(({"a": (0.80, 0.81)},), "reproduced"),
                           (({"a": (0.7, 0.8)},), "not determined by the text")],
    "judge_real_time": [((2.0,), "not reproducible in software")],
}  # fmt: skip


def test_every_verdict_function_has_a_case_that_is_not_reproduced():
    functions = {name for name, _ in inspect.getmembers(verdicts, inspect.isfunction) if name.startswith("judge")}
    assert functions == set(NOT_REPRODUCED)


@pytest.mark.parametrize("name", NOT_REPRODUCED)
def test_every_verdict_can_be_not_reproduced(name):
    found = getattr(verdicts, name)(*NOT_REPRODUCED[name])
    assert found.verdict == "not reproduced"
    assert found.why


@pytest.mark.parametrize(
    ("name", "measured", "verdict"), [(name, *case) for name, cases in OTHERWISE.items() for case in cases]
)
def test_other_measurements_give_other_verdicts(name, measured, verdict):
    assert getattr(verdicts, name)(*measured).verdict == verdict


def test_a_correction_is_named_and_a_missing_one_is_an_error():
    assert verdicts.judge(True, "yes", "no", "mean distance").correction == "mean distance"
    for verdict, correction in (("reproduced with a correction", ""), ("reproduced", "mean distance")):
        with pytest.raises(ValueError, match="correction"):
            Judgement(verdict, "why", correction)


def test_the_table_of_findings_counts_verdicts_and_names_the_correction():
    found = [
        Finding("Table 1, k", "25", "24", Judgement("reproduced with a correction", "it fits", "the mean"), "t"),
        Finding("Table 1, y", "5.02", "5.00", Judgement("not reproduced", "off"), "t"),
    ]
    told, table = findings_section(found).blocks
    assert told.body == "2 items: 1 reproduced with a correction, 1 not reproduced."
    assert [row[-1] for row in table.rows] == ["Correction: the mean. It fits.", "Off."]
    assert table.rows[1][3].tone == "bad"
