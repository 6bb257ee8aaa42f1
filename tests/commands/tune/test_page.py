"""The page of a tuning: better, equal and overfitted results on held-out runs, and its JSON output."""

import json
import math

import numpy as np
import pytest

from evalkit.commands.tune import page, results_json, search_loop
from evalkit.commands.tune.config import tuning_from_tables
from evalkit.commands.tune.objective import ScoredCandidate, compute_error_ratio, is_better, mark_pareto_front
from evalkit.commands.tune.result import TuningResult
from evalkit.commands.tune.space import TuningCandidate
from evalkit.report.html.blocks import Cell, Table, render

ATE = "ate_rmse_m"
SEEDS = range(10)


def plan():
    sequence = {"use": "lab", "laps": 0.05}
    return tuning_from_tables(
        {
            "title": "<script>alert(1)</script>",
            "points": 8,
            "method": [{"use": "embedded", "label": "a", "search": {"epsilon": {"levels": [1e-6, 1e-2]}}}],
            "training": [sequence | {"seeds": [0, 1], "confirm": [2, 3, 4, 5]}],
            "held-out": [{"use": "room", "laps": 0.05}],
        },
        "some.toml", "some", "evalkit tune some.toml",
    )  # fmt: skip


def found():
    """Search with a known function: a larger epsilon has less error and more time; a small one loses its runs."""

    def compute_task(job):
        epsilon, seed = job.arguments["parameters"]["epsilon"], job.arguments["sequence"]["seed"]
        lost = epsilon < 1e-5
        scores = {ATE: None if lost else (1.0 + 0.01 * seed) * 1e-5 / epsilon, "cpu_median_ms": 100.0 * epsilon}
        why = {ATE: "nothing answered", "cpu_median_ms": ""}
        status = "failed" if lost else "complete"
        return {"status": status, "reason": "too small", "cpu_s": 1.0, "scores": scores, "why": why}

    return search_loop.run_search(plan(), lambda jobs: {job.name: compute_task(job) for job in jobs})


def build_tuning(build, record, tuned_ate, lost=0, status="failed"):
    records = []
    for seed in SEEDS:
        records.append(record("a", "room", {ATE: 0.10 + 0.001 * seed}, seed=seed, error_m=0.1))
        ended = {"status": status, "reason": "lost the plot"} if seed < lost else {}
        records.append(
            record("a tuned", "room", {ATE: tuned_ate + 0.001 * seed}, seed=seed, error_m=tuned_ate, **ended)
        )
    return TuningResult(plan(), found(), build(records), {"processor": "some"}, "evalkit compare tuned.toml --resume")


def test_four_runs_that_are_all_better_can_be_chance():
    # logarithms -0.10, -0.20, -0.30, -0.05: mean -0.1625, standard error 0.05543, t of 3 degrees of freedom 3.182
    errors = np.exp([-0.10, -0.20, -0.30, -0.05])
    candidate = TuningCandidate((), {}, "step")
    ours, theirs = (ScoredCandidate(candidate, each, ("",) * 4, 1.0, 1.0, False) for each in (errors, np.ones(4)))
    ratio = compute_error_ratio(ours, theirs)
    assert (ratio.value, ratio.low, ratio.high) == pytest.approx(np.exp([-0.1625, -0.3389, 0.0139]), rel=1e-4)
    assert not is_better(ours, theirs, ratio)


@pytest.mark.parametrize(
    ("tuned_ate", "lost", "verdict", "overfitted"),
    [
        (0.05, 0, "better on held-out runs too", False),
        (0.10, 0, "no difference shown over all held-out runs", False),
        (0.20, 0, "overfitted: worse than the default on held-out runs", True),
        (0.05, 3, "overfitted: it loses 3 held-out runs, the default 0", True),
    ],
)
def test_worse_or_lost_held_out_runs_are_overfitting(build, record, tuned_ate, lost, verdict, overfitted):
    result = build_tuning(build, record, tuned_ate, lost)
    held = result.held_out_verdicts["a"]
    assert (held.verdict, held.overfitted) == (verdict, overfitted)
    assert verdict in render(page.build_document(result))


@pytest.mark.parametrize(("status", "said"), [("failed", True), ("skipped", False)])
def test_a_missing_run_is_not_counted_as_lost(build, record, status, said):
    assert ("3 of 10 lost" in render(page.build_document(build_tuning(build, record, 0.05, 3, status)))) is said


def test_the_test_over_runs_is_wilcoxons_signed_rank_test(build, record):
    paired = build_tuning(build, record, 0.05).held_out_verdicts["a"].paired
    assert paired is not None
    assert (paired.runs, paired.better, paired.worse) == (10, 10, 0)
    assert paired.p == pytest.approx(2.0**-9)  # all ten runs in one direction
    assert paired.ratio == pytest.approx(0.0545 / 0.1045, rel=0.02)


def test_the_json_has_every_point_and_the_cost(build, record):
    whole = json.loads(json.dumps(results_json.tuning_as_json(build_tuning(build, record, 0.05)), allow_nan=False))
    (backend,) = whole["backends"]
    assert whole["budget"] == {"points": 8, "seed": 0, "search_runs": 2, "confirming_runs": 4, "run_cpu_s": 60.0}
    assert len(backend["points"]) == backend["spent"]["points"] == 8
    assert backend["spent"]["runs"] == 8 * 2 + 2 * 4
    assert backend["spent"]["cpu_s"] == 24.0
    assert backend["tuned"]
    assert backend["parameters"]["epsilon"] == max(each["parameters"]["epsilon"] for each in backend["points"])
    assert backend["space"] == {"epsilon": {"levels": [1e-6, 1e-2], "scale": "linear", "continuous": True}}


def test_a_point_that_loses_runs_is_not_on_the_pareto_front():
    (one,) = found()
    on = mark_pareto_front(one.tried)
    assert on[[not each.losses for each in one.tried]].all()  # more time, less error: no point dominates another
    assert not on[[bool(each.losses) for each in one.tried]].any()
    assert np.isfinite([each.error for each in one.tried]).all()
    assert math.isclose(one.default.error, 0.1 * math.sqrt(1.01))


def test_a_title_with_a_script_is_escaped(build, record):
    assert "<script>alert(1)" not in render(page.build_document(build_tuning(build, record, 0.05)))


def test_errors_have_the_units_of_every_other_page(build, record):
    summary, held_out = page.build_document(build_tuning(build, record, 0.05)).sections[:2]
    tables = [block for block in held_out.blocks if isinstance(block, Table)]
    cells = [cell.text if isinstance(cell, Cell) else cell for table in tables for row in table.rows for cell in row]
    assert "105\u00a0mm" in cells
    assert any(text.startswith("55\u00a0mm (") for text in cells)
    ratio = np.exp(np.mean([np.log((0.05 + 0.001 * seed) / (0.10 + 0.001 * seed)) for seed in SEEDS]))
    lower = 104.5 * (1.0 - ratio)
    assert any(text.startswith(f"\u2212{lower:.1f}\u00a0mm (97\u00a0% interval") for text in cells)
    assert "100\u00a0mm → 1.0\u00a0mm" in [
        cell.text for block in summary.blocks if isinstance(block, Table) for row in block.rows for cell in row
        if isinstance(cell, Cell)
    ]  # fmt: skip
