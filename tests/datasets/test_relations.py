"""Relations of Kuemmerle et al."""

import pytest

from evalkit.core.errors import BadData
from evalkit_datasets import relations


def written(tmp_path, text):
    path = tmp_path / "some.relations"
    path.write_text(text)
    return path


def test_a_line_becomes_two_stamps_and_a_motion(tmp_path):
    read = relations.read(written(tmp_path, "1216.630413 1217.490267 0.407950 -0.016330 0 0 0 -0.069620\n"))
    assert read.first_ns.tolist() == [1216630413000]
    assert read.second_ns.tolist() == [1217490267000]
    assert read.first_from_second.tolist() == [[0.40795, -0.01633, -0.06962]]


def test_order_and_repeated_pairs_stay_as_published(tmp_path):
    read = relations.read(written(tmp_path, "5 3 1 0 0 0 0 0\n1 2 2 0 0 0 0 0\n5 3 1 0 0 0 0 0\n"))
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
def test_garbage_names_file_line_and_remedy(tmp_path, text, parts):
    with pytest.raises(BadData) as caught:
        relations.read(written(tmp_path, text))
    assert all(part in str(caught.value) for part in ["some.relations", *parts])
