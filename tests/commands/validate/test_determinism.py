"""Whether a back end answers the same when it is asked again."""

import numpy as np
import pytest

from evalkit.commands.validate.determinism import determinism, judged
from evalkit.core.run_result import STEP, RunResult


def run(*xs):
    steps = np.zeros(len(xs), dtype=STEP)
    steps["stamp_ns"], steps["x"] = np.arange(len(xs)), xs
    return RunResult(steps, len(xs))


SAME, OTHER = run(0.0, 1.0), run(0.0, 1.0 + 2**-40)


@pytest.mark.parametrize(
    ("made", "verdict"),
    [
        ({1: [SAME, SAME], 2: [SAME, SAME]}, "bit-equal"),
        ({1: [SAME, SAME], 2: [OTHER, OTHER]}, "thread-dependent"),
        ({1: [SAME, SAME], 2: [SAME, OTHER]}, "not deterministic"),
        ({1: [SAME, OTHER], 2: [SAME, SAME]}, "not deterministic"),
    ],
)
def test_one_bit_is_enough_and_its_place_decides(made, verdict):
    found = judged("b", made)
    assert found.verdict == verdict
    assert found.apart_m == (0.0 if verdict == "bit-equal" else 2**-40)
    assert found.scans == 2


def test_a_back_end_that_draws_lots_is_found_and_one_that_fails_says_why(strangers):
    sound = determinism("faulty", "straight", {}, threads=(1,))
    assert (sound.verdict, sound.apart_m, sound.scans) == ("bit-equal", 0.0, 12)
    lots = determinism("lots", "straight", {}, threads=(1,))
    assert lots.verdict == "not deterministic"
    assert 0.0 < lots.apart_m < 1.0
