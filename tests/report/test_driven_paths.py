"""Driven paths, measured from the runs and not copied from the card of the data set."""

from dataclasses import replace

import numpy as np
import pytest

from evalkit.core.trajectory import Trajectory
from evalkit.metrics.trajectory import IN_MAP
from evalkit.report.analysis.driven_paths import describe_alignments, path_m
from evalkit.report.analysis.sequence import analyse_sequence


def _line(metres):
    """Return a straight path with steps of 1 cm and alternating lateral noise of 1 mm."""
    x = np.arange(0.0, metres + 1e-9, 0.01)
    poses = np.stack([x, 0.001 * (np.arange(len(x)) % 2), np.zeros(len(x))], axis=1)
    return Trajectory(np.arange(len(x)) * 100_000_000, poses)


def test_noise_does_not_lengthen_a_path():
    assert path_m(_line(3.0)) == pytest.approx(3.0, abs=0.002)
    assert path_m(Trajectory(np.arange(50), np.zeros((50, 3)))) == 0.0
    assert path_m(Trajectory(np.zeros(0, dtype=np.int64), np.zeros((0, 3)))) == 0.0


def test_scans_duration_rate_and_true_path_are_measured(record, build):
    made = record("a", "room", {"ate_rmse_m": 0.1})
    way = _line(0.59)
    spec = replace(made.spec, sequence=replace(made.spec.sequence, parameters={"beams": 720}))  # of slices of clouds
    made = replace(made, truth=replace(made.truth, trajectory=way), spec=spec)
    short = record("b", "room", {}, status="crashed", reason="signal 11", answered=31)
    assert dict(analyse_sequence(build([made, short]), "room").drive) == {
        "Scans answered": "31 of 60 to 60 of 60, by run",
        "Driven": "5.9 s",
        "Path": "0.6 m (true trajectory)",
        "Scan rate": "10.0 Hz (median)",
    }


def test_without_ground_truth_the_path_comes_from_a_named_estimate_not_from_odometry(record, build):
    values = {"a": 0.1, "b": 0.2, "wheel": 0.3}
    names = ("split_distance_m", "mom_cm2", "cleared_percent", "s2m_m")
    runs = [record(n, "room", dict.fromkeys(names, v), seed=None, truth=False, error_m=0.0) for n, v in values.items()]
    path = dict(analyse_sequence(build(runs), "room").drive)["Path"]
    metres, unit, whose = path.partition(" m ")
    assert (unit, whose) == (" m ", "(estimate of a)")
    assert float(metres) == pytest.approx(20.7, abs=0.3)  # an ellipse with axes of 4 and 2.5 m


def test_without_a_best_estimate_the_path_is_the_median_of_all(record, build):
    runs = [
        record(n, "room", {"split_distance_m": v}, seed=None, truth=False)
        for n, v in (("wheel", 0.1), ("a", 0.2), ("b", 0.3))
    ]
    assert "(median of 2 estimates, " in dict(analyse_sequence(build(runs), "room").drive)["Path"]


def test_nothing_is_measured_without_runs(record, build):
    absent = record("a", "room", {}, status="not-installed", reason="no module", answered=0)
    assert analyse_sequence(build([absent]), "room").drive == ()


def test_alignments_that_differ_in_their_numbers_of_poses_alone_are_one_line(record):
    words = ["least squares over 117 poses; 117 equal stamps", "least squares over 1,461 poses; 1461 equal stamps"]
    rule = "estimate interpolated at {} stamps of the ground truth, gaps up to {} s"
    words += [f"least squares over {n} poses; {rule.format(n, gap)}" for n, gap in ((119, 1), (117, 1), (117, 2))]
    made = [(record("a", "room", {}, seed=seed), text) for seed, text in enumerate(words)]
    assert describe_alignments([replace(run, scores=replace(run.scores, alignment=text)) for run, text in made]) == (
        "Aligned: least squares over 117 to 1,461 poses; matched: 117 to 1,461 equal stamps (2 runs)",
        f"Aligned: least squares over 117 to 119 poses; matched: {rule.format('117 to 119', 1)} (2 runs)",
        f"Aligned: least squares over 117 poses; matched: {rule.format(117, 2)} (1 run)",
    )


def test_each_alignment_is_reported_once_with_its_runs(record):
    words = ["least squares over 60 poses; 60 equal stamps"] * 2 + ["the run has no poses", ""]
    words.append(f"{IN_MAP} over 60 poses; 60 equal stamps")
    made = [(record("a", "room", {}, seed=seed), text) for seed, text in enumerate(words)]
    runs = [replace(run, scores=replace(run.scores, alignment=text)) for run, text in made]
    assert describe_alignments(runs) == (
        "Aligned: least squares over 60 poses; matched: 60 equal stamps (2 runs)",
        "Not aligned: the run has no poses (1 run)",
        "Not aligned, because the ground truth is in the frame of the known map: 60 poses compared; "
        "matched: 60 equal stamps (1 run)",
    )
