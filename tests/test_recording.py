"""A plan from the words of a command line."""

import pytest

from evalkit import recording, registry
from evalkit.errors import BadData, BadExperiment, BadParameter


@pytest.fixture
def log(tmp_path):
    path = tmp_path / "my run.LOG"
    path.write_text("FLASER\n")
    return path


def plan(path, options=(), settings=(), backends=("wheel-odometry",)):
    return recording.plan(path, dict(options), dict(settings), list(backends), "compare it")


def test_a_log_is_read_by_the_reader_of_its_suffix(log):
    made = plan(log)
    (course,) = made.courses
    assert (course.dataset, course.label, course.parameters["path"]) == ("carmen", "my run.LOG", str(log))
    assert (course.seeds, made.source) == ((None,), "compare it")


def test_a_folder_is_read_by_the_reader_of_what_is_in_it(tmp_path):
    folder = tmp_path / "drive"
    folder.mkdir()
    (folder / "metadata.yaml").write_text("")
    (folder / "drive_0.db3").write_text("")
    assert plan(folder).courses[0].dataset == "rosbag"


def test_all_back_ends_run_unless_some_are_named(log):
    assert [entrant.label for entrant in plan(log, backends=()).contestants] == registry.names("backends")
    assert [entrant.label for entrant in plan(log, backends=("paper", "kiss-icp")).contestants] == ["paper", "kiss-icp"]


def test_settings_take_the_type_of_their_parameter_and_options_come_first(log):
    found = plan(log, {"odometry": "none"}, {"range_max_m": "30", "odometry": "auto"}).courses[0].parameters
    assert (found["range_max_m"], found["odometry"]) == (30.0, "none")


@pytest.mark.parametrize(
    ("settings", "error", "message"),
    [
        ({"range_max_m": "far"}, BadParameter, "carmen: parameter 'range_max_m': found 'far', expected float"),
        ({"range_max_m": "-3"}, BadExperiment, "'range_max_m': found -3.0, expected a number within"),
        ({"range_max": "3"}, BadExperiment, r"no parameter named 'range_max' \(did you mean 'range_max_m'\?\); known:"),
    ],
)
def test_a_setting_that_does_not_fit_is_named(log, settings, error, message):
    with pytest.raises(error, match=message):
        plan(log, settings=settings)


def test_a_back_end_that_is_none_is_named(log):
    with pytest.raises(BadExperiment, match=r"compare .*my run.LOG: contestant 1: no backend named 'papper'"):
        plan(log, backends=("papper",))


def test_what_no_reader_reads_lists_the_readers(tmp_path):
    with pytest.raises(BadData, match=r"nothing\.bag: no such file or folder"):
        plan(tmp_path / "nothing.bag")
    (tmp_path / "notes.txt").write_text("")
    for path, shown in ((tmp_path / "notes.txt", "'.txt'"), (tmp_path, f"'{tmp_path.name}'")):
        with pytest.raises(BadData, match=f"no reader for {shown}; known readers: carmen .*rosbag"):
            plan(path)
