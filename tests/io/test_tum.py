"""TUM trajectories."""

import numpy as np
import pytest

from evalkit.core.errors import BadData, DataMissing
from evalkit.core.trajectory import Trajectory
from evalkit.io.tum import format_tum, read_tum, yaw_from_quaternion


def write_tum(tmp_path, text):
    path = tmp_path / "poses.tum"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def test_a_line_is_read_as_stamp_x_y_and_yaw(tmp_path):
    path = write_tum(
        tmp_path, "# t x y z qx qy qz qw\n\n976052857.337284 1.5 -2 0 0 0 0.7071067811865476 0.7071067811865476\n"
    )
    read = read_tum(path)
    assert read.trajectory.stamps_ns.tolist() == [976052857337284000]
    np.testing.assert_allclose(read.trajectory.poses, [[1.5, -2.0, np.pi / 2]], atol=1e-12)
    assert read.notes == {}


def test_commas_and_trailing_comments_are_allowed(tmp_path):
    read = read_tum(write_tum(tmp_path, "1,0,0,0,0,0,0,1\r\n2, 3, 4, 0, 0, 0, 0, 1 # end\r\n"))
    assert read.trajectory.poses[1].tolist() == [3.0, 4.0, 0.0]


def test_unsorted_and_repeated_lines_are_corrected_and_counted(tmp_path):
    read = read_tum(write_tum(tmp_path, "3 3 0 0 0 0 0 1\n1 1 0 0 0 0 0 1\n3 9 0 0 0 0 0 1\n2 2 0 0 0 0 0 1\n"))
    assert read.trajectory.poses[:, 0].tolist() == [1.0, 2.0, 3.0]
    assert read.notes == {"poses out of order": 2, "poses with a repeated stamp ignored": 1}


def test_writing_and_reading_gives_the_same_trajectory(tmp_path):
    rng = np.random.default_rng(7)
    stamps = 1663967375543606542 + np.cumsum(rng.integers(1, 10**9, 50))
    poses = rng.uniform([-100, -100, -3.14], [100, 100, 3.14], (50, 3))
    again = read_tum(write_tum(tmp_path, format_tum(Trajectory(stamps, poses), "a comment"))).trajectory
    assert again.stamps_ns.tolist() == stamps.tolist()
    np.testing.assert_allclose(again.poses, poses, atol=1e-11)


def test_a_tilted_pose_keeps_its_heading():
    half_yaw, half_roll = 0.4, 0.1  # q = yaw * roll
    q = (
        np.cos(half_yaw) * np.sin(half_roll), np.sin(half_yaw) * np.sin(half_roll),
        np.sin(half_yaw) * np.cos(half_roll), np.cos(half_yaw) * np.cos(half_roll),
    )  # fmt: skip
    assert yaw_from_quaternion(*q) == pytest.approx(0.8)


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        (b"", ["empty"]),
        (b"# only comments\n", ["no pose"]),
        (b"1 0 0 0 0 0 0 1\n2 0 0\n", ["line 2", "3 columns", "qx qy qz qw"]),
        (b"1 0 zero 0 0 0 0 1\n", ["line 1", "'zero'", "column 2"]),
        (b"soon 0 0 0 0 0 0 1\n", ["line 1", "'soon'"]),
        (b"1 nan 0 0 0 0 0 1\n", ["line 1", "not finite"]),
        (b"1 0 0 0 0 0 0 0\n", ["line 1", "quaternion"]),
        (b"\x1f\x8b\x08\x00\xff\xfe\x00\x01", ["not UTF-8 text"]),
    ],
)
def test_an_invalid_line_is_reported_with_file_line_and_remedy(tmp_path, text, parts):
    with pytest.raises(BadData) as caught:
        read_tum(write_tum(tmp_path, text))
    assert all(part in str(caught.value) for part in ["poses.tum", *parts])


def test_an_absent_file_is_missing_data(tmp_path):
    with pytest.raises(DataMissing, match="no such file"):
        read_tum(tmp_path / "nothing.tum")
