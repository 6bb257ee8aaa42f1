"""Experiments built from command-line arguments."""

import re
import shlex
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest

from evalkit.config.adhoc_experiment import (
    experiment_from_recording,
    format_command,
    open_recording,
    read_first_frame,
)
from evalkit.core.errors import BadData, BadExperiment, BadParameter, NotInstalled, UnknownName
from evalkit.plugins import defaults, registry
from evalkit.plugins.specs import Choice


@pytest.fixture
def log(tmp_path):
    path = tmp_path / "my run.LOG"
    path.write_text("FLASER\n")
    return path


def plan(path, settings=(), backends=("wheel-odometry",), choices=()):
    return experiment_from_recording(open_recording(path, dict(settings)), choices, list(backends), "compare it")


def test_an_empty_file_is_called_empty_whatever_its_suffix(tmp_path):
    for name in ("empty.csv", "empty.bag", "empty.log"):
        (tmp_path / name).write_bytes(b"")
        with pytest.raises(BadData, match="the file is empty"):
            open_recording(tmp_path / name, {}).choose()


def test_a_log_is_read_by_the_reader_of_its_suffix(log):
    made = plan(log)
    (sequence,) = made.sequences
    assert (sequence.dataset, sequence.label, sequence.parameters["path"]) == ("carmen", "my run.LOG", str(log))
    assert (sequence.seeds, made.source) == ((None,), "compare it")


@pytest.mark.parametrize(
    ("name", "label"), [("-day 1.log", "day 1.log"), ("@home.log", "home.log"), ("a-b.log", "a-b.log")]
)
def test_a_recording_runs_whatever_its_name_begins_with(tmp_path, monkeypatch, name, label):
    monkeypatch.chdir(tmp_path)
    Path(name).write_text("FLASER\n")
    assert plan(Path(name)).sequences[0].label == label
    word = format_command(Path(name), {}, {}, ["x"], []).removeprefix("compare ").partition(" --")[0]
    assert shlex.split(word) == [f"./{name}" if name[0] == "-" else name]


def test_a_recording_runs_as_it_is_and_under_perturbations(log):
    made = experiment_from_recording(open_recording(log, {}), (), ["wheel-odometry"], "compare it", {"nuisance": 5})
    (sequence,) = made.sequences
    assert (sequence.perturbed, sequence.seeds) == (True, (None, 1, 2, 3, 4, 5))
    with pytest.raises(BadExperiment, match="found 1, expected 0, or 2 to 64 perturbations"):
        experiment_from_recording(open_recording(log, {}), (), ["wheel-odometry"], "compare it", {"nuisance": 1})


def test_a_doubt_of_the_reader_about_the_data_belongs_to_the_sequence(log):
    choices = (
        Choice("range_max_m", 30.0, "usual"),
        Choice("base_from_sensor", None, "heading 0: check it", warns=True),
    )
    assert plan(log, choices=choices).sequences[0].warnings == ("heading 0: check it",)
    assert plan(log, choices=choices[:1]).sequences[0].warnings == ()


def test_a_folder_is_read_by_the_reader_of_its_content(tmp_path):
    folder = tmp_path / "drive"
    folder.mkdir()
    (folder / "metadata.yaml").write_text("")
    (folder / "drive_0.db3").write_text("")
    assert plan(folder).sequences[0].dataset == "rosbag"


def test_a_folder_of_results_is_no_recording(tmp_path):
    (tmp_path / "runs").mkdir()
    for name in ("results.json", "summary.csv"):  # the suffix of a table of scans
        (tmp_path / name).write_text("")
    with pytest.raises(
        BadData, match=r"a folder of results; evalkit export and evalkit diff read it; to run it again,"
    ):
        open_recording(tmp_path, {})


def test_the_named_back_ends_run_and_by_default_one_of_each_family(log):
    assert [method.label for method in plan(log, backends=("paper", "kiss-icp")).methods] == ["paper", "kiss-icp"]
    chosen = defaults.find_default_backends()
    assert len(chosen) == 6
    assert len({registry.plug_in_of("backends", name).module for name in chosen}) == 6
    assert [registry.backend(name).role for name in chosen].count("baseline") == 1


def test_choices_apply_to_reader_and_mapper_unless_given(log):
    choices = (
        Choice("range_max_m", 30.0, "a code"), Choice("odometry", "none", "no wheels"),
        Choice("mapper.resolution_m", 0.1, "wide beams"), Choice("mapper.of_another_mapper", 1, ""),
        Choice("base_from_sensor", None, "as recorded"),
    )  # fmt: skip
    made = plan(log, {"odometry": "scan-poses"}, choices=choices)
    found = made.sequences[0].parameters
    assert (found["range_max_m"], found["odometry"], found["base_from_sensor"]) == (30.0, "scan-poses", "auto")
    assert made.mapper.parameters["resolution_m"] == 0.1
    assert plan(log).mapper.parameters["resolution_m"] == 0.05


def test_a_recording_that_breaks_the_search_for_choices_is_reported(log, monkeypatch):
    recording = open_recording(log, {})
    broken = replace(recording.spec, choose=lambda _: {}["x"])
    monkeypatch.setattr(registry, "dataset", lambda name: broken)
    with pytest.raises(BadData, match=r"my run.LOG: cannot be read \(KeyError: 'x'\)"):
        recording.choose()
    monkeypatch.setattr(registry, "dataset", lambda name: replace(broken, choose=None))
    assert recording.choose() == ()


def test_a_broken_plugin_does_not_affect_others(log, strangers, monkeypatch):
    original = registry.dataset

    def dataset(name):
        if name == "lab":
            raise NotInstalled(name, "its plug-in does not load", "reinstall its package")
        return original(name)

    monkeypatch.setattr(registry, "dataset", dataset)
    names = ("unloadable", "wheel-odometry")
    missing = {method.label: method.missing for method in plan(log, backends=names).methods}
    assert "does not load" in missing["unloadable"]
    assert missing["wheel-odometry"] == ""


def test_the_title_counts_the_back_ends(log):
    titles = [plan(log, backends=names).title for names in (("paper",), ("paper", "wheel-odometry"))]
    assert [title.removeprefix("my run.LOG: ") for title in titles] == [
        f"{many} on one recording" for many in ("one method", "2 methods")
    ]


def test_every_file_and_topic_has_its_own_results_folder(tmp_path):
    names = []
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "x.bag").write_text("")
        names += [plan(tmp_path / folder / "x.bag", {"topic": topic}).name for topic in ("/left/scan", "/right")]
    assert len(set(names)) == 4
    assert names == [plan(tmp_path / f / "x.bag", {"topic": t}).name for f in "ab" for t in ("/left/scan", "/right")]
    assert re.fullmatch(r"x-bag-left-scan-[0-9a-f]{6}", names[0])


def test_a_bag_in_a_subfolder_is_found_unless_there_are_several(tmp_path):
    for name in ("one", "two"):
        (tmp_path / "top" / name).mkdir(parents=True)
        (tmp_path / "top" / name / "x_0.db3").write_text("")
    with pytest.raises(BadData, match=r"2 folders with a recording in it; give one of .*top/one, .*top/two"):
        plan(tmp_path / "top")
    (tmp_path / "top" / "two" / "x_0.db3").unlink()
    assert plan(tmp_path / "top").sequences[0].parameters["path"] == str(tmp_path / "top" / "one")


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"FLASER 3 1 2\n", "drive.log"),
        (bytes(range(256)) * 40, "drive.log"),
        (b"# nothing\n", "drive.log"),
    ],
)
def test_an_unreadable_file_is_reported_before_anything_runs(tmp_path, content, message):
    path = tmp_path / "drive.log"
    path.write_bytes(content)
    with pytest.raises(BadData, match=message) as caught:
        read_first_frame(plan(path))
    assert "\n" not in str(caught.value)


def test_an_unexpected_reader_error_and_a_recording_without_scans_are_reported(log, monkeypatch):
    class Empty:
        def frames(self):
            return iter(())

    def opened_by(make):
        made = plan(log)
        with monkeypatch.context() as patch:
            patch.setattr(registry, "dataset", lambda name: SimpleNamespace(make=make))
            with pytest.raises(BadData) as caught:
                read_first_frame(made)
        return str(caught.value)

    assert opened_by(lambda **_: {}["x"]) == "my run.LOG: cannot be read (KeyError: 'x'); is the file whole?"
    assert opened_by(lambda **_: Empty()).startswith("my run.LOG: it contains no scan; ")


def test_settings_take_the_type_of_their_parameter(log):
    found = plan(log, {"odometry": "none", "range_max_m": "30"}).sequences[0].parameters
    assert (found["range_max_m"], found["odometry"]) == (30.0, "none")


@pytest.mark.parametrize(
    ("settings", "error", "message"),
    [
        ({"range_max_m": "far"}, BadParameter, "carmen: parameter 'range_max_m': found 'far', expected a number"),
        ({"range_max_m": "-3"}, BadExperiment, "'range_max_m': found -3.0, expected a number within"),
        ({"range_max": "3"}, BadExperiment, r"no parameter named 'range_max' \(did you mean 'range_max_m'\?\); known:"),
    ],
)
def test_an_invalid_setting_is_named(log, settings, error, message):
    with pytest.raises(error, match=message):
        plan(log, settings=settings)


def test_an_unknown_back_end_is_named(log):
    with pytest.raises(BadExperiment, match=r"compare .*my run.LOG: method 1: no backend named 'papper'"):
        plan(log, backends=("papper",))


def test_a_file_without_a_reader_lists_the_readers(tmp_path):
    with pytest.raises(BadData, match=r"nothing\.bag: no such file or folder"):
        plan(tmp_path / "nothing.bag")
    (tmp_path / "notes.md").write_text("")
    for path, shown in ((tmp_path / "notes.md", "'.md'"), (tmp_path, f"'{tmp_path.name}'")):
        with pytest.raises(BadData, match=f"no reader for {shown}; known readers: carmen .*rosbag"):
            plan(path)


@pytest.mark.parametrize(
    ("name", "said"), [("room", " (a data set, but its spec has no suffixes of files)"), ("carmem", " (did you mean ")]
)
def test_a_reader_that_is_none_is_named_with_the_reason(log, name, said):
    with pytest.raises(UnknownName, match=re.escape(f"no reader named '{name}'{said}")):
        open_recording(log, {}, name)


def test_a_log_is_recognised_by_its_content_whatever_its_suffix(tmp_path):
    log = tmp_path / "drive.txt"
    log.write_text("".join(f"FLASER 180 {'1.0 ' * 180}{k} 0 0 {k} 0 0 {k}.5 h {k}.5\n" for k in range(3)))
    assert open_recording(log, {}).reader == "carmen"
    other = tmp_path / "other.log"
    other.write_text("1 1 1\n2 1 1\n")
    assert open_recording(other, {}).reader == "carmen"  # by its suffix
    (tmp_path / "other.log.toml").write_text("[time]\ncolumn = 1\n[scan]\nfirst = 2\nstep_deg = 1\n")
    assert open_recording(other, {}).reader == "columns"
