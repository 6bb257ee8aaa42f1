import numpy as np
import pytest

from evalkit.core.errors import BadData, DataMissing
from evalkit.io.g2o import format_g2o, read_g2o


@pytest.fixture
def read(tmp_path):
    def read_text(text):
        (tmp_path / "graph.g2o").write_text(text)
        return read_g2o(tmp_path / "graph.g2o")

    return read_text


MATRIX = [[1.0, 0.1, 0.2], [0.1, 2.0, 0.3], [0.2, 0.3, 3.0]]


def test_both_spellings_of_one_graph_are_the_same_graph_although_their_matrices_are_in_another_order(read):
    g2o = read("VERTEX_SE2 5 0 0 0\nVERTEX_SE2 8 1 2 0.5\nEDGE_SE2 5 8 1 2 0.5 1 0.1 0.2 2 0.3 3\n")
    toro = read("VERTEX2 5 0 0 0\nVERTEX2 8 1 2 0.5\nEDGE2 5 8 1 2 0.5 1 0.1 2 3 0.2 0.3\n")
    for file in (g2o, toro):
        assert file.ids.tolist() == [5, 8]
        assert file.chained == 0
        np.testing.assert_array_equal(file.graph.information, [MATRIX])
        np.testing.assert_array_equal(file.graph.first_from_second, [[1.0, 2.0, 0.5]])
        np.testing.assert_array_equal(file.graph.poses, [[0.0, 0.0, 0.0], [1.0, 2.0, 0.5]])
        assert (file.graph.first.tolist(), file.graph.second.tolist()) == ([0], [1])


def test_a_written_graph_reads_back_the_same(read):
    text = format_g2o(
        read("VERTEX_SE2 5 0 0 0\nVERTEX_SE2 8 1 2 0.5\nFIX 8\nEDGE_SE2 8 5 1 2 0.5 1 0.1 0.2 2 0.3 3\n").graph,
        [5, 8],
        [1],
    )
    assert text == ("VERTEX_SE2 5 0 0 0\nVERTEX_SE2 8 1 2 0.5\nFIX 8\nEDGE_SE2 8 5 1 2 0.5 1 0.1 0.2 2 0.3 3\n")
    assert read(text).fixed.tolist() == [1]


def test_poses_without_a_line_are_chained_in_both_directions_of_an_edge(read):
    file = read("EDGE_SE2 1 2 1 0 1.5707963267948966 1 0 0 1 0 1\nEDGE_SE2 3 2 1 0 0 1 0 0 1 0 1\n")
    assert (file.ids.tolist(), file.chained) == ([1, 2, 3], 3)
    # 2 lies 1 m ahead of 1, turned left; 3 lies 1 m behind 2
    np.testing.assert_allclose(file.graph.poses, [[0, 0, 0], [1, 0, np.pi / 2], [1, -1, np.pi / 2]], atol=1e-12)


EDGE = "EDGE_SE2 0 1 1 0 0 1 0 0 1 0 1"


@pytest.mark.parametrize(
    ("text", "place", "found"),
    [
        ("VERTEX_SE3:QUAT 0 0 0 0 0 0 0 1", "line 1", "VERTEX_SE3:QUAT"),
        (f"{EDGE}\nVERTEX_XY 3 0 0", "line 2", "VERTEX_XY"),
        ("VERTEX_SE2 0 0 0", "line 1", "2 numbers after the pose numbers, not 3"),
        ("EDGE_SE2 0 1 1 0 0 1 0 0", "line 1", "6 numbers after the pose numbers, not 9"),
        ("VERTEX_SE2 0 nan 0 0", "line 1", "not finite"),
        ("VERTEX_SE2 0 1e9 0 0", "line 1", "above 1e+07 m"),
        ("VERTEX_SE2 a 0 0 0", "line 1", "'a' is not the number of a pose"),
        ("VERTEX_SE2 0 0 0 0\nVERTEX_SE2 0 1 0 0", "line 2", "pose 0 is given a second time"),
        ("EDGE_SE2 4 4 1 0 0 1 0 0 1 0 1", "line 1", "from pose 4 to itself"),
        ("EDGE_SE2 0 1 1 0 0 1 0 0 -1 0 1", "edge 0 1", "not positive"),
        (f"VERTEX_SE2 0 0 0 0\n{EDGE}\nEDGE_SE2 7 8 1 0 0 1 0 0 1 0 1", "", "no edge connects pose 7"),
        (f"{EDGE}\nFIX 9", "", "FIX names pose 9"),
        ("# nothing", "", "no pose and no edge"),
    ],
)
def test_what_is_no_planar_pose_graph_is_refused_with_the_place(read, tmp_path, text, place, found):
    with pytest.raises(BadData) as refused:
        read(text)
    message = str(refused.value)
    assert message.startswith(f"{tmp_path / 'graph.g2o'}: {place}")
    assert found in message


def test_a_matrix_in_toro_order_under_the_name_of_g2o_is_found_where_it_is_not_positive(read):
    # I11 I12 I22 I33 I13 I23 = 1 0 1 4 0 0 read as I11 I12 I13 I22 I23 I33
    with pytest.raises(BadData, match="another order"):
        read("EDGE_SE2 0 1 1 0 0 1 0 1 4 0 0")


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(DataMissing, match="planar pose graph"):
        read_g2o(tmp_path / "absent.g2o")


def test_information_beyond_all_sensors_is_refused(read):
    with pytest.raises(BadData, match=r"information above 1e\+"):
        read("EDGE_SE2 0 1 1 0 0 1e300 0 0 1 0 1")
