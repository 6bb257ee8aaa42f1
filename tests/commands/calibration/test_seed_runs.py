"""Runs of one seed: every method is scored, and its series yields the score."""

from __future__ import annotations

import numpy as np
import pytest

from evalkit.commands.calibration.command import measure
from evalkit.commands.calibration.seed_runs import DRIFTS, read_runs, run_seed
from evalkit.config.experiment import experiment_from_tables
from evalkit.core.errors import BadExperiment


def _experiment(**sequence):
    content = {"method": [{"use": "wheel-odometry", "label": "wheels"}], "sequence": [sequence]}
    return experiment_from_tables(content, "exp.toml", "exp", "compare exp.toml")


def test_a_seed_is_run_by_every_method_and_the_series_yield_the_scores():
    plan = _experiment(use="room", laps=0.1, rate_hz=5.0)
    (method,), (sequence,) = plan.methods, plan.sequences
    parameters = sequence.parameters_with_seed(3)
    found = run_seed(sequence.dataset, parameters, 3, [(method.label, method.backend, dict(method.parameters))])
    for label in ("wheels", *DRIFTS):
        errors = found[f"{label}|ate_rmse_m|values"]
        assert np.sqrt(np.mean(errors**2)) == pytest.approx(found[f"{label}|ate_rmse_m|score"], rel=0.02)
    scores = [found[f"{label}|ate_rmse_m|score"] for label in DRIFTS]
    assert scores[0] != scores[1]
    runs = read_runs("room", "wheels", "ate_rmse_m", [found, {}])
    assert runs.values == (found["wheels|ate_rmse_m|score"],)
    assert runs.draws[0].values.mean() == pytest.approx(runs.values[0], rel=0.3)


def test_a_recording_has_no_seeds_to_calibrate_with(tmp_path):
    path = tmp_path / "a.log"
    path.write_text("FLASER\n")
    plan = _experiment(use="carmen", path=str(path))
    with pytest.raises(BadExperiment, match="carmen: is a recording; give simulated worlds, which have seeds"):
        measure(plan, 20, 50, tmp_path, 1)
