"""Experiment files: complete validation before the first run, and run keys that identify their content."""

import os
import re
import shlex
import tomllib
from pathlib import Path

import pytest

from evalkit.config.experiment_file import experiment_from_tables, load_experiment
from evalkit.config.experiment_toml import format_experiment
from evalkit.config.limits import Limits
from evalkit.core.errors import BadExperiment, UnknownName
from evalkit.plugins import registry

WHEELS = '[[method]]\nuse = "wheel-odometry"\n'
ROOM = '[[sequence]]\nuse = "room"\n'
PAPER = '[[method]]\nuse = "paper"\n'


def read(tmp_path, text):
    path = tmp_path / "exp.toml"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return load_experiment(path)


def plan_runs(methods=({"use": "wheel-odometry"},), sequences=({"use": "room"},), **tables):
    content = {"method": list(methods), "sequence": list(sequences), **tables}
    return experiment_from_tables(content, "exp.toml", "exp", "compare exp.toml")


def only_key(**changes):
    return next(plan_runs(**changes).runs()).key


def digest(**changes):
    return only_key(**changes).rpartition("-")[2]


@pytest.fixture
def log(tmp_path):
    path = tmp_path / "a.log"
    path.write_text("FLASER\n")
    return path


# invalid files


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("", ["no [[method]]"]),
        (WHEELS, ["no [[sequence]]"]),
        ("title =\n", ["not valid TOML", "line 1"]),
        (b"title = '\xff'\n", ["not UTF-8 text at byte 9", "save it as UTF-8"]),
        ("titel = 'x'\n" + WHEELS + ROOM,
         ["no key named 'titel' (did you mean 'title'?)", "known: description, limits, mapper, method"]),
        ("title = 3\n" + WHEELS + ROOM, ["'title': found 3, expected a text"]),
        ("[method]\nuse = 'paper'\n" + ROOM, ["method: expected tables [[method]]"]),
        ("[[method]]\nlabel = 'x'\n" + ROOM, ["method 1: missing key 'use'"]),
        (WHEELS + "[[sequence]]\nusee = 'room'\n", ["sequence 1: no key named 'usee' (did you mean 'use'?)"]),
        (PAPER + "tuned_on = 'room'\n" + ROOM, ["method 1: 'tuned_on': found 'room', expected a list of texts"]),
        (PAPER + "tuned_on = ['rooom']\n" + ROOM, ["method 1: no dataset named 'rooom' (did you mean 'room'?)"]),
        ("[[method]]\nuse = 7\n" + ROOM, ["method 1: 'use': found 7, expected a text"]),
        (WHEELS + "[[method]]\nuse = 'papper'\n" + ROOM,
         ["method 2: no backend named 'papper' (did you mean 'paper'?)", "known:", "wheel-odometry"]),
        (WHEELS + "[[sequence]]\nuse = 'rooom'\n",
         ["sequence 1: no dataset named 'rooom' (did you mean 'room'?)", "known:", "carmen"]),
        ("[mapper]\nuse = 'log-ods'\n" + WHEELS + ROOM, ["mapper: no mapper named 'log-ods' (did you mean 'log-odds'?)",
          "known:"]),
        (PAPER + "epsilom = 1e-3\n" + ROOM,
         ["method 1 (paper): no parameter named 'epsilom' (did you mean 'epsilon'?)", "known:", "keyframes"]),
        (PAPER + "label = 'mine'\nkeyframes = 2.5\n" + ROOM,
         ["method 1 (mine): parameter 'keyframes': found 2.5, expected a whole number"]),
        (PAPER + "s2s.epsilom = 1e-3\n" + ROOM, ["method 1 (paper): no parameter named 's2s.epsilom'"]),
        (WHEELS + ROOM + "laps = 'two'\n", ["sequence 1 (room): parameter 'laps': found 'two', expected a number"]),
        (WHEELS + ROOM + "noise_m = -1\n", ["sequence 1 (room): parameter 'noise_m': found -1", "within [0, 1] m"]),
        (WHEELS + ROOM + "seed = 3\n", ["sequence 1 (room): found 'seed'; write seeds = [0, 1, ...]"]),
        (WHEELS + ROOM + "seeds = 3\n", ["sequence 1 (room): 'seeds': found 3, expected a list of whole numbers"]),
        (WHEELS + ROOM + "seeds = [0, true]\n", ["sequence 1 (room): 'seeds': found [0, True]"]),
        (WHEELS + ROOM + f"seeds = {list(range(1001))}\n",
         ["sequence 1 (room): 'seeds': found 1001 numbers, expected at most 1000"]),
        (WHEELS + ROOM + "seeds = []\n", ["sequence 1 (room): 'seeds': found []"]),
        (WHEELS + "[[sequence]]\nuse = 'carmen'\npath = 'a.log'\nseeds = [1]\n",
         ["sequence 1 (carmen): 'seeds': carmen is a recording and has none; remove the key"]),
        (WHEELS + PAPER + PAPER + ROOM, ["two methods are labelled 'paper'", 'label = "..."']),
        (WHEELS + ROOM + ROOM, ["two sequences are labelled 'room'"]),
        ("mapper = 'log-odds'\n" + WHEELS + ROOM, ["mapper: found 'log-odds', expected a table [mapper]"]),
        ("[mapper]\nscans = 1\n" + WHEELS + ROOM, ["mapper: 'scans': found 1, expected a whole number from 2"]),
        ("[mapper]\nsize = 1\n" + WHEELS + ROOM, ["mapper: no parameter named 'size'", "known:"]),
        ("[limits]\nrun = 3\n" + WHEELS + ROOM, ["limits: no key named 'run' (did you mean 'run_s'?)"]),
        ("[limits]\nrun_s = 0\n" + WHEELS + ROOM, ["limits: 'run_s': found 0, expected a positive number"]),
        ("[limits]\nscan_s = nan\n" + WHEELS + ROOM, ["limits: 'scan_s': found nan, expected a positive number"]),
        ("limits = 9\n" + WHEELS + ROOM, ["limits: found 9, expected a table [limits]"]),
    ],
)  # fmt: skip
def test_an_error_is_reported_with_file_place_and_known_names(tmp_path, text, parts):
    with pytest.raises(BadExperiment) as caught:
        read(tmp_path, text)
    message = str(caught.value)
    assert message.startswith(f"{tmp_path / 'exp.toml'}: ")
    assert message.count("exp.toml") == 1
    assert all(part in message for part in parts), message


def test_a_missing_experiment_file_is_named(tmp_path):
    with pytest.raises(BadExperiment, match=r"nothing\.toml: no such file; give the path of an experiment"):
        load_experiment(tmp_path / "nothing.toml")
    with pytest.raises(BadExperiment, match=re.escape(f"{tmp_path}: cannot be read")):
        load_experiment(tmp_path)


@pytest.mark.parametrize("key", ["path", "ground_truth", "relations"])
def test_a_missing_file_of_a_reader_is_an_error(tmp_path, log, key):
    table = {"use": "carmen", "label": "mine", "path": str(log), key: str(tmp_path / "no.such")}
    with pytest.raises(BadExperiment, match=rf"sequence 1 \(mine\): carmen: parameter '{key}': no file .*no\.such"):
        plan_runs(sequences=[table])


@pytest.mark.parametrize("method", ["file:{truth}", "file:{copy}", "file:{own}?final={truth}"])
def test_poses_that_are_the_ground_truth_are_no_method(tmp_path, log, method):
    names = {name: tmp_path / f"{name}.tum" for name in ("truth", "copy", "own")}
    for name, path in names.items():
        path.write_text(f"0 {1 if name == 'own' else 0} 0 0 0 0 0 1\n1 1 0 0 0 0 0 1\n")
    table = {"use": "carmen", "label": "mine", "path": str(log), "ground_truth": str(names["truth"])}
    plan_runs(methods=[{"use": f"file:{names['own']}"}], sequences=[table])
    use = method.format(**names)
    with pytest.raises(BadExperiment, match="its poses are the ground truth of mine") as caught:
        plan_runs(methods=[{"use": use, "label": "answers"}], sequences=[table])
    assert "'answers'" in str(caught.value)


def test_a_reader_without_a_path_is_an_error():
    with pytest.raises(BadExperiment, match=r"sequence 1 \(carmen\): carmen: parameter 'path' is empty; give a path"):
        plan_runs(sequences=[{"use": "carmen"}])


def test_a_catalogued_recording_without_data_is_not_an_error(tmp_path, monkeypatch):
    monkeypatch.setenv("EVALKIT_DATA", str(tmp_path))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setenv("HOME", str(tmp_path))
    (sequence,) = plan_runs(sequences=[{"use": "turtlebot4"}]).sequences
    assert "evalkit datasets fetch turtlebot4" in sequence.missing


def test_a_back_end_that_does_not_load_is_kept_with_the_reason(strangers):
    plan = plan_runs([{"use": "unloadable", "speed": 3}, {"use": "wheel-odometry"}])
    assert [method.missing != "" for method in plan.methods] == [True, False]
    assert "the licence server does not answer" in plan.methods[0].missing
    assert len(list(plan.runs())) == 2


# planned runs


def test_the_smallest_experiment_uses_every_default(tmp_path):
    plan = read(tmp_path, WHEELS + ROOM)
    assert (plan.name, plan.title, plan.description, plan.limits) == ("exp", "exp", "", Limits())
    assert (plan.mapper.name, plan.mapper.scans) == ("log-odds", 400)
    assert [(sequence.label, sequence.seeds) for sequence in plan.sequences] == [("room", (0,))]
    assert [(method.label, method.missing) for method in plan.methods] == [("wheel-odometry", "")]
    defaults = {p.name: p.default for p in registry.dataset("room").parameters}
    assert plan.sequences[0].parameters_with_seed(7) == {**defaults, "seed": 7}


def test_given_values_replace_defaults(tmp_path):
    plan = read(
        tmp_path,
        "title = 'T'\ndescription = 'D'\n"
        "[limits]\nrun_s = 9\nmemory_mib = 100\n[mapper]\nscans = 20\nresolution_m = 0.1\n"
        f"{PAPER}label = 'eager'\nkeyframes = 3\ns2s.epsilon = 0.5\n"
        f"{ROOM}label = 'box'\nlaps = 2\nseeds = [4, 2, 4]\n",
    )
    assert (plan.title, plan.description, plan.limits) == ("T", "D", Limits(run_s=9, memory_mib=100))
    assert (plan.mapper.scans, plan.mapper.parameters["resolution_m"]) == (20, 0.1)
    method, sequence = plan.methods[0], plan.sequences[0]
    assert (method.label, method.backend, method.parameters["keyframes"]) == ("eager", "paper", 3)
    assert (method.parameters["s2s.epsilon"], method.parameters["epsilon"]) == (0.5, 1e-4)
    assert (sequence.label, sequence.dataset, sequence.parameters["laps"], sequence.seeds) == (
        "box",
        "room",
        2.0,
        (4, 2),
    )


def test_a_recording_runs_once_without_a_seed(log):
    sequence = plan_runs(sequences=[{"use": "carmen", "path": str(log)}]).sequences[0]
    assert sequence.seeds == (None,)
    assert "seed" not in sequence.parameters_with_seed(None)


def test_methods_alternate_and_every_second_repetition_is_reversed():
    plan = plan_runs(
        [{"use": "wheel-odometry", "label": "A"}, {"use": "paper", "label": "B"}],
        [{"use": "room", "seeds": [0, 1]}, {"use": "lab"}],
    )
    order = [(item.sequence.label, item.seed, item.method.label) for item in plan.runs()]
    turns = (("room", 0, "AB"), ("room", 1, "BA"), ("lab", 0, "AB"))
    assert order == [(label, seed, who) for label, seed, both in turns for who in both]


# selections


@pytest.fixture
def wide(log):
    return plan_runs(
        [{"use": "wheel-odometry"}, {"use": "paper", "label": "the <odd> one's"}],
        [
            {"use": "room", "seeds": [0, 1, 2]},
            {"use": "lab", "label": "lab; askew"},
            {"use": "carmen", "path": str(log)},
        ],
    )


def test_a_selection_keeps_the_order_and_an_empty_selection_keeps_all(wide):
    assert wide.select([], [], []) == wide
    part = wide.select(["lab; askew", "room"], ["wheel-odometry"], [0, 2])
    assert [(sequence.label, sequence.seeds) for sequence in part.sequences] == [("room", (0, 2)), ("lab; askew", (0,))]
    assert [method.label for method in part.methods] == ["wheel-odometry"]


def test_a_recording_stays_selected_for_any_seeds(wide):
    assert wide.select([], [], [1]).sequences[2].seeds == (None,)


@pytest.mark.parametrize(
    ("choice", "message"),
    [
        ((["rom"], [], []), r"compare exp.toml: no sequence named 'rom' \(did you mean 'room'\?\); known: carmen, lab"),
        (([], ["papers"], []), "compare exp.toml: no method named 'papers'.*known: the <odd> one's, wheel-odometry"),
        (([], [], [0, 5]), "compare exp.toml: no seed named '5'; known: 0, 1, 2"),
    ],
)
def test_an_unknown_selection_is_an_error(wide, choice, message):
    with pytest.raises(UnknownName, match=message):
        wide.select(*choice)


def test_the_command_of_a_run_selects_that_run_alone(wide):
    for item in wide.runs():
        words = shlex.split(wide.command(item))
        assert words[:3] == ["evalkit", "compare", "exp.toml"]
        words.remove("--no-page")
        given = {name: [] for name in ("--sequence", "--method", "--seed", "--out")}
        for name, value in zip(words[3::2], words[4::2], strict=True):
            given[name].append(value)
        part = wide.select(given["--sequence"], given["--method"], [int(seed) for seed in given["--seed"]])
        assert [(alone.key, alone.method, alone.sequence.label, alone.seed) for alone in part.runs()] == [
            (item.key, item.method, item.sequence.label, item.seed)
        ]
        assert given["--out"] == ["evalkit-results/exp-one"]  # never the folder of the whole experiment


def test_the_command_of_a_run_sets_the_path_of_its_plug_in(tmp_path, monkeypatch):
    """As a stranger would copy it: with the folder of a module that is not installed."""
    folder = tmp_path / "my code"
    folder.mkdir()
    (folder / "my_icp.py").write_text("from evalkit_baselines.wheel_odometry import SPEC")
    monkeypatch.syspath_prepend(folder)
    monkeypatch.setenv("PYTHONPATH", str(folder))
    path = tmp_path / "own.toml"
    path.write_text(WHEELS + '[[method]]\nuse = "my_icp:SPEC"\n' + ROOM)
    plan = load_experiment(path)
    commands = {spec.method.label: plan.command(spec) for spec in plan.runs()}
    assert commands["my_icp:SPEC"].startswith(f"PYTHONPATH='{folder}' evalkit compare ")
    assert commands["wheel-odometry"].startswith("evalkit compare ")


def test_a_file_name_with_blanks_is_quoted_in_the_command(tmp_path):
    path = tmp_path / "my first.toml"
    path.write_text(WHEELS + ROOM)
    plan = load_experiment(path)
    assert shlex.split(plan.command(next(plan.runs())))[2] == str(path)


# keys


def test_keys_are_distinct_and_valid_file_names(wide):
    keys = [item.key for item in wide.runs()]
    assert len(set(keys)) == len(keys) == 10
    assert all(re.fullmatch(r"[\w.-]+", key) for key in keys)
    assert re.fullmatch(r"room-s1-wheel-odometry-[0-9a-f]{10}", keys[3])


@pytest.mark.parametrize(
    "changes",
    [
        {"methods": [{"use": "paper", "epsilon": 2e-4}]},
        {"methods": [{"use": "paper", "keyframes": 11}]},
        {"methods": [{"use": "paper", "s2s.epsilon": 2e-4}]},
        {"methods": [{"use": "paper-tight", "label": "paper"}]},
        {"sequences": [{"use": "room", "laps": 1.5}]},
        {"sequences": [{"use": "room", "seeds": [1]}]},
        {"sequences": [{"use": "lab", "label": "room"}]},
    ],
)
def test_anything_that_could_change_a_result_changes_the_key(changes):
    assert digest(**{"methods": [{"use": "paper"}], **changes}) != digest(methods=[{"use": "paper"}])


def test_settings_that_cannot_change_a_result_do_not_change_the_key():
    told = {"title": "T", "description": "D", "limits": {"run_s": 1}, "mapper": {"scans": 9}}
    assert only_key(**told) == only_key()
    assert only_key(sequences=[{"use": "room", "laps": 1}]) == only_key()  # the default, written as an integer
    assert only_key(methods=[{"use": "wheel-odometry"}, {"use": "paper"}]) == only_key()
    assert digest(methods=[{"use": "paper", "tuned_on": ["lab"]}]) == digest(methods=[{"use": "paper"}])


def test_a_method_is_tuned_on_the_data_sets_of_its_back_end_and_of_its_table():
    plan = plan_runs([{"use": "paper-map", "tuned_on": ["lab", "intel"]}, {"use": "paper"}])
    assert [method.tuned_on for method in plan.methods] == [("fr079", "intel", "lab"), ()]


def test_other_code_changes_the_key(monkeypatch):
    before = only_key()
    monkeypatch.setattr(registry, "hash_run_code", lambda backend, dataset: f"{backend} {dataset} changed")
    assert only_key() != before


def test_labels_with_equal_file_names_do_not_share_a_folder():
    alike = [{"use": "paper", "label": "a/b"}, {"use": "paper", "label": "a b"}]
    first, second = (item.key for item in plan_runs(alike).runs())
    assert first != second


def test_a_changed_recording_changes_the_key_and_reading_does_not(log):
    sequences = [{"use": "carmen", "path": str(log)}]
    before = only_key(sequences=sequences)
    log.read_text()
    (log.parent / "beside.log").write_text("x")
    assert only_key(sequences=sequences) == before
    log.write_text("FLASER 2\n")
    assert only_key(sequences=sequences) != before


def test_a_changed_bag_in_a_folder_changes_the_key(tmp_path):
    folder = tmp_path / "bag"
    folder.mkdir()
    (folder / "bag_0.db3").write_text("one")
    sequences = [{"use": "rosbag", "path": str(folder)}]
    before, state = only_key(sequences=sequences), folder.stat()
    (folder / "bag_0.db3").write_text("other")
    os.utime(folder, ns=(state.st_atime_ns, state.st_mtime_ns))
    assert only_key(sequences=sequences) != before


def test_a_text_that_is_not_a_valid_file_name_is_allowed(log):
    long = {"use": "rosbag", "path": str(log), "topic": "/scan" * 1_000}
    assert only_key(sequences=[long])


def test_the_shipped_experiments_can_be_planned():
    shipped = sorted(Path(__file__).parents[2].glob("reports/*.toml"))
    tables = {file: tomllib.loads(file.read_text()) for file in shipped}
    lists = ("method", "sequence")  # other files are about other questions
    files = [file for file, given in tables.items() if all(isinstance(given.get(name), list) for name in lists)]
    if not files:
        pytest.skip("no experiment beside the tests")
    assert all(list(load_experiment(file).runs()) for file in files)


@pytest.mark.parametrize(
    "label", ["=cmd|' /C calc'!A0", "+1", "-x", "@a", "", "a\x1b[2J", "a\u2028b", "a\u202eb", "a\nb", "x" * 501]
)
def test_a_label_cannot_be_a_terminal_or_spreadsheet_command(label):
    with pytest.raises(BadExperiment, match=r"method 1: 'label': found .*, expected printable text"):
        plan_runs(methods=({"use": "wheel-odometry", "label": label},))


@pytest.mark.parametrize(
    "label", ["../../etc/x", "/etc/x", "..", "x" * 300, "\u8def" * 300, "NUL", "nul.txt", "a\\b", "C:x"]
)
def test_no_label_places_a_run_outside_its_folder(label):
    plan = plan_runs(methods=({"use": "wheel-odometry", "label": label},), sequences=({"use": "room", "label": label},))
    (run,) = plan.runs()
    assert re.fullmatch(r"\w[\w.-]*", run.key)
    assert len(f"{run.key}.yaml.part".encode()) < 200
    assert not run.key.lower().startswith(("nul.", "con."))


# perturbed recordings


def test_nuisance_repeats_recordings_under_perturbations_and_leaves_seeded_worlds_alone(log):
    sequences = ({"use": "carmen", "path": str(log)}, {"use": "room", "seeds": [4]})
    plain, found = plan_runs(sequences=sequences), plan_runs(sequences=sequences, nuisance=3)
    assert [sequence.seeds for sequence in found.sequences] == [(None, 1, 2, 3), (4,)]
    runs = [run for run in found.runs() if run.sequence.dataset == "carmen"]
    assert [run.dataset_parameters.get("nuisance") for run in runs] == [None, 1, 2, 3]
    assert len({run.key for run in runs}) == 4
    assert runs[0].key == next(plain.runs()).key  # the unperturbed run stays the same
    assert found.command(runs[2]).split(" --seed ")[1].startswith("2 ")
    assert "nuisance" not in next(run for run in found.runs() if run.seed == 4).dataset_parameters


def test_excerpts_replace_the_whole_recording_and_a_sequence_overrides_the_experiment(log):
    own = {"use": "carmen", "path": str(log), "nuisance": 2, "nuisance_scans": 100}
    (sequence,) = plan_runs(sequences=[own], nuisance=9).sequences
    assert (sequence.seeds, sequence.excerpt_scans) == ((1, 2), 100)
    assert sequence.parameters_with_seed(2) == {**sequence.parameters, "nuisance": 2, "nuisance_scans": 100}
    written = tomllib.loads(format_experiment(plan_runs(sequences=[own])))["sequence"][0]
    assert (written["nuisance"], written["nuisance_scans"]) == (2, 100)


@pytest.mark.parametrize(
    ("keys", "part"),
    [
        ({"nuisance": 1}, "expected 0, or 2 to 64 perturbations"),
        ({"nuisance": 65}, "expected 0, or 2 to 64 perturbations"),
        ({"nuisance": 8, "nuisance_scans": 20}, "expected 0 for whole recordings, or at least 50 scans"),
    ],
)
def test_numbers_of_perturbations_are_checked(log, keys, part):
    with pytest.raises(BadExperiment, match=part):
        plan_runs(sequences=[{"use": "carmen", "path": str(log)}], **keys)
    with pytest.raises(BadExperiment, match=r"room has seeds; write seeds = \[0, 1, ...\]"):
        plan_runs(sequences=[{"use": "room", "nuisance": 4}])
