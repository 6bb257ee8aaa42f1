"""Folders of point clouds: PCD and PLY in every form, times in names, readers by name."""

import struct

import numpy as np
import pytest
from typer.testing import CliRunner

from evalkit.cli import app
from evalkit.core.errors import BadData, BadParameter
from evalkit_datasets.commands.inspect.inspector import inspect_recording
from evalkit_datasets.commands.inspect.suggested_config import suggest_config
from evalkit_datasets.parsing import cloud_files
from evalkit_datasets.parsing.cloud_files import read_cloud_file, stamps_of, unpack_lzf
from evalkit_datasets.readers.clouds import Clouds

POINTS = np.array([[1.0, 2.0, 0.05], [-3.0, 0.5, 0.0], [0.0, -4.0, 9.0]])


def pcd(points, form):
    """Return a PCD file with an intensity before the coordinates."""
    count = len(points)
    head = (f"# .PCD v0.7\nVERSION 0.7\nFIELDS i x y z\nSIZE 1 4 8 4\nTYPE U F F F\nCOUNT 1 1 1 1\nWIDTH {count}\n"
            f"HEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {count}\nDATA {form}\n").encode()  # fmt: skip
    if form == "ascii":
        return head + "".join(f"7 {x} {y} {z}\n" for x, y, z in points).encode()
    if form == "binary":
        return head + b"".join(struct.pack("<Bfdf", 7, *row) for row in points)
    columns = bytes([7] * count) + b"".join(
        np.asarray(points)[:, at].astype(kind).tobytes() for at, kind in enumerate(("<f4", "<f8", "<f4"))
    )
    packed = b"".join(
        bytes([len(part) - 1]) + part for part in (columns[k : k + 32] for k in range(0, len(columns), 32))
    )
    return head + struct.pack("<II", len(packed), len(columns)) + packed


def ply(points, form):
    """Return a PLY file with faces behind the vertices."""
    count = len(points)
    head = (f"ply\nformat {form} 1.0\ncomment made\nelement vertex {count}\nproperty float x\nproperty double y\n"
            "property float z\nproperty uchar red\nelement face 1\n"
            "property list uchar int v\nend_header\n").encode()  # fmt: skip
    if form == "ascii":
        return head + "".join(f"{x} {y} {z} 9\n" for x, y, z in points).encode() + b"3 0 1 2\n"
    order = "<" if "little" in form else ">"
    return head + b"".join(struct.pack(f"{order}fdfB", *row, 9) for row in points) + b"\x03" + bytes(12)


FILES = [("pcd", form) for form in ("ascii", "binary", "binary_compressed")]
FILES += [("ply", form) for form in ("ascii", "binary_little_endian", "binary_big_endian")]
WRITERS = {"pcd": pcd, "ply": ply}


@pytest.mark.parametrize(("suffix", "form"), FILES)
def test_a_cloud_is_read_back_in_every_form(tmp_path, suffix, form):
    path = tmp_path / f"a.{suffix}"
    path.write_bytes(WRITERS[suffix](POINTS, form))
    np.testing.assert_allclose(read_cloud_file(path), POINTS, atol=1e-6)


@pytest.mark.parametrize(("suffix", "form"), FILES)
def test_a_cloud_cut_anywhere_or_with_lies_is_refused_with_what_to_give(tmp_path, suffix, form):
    path = tmp_path / f"a.{suffix}"
    content = WRITERS[suffix](POINTS, form)
    body = content.index(b"\n", content.index(b"end_header" if suffix == "ply" else b"DATA ")) + 1
    lie = content.replace(b"POINTS 3", b"POINTS 999999999").replace(b"vertex 3", b"vertex 999999999")
    for broken in (content[:10], content[: body - 3], content[: body + 9], lie, bytes(100), b"x"):
        path.write_bytes(broken)
        with pytest.raises(BadData, match=r"a point cloud \(\.pcd or \.ply\)"):
            read_cloud_file(path)


def test_lzf_copies_and_literal_bytes_follow_each_other_over_short_and_long_distances():
    near = bytes([3]) + b"abcd" + bytes([1 << 5, 3]) + b"\0x" + bytes([2 << 5, 1]) + b"\0y"
    assert unpack_lzf(near, 13) == b"abcd" + b"abc" + b"x" + b"cxcx" + b"y"  # 3 from four back, 4 from two back
    text = bytes(range(256)) + b"0123456789"
    parts = b"".join(bytes([len(part) - 1]) + part for part in (text[at : at + 32] for at in range(0, len(text), 32)))
    assert unpack_lzf(parts + bytes([1 << 5 | 1, 1]) + b"\0z", 270) == text + text[8:11] + b"z"  # 256 + 1 + 1 back


def test_lzf_copies_may_overlap_what_they_write():
    assert unpack_lzf(bytes([0, 65, 0xE0, 3, 0]), 13) == b"A" * 13  # one byte, then 7 + 3 + 2 from one back
    for bad in (b"\x20\x09", bytes([0, 65]), b"\xe0"):
        with pytest.raises((ValueError, IndexError)):
            unpack_lzf(bad, 40)


@pytest.mark.parametrize(
    ("names", "expected"),
    [
        (["1.pcd", "2.pcd"], [0, 10**8]),
        (["1663967375.5.pcd", "1663967376.pcd"], [1663967375500000000, 1663967376000000000]),
        (["1663967375123.ply"], [1663967375123000000]),
        (["1663967375123456.ply"], [1663967375123456000]),
        (["scan_1663967375123456789.ply"], [1663967375123456789]),
        (["1000000000.pcd", "1100000000.pcd"], [1000000000, 1100000000]),  # 0.1 s apart as ns
        (["0.25.pcd", "0.5.pcd"], [250000000, 500000000]),
        (["c_20240131120000.pcd", "c_20240131120001.pcd"], [0, 10**8]),  # dates
        (["c_20240131120000123456.pcd"], [0]),
    ],
)
def test_names_give_times_in_the_unit_of_their_magnitude_or_counts(names, expected):
    assert stamps_of(names, 10**8).tolist() == expected


@pytest.fixture
def folder(tmp_path):
    """Return a folder of clouds: walls all around, seen while the robot moves by 5 cm a cloud."""
    place = tmp_path / "clouds"
    place.mkdir()
    angle = np.linspace(-np.pi, np.pi, 1440, endpoint=False)
    for k in range(12):
        wall = 4.0 / np.maximum(np.abs(np.cos(angle)), np.abs(np.sin(angle)))
        ring = np.stack([wall * np.cos(angle) - 0.05 * k, wall * np.sin(angle), np.zeros_like(angle)], axis=-1)
        (place / f"{k}.pcd").write_bytes(pcd(ring.tolist(), "binary"))
    return place


def test_a_folder_of_clouds_is_a_sequence_in_the_order_of_its_numbers(folder):
    sequence = Clouds(str(folder), start=2, every=3)
    frames = list(sequence.frames())
    assert [frame.scan.stamp_ns for frame in frames] == [2 * 10**8, 5 * 10**8, 8 * 10**8, 11 * 10**8]
    assert [round(frame.scan.points()[:, 0].max(), 3) for frame in frames] == [3.9, 3.75, 3.6, 3.45]
    assert frames[0].odom_from_base is None


def test_points_nearer_than_the_minimum_are_left_out(folder):
    """The first cloud is a square of 8 m: corners are more than 4.5 m away, the middles of its sides 4 m."""
    first = next(Clouds(str(folder), range_min_m=4.5).frames()).scan
    whole = next(Clouds(str(folder)).frames()).scan
    assert (first.range_min_m, whole.range_min_m) == (4.5, 0.1)
    far = whole.ranges >= 4.5
    np.testing.assert_equal(first.ranges[far], whole.ranges[far])
    assert np.nanmin(first.ranges) >= 4.5
    assert 0 < first.hits.sum() < whole.hits.sum() == 720
    with pytest.raises(BadParameter, match="clouds: parameter 'range_min_m': found '200', expected less than"):
        Clouds(str(folder), range_min_m=200.0)


def test_a_folder_of_clouds_is_inspected_and_the_command_runs_it(folder):
    advice = suggest_config(inspect_recording(folder))
    assert (advice.reader, advice.scans, advice.problem) == ("clouds", 12, "")
    assert advice.command.startswith(f"evalkit compare {folder}")


def test_the_reader_may_be_named_and_an_unknown_one_is_refused(folder):
    run = CliRunner().invoke
    assert "opened: 12 scans" in run(app, ["inspect", str(folder), "--reader", "clouds"]).output
    refused = run(app, ["inspect", str(folder), "--reader", "cloud"])
    assert refused.exit_code == 2 or "clouds" in str(refused.exception)
    assert "reader named 'rosbagg' (did you mean 'rosbag'?)" in str(
        run(app, ["compare", str(folder), "--reader", "rosbagg"]).exception
    )


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.ply", b"ply\nformat ascii 1.0\nelement face 1\nproperty float x\nend_header\n1\n", "first element is not"),
        (
            "a.ply",
            b"ply\nformat ascii 1.0\nelement vertex 1\nproperty list uchar int x\nend_header\n1 1\n",
            "a list in",
        ),
        ("a.pcd", pcd(POINTS, "binary").replace(b"TYPE U F F F", b"TYPE U I F F"), "x, y, z are no floats"),
    ],
)
def test_a_cloud_whose_points_are_no_numbers_is_refused(tmp_path, name, content, message):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(BadData, match=message):
        read_cloud_file(tmp_path / name)


def test_a_cloud_without_points_is_empty_and_a_huge_file_is_not_read(tmp_path, monkeypatch):
    (tmp_path / "a.pcd").write_bytes(pcd(POINTS[:0], "binary"))
    assert read_cloud_file(tmp_path / "a.pcd").shape == (0, 3)
    monkeypatch.setattr(cloud_files, "MAX_FILE_BYTES", 2**20)
    (tmp_path / "b.pcd").write_bytes(bytes(2**20 + 1))
    with pytest.raises(BadData, match="more than 1 MiB for one cloud"):
        read_cloud_file(tmp_path / "b.pcd")


def test_a_folder_without_clouds_or_with_too_few_of_them_is_refused(tmp_path):
    with pytest.raises(BadData, match=r"no file \.pcd or \.ply in it"):
        Clouds(path=str(tmp_path))
    (tmp_path / "1.pcd").write_bytes(pcd(POINTS, "binary"))
    with pytest.raises(BadData, match="start 5 lies beyond its 1 clouds"):
        Clouds(path=str(tmp_path), start=5)
