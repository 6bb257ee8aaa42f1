"""The real-time chapter: synthetic results for several device speeds."""

import numpy as np
import pytest

from evalkit.report.html.blocks import Document, render
from evalkit_paper import realtime_chapter
from evalkit_paper.realtime_chapter import Ladder

SETTINGS = {"seeds": 2, "laps": 0.1, "rates_hz": "10", "methods": "own", "largest_factor": 100}


def rung(factor, ate_m, lost="", dropped=0.0):
    measures = {"ate_rmse_m": ate_m, "rpe_1m_m": ate_m, "heading_rmse_deg": 0.1}
    return {
        "factor": factor, "answered": 10, "dropped": dropped, "late": 0.0, "age_ms": [1.0, 2.0],
        "of_answers": measures, "at_hand": measures, "lost": lost, "predicted": None,
    }  # fmt: skip


def ladder(*ates):
    factors = (0.0, 10.0, 100.0)
    results = [
        {"devices": [rung(f, a, "" if a else "lost") for f, a in zip(factors, own, strict=True)]} for own in ates
    ]
    return Ladder("one", 10.0, results)


def test_a_method_breaks_where_the_median_over_seeds_doubles_and_exceeds_5_cm():
    assert ladder((0.02, 0.03, 0.06)).breaks_at() == 100.0
    assert ladder((0.02, 0.03, 0.06), (0.02, 0.03, 0.03), (0.02, 0.03, 0.03)).breaks_at() is None
    assert ladder((0.001, 0.01, 0.04)).breaks_at() is None  # 40 times as large, but small enough


def test_a_method_lost_with_most_seeds_is_broken():
    assert ladder((0.02, None, 0.02), (0.02, None, 0.02), (0.02, 0.02, 0.02)).breaks_at() == 10.0
    assert ladder((0.02, None, 0.02), (0.02, 0.02, 0.02), (0.02, 0.02, 0.02)).breaks_at() is None


def make_ladder(task):
    factors = [0.0, *task.arguments["factors"]]
    rungs = [rung(factor, 0.01 + 0.002 * factor, dropped=min(factor / 100.0, 0.9)) for factor in factors]
    linear = {"base_ns": 1e6, "step_ns": 10.0, "residual": 0.1, "held_out": 0.2}
    return {
        "devices": rungs, "costs_ns": np.full(5, 1_000_000), "headroom": 50.0, "gaps": np.array([1, 2]),
        "growth": np.array([1.0, 1.2]), "linear": linear if task.arguments["backend"] == "paper" else None,
    }  # fmt: skip


@pytest.mark.parametrize("changed", [{}, {"methods": "all"}])
def test_the_chapter_is_rendered_for_any_result(changed):
    settings = realtime_chapter.CHAPTER.settings("test", SETTINGS | changed)
    tasks = realtime_chapter.CHAPTER.tasks(settings)
    assert len({task.name for task in tasks}) == len(tasks)
    assert tasks[0].arguments["factors"] == [1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0]
    results = {task.name: make_ladder(task) for task in tasks}
    (section,) = realtime_chapter.CHAPTER.sections(settings, results)
    page = render(Document("test", "test", "", (section,)))
    assert "No board is measured" in page
    (finding,) = realtime_chapter.CHAPTER.findings(settings, results)
    assert finding.judgement.verdict == "not reproducible in software"
    assert "breaks at 50" in finding.measured  # 11 cm at 50, 5 cm at 20
