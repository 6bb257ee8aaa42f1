"""Mistakes planted between a sequence and its scores: every one is plain in the numbers of a report."""

import pytest

from evalkit.commands.metric_validation import fault_injection
from evalkit.commands.metric_validation.fault_injection import NO_MISTAKE, PLANTS

WORLD = {"world": "lab", "seed": 0, "mapper": "log-odds", "scans": 40}

SEEN_BY = {
    "axes swapped": ("heading_rmse_deg", 50.0),
    "yaw flipped": ("heading_rmse_deg", 50.0),
    "stamps one scan late": ("heading_rmse_deg", 5.0),
    "degrees for radians": ("heading_rmse_deg", 50.0),
    "pose inverted": ("ate_rmse_m", 20.0),
    "extrinsics dropped": ("map_iou", 10.0),
    "beams mirrored": ("map_iou", 10.0),
}
"""A metric that must show each mistake, and by which factor at least."""


@pytest.fixture(scope="module")
def good():
    return fault_injection.planted(NO_MISTAKE, **WORLD)["scores"]


def test_every_mistake_has_its_witness():
    assert SEEN_BY.keys() == PLANTS.keys()


@pytest.mark.parametrize("plant", PLANTS)
def test_a_planted_mistake_is_caught_by_the_metric_that_must_show_it(good, plant):
    seen = {
        s.metric.name: s.factor
        for s in fault_injection.sightings(good, fault_injection.planted(plant, **WORLD)["scores"])
    }
    name, factor = SEEN_BY[plant]
    assert seen[name] > factor


def test_a_mistake_in_the_scans_is_seen_without_any_truth(good):
    wrong = fault_injection.planted("extrinsics dropped", **WORLD)["scores"]
    free = {
        s.metric.name
        for s in fault_injection.sightings(good, wrong)
        if s.metric.group == "map consistency" and s.factor > 2
    }
    assert {"split_distance_m", "cleared_percent", "wall_share_percent"} <= free


def test_no_mistake_is_no_sighting(good):
    assert fault_injection.sightings(good, good) == ()


def test_a_share_that_falls_to_nothing_and_an_entropy_below_nothing_have_factors():
    seen = {s.metric.name: s.factor for s in fault_injection.sightings(
        {"map_f1": 0.9, "mme_nat": -2.0, "corners": 4.0}, {"map_f1": 0.0, "mme_nat": -1.0, "corners": 3.0}
    )}  # fmt: skip
    assert seen == {"map_f1": fault_injection.MOST, "mme_nat": pytest.approx(2.718281828)}
