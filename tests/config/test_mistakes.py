"""All mistakes of a file at once, and its JSON Schema."""

import json
import tomllib
from pathlib import Path

import pytest
from typer.testing import CliRunner

from evalkit.cli import app
from evalkit.commands.study.config import load_study
from evalkit.commands.tune.config import load_tuning
from evalkit.config.experiment_file import load_experiment
from evalkit.config.json_schema import make_schema
from evalkit.config.mistakes import find_mistakes
from evalkit.core.errors import BadExperiment, UnknownName

REPORTS = Path(__file__).parents[2] / "reports"
KINDS = {"study": "study", "tune": "tuning", "paper": ""}
"""Kind of a shipped file by the first word of its name; reproductions have a reader of their own."""

WRONG = """
tittle = "no"
[[method]]
use = "wheel-odometry"
[[method]]
use = "embeded"
[[method]]
use = "embedded"
epsilom = 1e-5
max_iterations = 0
[[sequence]]
use = "lab"
laps = "many"
[limits]
run_s = -1
"""


def shipped():
    kinds = [(path, KINDS.get(path.stem.split("-")[0], "experiment")) for path in sorted(REPORTS.glob("*.toml"))]
    return [(path, kind) for path, kind in kinds if kind]


def test_every_mistake_of_an_experiment_is_told_with_its_place_and_the_likely_name(tmp_path):
    path = tmp_path / "wrong.toml"
    path.write_text(WRONG)
    with pytest.raises(BadExperiment) as raised:
        load_experiment(path)
    text = str(raised.value)
    for part in (
        "did you mean 'title'", "method 2: ", "did you mean 'embedded'", "method 3 (embedded): no parameter named",
        "did you mean 'epsilon'", "method 3 (embedded): parameter 'max_iterations': found 0",
        "limits: 'run_s': found -1", "sequence 1 (lab): parameter 'laps': found 'many'",
    ):  # fmt: skip
        assert text.count(part) == 1, part


def test_a_single_mistake_keeps_its_wording(tmp_path):
    path = tmp_path / "wrong.toml"
    path.write_text('[[method]]\nuse = "wheel-odometry"\n[[sequence]]\nuse = "labb"\nlaps = 0.1\n')
    with pytest.raises(BadExperiment) as raised:
        load_experiment(path)
    assert "also" not in str(raised.value)
    assert str(raised.value).count("did you mean 'lab'") == 1


@pytest.mark.parametrize(
    ("content", "told"),
    [
        ('[[sequence]]\nuse = "lab"\n', "no [[method]]: an experiment needs at least one"),
        ("", "no [[method]]: an experiment needs at least one; also no [[sequence]]"),
        ('{m}max_iterations = 0\n{s}', "method 1 (paper): parameter 'max_iterations': found 0"),
        ('{m}tuned_on = "x"\n{s}', "'tuned_on': found 'x'"),
        ('mapper = 3\n{m}{s}', "mapper: found 3, expected a table [mapper] with use = NAME"),
        ('{m}{s}seeds = []\n', "'seeds': found [], expected a list of whole numbers from 0, at least one"),
        ('{m}{s}label = "corner"\nlaps = "x"\n', "sequence 1 (corner): parameter 'laps': found 'x'"),
        ('{m}{s}[mapper]\nscans = 0\n', "mapper: 'scans': found 0"),
        ('{m}{s}[mapper]\nresolution_m = 0\n', "mapper: parameter 'resolution_m': found 0"),
    ],
)  # fmt: skip
def test_the_first_mistake_is_not_told_again(tmp_path, content, told):
    path = tmp_path / "wrong.toml"
    path.write_text(content.format(m='[[method]]\nuse = "paper"\n', s='[[sequence]]\nuse = "lab"\n'))
    with pytest.raises(BadExperiment) as raised:
        load_experiment(path)
    assert told in str(raised.value)
    assert str(raised.value).count("also") == told.count("also")


def test_a_study_names_its_only_method_without_a_number_and_once(tmp_path):
    path = tmp_path / "wrong.toml"
    shipped = (REPORTS / "study-quick.toml").read_text(encoding="utf-8")
    path.write_text(shipped.replace("[method]", '[method]\nmin_pairs = "x"', 1))
    with pytest.raises(BadExperiment, match=r"method \(.*\): parameter 'min_pairs': found 'x'") as raised:
        load_study(path, "x")
    assert "also" not in str(raised.value)


def test_the_search_ends_after_100_mistakes(tmp_path):
    path = tmp_path / "wrong.toml"
    path.write_text("".join(f"k{number} = 1\n" for number in range(100_000)))
    with pytest.raises(BadExperiment, match=r"; and at least \d+ more$") as raised:
        load_experiment(path)
    assert len(str(raised.value)) < 1500


@pytest.mark.parametrize(
    ("load", "missing"),
    [(load_study, "no table [method]"), (lambda path, command: load_tuning(path, "x", command), "no [[method]]")],
)
def test_studies_and_tunings_tell_all_mistakes_too(tmp_path, load, missing):
    path = tmp_path / "wrong.toml"
    path.write_text('titel = "x"\n[limits]\nrun = 3\n')
    with pytest.raises(BadExperiment) as raised:
        load(path, "x")
    assert "did you mean 'title'" in str(raised.value)
    assert "also limits: no key named 'run'" in str(raised.value)
    assert f"also {missing}" in str(raised.value)


def test_a_misspelt_key_deep_in_a_study_is_told_in_its_own_table(tmp_path):
    path = tmp_path / "wrong.toml"
    path.write_text(
        '[method]\nuse = "embedded"\n[sequence]\nuse = "lab"\n[limits]\nmemory_mib = 5\n'
        '[[factor]]\nlevels = [5, 10]\nunitt = "x"\n[[response]]\nmetric = "ate_rmse_m"\nscael = "log"\n'
        '[[design]]\nkind = "grid"\nfactors = []\npionts = 3\n'
    )
    with pytest.raises(BadExperiment) as raised:
        load_study(path, "x")
    text = str(raised.value)
    for part in (
        "limits: no key named 'memory_mib'; known: run_s",
        "response 1: no key named 'scael' (did you mean 'scale'?)",
        "factor 1: no key named 'unitt' (did you mean 'unit'?)",
        "design 1: no key named 'pionts' (did you mean",
    ):
        assert text.count(part) == 1, part


@pytest.mark.parametrize(("path", "kind"), shipped(), ids=lambda value: getattr(value, "name", ""))
def test_shipped_files_have_no_mistake_and_fit_the_schema(path, kind):
    jsonschema = pytest.importorskip("jsonschema")
    content = tomllib.loads(path.read_text(encoding="utf-8"))
    assert list(find_mistakes(content, kind)) == []
    jsonschema.Draft202012Validator(make_schema(kind)).validate(content)


def test_the_schema_has_the_largest_value_of_a_number():
    jsonschema = pytest.importorskip("jsonschema")
    validator = jsonschema.Draft202012Validator(make_schema("tuning"))
    said = [[error.message for error in validator.iter_errors({"points": count})] for count in (5000, 5001)]
    assert "5001 is greater than the maximum of 5000" in set(said[1]) - set(said[0])


def test_the_schema_knows_installed_names_and_the_parameters_of_each(tmp_path):
    jsonschema = pytest.importorskip("jsonschema")
    file = tmp_path / "experiment.schema.json"
    assert CliRunner().invoke(app, ["schema", "experiment", "--out", str(file)]).exit_code == 0
    schema = json.loads(file.read_text())
    checker = jsonschema.Draft202012Validator(schema)
    good = {"method": [{"use": "embedded", "max_iterations": 5}, {"use": "lib:./x.so"}], "sequence": [{"use": "lab"}]}
    checker.validate(good)
    for method in ({"use": "embeded"}, {"use": "embedded", "max_iterations": 0}, {"use": "embedded", "epsilon": "x"}):
        assert not checker.is_valid({**good, "method": [method]})
    assert not checker.is_valid({**good, "tittle": "x"})
    assert not checker.is_valid({"method": good["method"]})
    with pytest.raises(UnknownName, match="did you mean 'study'"):
        raise CliRunner().invoke(app, ["schema", "studdy"]).exception
