"""Files of ground truth: measured distances and relations, and the errors of invalid files."""

import numpy as np
import pytest

from evalkit import metrics
from evalkit.core.errors import BadData, DataMissing
from evalkit.core.ground_truth import Truth
from evalkit.core.measured_distances import Span, SpanEnd
from evalkit.core.run_result import STEP, RunResult
from evalkit.metrics.metric import Evidence
from evalkit.plugins import registry
from evalkit_datasets.parsing.truth_files import read_relations, read_spans
from evalkit_datasets.readers.carmen import Carmen

DOORS = """
[[span]]
name = "door to door"
from = 976052857.337284001
to = { at = "976052860", point = [0.5, -1] }
metres = 4.09

[[span]]
from = { wall = [0, 1.5] }
to = { wall = [3, 1.5] }
metres = 3
sigma_m = 0.02
"""


def file(tmp_path, text):
    path = tmp_path / "tape.toml"
    path.write_text(text, encoding="utf-8")
    return path


def test_places_are_times_observed_points_and_walls(tmp_path):
    assert read_spans(file(tmp_path, DOORS)) == (
        Span("door to door", SpanEnd(stamp_ns=976052857337284001), SpanEnd(0.5, -1.0, 976052860 * 10**9), 4.09, 0.01),
        Span("span 2", SpanEnd(0.0, 1.5), SpanEnd(3.0, 1.5), 3.0, 0.02),
    )


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[[span]]\nfrom = 1\nmetres = 2\n", "span 1: missing key 'to'"),
        ("[[span]]\nfrom = 1\nto = 2\nmetres = -2\n", "span 1: metres: expected a positive number, got -2.0"),
        ("[[span]]\nfrom = 'door'\nto = 2\nmetres = 2\n", "span 1, from: 'door' is not a time in seconds"),
        ("[[span]]\nfrom = { wall = [1] }\nto = 2\nmetres = 2\n", "span 1, from: '[1]' is not a point"),
        ("[[span]]\nfrom = { wal = [1, 2] }\nto = 2\nmetres = 2\n", "span 1, from: unknown key 'wal'"),
        ("[[span]]\nfrom = 1\nto = 2\nmetres = nan\n", "span 1, metres: 'NaN' is not a number"),
        ("[[span]]\nfrom = { at = 1, point = [1e400, 0] }\nto = 2\nmetres = 2\n", "'1E+400' is not a number"),
        ("[[span]]\nfrom = 1\nto = 2\nmetres = 2\nfeet = 6\n", "span 1: unknown key 'feet'"),
        ("span = [1]\n", "span 1: 1 is not a table"),
        ("[[span]]\nfrom = { point = [0, 0] }\nto = 2\nmetres = 2\n", "span 1, from: neither 'at' nor 'wall'"),
        ("[[tape]]\n", "expected tables [[span]] and nothing else"),
        ("[[span]\n", "not valid TOML"),
    ],
)
def test_an_error_contains_the_invalid_place(tmp_path, text, message):
    with pytest.raises(BadData) as caught:
        read_spans(file(tmp_path, text))
    assert message in str(caught.value)


def test_an_absent_file_is_missing_data(tmp_path):
    with pytest.raises(DataMissing):
        read_spans(tmp_path / "none.toml")


def log(tmp_path):
    """Write eleven scans, 1 s and 1 m apart; the odometry is the robot pose of each scan."""
    beams = " ".join(["5.0"] * 180)
    lines = [f"FLASER 180 {beams} {k} 0 0 {k} 0 0 {100 + k}.5 host {k}.5" for k in range(11)]
    path = tmp_path / "run.log"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def test_a_recording_contains_its_measured_distances(tmp_path):
    tape = file(tmp_path, "[[span]]\nfrom = 101.5\nto = 109.5\nmetres = 8.16\n")
    sequence = Carmen(str(log(tmp_path)), spans=str(tape))
    assert sequence.truth().how == "distances measured with a tape"
    steps = [(frame.scan.stamp_ns, *frame.odom_from_base.row) for frame in sequence.frames()]
    rows = np.zeros(len(steps), STEP)
    for row, values in zip(rows, steps, strict=True):
        row["stamp_ns"], row["x"], row["y"], row["theta"] = values
    truth: Truth = sequence.truth()
    found = metrics.compute_scores(Evidence(RunResult(rows, 11), truth))
    assert found["span_stretch_percent"].value == pytest.approx(100.0 * (8.0 / 8.16 - 1.0))


def test_distances_of_another_recording_are_rejected(tmp_path):
    tape = file(tmp_path, "[[span]]\nfrom = 1.5\nto = 9.5\nmetres = 8\n")
    with pytest.raises(BadData, match="do not overlap the recording"):
        Carmen(str(log(tmp_path)), spans=str(tape))


def test_every_reader_of_recordings_accepts_measured_distances():
    for name in ("carmen", "rosbag"):
        assert "spans" in {parameter.name for parameter in registry.dataset(name).parameters}


# relations


def relations_file(tmp_path, text):
    path = tmp_path / "some.relations"
    path.write_text(text)
    return path


def test_a_line_is_read_as_two_stamps_and_a_motion(tmp_path):
    read = read_relations(relations_file(tmp_path, "1216.630413 1217.490267 0.407950 -0.016330 0 0 0 -0.069620\n"))
    assert read.first_ns.tolist() == [1216630413000]
    assert read.second_ns.tolist() == [1217490267000]
    assert read.first_from_second.tolist() == [[0.40795, -0.01633, -0.06962]]


def test_the_order_and_repeated_pairs_are_kept(tmp_path):
    read = read_relations(relations_file(tmp_path, "5 3 1 0 0 0 0 0\n1 2 2 0 0 0 0 0\n5 3 1 0 0 0 0 0\n"))
    assert read.first_ns.tolist() == [5 * 10**9, 10**9, 5 * 10**9]


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("", ["empty"]),
        ("\n# nothing\n", ["no relation"]),
        ("1 2 3\n", ["line 1", "3 columns"]),
        ("1 2 0 0 0 0 0 0\n1 x 0 0 0 0 0 0\n", ["line 2", "'x'"]),
        ("1 2 0 0 0 0 0 left\n", ["line 1", "'left'", "column 6"]),
        ("1 2 inf 0 0 0 0 0\n", ["line 1", "not finite"]),
    ],
)
def test_an_invalid_line_is_reported_with_file_line_and_remedy(tmp_path, text, parts):
    with pytest.raises(BadData) as caught:
        read_relations(relations_file(tmp_path, text))
    assert all(part in str(caught.value) for part in ["some.relations", *parts])
