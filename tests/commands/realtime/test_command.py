"""``evalkit realtime``: one back end on slower devices."""

import json
import shlex

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from evalkit.commands.realtime import command
from evalkit.commands.realtime.command import realtime
from evalkit.commands.tune.config import make_tuning_tables, tuning_from_tables
from evalkit.core.errors import BadParameter, UnknownName

pytestmark = pytest.mark.usefixtures("scoring_in_threads")

ARGUMENTS = ["wheel-odometry", "--on", "lab laps=0.05", "--factors", "1,1e6", "--repetitions", "1"]


def call(*words):
    app = typer.Typer()
    app.command()(realtime)
    return CliRunner().invoke(app, [*map(str, words)])


def test_it_prints_the_devices_and_stores_the_measured_costs(tmp_path):
    contents = [json.loads(call(*ARGUMENTS, "--json", "--out", tmp_path).stdout) for _ in range(2)]
    assert contents[0] == contents[1]  # the second run uses the stored costs
    assert [device["factor"] for device in contents[0]["devices"]] == [0.0, 1.0, 1e6]
    assert [device["dropped"] > 0.5 for device in contents[0]["devices"]] == [False, False, True]
    assert contents[0]["headroom"] > 1.0
    shown = call(*ARGUMENTS, "--out", tmp_path).stdout
    assert "answers every scan in time" in shown
    rows = [line for line in shown.splitlines() if " slower " in line and line.startswith("  ")]
    assert [row.split(" x")[0].strip() for row in rows] == ["up to 1", "1e+06"]  # neither 0 nor 1 drops a scan
    assert max(map(len, rows)) <= 80
    assert "100" not in rows[0]
    assert rows[1].rstrip().endswith("broken fewer than two answers") or "% dropped" in rows[1]


def result_of(costs_ms, late=(0.0, 0.0), waits_ms=(0.0, 0.0, 0.0)):
    """A result of three scans, 100 ms apart, on a device without cost and one as fast as this machine."""
    at_hand = {"at_hand": {"ate_rmse_m": 0.01}, "age_ms": (1.0, 2.0), "lost": "", "answered": 3, "dropped": 0.0}
    slowest = int(np.argmax(costs_ms))
    return {
        "costs_ns": np.array(costs_ms) * 1e6, "waits_ns": np.array(waits_ms) * 1e6, "gaps": np.array([1]),
        "growth": np.array([1.0]), "period_ns": 1e8, "headroom": 100.0 / costs_ms[slowest],
        "slowest_scan": slowest + 1, "slowest_period_ns": 1e8, "linear": None,
        "devices": [at_hand | {"factor": float(factor), "late": late[factor]} for factor in (0, 1)],
    }  # fmt: skip


def show(result, capsys):
    command._print(command._as_json("mine", "room", result), "room")
    return " ".join(capsys.readouterr().out.split())


@pytest.mark.parametrize(
    ("errors_m", "said"),
    [((0.01, 0.30, 0.02, 0.40), "broken at 1, but not at 2."), ((0.01, 0.02, 0.30, 0.40), "broken from 2 on."),
     ((0.01, 0.02, 0.02, 0.03), "not broken at any factor.")],
)  # fmt: skip
def test_a_slower_device_that_is_not_broken_is_named(errors_m, said, capsys):
    result = result_of([10.0, 6.0, 8.0])
    result["devices"] = [
        result["devices"][0] | {"factor": float(factor), "at_hand": {"ate_rmse_m": error_m}}
        for factor, error_m in enumerate(errors_m)
    ]
    assert said in show(result, capsys)


def test_the_next_command_names_the_world_without_its_seed_and_tune_takes_it(capsys):
    command._print(command._as_json("embedded", "room", result_of([10.0, 6.0, 8.0])), "room seed=1 laps=0.05")
    line = capsys.readouterr().out.splitlines()[-1]
    said = line.removeprefix("next: evalkit tune ").removesuffix(" (cheaper or better parameters)")
    assert said == "embedded --on 'room laps=0.05'"
    backend, _, on = shlex.split(said)
    made = tuning_from_tables(make_tuning_tables([backend], [on], [], 2, {}), "evalkit tune", "x", "y")
    assert made.training[0].sequence.parameters["laps"] == 0.05
    with pytest.raises(BadParameter, match="'seed': found 1, expected none here: a tuning takes 0 and 1"):
        make_tuning_tables([backend], ["room seed=1"], [], 2, {})


def test_the_next_command_of_a_recording_trains_on_a_world_and_judges_on_the_recording(tmp_path, capsys):
    bag = tmp_path / "drive.bag"
    bag.touch()
    command._print(command._as_json("embedded", "rosbag", result_of([10.0, 6.0, 8.0])), f"rosbag path={bag}")
    line = capsys.readouterr().out.splitlines()[-1]
    said = line.removeprefix("next: evalkit tune ").removesuffix(" (cheaper or better parameters)")
    backend, _, on, option, held_out = shlex.split(said)
    assert option == "--held-out"
    made = tuning_from_tables(make_tuning_tables([backend], [on], [held_out], 2, {}), "evalkit tune", "x", "y")
    assert [one.parameters["path"] for one in made.held_out] == [str(bag)]


def test_a_wait_far_above_the_cpu_time_is_named_with_its_scan(capsys):
    shown = show(result_of([10.0, 6.0, 8.0], waits_ms=[1.0, 400.0, 50.0]), capsys)
    assert "by its CPU time, a device up to 10 times slower answers every scan in time" in shown
    assert "scan 2 waited 400 ms besides its CPU time (for a timer, a file, a device); so did 1 more." in shown
    assert "waited" not in show(result_of([10.0, 6.0, 8.0], waits_ms=[9.0, 11.0, 3.0]), capsys)


def test_a_machine_that_is_too_slow_is_not_called_up_to_one_times_slower(capsys):
    shown = show(result_of([80.0, 112.5, 90.0], late=(0.0, 1 / 3)), capsys)
    assert "even this machine is too slow for the slowest scan: scan 2 took 112 ms of CPU time" in shown
    assert "up to" not in shown
    assert "0.0 % dropped, 33.3 % late" in shown
    assert "up to 1 x slower" in show(result_of([80.0, 90.0, 70.0]), capsys)


@pytest.mark.parametrize(
    ("words", "option"),
    [
        (["--factors", "1,-2"], "--factors"),
        (["--factors", "fast"], "--factors"),
        (["--factors", "1e308"], "--factors"),
        (["--policy", "wait"], "--policy"),
    ],
)
def test_an_invalid_option_is_a_usage_error(tmp_path, words, option):
    result = call(*ARGUMENTS, *words, "--out", tmp_path)
    assert result.exit_code == 2
    assert option in result.output


def test_an_unknown_back_end_is_refused_before_any_measurement(tmp_path):
    assert isinstance(call("papper", "--out", tmp_path).exception, UnknownName)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(("on", "message"), [("room 'laps=1", "No closing quotation"), ("room laps", "NAME=VALUE")])
def test_an_invalid_data_set_is_refused_before_any_measurement(tmp_path, on, message):
    error = call("paper", "--on", on, "--out", tmp_path).exception
    assert isinstance(error, BadParameter)
    assert message in str(error)
    assert not list(tmp_path.iterdir())


def test_without_a_true_trajectory_no_device_is_called_broken_or_lost(capsys):
    result = result_of([10.0, 6.0, 8.0])
    for device in result["devices"]:
        device["at_hand"] = {"ate_rmse_m": None}
    content = command._as_json("mine", "room", result)
    assert [content["breaks_at"], *(device["broken"] for device in content["devices"])] == [None, None, None]
    shown = show(result, capsys)
    assert "; without a true trajectory, its errors are unknown." in shown
    assert "up to 1 x slower unknown" in shown
    assert "lost" not in shown.split("age (95 %)")[1]
    result["devices"][1]["lost"] = "fewer than two answers"
    assert command._as_json("mine", "room", result)["breaks_at"] == 1.0  # that is known without a truth


def test_a_path_instead_of_a_data_set_says_how_a_file_is_given(tmp_path):
    bag = tmp_path / "drive.bag"
    bag.touch()
    with pytest.raises(BadParameter, match=r"of a file its reader, 'READER path=.*drive\.bag', which evalkit inspect"):
        make_tuning_tables(["embedded"], [str(bag)], [], 2, {})
