"""The proposed layout of a text log in columns: logs that are written here, so that their meaning is known."""

import math
import os
import tomllib
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from evalkit.cli import app
from evalkit.plugins import registry
from evalkit_datasets.commands.inspect.inspector import inspect_recording
from evalkit_datasets.commands.inspect.layout_proposal import propose_layout
from evalkit_datasets.parsing.columns_layout import layout_from_table
from evalkit_datasets.readers.columns import Columns

ANGLES = np.radians(np.arange(360.0))


def ranges_m(x, theta):
    """Ranges in a room of 8 m by 5 m from a pose on its middle line."""
    directions = ANGLES + theta
    with np.errstate(divide="ignore"):
        sides = np.where(np.cos(directions) > 0.0, 8.0 - x, -x) / np.cos(directions)
        ends = np.where(np.sin(directions) > 0.0, 2.5, -2.5) / np.sin(directions)
    return np.minimum(sides, ends)


def path_of(count=80):
    """Poses (N, 3): turns of 10 deg on the spot and short drives."""
    turns = np.where(np.arange(count) % 2, math.radians(10.0), 0.0)
    drives = np.where(np.arange(count) % 2, 0.0, 0.02)
    return np.column_stack([2.0 + np.cumsum(drives), np.zeros(count), np.mod(np.cumsum(turns) + 3.0, 6.0) - 3.0])


def write_log(
    path, unit=1000.0, clockwise=False, header="", separator=" ", poses=True, first_ms=65000, code=0, decimals=0,
    headings=None, count=80,
):  # fmt: skip
    lines = [header] if header else []
    for at, (x, y, theta) in enumerate(path_of(count)):
        ranges = np.round(ranges_m(x, theta) * unit, decimals)[:: -1 if clockwise else 1]
        ranges = np.roll(ranges, 1) if clockwise else ranges
        ranges[at % 7 :: 10] = code
        heading = theta if headings is None else headings[at]
        own = [f"{x:.4f}", f"{y:.4f}", f"{heading:.5f}"] if poses else []
        lines.append(separator.join([str((first_ms + 100 * at) % 65536), *own, *(f"{r:g}" for r in ranges)]))
    path.write_text("\n".join(lines) + "\n")
    return path


def test_time_ranges_code_and_odometry_are_found(tmp_path):
    path = write_log(tmp_path / "drive.csv", header="t,x,y,h,ranges", separator=",")
    proposal = propose_layout(path)
    layout = tomllib.loads(proposal.toml)
    assert layout["header_lines"] == 1
    assert layout["time"] == {"column": 1, "unit": "ms", "wraps_at": 65536}
    assert layout["pose"] == {"x": 2, "y": 3, "heading": 4}
    scan = layout["scan"]
    assert (scan["first"], scan["beams"], scan["unit"], scan["no_return"]) == (5, 360, "mm", [0])
    assert (scan["first_angle_deg"], scan["step_deg"]) == (0.0, 1.0)
    assert "clockwise" not in scan
    assert proposal.scans == 80
    assert len(Columns(str(path), layout)) == 80
    layout_from_table("the proposal", layout)


def test_numbers_that_are_no_lengths_are_no_ranges(tmp_path):
    path = tmp_path / "huge.csv"
    path.write_text("".join(f"{0.1 * at} {'1.7e308 ' * 360}\n" for at in range(80)))
    assert propose_layout(path) is None


def test_beams_that_turn_against_the_odometry_are_clockwise(tmp_path):
    proposal = propose_layout(write_log(tmp_path / "drive.log", clockwise=True))
    assert tomllib.loads(proposal.toml)["scan"]["clockwise"] is True
    assert "taken as clockwise" in proposal.toml


def test_a_direction_that_cannot_be_checked_is_said_in_the_layout_and_by_the_inspection(tmp_path):
    path = write_log(tmp_path / "drive.log", poses=False)
    proposal = propose_layout(path)
    assert "# direction not checked: no odometry is known; counter-clockwise assumed" in proposal.toml
    assert "# mounting assumed: base_from_sensor (m, m, deg), the lidar at the robot's centre" in proposal.toml
    assert tomllib.loads(proposal.toml)["base_from_sensor"] == [0.0, 0.0, 0.0]
    path.with_name("drive.log.toml").write_text(proposal.toml)
    told = " ".join(CliRunner().invoke(app, ["inspect", str(path)]).output.split())
    assert "warning: direction of the angles: columns: whether the angles are mirrored" in told
    (said,) = [one for one in registry.dataset("columns").choose({"path": str(path)}) if "mirrored" in one.reason]
    assert (said.value, said.warns) == (None, True)
    checked = propose_layout(write_log(tmp_path / "turns.log"))
    assert "direction not checked" not in checked.toml


def test_centimetres_metres_and_a_code_above_the_ranges_are_told_apart(tmp_path):
    scan = tomllib.loads(propose_layout(write_log(tmp_path / "a.log", unit=100.0, poses=False, code=8191)).toml)["scan"]
    assert (scan["unit"], scan["no_return"]) == ("cm", [8191])
    assert 5.0 < scan["range_max_m"] < 9.0
    path = tmp_path / "b.log"
    rows = [f"{0.1 * at:.1f} " + " ".join(f"{r:.3f}" for r in ranges_m(3.0, 0.01 * at)) for at in range(40)]
    path.write_text("\n".join(rows))
    layout = tomllib.loads(propose_layout(path).toml)
    assert (layout["scan"]["unit"], layout["time"]) == ("m", {"column": 1, "unit": "s"})


def test_headings_in_degrees_are_found_and_many_turns_in_radians_are_not_taken_for_them(tmp_path):
    """The turns of the second log add up to three."""
    for count, unit, scale in ((80, "deg", 180.0 / math.pi), (220, "rad", 1.0)):
        theta = np.unwrap(path_of(count)[:, 2], period=6.0)
        path = write_log(tmp_path / f"{unit}.log", headings=scale * theta, count=count)
        assert np.abs(scale * theta).max() > 4.0 * math.pi
        proposal = propose_layout(path)
        pose = tomllib.loads(proposal.toml)["pose"]
        assert pose == {"x": 2, "y": 3, "heading": 4, **({"heading_unit": "deg"} if unit == "deg" else {})}
        assert "direction not checked" not in proposal.toml
        path.with_name(f"{unit}.log.toml").write_text(proposal.toml)
        assert CliRunner().invoke(app, ["inspect", str(path)]).exit_code == 0


def test_jumps_of_headings_in_degrees_that_are_read_as_radians_name_the_key(tmp_path):
    path = write_log(tmp_path / "a.log", headings=np.degrees(path_of()[:, 2]))
    layout = propose_layout(path).toml.replace('heading_unit = "deg"\n', "")
    path.with_name("a.log.toml").write_text(layout)
    said = [one.advice for one in inspect_recording(path).findings if "jump" in one.what]
    key = 'if its headings are in deg, write heading_unit = "deg" in [pose]; else '
    assert said
    assert all(one.startswith(key) for one in said)


def test_beams_without_a_return_that_are_inf_are_ranges(tmp_path):
    """Half of the beams, and the first 30 of every scan, have none."""
    path = write_log(tmp_path / "drive.csv", unit=1.0, code=math.inf, decimals=3)
    lines = [line.split() for line in path.read_text().splitlines()]
    for at, words in enumerate(lines):
        words[4:34] = ["inf"] * 30
        words[34 + at % 2 :: 2] = ["inf"] * len(words[34 + at % 2 :: 2])
    path.write_text("\n".join(map(" ".join, lines)))
    scan = tomllib.loads(propose_layout(path).toml)["scan"]
    assert (scan["first"], scan["beams"], scan["unit"]) == (5, 360, "m")


@pytest.mark.parametrize(
    "text", ["some words\n" * 50, "1 2 3\n" * 50, ("5 " * 40 + "\n") * 50, "FLASER 3 1 1 1 0\n" * 50]
)
def test_a_file_without_ranges_and_time_gives_no_layout(text, tmp_path):
    path = tmp_path / "file.txt"
    path.write_text(text)
    assert propose_layout(path) is None


def test_a_log_with_decimal_commas_gets_no_layout_of_twice_the_columns(tmp_path):
    path = write_log(tmp_path / "drive.csv", separator=";", unit=1.0, decimals=3)
    assert propose_layout(path) is not None
    path.write_text(path.read_text().replace(".", ","))
    result = CliRunner().invoke(app, ["inspect", str(path)])
    assert propose_layout(path) is None
    assert "its numbers have a decimal comma; write them with a point" in str(result.exception)


def test_inspect_prints_the_layout_as_one_block_that_can_be_saved(tmp_path):
    path = write_log(tmp_path / "drive.log")
    result = CliRunner().invoke(app, ["inspect", str(path)])
    assert result.exit_code == 1
    block = result.output.split("\n\n")[1]
    path.with_name("drive.log.toml").write_text(block)
    again = CliRunner().invoke(app, ["inspect", str(path)])
    assert again.exit_code == 0
    assert "opened: 80 scans" in again.output


def test_the_layout_of_a_real_log_is_that_of_the_catalogue():
    path = Path(os.environ.get("EVALKIT_DATA") or "absent") / "rplidar-slambot" / "data_24JUL14_14m.log"
    if not path.exists():
        pytest.skip(f"{path} is not here: set EVALKIT_DATA")
    layout = tomllib.loads(propose_layout(path).toml)
    assert (layout["time"]["column"], layout["time"]["unit"]) == (3, "ms")
    scan = layout["scan"]
    assert (scan["first"], scan["beams"], scan["unit"], scan["no_return"], scan["range_max_m"]) == (
        4,
        360,
        "mm",
        [0],
        6.0,
    )
