"""The trust that ships with the metrics: whole, and what a new computation of a part of it gives."""

import json
from importlib.resources import files

import pytest

from evalkit.commands.metric_validation import map_rebuilding
from evalkit.commands.metric_validation.fault_injection import PLANTS
from evalkit.commands.metric_validation.perturbation import WAYS
from evalkit.commands.metric_validation.rank_agreement import reference_free
from evalkit.metrics.validated import shipped


@pytest.fixture(scope="module")
def content():
    return json.loads(files("evalkit.metrics").joinpath("validated.json").read_text(encoding="utf-8"))


def test_every_reference_free_map_metric_was_validated_in_every_way():
    trust = shipped()
    assert {each.metric for each in trust.trust} == {metric.name for metric in reference_free()}
    for each in trust.trust:
        assert each.overall is not None
        assert each.by_way.keys() == WAYS.keys() == trust.ways.keys()
        assert tuple(each.by_world) == trust.worlds
    assert trust.of("ate_rmse_m") is None


def test_it_tells_how_it_was_made(content):
    trust = shipped()
    assert trust.command.startswith("evalkit metrics validate")
    assert {"evalkit", "numpy", "scipy"} <= trust.versions.keys()
    assert trust.maps == len(content["rows"]) == 3 * (1 + sum(len(way.sizes) for way in WAYS.values()))
    assert {row["plant"] for row in content["planted"]} == PLANTS.keys()
    assert all(row["caught"] for row in content["planted"])


def test_a_part_of_it_computed_again_is_the_same(content):
    of = {(row["way"], row["size"]): row for row in content["rows"] if row["world"] == "room"}
    size = 0.4
    made = map_rebuilding.spoiled("room", "jump", [size], content["seed"], content["mapper"], content["scans"])["rows"][
        0
    ]
    kept = of["jump", size]
    assert made["ate_rmse_m"] == pytest.approx(kept["error_m"], rel=1e-6)
    for name, value in kept["scores"].items():
        assert made[name] == pytest.approx(value, rel=1e-3), name


def test_the_metrics_that_follow_the_error_best_follow_it_well():
    trust = shipped()
    for name in ("split_distance_m", "cleared_percent", "mme_nat"):
        assert trust.of(name).overall.low > 0.7
    assert trust.of("occupied_percent").overall.value < 0.0
