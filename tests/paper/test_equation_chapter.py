"""The equations of the paper taken literally: every consequence on the page is computed and correct."""

import re

import numpy as np
import pytest

from evalkit.report.html.blocks import Document, render
from evalkit_paper import equation_chapter, equation_checks
from evalkit_paper.equation_checks import rotation_as_printed, rotation_with_guard, rotation_without_guard

DRIVE = {"sequence": "room", "seed": 0, "laps": 0.1}


def rotate(points, angle):
    return points @ np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])


def test_the_printed_rotation_is_the_transpose_of_the_correct_one():
    source = np.random.default_rng(0).normal(size=(20, 2))
    K = source.T @ rotate(source, 0.4)
    np.testing.assert_allclose(rotation_as_printed(K), rotation_with_guard(K).T, atol=1e-12)
    assert np.arctan2(rotation_with_guard(K)[1, 0], rotation_with_guard(K)[0, 0]) == pytest.approx(0.4)


def test_with_the_printed_rotation_icp_does_not_converge():
    found = equation_checks.check_transpose(seeds=4)
    assert found["printed_reached"] == 0
    assert found["correct_reached"] == 4
    assert found["printed"][:, -1].min() > 10 * found["correct"][:, -1].max()


def test_without_the_guard_about_half_of_noisy_walls_are_mirrored_and_with_it_none():
    found = equation_checks.check_mirrored_walls(walls=300)
    assert 100 < found["unguarded"] < 200
    assert found["guarded"] == 0
    assert found["worst_m"] == pytest.approx(2.0, abs=0.01)


def test_the_guard_changes_only_mirrored_results():
    source = np.random.default_rng(1).normal(size=(20, 2))
    K = source.T @ rotate(source, -1.0)
    np.testing.assert_allclose(rotation_without_guard(K), rotation_with_guard(K), atol=1e-12)


def test_the_mean_square_stops_after_two_iterations_from_the_odometry_guess():
    found = equation_checks.compare_stop_rules(**DRIVE, most=6, guess="odometry")
    assert np.median(found["rules"]["printed"]["iterations"]) == 2.0
    assert np.median(found["rules"]["tight"]["iterations"]) > 6.0
    assert np.median(found["rules"]["printed"]["first_square"]) < 3e-3


def test_from_a_worse_guess_the_mean_square_stops_farther_from_the_solution():
    found = equation_checks.compare_stop_rules(**DRIVE, most=6, guess="off")
    assert found["guess_m"] == pytest.approx([0.05] * 6)
    assert found["guess_deg"] == pytest.approx([2.0] * 6)
    printed, tight = (np.median(found["rules"][rule]["error_deg"]) for rule in ("printed", "tight"))
    assert printed > 1.5 * tight


def test_table_1_is_missed_by_the_mean_square_and_met_by_the_mean_distance():
    found = equation_checks.measure_table_errors(seeds=12)
    assert 0.0 <= (found["before"] - found["after"])[:, 0].mean() < 1.5
    assert found["after sigmas"][2] < 2.0 < 50.0 < found["square sigmas"][2]


def test_body_frame_steps_multiplied_on_the_left_diverge_and_on_the_right_do_not():
    found = equation_checks.check_composition(sequence="room", seed=0, laps=0.6)
    assert found["right_error_m"] < 1e-9
    assert found["left_error_m"] > 0.1 * found["path_m"]


def test_the_printed_update_clears_free_space():
    found = equation_checks.check_free_space(**DRIVE, every=5)
    assert found["cells"] > 10_000
    assert found["wrong"] < 0.02


def test_only_the_filter_gives_both_subsets_equal_size():
    found = equation_checks.count_shared_targets(seeds=2)
    assert found["pairs_all"] == found["points"] > found["targets_all"]
    assert found["pairs_one"] == found["targets_one"] == found["targets_all"]


def test_the_formulae_of_the_software_are_those_of_the_paper():
    found = equation_checks.check_formulas(count=20)
    assert set(found) == {"extrinsics", "nearest", "alignment", "matrix", "heading", "logistic", "count"}
    assert max(value for key, value in found.items() if key != "count") < 1e-7


def test_a_wrong_formula_is_found(monkeypatch):
    monkeypatch.setattr(equation_checks.icp, "fit_motion", lambda source, target: np.array([0.0, 0.0, 0.1]))
    assert equation_checks.check_formulas(count=3)["alignment"] > 0.01


def test_every_finding_is_on_the_page_with_all_its_numbers():
    chapter = equation_chapter.CHAPTER
    settings = chapter.settings("test", {"seeds": 3, "walls": 50, "sequence": "room", "laps": 0.1, "pairs": 5})
    results = {}
    for task in chapter.tasks(settings):
        assert task.function.__module__ == equation_checks.__name__
        results[task.name], _ = task.run()
    page = render(Document("", "", "", chapter.sections(settings, results)))
    for finding in chapter.findings(settings, results):
        assert finding.anchor == "equations"
        assert finding.item.split(",")[0] in page
        assert finding.judgement.verdict != "not reproduced"
    assert "0 of 3 seeds reach the true motion" in page
    assert not re.search(r"\bnan\b", re.sub(r"base64,[^\"]*", "", page))
