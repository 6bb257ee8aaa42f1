"""The rules on the state of an Odometry: nothing but the frames may decide an answer, here, later, elsewhere."""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from evalkit.commands.validate.rules.elsewhere import FORKS, count_other_copies, in_another_thread, run_elsewhere
from evalkit.commands.validate.rules.odometry_fixture import OdometryFixture
from evalkit.commands.validate.rules.rule import RuleBroken, RuleNotApplicable
from evalkit.commands.validate.rules.state_rules import LATER_S
from evalkit.core.se2 import Floats


def check_thread(fixture: OdometryFixture) -> str:
    """A second thread gets the same answers."""
    found = in_another_thread(lambda: fixture.run(fixture.short.frames))
    return _same_answers(fixture.first_answers, found, "in a second thread")


def check_process(fixture: OdometryFixture) -> str:
    """Another process, with other addresses and other values in fresh memory, gets the same answers."""
    if not fixture.elsewhere:
        raise RuleNotApplicable("it has no address by which another process finds it")
    found = run_elsewhere(answers_elsewhere, fixture.elsewhere)
    observed = _same_answers(fixture.first_answers, np.array(found["answers"], dtype=np.float64), "in another process")
    if found["copies"]:
        raise RuleBroken(f"{found['copies']} of {FORKS} copies of a process, with other numbers, have other answers")
    return observed


def check_later(fixture: OdometryFixture) -> str:
    """The answers are the same seconds later."""
    expected = fixture.first_answers
    time.sleep(max(0.37, LATER_S - (time.monotonic() - fixture.asked_s)))
    return _same_answers(expected, fixture.run(fixture.short.frames), f"{LATER_S:g} s later")


def answers_elsewhere(*, address: dict[str, str], parameters: dict[str, Any], seed: int) -> dict[str, Any]:
    """The answers to a short drive, in this process."""
    from evalkit.commands.validate.rules import runner  # noqa: PLC0415 - which imports the rules

    fixture = runner.load_fixture(address, parameters, seed)
    answers = fixture.first_answers
    copies = count_other_copies(lambda: np.array_equal(answers, fixture.run(fixture.short.frames), equal_nan=True))
    return {"answers": answers, "copies": copies}


def _same_answers(expected: Floats, found: Floats, when: str) -> str:
    """Raise RuleBroken at the first scan with another answer (N, 3)."""
    if not np.array_equal(expected, found, equal_nan=True):
        scan = int(np.argmax((expected != found).any(axis=1)))
        answers = f"{found[scan].tolist()}, before {expected[scan].tolist()}"
        raise RuleBroken(f"{when} scan {scan + 1} has another answer: {answers}")
    return f"{len(expected)} answers are the same to the bit {when}"


ODOMETRY_STATE_RULES = (check_thread, check_process, check_later)
