"""The shipped reports show a closed loop."""

from pathlib import Path

import pytest

from evalkit.config.experiment import load_experiment
from evalkit.core.errors import DataMissing
from evalkit.metrics.loop_closures import judge_closures
from evalkit.odometry.run_odometry import estimate_poses
from evalkit.plugins import registry

REPORTS = Path(__file__).parents[3] / "reports"


@pytest.mark.parametrize(("file", "label"), [("default.toml", "lab lap"), ("quick.toml", "wheelchair")])
def test_a_slam_closes_a_loop_on_data_that_it_was_not_tuned_on(file, label):
    (run,) = load_experiment(REPORTS / file).select([label], ["embedded-slam"], []).runs()
    assert run.sequence.dataset not in run.method.tuned_on
    try:
        sequence = registry.dataset(run.sequence.dataset).make(**run.dataset_parameters)
    except DataMissing as error:
        pytest.skip(str(error))
    slam = registry.backend(run.method.backend).make(**run.method.parameters)
    estimate_poses(slam, sequence.frames())
    closures, truth = slam.loop_closures(), sequence.truth().trajectory
    assert any(one.accepted for one in closures)
    assert truth is None or judge_closures(closures, truth).right.all()
