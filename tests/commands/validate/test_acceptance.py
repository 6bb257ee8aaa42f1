"""What a dossier says of its lines: the verdict, what decides, and its JSON form."""

import json
from dataclasses import replace
from pathlib import Path

import pytest

import evalkit.commands.validate as package
from evalkit.commands.validate import examination
from evalkit.commands.validate.acceptance import Claim, Dossier, Level, Line

SCHEMA = json.loads((Path(package.__file__).parent / "acceptance.schema.json").read_text(encoding="utf-8"))
EFFORT = {"pairs": 4, "scans": 8, "timed": 8}
SETTINGS = {"backend": {}, "twin": {}, "on": ["room"], "seeds": 1, "share": 0.5, "effort": EFFORT, "mappers": ["", ""]}


def dossier(*levels: Level, claim: Claim = "equal") -> Dossier:
    return Dossier("mine", "paper", "named", ("other",), {}, claim, "exact", "within 1e-09 m", levels, SETTINGS, {})


def level(number, name, *lines):
    return Level(number, name, "Is it?", lines)


KEPT = level(0, "conformance", Line("rules kept", "", "passed", "always", "none broken"))
SAME = Line("equal to paper", "room", "passed", "equal", "no difference")
GOOD = Line("as good", "room", "passed", "as-good", "no larger")


def test_the_verdict_of_an_equal_implementation_names_its_twin_the_margin_and_the_levels():
    found = dossier(KEPT, level(1, "registration", SAME))
    assert found.passed
    expected = "mine is equivalent to paper within 1e-09 m at every level asked (0 conformance, 1 registration)"
    assert found.verdict == expected


def test_the_first_line_that_refutes_is_the_verdict():
    wrong = replace(SAME, outcome="failed", observed="pair 3: units")
    found = dossier(KEPT, level(1, "registration", SAME, wrong), level(2, "scan by scan", wrong))
    assert not found.passed
    assert found.verdict == "mine first differs from paper at level 1 (registration, room): pair 3: units"


def test_broken_rules_do_not_hide_where_the_answers_first_differ():
    broken = level(0, "conformance", Line("rules kept", "", "failed", "always", "2 of 22 rules broken"))
    wrong = replace(SAME, outcome="failed", observed="pair 1: transposed")
    verdict = dossier(broken, level(1, "registration", wrong)).verdict
    assert verdict.startswith("mine fails at level 0 (conformance): rules kept: 2 of 22 rules broken. ")
    assert verdict.endswith("It first differs from paper at level 1 (registration, room): pair 1: transposed")


def test_each_claim_hangs_on_its_own_lines():
    other_method = level(1, "registration", replace(SAME, outcome="failed"), GOOD)
    assert not dossier(KEPT, other_method).passed
    assert dossier(KEPT, other_method, claim="as-good").passed
    worse = level(1, "registration", SAME, replace(GOOD, outcome="failed"))
    assert dossier(KEPT, worse).passed
    assert not dossier(KEPT, worse, claim="as-good").passed


def test_what_was_only_told_speaks_for_nothing():
    told = level(5, "time", Line("time", "room", "told", "", "1 ms"), Line("pace", "room", "failed", "", "slow"))
    assert told.outcome("equal") == "told"
    assert level(4, "maps", Line("map", "", "not applicable", "", "none")).outcome("equal") == "not applicable"
    assert not dossier(told).passed
    assert dossier(told).verdict == "nothing can be said of mine: no level could be asked"


@pytest.mark.parametrize("claim", ["equal", "as-good"])
def test_the_json_form_is_what_the_schema_says(claim: Claim):
    found = dossier(KEPT, level(1, "registration", SAME, GOOD), claim=claim).as_json()
    jsonschema = pytest.importorskip("jsonschema")
    jsonschema.validate(json.loads(json.dumps(found)), SCHEMA)
    assert found["levels"][1]["lines"][0]["decides"] is (claim == "equal")


def test_machine_code_is_the_library_named_or_what_the_plug_in_reaches(tmp_path):
    assert examination.compiled(f"lib:{tmp_path / 'libmine.so'}") == [(tmp_path / "libmine.so").resolve()]
    assert examination.compiled("paper") == []
    assert {file.suffix for file in examination.compiled("embedded")} <= {".so"}
