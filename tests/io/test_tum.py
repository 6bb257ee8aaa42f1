"""TUM trajectories."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

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


def write_rotations(tmp_path, rotations, order="xyzw"):
    """Write poses at the origin with these rotations (scipy), one a second."""
    columns = ["xyzw".index(letter) for letter in order]
    quaternions = rotations.as_quat()[:, columns].tolist()
    return write_tum(tmp_path, "".join(f"{at} 0 0 0 {' '.join(map(str, q))}\n" for at, q in enumerate(quaternions)))


@pytest.mark.parametrize("headings_deg", [(0, 20, 90, -150), (10, 0, -15), (5,), (160, 180, 200), (150, 130, 170)])
def test_quaternions_with_w_first_are_refused_at_the_first_line_that_shows_it(tmp_path, headings_deg):
    path = write_rotations(tmp_path, Rotation.from_euler("z", [[each] for each in headings_deg], degrees=True), "wxyz")
    with pytest.raises(BadData, match=r"line 1: .* 't x y z qx qy qz qw'.*'qw qx qy qz': move qw to the end"):
        read_tum(path)


def test_a_pose_tilted_by_more_than_30_deg_is_refused_and_a_ramp_is_read(tmp_path):
    ramp = Rotation.from_euler("ZYX", [[40, 0, 0], [40, -29, 0], [130, 0, 29]], degrees=True)
    poses = read_tum(write_rotations(tmp_path, ramp)).trajectory.poses
    np.testing.assert_allclose(np.degrees(poses[:, 2]), [40, 40, 130], atol=1e-9)
    steep = Rotation.from_euler("ZYX", [[40, 0, 0], [40, -31, 0], [130, 0, 0]], degrees=True)
    with pytest.raises(BadData, match=r"line 2: a pose tilted by 31 deg to the plane \(at most 30 deg\)") as caught:
        read_tum(write_rotations(tmp_path, steep))
    assert "move qw" not in str(caught.value)


def test_poses_of_a_camera_with_z_forward_are_refused_with_what_to_do(tmp_path):
    camera = Rotation.from_euler("Y", [[0], [20], [50], [90]], degrees=True)  # world and camera: x right, z forward
    with pytest.raises(BadData, match=r"line 3: a pose tilted by 50 deg .* \(z forward\) into those of the robot's"):
        read_tum(write_rotations(tmp_path, camera))


def test_poses_of_a_lidar_upside_down_keep_their_heading(tmp_path):
    flipped = Rotation.from_euler("ZYX", [[0, 0, 180], [60, 0, 180], [100, 0, 178]], degrees=True)
    poses = read_tum(write_rotations(tmp_path, flipped)).trajectory.poses
    np.testing.assert_allclose(np.degrees(poses[:, 2]), [0, 60, 100], atol=1e-9)
    straight = Rotation.from_euler("ZYX", [[0, 0, 180], [20, 0, 180], [-15, 0, 180]], degrees=True)
    poses = read_tum(write_rotations(tmp_path, straight)).trajectory.poses
    np.testing.assert_allclose(np.degrees(poses[:, 2]), [0, 20, -15], atol=1e-9)
    mixed = Rotation.from_euler("ZYX", [[0, 0, 0], [60, 0, 0], [100, 0, 180]], degrees=True)
    with pytest.raises(BadData, match="line 3: a pose tilted by 180 deg"):
        read_tum(write_rotations(tmp_path, mixed))


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        (b"", ["empty"]),
        (b"# only comments\n", ["no pose"]),
        (b"1 0 0 0 0 0 0 1\n2 0 0\n", ["line 2", "3 columns", "qx qy qz qw"]),
        (b"1 0 zero 0 0 0 0 1\n", ["line 1", "'zero'", "column 2"]),
        (b"soon 0 0 0 0 0 0 1\n", ["line 1", "'soon'"]),
        (b"1 nan 0 0 0 0 0 1\n", ["line 1", "not finite"]),
        (b"1 0 2e7 0 0 0 0 1\n", ["line 1", "a length above 10,000,000 m"]),
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
