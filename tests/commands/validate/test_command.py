"""``evalkit validate``: injected faults fail at the expected level; the compiled core and an example library pass."""

import json
import re
import shutil
import subprocess
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from typer.testing import CliRunner

from evalkit.cli import app
from evalkit.commands.validate import level_answers, mapper_run, plan, probes, run
from evalkit.commands.validate.comparison_terms import ComparisonTerms, choose_margin
from evalkit.commands.validate.equivalence.lockstep import AnswerPair, Question
from evalkit.commands.validate.equivalence.margins import FLOAT32
from evalkit.commands.validate.probes import EXACT
from evalkit.core.errors import BackendFailed, BadData, BadParameter, NotInstalled, UnknownName
from evalkit.core.match import Match
from evalkit.core.pose import Pose
from evalkit.core.scan import Cloud
from evalkit.execution import sandbox
from evalkit.external import INCLUDE
from evalkit.plugins import defaults, registry
from evalkit_baselines.embedded.compiled import compiled_missing

HERE = Path(__file__).parents[2]
PAGES = HERE.parent / "docs" / "pages"
EXAMPLES = INCLUDE / "examples"
SCHEMA = json.loads((Path(plan.__file__).parent / "acceptance.schema.json").read_text(encoding="utf-8"))
MARGINS = [EXACT, FLOAT32]
ROOM = {"label": "room, seed 0", "dataset": "room", "parameters": {"laps": 0.04, "seed": 0}}
TINY = plan.Effort(pairs=4, scans=6, mapper_scans=3, timed=8, limit_s=600.0, map_scans=8)


@pytest.fixture
def misfits(monkeypatch):
    """Make the faulty back ends importable, in this process and in others."""
    monkeypatch.syspath_prepend(str(HERE / "misfits"))
    monkeypatch.setenv("PYTHONPATH", str(HERE / "misfits"))


def make_plan(backend, **changes):
    known = plan.ValidationRequest(backend, {}, "", {}, (), ("room laps=0.04",), 1, "equal", "auto", 0.5, "", TINY)
    return plan.make_plan(replace(known, **changes))


def test_a_file_of_results_is_refused_before_anything_is_computed(tmp_path):
    (tmp_path / "poses.tum").write_text("0.0 0 0 0 0 0 0 1\n1.0 1 0 0 0 0 0 1\n")
    with pytest.raises(BackendFailed, match="holds recorded results: there is no behaviour to check"):
        make_plan(f"file:{tmp_path / 'poses.tum'}")


@contextmanager
def hide_tasks(*_):
    yield lambda _name, _seconds: None


class NoProgress:
    def started(self, spec): ...
    def answered(self, spec, scans): ...
    def finished(self, spec, result): ...


@contextmanager
def hide_runs(*_):
    yield NoProgress()


def report(validation, folder):
    return run.ValidationRun(validation, folder, 2, run.ProgressDisplay(hide_tasks, hide_runs)).report()


def present(name):
    if why := registry.backend(name).missing():
        pytest.skip(why)
    return name


def registrations(backend, reference="paper", given=None):
    """Run AcceptanceLevel 1 over a few pairs, in this process."""
    a, b = ({"name": name, "given": given or {}} for name in (reference, backend))
    found = {"room, seed 0": probes.compare_pairs(a, b, ROOM, 6, True, MARGINS)}
    margin = choose_margin(found, MARGINS)
    return level_answers.registrations_level(found, {}, ComparisonTerms(backend, reference, margin, 0.5)), margin


FAULTS = {
    "TRANSPOSED": "pair 1, iteration 1, pose: different: the rotation is transposed",
    "MANY_TO_ONE": "pairs: outlier rule: one-to-one filter: injected_faults:MANY_TO_ONE pairs a target with several",
    "DEGREES": "answer: units: the answer's angle is in degrees",
}


@pytest.mark.parametrize("name", [pytest.param("TRANSPOSED", marks=pytest.mark.thorough), "MANY_TO_ONE", "DEGREES"])
def test_an_injected_fault_is_named_at_the_level_of_registrations(name, misfits):
    level, margin = registrations(f"injected_faults:{name}")
    assert (level.outcome("equal"), margin) == ("failed", EXACT)
    assert FAULTS[name] in level.failed("equal")[0].observed


@pytest.mark.parametrize(
    ("name", "reference", "margin"),
    [
        ("embedded", "paper", EXACT), ("embedded-f32", "paper", FLOAT32), ("embedded-pipeline", "paper", EXACT),
        ("embedded-slam", "paper-slam", EXACT),
    ],
)  # fmt: skip
def test_the_compiled_core_equals_the_reference_within_the_margin_of_its_precision(name, reference, margin):
    level, found = registrations(present(name), reference)
    assert (level.outcome("equal"), found) == ("passed", margin), level.checks


@pytest.mark.parametrize(
    ("x", "other", "undecided"), [(0.0, 0.0, True), (0.0, 1.0, False), (0.0, 7.0, False), (0.5, 0.0, False)]
)
def test_an_odometry_is_not_asked_for_the_answer_that_rounding_decides(x, other, undecided):
    # its answer is on which side of x = 0 the last point lies: on the line itself, rounding decides
    side = SimpleNamespace(
        register=lambda _, source, __: Match(Pose(float(source.points[0, 0] >= 0.0)), True, 0, 0.0, 0)
    )
    question = Question(1, "pair", Cloud(np.eye(2)), Cloud(np.array([[x, 1.0]])), Pose())
    right = side.register(question.target, question.source, question.guess)
    answered = AnswerPair(question, right, replace(right, target_from_source=Pose(other)))
    assert probes._is_undecided(side, answered) is undecided


def test_another_stop_rule_is_not_equal_but_not_worse():
    level, _ = registrations("paper-tight")
    assert level.outcome("equal") == "failed"
    assert "stop rule" in level.failed("equal")[0].observed
    assert level.outcome("as-good") == "passed"


def test_single_precision_does_not_excuse_a_fault(misfits):
    level, margin = registrations("injected_faults:ROUNDED_AND_FEWER")
    assert margin == FLOAT32
    assert "iteration cap" in level.failed("equal")[0].observed


@pytest.mark.thorough
@pytest.mark.slow(40)
def test_the_report_of_the_compiled_core_is_complete(tmp_path, monkeypatch, capsys, scoring_in_threads):
    monkeypatch.setattr(plan, "QUICK", TINY)
    words = ["validate", present("embedded"), "--quick", "--on", "room laps=0.04", "--peer", "paper", "--json"]
    with pytest.raises(SystemExit) as end:
        app([*words, "--out", str(tmp_path)])
    assert not end.value.code
    found = json.loads(capsys.readouterr().out)
    expected = "embedded is equivalent to paper within 1e-09 m and 1e-09 rad at every level that was run"
    assert found["verdict"].startswith(expected)
    assert [level["outcome"] for level in found["levels"]] == [*["passed"] * 5, "informative"]
    assert (found["reference"], found["peers"]) == ("paper", ["wheel-odometry"])
    assert any(check["name"].startswith("mapper embedded-log-odds") for check in found["levels"][4]["checks"])
    jsonschema = pytest.importorskip("jsonschema")
    jsonschema.validate(found, SCHEMA)
    assert json.loads((tmp_path / "acceptance.json").read_text(encoding="utf-8")) == found
    page = (tmp_path / "index.html").read_text(encoding="utf-8")
    assert "embedded is equivalent to paper" in page
    assert page.count("<figure") > 6


@pytest.fixture(scope="module")
def example_library(tmp_path_factory):
    """The example library, built with the compiler of this system."""
    if shutil.which("cc") is None:
        pytest.skip("no compiler 'cc' here")
    file = tmp_path_factory.mktemp("mine") / "libicp.so"
    words = ["-std=c99", "-O2", "-shared", "-fPIC", "-I", str(INCLUDE)]
    sources = [str(EXAMPLES / "c" / name) for name in ("library.c", "icp.c")]
    subprocess.run(["cc", *words, *sources, "-o", str(file), "-lm"], check=True)
    return f"lib:{file}"


def test_a_library_equals_itself_as_its_reference(example_library):
    level, margin = registrations(f"{example_library} max_iterations=40", reference=example_library)
    assert (level.outcome("equal"), margin) == ("passed", EXACT)


@pytest.mark.thorough
def test_a_library_is_validated_at_every_level(example_library, tmp_path, scoring_in_threads):
    found = report(make_plan(example_library, claim="as-good"), tmp_path)
    assert [level.outcome("equal") for level in found.levels[:3]] == ["passed", "failed", "failed"]
    assert all(check.outcome == "passed" for check in found.levels[3].checks if check.name == "completes its runs")
    assert any("times as long" in check.observed for check in found.levels[5].checks)


def test_a_crash_is_a_failed_check(misfits):
    a, b = ({"name": name, "given": {}} for name in ("paper", "injected_faults:CRASHES_ON_SCANS"))
    given = {"a": a, "b": b, "on": ROOM, "count": 3, "exact": True, "margins": MARGINS}
    found = {"room, seed 0": sandbox.run(probes.compare_pairs, given, 60.0, 2000)}
    names = ComparisonTerms("mine", "paper", choose_margin(found, MARGINS), 0.5)
    (check,) = level_answers.registrations_level(found, {}, names).failed("as-good")
    assert "SIGSEGV; it was in: room, seed 0, pair 1 (pair)" in check.observed


def test_a_back_end_that_does_not_start_is_asked_nothing_else(misfits, tmp_path):
    found = report(make_plan("faulty_backends:RAISES", reference="paper"), tmp_path)
    assert [(level.name, level.outcome("equal")) for level in found.levels] == [("rules", "failed")]
    assert "rule starts" in [check.name for check in found.levels[0].failed("equal")]
    assert [path.name.partition("-")[0] for path in (tmp_path / "tasks").glob("*.npz")] == ["rules"]


def test_the_reference_is_the_first_back_end_with_that_role_and_gets_the_same_settings():
    assert make_plan("paper-tight").reference == "paper"
    validation = make_plan(
        "paper-tight", given={"max_iterations": "7", "epsilon": "1e-5"}, given_reference={"epsilon": "1e-3"}
    )
    assert validation.given_reference == {"max_iterations": 7, "epsilon": 1e-3}
    assert validation.why_reference == 'the first back end by name with the role "reference"'


@pytest.mark.skipif(bool(compiled_missing()), reason="the core is not built")
def test_without_reference_a_twin_is_compared_with_the_back_end_that_its_spec_names():
    for name, reference in (
        ("embedded-map-line", "paper-map-line"), ("embedded-pipeline-line", "paper-map-line"),
        ("embedded-pipeline", "paper"), ("embedded-slam", "paper-slam"),
    ):  # fmt: skip
        found = make_plan(name)
        assert (found.reference, found.why_reference) == (reference, f"the twin that {name} names")
    given = make_plan("embedded-map-line", reference="paper")
    assert (given.reference, given.why_reference) == ("paper", "given with --reference")


@pytest.mark.skipif(bool(compiled_missing()), reason="the core is not built")
def test_the_difference_that_a_mapper_is_meant_to_have_is_said(tmp_path):
    request = replace(make_plan("paper").request, backend="embedded-polygon", effort=replace(TINY, scans=2))
    found = mapper_run.report_mapper(request, tmp_path, 1, run.ProgressDisplay(hide_tasks, hide_runs))
    assert (found.reference, found.passed) == ("log-odds", False)
    outcomes = {level.name: level.outcome("equal") for level in found.levels}
    assert outcomes == {"rules": "passed", "lockstep": "failed"}
    assert "embedded-polygon is meant to differ from the default mapper: it frees" in found.why_reference


HIT_MAP = re.search(r'python title="hit_map.py"\n(.*?)```', (PAGES / "more.md").read_text(encoding="utf-8"), re.DOTALL)


@pytest.mark.parametrize(
    ("only", "code", "said"),
    [
        ("rules", 0, "hit_map:SPEC passes every level that was run (rules)"),
        ("lockstep", 1, "hit_map:SPEC fails at level 2 (lockstep, room"),
        ("registrations", 2, "'hit_map:SPEC' is a mapper, expected --only rules or lockstep"),
    ],
)
def test_a_mapper_of_an_own_module_is_validated_before_it_is_registered(tmp_path, monkeypatch, only, code, said):
    assert HIT_MAP
    (tmp_path / "hit_map.py").write_text(HIT_MAP[1], encoding="utf-8")
    words = ("validate", "hit_map:SPEC", "--only", only, "--quick", "--on", "room laps=0.05", "--scans", "3")
    monkeypatch.chdir(tmp_path)
    words = ["validate", "hit_map:SPEC", "--only", only, "--quick", "--on", "room laps=0.05", "--scans", "3"]
    ran = CliRunner().invoke(app, words)
    assert ran.exit_code == code, ran.output
    assert said in re.sub(r"[\s│]+", " ", ran.output)


def test_the_mapper_of_a_back_end_comes_from_its_module():
    assert (defaults.find_mapper_of("embedded"), defaults.find_mapper_of("paper-tight")) == (
        "embedded-log-odds",
        "log-odds",
    )
    assert defaults.find_mapper_of("kiss-icp") == ""


@pytest.mark.parametrize(
    ("content", "found"), [(b"\xff", "byte 0: not UTF-8 text"), (b"twelve\n", "found 'twelve'"), (b"", "empty")]
)
def test_a_damaged_seed_of_the_folder_is_refused_and_one_that_is_given_replaces_it(tmp_path, content, found):
    (tmp_path / "seed.txt").write_bytes(content)
    words = ["validate", "wheel-odometry", "--rule", "starts", "-o", str(tmp_path)]
    error = CliRunner().invoke(app, words).exception
    assert isinstance(error, BadData)
    assert str(error).startswith(f"{tmp_path}/seed.txt: ")
    assert found in str(error)
    for more, seed in ((["--seed", "12"], "12"), ([], "12")):  # the second call takes the seed of the first one
        ended = CliRunner().invoke(app, [*words, *more])
        assert ended.exit_code == 0, ended.output
        assert (tmp_path / "seed.txt").read_text() == f"{seed}\n"


def test_invalid_requests_are_rejected_before_anything_is_computed():
    with pytest.raises(UnknownName, match="papre"):
        make_plan("papre")
    with pytest.raises(NotInstalled, match="no such file"):
        make_plan("lib:./nowhere.so")
    with pytest.raises(UnknownName, match="room: no parameter named 'lapse'"):
        make_plan("paper", on=("room lapse=1",))
    with pytest.raises(UnknownName, match="paper: no parameter named 'use'"):
        make_plan("paper", given={"use": "embedded"})
    with pytest.raises(BadParameter, match="'seed': found 0, expected none here: --seeds N takes"):
        make_plan("paper", on=("room seed=0",))
    with pytest.raises(BadParameter, match="NAME=VALUE"):
        make_plan("paper", on=("room 0.3",))
    with pytest.raises(BadParameter, match="laps"):
        make_plan("paper", on=("room laps=many",))


@pytest.mark.parametrize(
    ("more", "said"),
    [
        (["--only", "rules", "--only", "lockstep"], "--only takes one group of checks, found rules and lockstep"),
        (["--only", "lockstep", "--rule", "starts"], "--only takes one group of checks, found lockstep and rules"),
        (["--only", "speed"], "--only: 'speed' is not one of 'rules', 'registrations', 'lockstep', 'determinism'"),
    ],
)
def test_several_groups_of_checks_or_an_unknown_one_are_a_usage_error(tmp_path, more, said):
    ended = CliRunner().invoke(app, ["validate", "wheel-odometry", "-o", str(tmp_path), *more], env={"COLUMNS": "200"})
    assert ended.exit_code == 2
    assert said in ended.output
    assert not list(tmp_path.iterdir())


def test_single_rules_may_be_given_with_their_group(tmp_path):
    words = ["validate", "wheel-odometry", "-o", str(tmp_path), "--only", "rules", "--rule", "starts"]
    assert CliRunner().invoke(app, words).exit_code == 0
