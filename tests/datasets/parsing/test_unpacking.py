"""Compressed bags: read when sound, refused when they unpack to more than a limit or are cut short."""

import bz2
import importlib.util
from pathlib import Path

import pytest

from evalkit.core.errors import BadData
from evalkit_datasets.parsing import unpacking
from evalkit_datasets.readers.rosbag import RosBag

pytest.importorskip("rosbags")
lz4 = pytest.importorskip("lz4.frame")

T0 = 1663967375_000000001
PACKED = [("ros1", "bz2"), ("ros1", "lz4"), ("mcap", "storage"), ("sqlite3", "file"), ("sqlite3", "message")]


def made(kind, folder, packed):
    """Return the path of a bag of two scans of 5,000 equal ranges, 20 kB each unpacked."""
    path = Path(__file__).parent.parent / "readers" / "test_rosbag.py"
    spec = importlib.util.spec_from_file_location("bag_tests", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    bag = module.Bag(kind)
    for k in range(2):
        bag.scan(T0 + k * 10**8, [1.5] * 5000, angle_increment=0.001, time_increment=1e-6)
    return bag.write(folder, packed)


@pytest.mark.parametrize(("kind", "packed"), PACKED)
def test_a_compressed_bag_is_read_exactly(tmp_path, kind, packed):
    frames = list(RosBag(str(made(kind, tmp_path, packed))).frames())
    assert [(frame.scan.stamp_ns, set(frame.scan.ranges.tolist())) for frame in frames] == [
        (T0, {1.5}),
        (T0 + 10**8, {1.5}),
    ]


@pytest.mark.parametrize(("kind", "packed"), PACKED)
def test_a_bag_that_unpacks_to_more_than_the_limit_is_refused(tmp_path, monkeypatch, kind, packed):
    path = made(kind, tmp_path, packed)
    monkeypatch.setattr(unpacking, "FREE_BYTES", 2**13)
    monkeypatch.setattr(unpacking, "MAX_RATIO", 0)
    with pytest.raises(BadData, match="its compressed data unpack to more than"):
        RosBag(str(path))


@pytest.mark.parametrize(("kind", "packed"), [part for part in PACKED if part[1] != "file"])  # a file is no piece
def test_a_piece_beyond_its_limit_is_refused(tmp_path, monkeypatch, kind, packed):
    path = made(kind, tmp_path, packed)
    monkeypatch.setattr(unpacking, "MAX_PIECE_BYTES", 2**13)
    with pytest.raises(BadData, match="a compressed piece unpacks to more than"):
        RosBag(str(path))


def test_unpacking_stops_at_the_limit_and_not_at_the_end(monkeypatch):
    """64 MiB of zeros, of which 1 MiB may be taken: the rest is never unpacked."""
    monkeypatch.setattr(unpacking, "MAX_PIECE_BYTES", 2**20)
    taken = []

    class Counting:
        def __init__(self):
            self._inner = bz2.BZ2Decompressor()

        def __getattr__(self, name):
            return getattr(self._inner, name)

        def decompress(self, data, size):
            piece = self._inner.decompress(data, size)
            taken.append(len(piece))
            return piece

    with pytest.raises(unpacking.UnpackedTooMuch):
        unpacking.unpack(Counting, bz2.compress(bytes(2**26)))
    assert sum(taken) <= 2**21


@pytest.mark.parametrize(
    ("make", "content"),
    [(bz2.BZ2Decompressor, bz2.compress(b"scan" * 99)), (lz4.LZ4FrameDecompressor, lz4.compress(b"scan" * 99))],
)
def test_data_are_unpacked_exactly_and_a_cut_is_an_error(make, content):
    assert unpacking.unpack(make, content) == b"scan" * 99
    with pytest.raises((ValueError, EOFError, RuntimeError)):
        unpacking.unpack(make, content[:-9])
