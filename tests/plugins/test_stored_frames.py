"""Frames in a file are those of the sequence, to the bit, and only as long as the file is unchanged."""

import math
import struct
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from evalkit.core.errors import BadData
from evalkit.core.pose import Pose
from evalkit.core.scan import Frame, Scan
from evalkit.plugins import registry
from evalkit.plugins.nuisance import perturb_sequence
from evalkit.plugins.stored_frames import FramesFile, StoredFrames, write_frames


@dataclass
class Listed:
    """A sequence of given frames."""

    listed: tuple[Frame, ...]

    def __len__(self):
        return len(self.listed)

    def frames(self):
        return iter(self.listed)

    def truth(self):
        raise AssertionError("the frames need no ground truth")

    def notes(self):
        return {"invalid ranges": 1}


def frames_of(*scans):
    """Frames with, in turn, every pose, none but the sensor's, and neither a turn nor a motion."""
    poses = [
        (Pose(0.1, -0.0, math.pi), Pose(1.0, 2.0, -3.0), Pose(1e-9, 0.0, 0.1)),
        (Pose(),),
        (Pose(2.0), None, Pose()),
    ]
    return tuple(Frame(scan, *poses[k % 3]) for k, scan in enumerate(scans))


def bits(frame):
    """Everything in a frame."""
    scan = frame.scan
    poses = [
        pose and struct.pack("<3d", *pose.row)
        for pose in (frame.base_from_sensor, frame.odom_from_base, frame.start_from_end)
    ]
    limits = struct.pack("<2d", scan.range_min_m, scan.range_max_m)
    return scan.stamp_ns, scan.ranges.tobytes(), scan.angles.tobytes(), limits, scan.time_increment_ns, *poses


def store(sequence, folder, **limits):
    path = folder / "frames"
    return FramesFile(str(path), write_frames(sequence, path, folder, **limits))


RANGES = np.array([0.1, math.inf, math.nan, 5.0])
SCANS = (
    Scan(2**62, RANGES, np.linspace(-1.0, 1.0, 4), 0.1, 5.0, 125_000),
    Scan(2**62 + 1, RANGES[:2], np.linspace(-1.0, 1.0, 2), 0.0, math.inf),
    Scan(2**62 + 2, np.zeros(0), np.zeros(0), 0.0, 1.0),
    Scan(2**62 + 3, RANGES[::-1], np.linspace(-1.0, 1.0, 4), 0.1, 5.0, 125_000),
)


def test_frames_return_to_the_bit_on_every_pass(tmp_path):
    sequence = Listed(frames_of(*SCANS))
    stored = StoredFrames(store(sequence, tmp_path))
    for _ in range(2):
        assert list(map(bits, stored.frames())) == list(map(bits, sequence.listed))
    first, last = zip(stored.frames(), stored.frames(), strict=True), list(stored.frames())  # passes at the same time
    assert [bits(one) == bits(other) for one, other in first] == [True] * 4
    assert (len(stored), len(last), stored.notes()) == (4, 4, {"invalid ranges": 1})


def test_a_simulated_drive_and_an_excerpt_of_it_return_to_the_bit(tmp_path):
    room = registry.dataset("room").open({"laps": 0.02, "seed": 3})
    for sequence in (room, perturb_sequence(room, 2, 10)):
        stored = StoredFrames(store(sequence, tmp_path))
        assert list(map(bits, stored.frames())) == list(map(bits, sequence.frames()))
        assert (len(stored), stored.notes()) == (len(sequence), sequence.notes())


def test_a_changed_file_is_refused(tmp_path):
    file = store(Listed(frames_of(*SCANS)), tmp_path)
    content = bytearray(Path(file.path).read_bytes())
    content[-1] ^= 1
    Path(file.path).write_bytes(content)
    with pytest.raises(BadData, match="sha256"):
        StoredFrames(file)


def test_a_file_cut_off_while_it_is_read_is_named(tmp_path):
    file = store(Listed(frames_of(*SCANS)), tmp_path)
    frames = StoredFrames(file).frames()
    next(frames)
    with Path(file.path).open("r+b") as stream:
        stream.truncate(Path(file.path).stat().st_size - 8 * len(SCANS[-1].ranges) - 8)  # the second scan loses a beam
    with pytest.raises(BadData, match=r"frames.*it ends there"):
        next(frames)


def test_frames_stay_readable_after_the_file_is_replaced(tmp_path):
    sequence = Listed(frames_of(*SCANS))
    stored = StoredFrames(store(sequence, tmp_path))
    store(Listed(frames_of(SCANS[2])), tmp_path)
    assert list(map(bits, stored.frames())) == list(map(bits, sequence.listed))


@pytest.mark.parametrize(("max_bytes", "is_written"), [(8 * (10 + 6), True), (8 * (10 + 6) - 1, False)])
def test_too_many_ranges_and_angles_are_not_written(tmp_path, max_bytes, is_written):
    """Ten ranges; six angles, because equal ones are written once."""
    file = store(Listed(frames_of(*SCANS)), tmp_path, max_bytes=max_bytes)
    assert (file.sha256 is not None) == is_written == Path(file.path).exists()


@dataclass(frozen=True, eq=False)
class ColouredScan(Scan):
    colour: str = "red"


def test_a_scan_with_more_than_a_scan_has_is_not_written(tmp_path):
    coloured = ColouredScan(5, RANGES, np.linspace(-1.0, 1.0, 4), 0.1, 5.0)
    assert store(Listed(frames_of(coloured)), tmp_path).sha256 is None
    assert not list(tmp_path.iterdir())
