"""The default report shows a closed loop."""

from pathlib import Path

from evalkit.config.experiment_file import load_experiment
from evalkit.metrics.loop_closures import judge_closures
from evalkit.odometry.run_odometry import estimate_poses
from evalkit.plugins import registry

REPORTS = Path(__file__).parents[3] / "reports"


def test_a_slam_closes_a_loop_on_data_that_it_was_not_tuned_on():
    (run,) = load_experiment(REPORTS / "default.toml").select(["random-office lap"], ["embedded-slam"], []).runs()
    assert run.sequence.dataset not in run.method.tuned_on
    sequence = registry.dataset(run.sequence.dataset).make(**run.dataset_parameters)
    slam = registry.backend(run.method.backend).make(**run.method.parameters)
    estimate_poses(slam, sequence.frames())
    closures, truth = slam.loop_closures(), sequence.truth().trajectory
    assert any(one.accepted for one in closures)
    assert truth is not None
    assert judge_closures(closures, truth).right.all()
