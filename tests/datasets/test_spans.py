"""The file of distances by tape: what it holds, and what it is told where it does not."""

import numpy as np
import pytest

from evalkit import metrics
from evalkit.core.errors import BadData, DataMissing
from evalkit.core.ground_truth import Truth
from evalkit.core.measured_distances import Place, Span
from evalkit.core.run_result import STEP, RunResult
from evalkit.metrics.table import Evidence
from evalkit.plugins import registry
from evalkit_datasets import spans
from evalkit_datasets.carmen import Carmen

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


def test_places_are_times_points_seen_then_and_walls(tmp_path):
    assert spans.read(file(tmp_path, DOORS)) == (
        Span("door to door", Place(stamp_ns=976052857337284001), Place(0.5, -1.0, 976052860 * 10**9), 4.09, 0.01),
        Span("span 2", Place(0.0, 1.5), Place(3.0, 1.5), 3.0, 0.02),
    )


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("[[span]]\nfrom = 1\nmetres = 2\n", "span 1: missing key 'to'"),
        ("[[span]]\nfrom = 1\nto = 2\nmetres = -2\n", "span 1: metres: expected a positive number, got -2.0"),
        ("[[span]]\nfrom = 'door'\nto = 2\nmetres = 2\n", "span 1, from: 'door' is not a time in seconds"),
        ("[[span]]\nfrom = { wall = [1] }\nto = 2\nmetres = 2\n", "span 1, from: '[1]' is no point"),
        ("[[span]]\nfrom = { wal = [1, 2] }\nto = 2\nmetres = 2\n", "span 1, from: unknown key 'wal'"),
        ("[[span]]\nfrom = 1\nto = 2\nmetres = nan\n", "span 1, metres: 'NaN' is not a number"),
        ("[[span]]\nfrom = 1\nto = 2\nmetres = 2\nfeet = 6\n", "span 1: unknown key 'feet'"),
        ("[[tape]]\n", "its tables are not [[span]] alone"),
        ("[[span]\n", "not valid TOML"),
    ],
)
def test_what_is_wrong_is_named_with_its_place(tmp_path, text, told):
    with pytest.raises(BadData) as caught:
        spans.read(file(tmp_path, text))
    assert told in str(caught.value)


def test_no_file_is_no_data(tmp_path):
    with pytest.raises(DataMissing):
        spans.read(tmp_path / "none.toml")


def log(tmp_path):
    """Eleven scans, one a second and one a metre; the odometry is the robot pose beside each scan."""
    beams = " ".join(["5.0"] * 180)
    lines = [f"FLASER 180 {beams} {k} 0 0 {k} 0 0 {100 + k}.5 host {k}.5" for k in range(11)]
    path = tmp_path / "run.log"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def test_a_recording_brings_the_distances_given_for_it(tmp_path):
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


def test_distances_of_another_recording_are_refused(tmp_path):
    tape = file(tmp_path, "[[span]]\nfrom = 1.5\nto = 9.5\nmetres = 8\n")
    with pytest.raises(BadData, match="have nothing in common with the recording"):
        Carmen(str(log(tmp_path)), spans=str(tape))


def test_every_reader_of_recordings_takes_them():
    for name in ("carmen", "rosbag"):
        assert "spans" in {parameter.name for parameter in registry.dataset(name).parameters}
