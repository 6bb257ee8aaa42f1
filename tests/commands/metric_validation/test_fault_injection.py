"""Faults injected between a sequence and its scores are detected by the metrics."""

from functools import cache

import pytest

from evalkit.commands.metric_validation import fault_injection
from evalkit.commands.metric_validation.fault_injection import FAULTS, NO_FAULT

WORLD = {"world": "lab", "seed": 0, "mapper": "log-odds", "scans": 40}

DETECTED_BY = {
    "axes swapped": ("heading_rmse_deg", 50.0),
    "yaw flipped": ("heading_rmse_deg", 50.0),
    "stamps one scan late": ("heading_rmse_deg", 5.0),
    "degrees for radians": ("heading_rmse_deg", 50.0),
    "pose inverted": ("ate_rmse_m", 20.0),
    "extrinsics dropped": ("map_iou", 10.0),
    "beams mirrored": ("map_iou", 10.0),
}
"""A metric that must detect each fault, and the least factor."""


@cache
def score(fault):
    return fault_injection.score_with_fault(fault, **WORLD)["scores"]


@pytest.fixture(scope="module")
def good():
    return score(NO_FAULT)


def test_every_fault_has_a_metric():
    assert DETECTED_BY.keys() == FAULTS.keys()


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_is_detected_by_its_metric(good, fault):
    seen = {s.metric.name: s.factor for s in fault_injection.compare_scores(good, score(fault))}
    name, factor = DETECTED_BY[fault]
    assert seen[name] > factor


def test_a_fault_of_the_scans_is_detected_without_ground_truth(good):
    wrong = score("extrinsics dropped")
    free = {
        s.metric.name
        for s in fault_injection.compare_scores(good, wrong)
        if s.metric.group == "map consistency" and s.factor > 2
    }
    assert {"split_distance_m", "cleared_percent", "wall_share_percent"} <= free


def test_a_run_without_a_fault_has_no_detections(good):
    assert fault_injection.compare_scores(good, good) == ()


def test_zero_shares_and_negative_entropies_have_factors():
    seen = {s.metric.name: s.factor for s in fault_injection.compare_scores(
        {"map_f1": 0.9, "mme_nat": -2.0, "corners": 4.0}, {"map_f1": 0.0, "mme_nat": -1.0, "corners": 3.0}
    )}  # fmt: skip
    assert seen == {"map_f1": fault_injection.MAX_FACTOR, "mme_nat": pytest.approx(2.718281828)}
