"""Operating envelopes of known functions."""

import numpy as np
import pytest

from evalkit.commands.study.envelope import compute_panels, describe_panels, find_largest_box, mark_enclosed_cells
from evalkit.commands.study.plan import Design, EnvelopeChoice, Point, Study, format_task_name
from evalkit.commands.study.result import StudyResult
from evalkit.design.factors import Factor, FactorLevel
from evalkit.design.responses import Response
from evalkit.metrics import METRICS

SPEEDS, TURNS = (0.5, 1.0, 2.0), (10.0, 20.0, 40.0, 80.0)
ATE = Response(next(metric for metric in METRICS if metric.name == "ate_rmse_m"), "log", 1.0)


def numbers(name, values, unit=""):
    return Factor(name, tuple(FactorLevel(f"{v:g}", {f"sequence.{name}": v}, v) for v in values), 0, "linear", unit)


def make_result(error, seeds=(0, 1), status=lambda *_: "complete"):
    """A study over speed, turn and deskewing whose error is a function of the three and the seed."""
    factors = (
        numbers("speed", SPEEDS, "m/s"), numbers("turn", TURNS, "deg/s"),
        Factor("deskew", (FactorLevel("off", {"method.deskew": False}), FactorLevel("on", {"method.deskew": True}))),
    )  # fmt: skip
    points, results = [], {}
    for speed in factors[0].levels:
        for turn in factors[1].levels:
            for deskew in factors[2].levels:
                levels = {"speed": speed, "turn": turn, "deskew": deskew}
                settings = {name: value for level in levels.values() for name, value in level.sets.items()}
                points.append(Point(levels, settings, {}, {}))
                for seed in seeds:
                    value = error(speed.number, turn.number, deskew.label == "on", seed)
                    how = status(speed.number, turn.number, deskew.label == "on", seed)
                    results[format_task_name(points[-1].key, seed)] = {
                        "status": how, "reason": "" if how == "complete" else "it broke",
                        "scores": {"ate_rmse_m": value}, "why": {}, "cpu_s": 0.1,
                    }  # fmt: skip
    design = Design("grid", "grid", factors, np.zeros((len(points), 3)), tuple(points), seeds)
    choice = EnvelopeChoice("grid", "speed", "turn", ATE, 0.1)
    study = Study("t", "", "evalkit study t", "b", "d", "m", 10, "", (ATE,), factors, (design,), (choice,))
    return StudyResult(study, results), choice, design


def test_inside_includes_all_smaller_conditions():
    held = np.array([[1, 1, 0, 1], [1, 0, 1, 1], [1, 1, 1, 1]], dtype=bool)
    assert mark_enclosed_cells(held).astype(int).tolist() == [[1, 1, 0, 0], [1, 0, 0, 0], [1, 0, 0, 0]]


@pytest.mark.parametrize(
    ("rows", "box"),
    [
        ([[1, 1, 1], [1, 1, 1]], (3, 2)),
        ([[1, 1, 1], [1, 0, 0], [1, 0, 0]], (3, 1)),
        ([[1, 1, 0], [1, 1, 0], [1, 0, 0]], (2, 2)),
        ([[0, 1], [1, 1]], (0, 0)),
    ],
)
def test_the_largest_box_starts_at_the_smallest_levels(rows, box):
    assert find_largest_box(mark_enclosed_cells(np.array(rows, dtype=bool))) == box


def test_the_envelope_of_a_product_is_its_hyperbola():
    found, choice, _ = make_result(lambda v, w, on, seed: 0.001 * v * w * (0.5 if on else 4.0))
    off, on = compute_panels(found, choice)
    assert on.inside.all()
    assert off.inside.tolist() == [[bool(0.004 * v * w <= 0.1) for v in SPEEDS] for w in TURNS]
    assert off.box == (2, 2)  # 1 m/s and 20 deg/s: four cells; 2 m/s and 10 deg/s would be three
    assert off.held.support == 8  # four cells, two seeds
    assert 0.6 < off.held.low < off.held.value == 1.0


def test_the_worst_seed_decides_and_a_cell_with_a_lost_seed_is_outside():
    found, choice, _ = make_result(
        lambda v, w, on, seed: 2.0 if (v, w, on, seed) == (1.0, 20.0, True, 1) else 0.01,
        status=lambda v, w, on, seed: "failed" if (v, w, on) == (0.5, 10.0, False) else "complete",
    )
    off, on = compute_panels(found, choice)
    assert not off.inside.any()
    assert off.box == (0, 0)
    assert np.isnan(off.worst[0, 0])
    assert off.lost[0, 0] == 2
    assert np.isnan(on.worst[1, 1])
    assert on.lost.sum() == 1
    assert on.box == (1, 4)


def test_the_sentence_names_levels_and_number_of_drives():
    found, choice, design = make_result(lambda v, w, on, seed: 0.001 * v * w * (0.1 if on else 4.0))
    assert describe_panels(choice, design, compute_panels(found, choice)) == [
        "deskew off: up to 1 m/s and 20 deg/s (8 of 8 drives).",
        "deskew on: up to 2 m/s and 80 deg/s, the largest levels tested (24 of 24 drives).",
    ]


def test_a_lost_run_has_its_bound_as_value():
    found, _, design = make_result(lambda v, w, on, seed: 50.0 if v == 2.0 else 0.5)
    table = found.table(design, ATE)
    assert table.shape == (24, 2)
    assert sorted(set(table.ravel().tolist())) == [0.5, 1.0]
    assert found.counts(design) == (16, 48)
