"""Determinism of repeated runs."""

import numpy as np
import pytest

from evalkit.commands.validate.determinism import compare_runs, measure_determinism
from evalkit.core.run_result import STEP, RunResult


def run(*xs):
    steps = np.zeros(len(xs), dtype=STEP)
    steps["stamp_ns"], steps["x"] = np.arange(len(xs)), xs
    return RunResult(steps, len(xs))


SAME, OTHER = run(0.0, 1.0), run(0.0, 1.0 + 2**-40)


@pytest.mark.parametrize(
    ("runs", "verdict"),
    [
        ({1: [SAME, SAME], 2: [SAME, SAME]}, "bit-equal"),
        ({1: [SAME, SAME], 2: [OTHER, OTHER]}, "thread-dependent"),
        ({1: [SAME, SAME], 2: [SAME, OTHER]}, "not deterministic"),
        ({1: [SAME, OTHER], 2: [SAME, SAME]}, "not deterministic"),
    ],
)
def test_a_difference_of_one_bit_is_detected_and_classified_by_threads(runs, verdict):
    found = compare_runs("b", runs)
    assert found.verdict == verdict
    assert found.apart_m == (0.0 if verdict == "bit-equal" else 2**-40)
    assert found.scans == 2


def test_a_random_back_end_is_not_deterministic_and_a_correct_one_is(strangers):
    sound = measure_determinism("faulty", {}, "straight", {}, threads=(1,))
    assert (sound.verdict, sound.apart_m, sound.scans) == ("bit-equal", 0.0, 12)
    lots = measure_determinism("lots", {}, "straight", {}, threads=(1,))
    assert lots.verdict == "not deterministic"
    assert 0.0 < lots.apart_m < 1.0
