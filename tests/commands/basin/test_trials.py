"""Trials of a back end with wrong guesses: reproducible, and every outcome is a result or a reason."""

from dataclasses import replace

import numpy as np
import pytest

from evalkit.commands.basin import trials as attempts
from evalkit.commands.basin.trials import TrialPlan
from evalkit.core.errors import UnknownName
from evalkit.core.match import Match
from evalkit.core.pose import Pose
from evalkit.plugins.specs import RegistrationSpec

TRIALS = TrialPlan("long-corridor", 40, 4, 90, 0.02, 1.0, 0.5, seed=3)


class KeepsGuess:
    def register(self, target, source, guess):
        return Match(guess, converged=True, iterations=0, error=0.0, inliers=len(source))


class Raises:
    def register(self, target, source, guess):
        if guess.theta > 0.0:
            raise RuntimeError("no turn to the left")
        return Match(Pose(), converged=False, iterations=0, error=0.0, inliers=len(source))


def run_trials(monkeypatch, make, begin=0, end=40):
    spec = RegistrationSpec(make, "", "", "")
    monkeypatch.setattr(attempts, "backend_at", lambda _name: spec)
    return attempts.answers(backend="x", values={}, trials=TRIALS, begin=begin, end=end, code="")


def test_a_registration_that_returns_its_guess_has_the_error_of_the_guess(monkeypatch):
    found = run_trials(monkeypatch, KeepsGuess)
    left = attempts.convergence.compute_offsets(found["rows"], *TRIALS.truths(TRIALS.pairs_of_scans()))
    np.testing.assert_allclose(left, TRIALS.offsets_drawn(), atol=1e-12)
    assert found["claimed"].all()


@pytest.mark.parametrize("pairs", [1, 2, 4, 5, 8, 16])
def test_every_kind_of_guess_is_made_over_all_pairs_alike(pairs):
    trials = replace(TRIALS, offsets=1024, pairs=pairs)
    offsets, numbers = trials.offsets_drawn(), trials.pair_numbers(pairs)
    shifted, turned = offsets[:, 2] == 0.0, ~offsets[:, :2].any(axis=1)
    for kind, count in ((shifted, 256), (turned, 256), (~shifted & ~turned, 512)):
        uses = np.bincount(numbers[kind], minlength=pairs)
        assert uses.sum() == count
        assert uses.max() - uses.min() <= 2


def test_a_trial_does_not_depend_on_its_task(monkeypatch):
    whole = run_trials(monkeypatch, KeepsGuess)["rows"]
    parts = [run_trials(monkeypatch, KeepsGuess, begin, end)["rows"] for begin, end in ((0, 13), (13, 40))]
    assert (np.concatenate(parts) == whole).all()


def test_a_registration_that_raises_gives_a_reason(monkeypatch):
    found = run_trials(monkeypatch, Raises)
    turned = (
        attempts.convergence.make_guesses(TRIALS.offsets_drawn(), *TRIALS.truths(TRIALS.pairs_of_scans()))[:, 2] > 0.0
    )
    assert np.isnan(found["rows"][turned]).all()
    assert np.isfinite(found["rows"][~turned]).all()
    assert "no turn to the left" in found["reason"]


def test_every_scene_and_seed_has_its_own_scans():
    first = TRIALS.pairs_of_scans()[0].source.points
    assert (TRIALS.pairs_of_scans()[0].source.points == first).all()
    other = replace(TRIALS, seed=4).pairs_of_scans()[0].source.points
    assert len(other) != len(first) or (other != first).any()


def test_tasks_cover_all_trials_once(monkeypatch):
    monkeypatch.setattr(attempts, "TRIALS_PER_TASK", 16)
    spec = attempts.backend_at("paper")
    jobs = attempts.make_tasks("paper", spec, {}, TRIALS)
    assert [(job.arguments["begin"], job.arguments["end"]) for job in jobs] == [(0, 16), (16, 32), (32, 40)]


def test_the_icp_of_the_paper_converges_from_near_and_not_from_far():
    trials = replace(TRIALS, place="bare-room", beams=360, offsets=24)
    found = attempts.answers(backend="paper-tight", values={}, trials=trials, begin=0, end=24, code="")
    left = attempts.convergence.compute_offsets(found["rows"], *trials.truths(trials.pairs_of_scans()))
    drawn = trials.offsets_drawn()
    near = (np.hypot(*drawn[:, :2].T) < 0.3) & (np.abs(drawn[:, 2]) < np.radians(5.0))
    assert near.any()
    assert np.hypot(*left[near, :2].T).max() < 0.1
    assert np.hypot(*left[:, :2].T).max() > 0.3


def test_a_back_end_can_be_given_as_module_and_spec():
    assert attempts.backend_at("evalkit_baselines.paper:TIGHT").kind == "registration"
    with pytest.raises(UnknownName, match="no backend named 'papr'"):
        attempts.backend_at("papr")
