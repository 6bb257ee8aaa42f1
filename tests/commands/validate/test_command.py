"""The whole dossier: planted mistakes fail at the right level, the compiled twin and somebody's library pass."""

import json
import shutil
import subprocess
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import pytest

from evalkit.cli import app
from evalkit.commands.validate import answers, examination, probes
from evalkit.commands.validate.answers import Names
from evalkit.commands.validate.equivalence.comparison import FLOAT32
from evalkit.commands.validate.probes import EXACT
from evalkit.core.errors import BadExperiment, BadParameter, NotInstalled, UnknownName
from evalkit.execution import sandbox
from evalkit.external import INCLUDE
from evalkit.plugins import defaults, registry

HERE = Path(__file__).parents[2]
EXAMPLES = INCLUDE / "examples"
SCHEMA = json.loads((Path(examination.__file__).parent / "acceptance.schema.json").read_text(encoding="utf-8"))
MARGINS = [EXACT, FLOAT32]
ROOM = {"label": "room, seed 0", "dataset": "room", "parameters": {"laps": 0.04, "seed": 0}}
TINY = examination.Effort(pairs=4, scans=6, drawn=3, timed=8, limit_s=60.0, map_scans=8)


@pytest.fixture
def misfits(monkeypatch):
    """Planted mistakes are found as modules under development are, here and in other processes."""
    monkeypatch.syspath_prepend(str(HERE / "misfits"))
    monkeypatch.setenv("PYTHONPATH", str(HERE / "misfits"))


def asked(backend, **changes):
    known = examination.Asked(backend, {}, "", {}, (), ("room laps=0.04",), 1, "equal", "auto", 0.5, "", TINY)
    return examination.examination(replace(known, **changes))


@contextmanager
def unheard(*_):
    yield lambda _name, _seconds: None


class Silent:
    def begun(self, planned): ...
    def answered(self, planned, scans): ...
    def finished(self, record): ...


@contextmanager
def silent(*_):
    yield Silent()


def dossier(examined, folder):
    return examined.dossier(folder, 2, examination.Watch(unheard, silent))


def present(name):
    if why := registry.backend(name).missing():
        pytest.skip(why)
    return name


def registrations(backend, twin="paper", given=None):
    """Level 1 over a few pairs, in this process."""
    a, b = ({"name": name, "given": given or {}} for name in (twin, backend))
    found = {"room, seed 0": probes.pairs_compared(a, b, ROOM, 6, True, MARGINS)}
    margin = answers.margin_of(found, MARGINS)
    return answers.pairs(found, {}, Names(backend, twin, margin, 0.5)), margin


PLANTED = {
    "TRANSPOSED": "pair 1, iteration 1, pose: different: the rotation is transposed",
    "MANY_TO_ONE": "pairs: outlier rule: one-to-one filter: planted_mistakes:MANY_TO_ONE gives a target to several",
    "DEGREES": "answer: units: the answer's angle is in degrees",
}


@pytest.mark.parametrize("name", PLANTED)
def test_a_planted_mistake_is_named_at_the_level_of_registrations(name, misfits):
    level, margin = registrations(f"planted_mistakes:{name}")
    assert (level.outcome("equal"), margin) == ("failed", EXACT)
    assert PLANTED[name] in level.failed("equal")[0].observed


@pytest.mark.parametrize(
    ("name", "margin"), [("embedded", EXACT), ("embedded-f32", FLOAT32), ("embedded-pipeline", EXACT)]
)
def test_the_compiled_core_is_its_twin_within_the_margin_of_its_precision(name, margin):
    level, found = registrations(present(name))
    assert (level.outcome("equal"), found) == ("passed", margin), level.lines


def test_another_stop_rule_is_not_equal_but_as_good():
    level, _ = registrations("paper-tight")
    assert level.outcome("equal") == "failed"
    assert "stop rule" in level.failed("equal")[0].observed
    assert level.outcome("as-good") == "passed"


def test_single_precision_is_no_excuse_for_a_mistake(misfits):
    level, margin = registrations("planted_mistakes:ROUNDED_AND_FEWER")
    assert margin == FLOAT32
    assert "iteration cap" in level.failed("equal")[0].observed


@pytest.mark.slow
def test_the_dossier_of_the_compiled_core_is_whole(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(examination, "QUICK", TINY)
    words = ["validate", present("embedded"), "--quick", "--on", "room laps=0.04", "--against", "paper", "--json"]
    with pytest.raises(SystemExit) as end:
        app([*words, "--out", str(tmp_path)])
    assert not end.value.code
    found = json.loads(capsys.readouterr().out)
    expected = "embedded is equivalent to paper within 1e-09 m and 1e-09 rad at every level asked"
    assert found["verdict"].startswith(expected)
    assert [level["outcome"] for level in found["levels"]] == [*["passed"] * 5, "told"]
    assert (found["twin"], found["against"]) == ("paper", ["wheel-odometry"])
    assert any(line["name"].startswith("its mapper embedded-log-odds") for line in found["levels"][4]["lines"])
    jsonschema = pytest.importorskip("jsonschema")
    jsonschema.validate(found, SCHEMA)
    assert json.loads((tmp_path / "dossier.json").read_text(encoding="utf-8")) == found
    page = (tmp_path / "index.html").read_text(encoding="utf-8")
    assert "embedded is equivalent to paper" in page
    assert page.count("<figure") > 6


@pytest.fixture(scope="module")
def somebodys(tmp_path_factory):
    """The example library, as somebody else would build it."""
    if shutil.which("cc") is None:
        pytest.skip("no compiler 'cc' here")
    file = tmp_path_factory.mktemp("mine") / "libicp.so"
    words = ["-std=c99", "-O2", "-shared", "-fPIC", "-I", str(INCLUDE)]
    sources = [str(EXAMPLES / "c" / name) for name in ("library.c", "icp.c")]
    subprocess.run(["cc", *words, *sources, "-o", str(file), "-lm"], check=True)
    return f"lib:{file}"


def test_a_library_is_equal_to_the_same_method_named_as_its_twin(somebodys):
    level, margin = registrations(f"{somebodys} max_iterations=40", twin=somebodys)
    assert (level.outcome("equal"), margin) == ("passed", EXACT)


@pytest.mark.slow
def test_a_library_goes_through_the_whole_dossier(somebodys, tmp_path):
    found = dossier(asked(somebodys, claim="as-good"), tmp_path)
    assert [level.outcome("equal") for level in found.levels[:3]] == ["passed", "failed", "failed"]
    assert all(line.outcome == "passed" for line in found.levels[3].lines if line.name == "runs to the end")
    assert any("times as long" in line.observed for line in found.levels[5].lines)


def test_a_crash_on_the_way_is_a_line_and_not_the_end(misfits):
    a, b = ({"name": name, "given": {}} for name in ("paper", "planted_mistakes:CRASHES_ON_SCANS"))
    given = {"a": a, "b": b, "on": ROOM, "count": 3, "exact": True, "margins": MARGINS}
    found = {"room, seed 0": sandbox.run("evalkit.commands.validate.probes:pairs_compared", given, 60.0, 2000)}
    names = Names("mine", "paper", answers.margin_of(found, MARGINS), 0.5)
    (line,) = answers.pairs(found, {}, names).failed("as-good")
    assert "SIGSEGV; it was at room, seed 0, pair 1 (pair)" in line.observed


def test_the_twin_is_the_first_of_its_role_and_gets_the_same_settings():
    assert asked("paper-tight").twin == "paper"
    examined = asked("paper-tight", given={"max_iterations": "7", "epsilon": "1e-5"}, given_twin={"epsilon": "1e-3"})
    assert examined.given_twin == {"max_iterations": 7, "epsilon": 1e-3}
    assert examined.why_twin == 'the first back end by name with the role "reference"'


def test_its_mapper_is_the_one_of_its_module():
    assert (defaults.mapper_of("embedded"), defaults.mapper_of("paper-tight")) == ("embedded-log-odds", "log-odds")
    assert defaults.mapper_of("kiss-icp") == ""


def test_what_is_wrong_is_told_before_anything_is_computed():
    with pytest.raises(UnknownName, match="papre"):
        asked("papre")
    with pytest.raises(NotInstalled, match="no such file"):
        asked("lib:./nowhere.so")
    with pytest.raises(BadExperiment, match="lapse"):
        asked("paper", on=("room lapse=1",))
    with pytest.raises(BadParameter, match="NAME=VALUE"):
        asked("paper", on=("room 0.3",))
    with pytest.raises(BadParameter, match="laps"):
        asked("paper", on=("room laps=many",))
