"""The cards of a report, built from an experiment."""

from dataclasses import asdict, replace
from datetime import UTC, datetime

import pytest

from evalkit.config.experiment_file import experiment_from_tables
from evalkit.core.ground_truth import Truth
from evalkit.plugins.specs import OdometrySpec, RegistrationSpec
from evalkit.report import build_comparison
from evalkit.report.assembly import build_sequence_card, describe_fairness, find_distribution, sort_runs


@pytest.fixture
def plan():
    content = {
        "title": "Two",
        "method": [{"use": "wheel-odometry"}, {"use": "paper", "label": "ours", "keyframes": 7}],
        "sequence": [{"use": "room", "seeds": [0]}, {"use": "corridor", "seeds": [0]}],
    }
    return experiment_from_tables(content, "two.toml", "two", "compare two.toml")


def test_cards_contain_every_setting_of_a_method(plan):
    noon = datetime(2024, 5, 1, 12, tzinfo=UTC)
    made = build_comparison(plan, [], noon, noon)
    assert made.command == "evalkit compare two.toml"
    assert [card.role for card in made.methods.values()] == ["baseline", "reference"]
    settings = {setting.name: setting for setting in made.methods["ours"].settings}
    assert {name: setting.value for name, setting in settings.items()} == dict(plan.methods[1].parameters)
    assert (settings["keyframes"].value, settings["keyframes"].default) == (7, 10)


def test_only_the_corridor_is_degenerate(plan):
    noon = datetime(2024, 5, 1, 12, tzinfo=UTC)
    cards = build_comparison(plan, [], noon, noon).sequences
    assert [bool(card.degenerate) for card in cards.values()] == [False, True]


def test_the_mapper_is_named_with_its_settings(plan):
    noon = datetime(2024, 5, 1, 12, tzinfo=UTC)
    assert build_comparison(plan, [], noon, noon).mapper.startswith("log-odds (")


def test_the_executed_warm_up_is_reported(demo):
    assert any("processes the first 5 scans before" in sentence for sentence in describe_fairness(demo.records, {}))


def test_an_unknown_requirement_keeps_its_name():
    assert find_distribution("numpy") == "numpy"
    assert find_distribution("no-such-library") == "no-such-library"


def test_the_environment_is_that_of_the_first_run_with_library_versions(plan):
    noon = datetime(2024, 5, 1, 12, tzinfo=UTC)
    told = build_comparison(plan, [], noon, noon, {"commit": "abc", "earlier runs": "2 runs"}).environment
    assert list(told) == ["commit", "earlier runs", "numpy", "scipy"]


def test_the_number_of_runs_at_a_time_is_described_where_known(demo):
    assert describe_fairness(demo.records, {"runs at a time": "2"})[0].startswith(
        "Runs at a time: 2; concurrent runs share"
    )
    assert describe_fairness(demo.records, {"runs at a time": "1"})[0] == "Runs at a time: 1."
    assert not any("at a time" in sentence for sentence in describe_fairness(demo.records, {}))


def test_runs_kept_from_an_earlier_call_did_not_take_turns(demo):
    alike = "so that slow periods affect all alike"
    assert any(alike in sentence for sentence in describe_fairness(demo.records, {}))
    resumed = describe_fairness(demo.records, {"earlier runs": "3 runs, executed 2026-01-01 10:00 UTC"})
    assert not any(alike in sentence for sentence in resumed)
    assert any("some were kept from earlier calls" in sentence for sentence in resumed)


def test_a_sequence_has_its_settings_and_the_ground_truth_of_its_runs(plan, record):
    sequence = plan.sequences[0]
    met = replace(record("paper", "room", {}), truth=Truth("exact: as met"))
    card = build_sequence_card(sequence, [met])
    assert {setting.name: setting.value for setting in card.settings} == dict(sequence.parameters)
    assert card.truth == "exact: as met"
    assert build_sequence_card(sequence, []).truth != "exact: as met"


def test_an_odometry_that_does_not_declare_its_guess_gets_none():
    assert RegistrationSpec(Truth, "", "", "").guess == "wheel odometry where recorded, else constant velocity"
    assert OdometrySpec(Truth, "", "", "").guess == "not reported"
    assert OdometrySpec(Truth, "", "", "", guess="its own").guess == "its own"


def test_trials_are_in_experiment_order_even_if_repetitions_ran_in_reverse(plan, record):
    sequence, labels = plan.sequences[0], [method.label for method in plan.methods]
    run = [record(who, sequence.label, {}, seed=seed) for seed in sequence.seeds for who in reversed(labels)]
    told = sort_runs(plan, run)
    assert [(t.seed, t.method) for t in told] == [(seed, who) for seed in sequence.seeds for who in labels]


def test_the_limits_in_force_are_reported(plan):
    noon = datetime(2024, 5, 1, 12, tzinfo=UTC)
    told = build_comparison(plan, [], noon, noon).fairness[-1]
    for name, value in asdict(plan.limits).items():
        assert f"{value:g} {'MiB' if name == 'memory_mib' else 's'}" in told
