"""A run as the worker makes it, in this process: what is timed, written and noted."""

import json

import numpy as np
import pytest

from evalkit import worker
from evalkit.store import read_steps
from evalkit.worker import Request

pytestmark = pytest.mark.usefixtures("strangers")

ROOM = {"laps": 0.02, "seed": 3}


def perform(folder, backend="wheel-odometry", parameters=None, dataset="straight", course=None):
    if dataset == "straight":
        course = {"scans": 12, "backwards": 0, "file": "", "breaks": False, **(course or {})}
    return worker.perform(Request(backend, parameters or {}, dataset, course), folder), read_steps(folder / "steps.bin")


def test_the_warm_up_is_another_instance_so_the_first_answer_is_the_identity(tmp_path):
    outcome, steps = perform(tmp_path)
    assert (outcome.status, outcome.reason, outcome.expected, outcome.warm_up_scans) == ("complete", "", 12, 5)
    assert steps[["x", "y", "theta"]][0].tolist() == (0.0, 0.0, 0.0)
    assert steps["x"].tolist() == pytest.approx([0.1 * k for k in range(12)])
    assert json.loads((tmp_path / "begun.json").read_text()) == {"expected": 12, "warm_up_scans": 5}


def test_a_sequence_shorter_than_the_warm_up_is_all_warm_up_and_all_run(tmp_path):
    outcome, steps = perform(tmp_path, course={"scans": 3})
    assert (outcome.warm_up_scans, outcome.expected, len(steps)) == (3, 3, 3)


def test_an_odometry_has_no_residuals_and_a_registration_has_those_of_both_stages(tmp_path):
    from evalkit import frontend, registry

    _, steps = perform(tmp_path)
    assert np.isnan(steps["s2s_error"]).all()
    assert (steps["s2m_inliers"] == 0).all()
    parameters = frontend.complete_parameters("t", registry.backend("paper"), {})
    (tmp_path / "paper").mkdir()
    outcome, steps = perform(tmp_path / "paper", "paper", parameters, "room", ROOM)
    assert outcome.status == "complete"
    assert np.isnan(steps["s2s_error"][0])
    assert (steps["s2s_error"][1:] > 0).all()
    assert (steps["s2m_inliers"][1:] > 100).all()


def test_the_sequences_notes_are_kept(tmp_path):
    outcome, _ = perform(tmp_path, dataset="room", course=ROOM)
    assert outcome.notes["invalid ranges"] > 0


def test_an_absent_library_and_absent_data_have_statuses_of_their_own(tmp_path):
    outcome, steps = perform(tmp_path, "absent")
    assert outcome.status == "not-installed"
    assert outcome.reason == "absent: not installed; the library 'nowhere' is not installed; pip install nowhere"
    assert len(steps) == 0
    outcome, _ = perform(tmp_path, course={"file": str(tmp_path / "gone")})
    assert outcome.status == "data-missing"
