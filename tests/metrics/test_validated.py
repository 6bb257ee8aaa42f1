"""The shipped validation of the metrics is complete, and a part of it is reproduced exactly."""

import json
from importlib.resources import files

import pytest

from evalkit.commands.metric_validation import map_rebuilding
from evalkit.commands.metric_validation.fault_injection import FAULTS
from evalkit.commands.metric_validation.perturbation import PERTURBATIONS
from evalkit.commands.metric_validation.rank_agreement import reference_free_metrics
from evalkit.metrics.validated import SCHEMA, load_validation


@pytest.fixture(scope="module")
def content():
    return json.loads(files("evalkit.metrics").joinpath("validated.json").read_text(encoding="utf-8"))


def test_every_map_metric_without_ground_truth_was_validated_with_every_perturbation():
    validation = load_validation()
    assert {each.metric for each in validation.agreement} == {metric.name for metric in reference_free_metrics()}
    for each in validation.agreement:
        assert each.overall is not None
        assert each.by_perturbation.keys() == PERTURBATIONS.keys() == validation.perturbations.keys()
        assert tuple(each.by_world) == validation.worlds
    assert validation.agreement_of("ate_rmse_m") is None


def test_the_validation_records_its_provenance(content):
    validation = load_validation()
    assert validation.command.startswith("python -m evalkit.commands.metric_validation validate")
    assert {"evalkit", "numpy", "scipy"} <= validation.versions.keys()
    assert content["schema"] == SCHEMA == {"name": "evalkit-metrics-validated", "version": 2}
    assert validation.map_count == 3 * (1 + sum(len(one.sizes) for one in PERTURBATIONS.values()))
    assert {row["fault"] for row in content["faults"]} == FAULTS.keys()
    assert all(row["metric_count"] for row in content["faults"])


@pytest.mark.thorough
def test_a_recomputed_part_is_identical(content):
    sample, settings = content["sample"], (content["seed"], content["mapper"], content["scans"])
    result = map_rebuilding.score_perturbed_maps(sample["world"], sample["perturbation"], [sample["size"]], *settings)
    (computed,) = result["rows"]
    assert computed["ate_rmse_m"] == pytest.approx(sample["error_m"], rel=1e-6)
    for name, value in sample["scores"].items():
        assert computed[name] == pytest.approx(value, rel=1e-3), name


def test_the_best_metrics_correlate_with_the_true_error():
    validation = load_validation()
    for name in ("split_distance_m", "cleared_percent", "mme_nat"):
        assert validation.agreement_of(name).overall.low > 0.7
    assert validation.agreement_of("occupied_percent").overall.value < 0.0


def test_the_strongest_metric_of_a_fault_comes_first(content):
    for fault in content["faults"]:
        factors = [one["factor"] for one in fault["strongest"]]
        assert factors == sorted(factors, reverse=True), fault["fault"]
        ious = {one["without"] for one in fault["strongest"] if one["metric"] == "map_iou"}
        assert ious <= {0.2220891176733261}, fault["fault"]  # mean over the sides of edges: no side is preferred
