"""Memory of long recordings: bags, logs and simulated drives of 1x and 10x grow only by their trajectory."""

import importlib.util
import sys
import tracemalloc
from pathlib import Path

import pytest

from evalkit_datasets.readers.carmen import Carmen
from evalkit_datasets.readers.rosbag import RosBag

SHORT, LONG = 120, 1200
WITHOUT_CHUNKS = 480  # is long enough where no chunk has to be filled
BEAMS = 361
PER_SCAN = 600  # bytes; one scan of 361 beams alone has 5,800, with its angles
CHUNK = 3 * 2**20  # bags of two formats are read in chunks, which a short bag does not fill


def long_bags():
    path = Path(__file__).parents[1] / "bench" / "long_bags.py"
    spec = importlib.util.spec_from_file_location("long_bags", path)
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


def growth(make, long=LONG):
    """Return the bytes that every further scan adds to the peak while a sequence is opened and iterated."""
    make(SHORT)  # imports and caches are counted here
    peaks = []
    for scans in (SHORT, long):
        tracemalloc.start()
        seen = sum(1 for _ in make(scans).frames())
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
        assert seen >= scans
    return (peaks[1] - peaks[0]) / (long - SHORT)


@pytest.mark.thorough
@pytest.mark.parametrize("kind", ["ros1", "sqlite3", "mcap"])
def test_a_bag_needs_no_more_memory_than_its_trajectory(tmp_path, kind):
    pytest.importorskip("rosbags")
    bags = {scans: str(long_bags().write(tmp_path, kind, scans, BEAMS)) for scans in (SHORT, LONG)}
    assert growth(lambda scans: RosBag(bags[scans])) < PER_SCAN + CHUNK / (LONG - SHORT)


def test_a_log_needs_no_more_memory_than_its_trajectory(tmp_path):
    def line(scan):
        beams = " ".join(["2.5"] * BEAMS)
        where = f"{0.01 * scan:.2f} 0 0"
        return f"ODOM {where} 0 0 0 {scan / 10} r 1\nFLASER {BEAMS} {beams} {where} {where} {scan / 10} r 1\n"

    for scans in (SHORT, WITHOUT_CHUNKS):
        (tmp_path / f"{scans}.log").write_text("".join(map(line, range(scans))))
    assert growth(lambda scans: Carmen(str(tmp_path / f"{scans}.log")), WITHOUT_CHUNKS) < PER_SCAN


def test_a_simulated_drive_needs_no_more_memory_than_its_trajectory(monkeypatch):
    from evalkit_datasets.worlds import robot, synthetic

    monkeypatch.setattr(robot, "_TICKS_AT_ONCE", 100)  # ten scans: fewer than in the short drive
    monkeypatch.setattr(synthetic, "_MAX_KEPT_BYTES", 0)
    assert growth(lambda scans: long_bags().drive(scans, BEAMS), WITHOUT_CHUNKS) < PER_SCAN
