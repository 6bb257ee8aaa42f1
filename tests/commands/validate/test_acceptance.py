"""Acceptance reports: the verdict, deciding checks, and the JSON form."""

import json
from dataclasses import replace
from pathlib import Path

import pytest

import evalkit.commands.validate as package
from evalkit.commands.validate import plan
from evalkit.commands.validate.acceptance import AcceptanceLevel, AcceptanceReport, Check, Claim

SCHEMA = json.loads((Path(package.__file__).parent / "acceptance.schema.json").read_text(encoding="utf-8"))
EFFORT = {"pairs": 4, "scans": 8, "timed": 8}
SETTINGS = {"backend": {}, "reference": {}, "on": ["room"], "seeds": 1, "noise_share": 0.5, "effort": EFFORT}


def report(*levels: AcceptanceLevel, claim: Claim = "equal") -> AcceptanceReport:
    return AcceptanceReport(
        "mine", "paper", "named", ("other",), {}, claim, "exact", "within 1e-09 m", levels, SETTINGS, {}
    )


def level(number, name, *lines):
    return AcceptanceLevel(number, name, "Is it?", lines)


KEPT = level(0, "rules", Check("all rules", "", "passed", "always", "none broken"))
SAME = Check("equal to paper", "room", "passed", "equal", "no difference")
GOOD = Check("as good", "room", "passed", "as-good", "no larger")


def test_the_verdict_of_an_equal_implementation_names_the_reference_the_margin_and_the_levels():
    found = report(KEPT, level(1, "registrations", SAME))
    assert found.passed
    expected = "mine is equivalent to paper within 1e-09 m at every level that was run (0 rules, 1 registrations)"
    assert found.verdict == expected


def test_the_first_check_that_refutes_the_claim_is_the_verdict():
    wrong = replace(SAME, outcome="failed", observed="pair 3: units")
    found = report(KEPT, level(1, "registrations", SAME, wrong), level(2, "lockstep", wrong))
    assert not found.passed
    assert found.verdict == "mine first differs from paper at level 1 (registrations, room): pair 3: units"


def test_broken_rules_do_not_hide_the_first_difference_of_results():
    broken = level(0, "rules", Check("all rules", "", "failed", "always", "2 of 22 rules broken"))
    wrong = replace(SAME, outcome="failed", observed="pair 1: transposed")
    verdict = report(broken, level(1, "registrations", wrong)).verdict
    assert verdict.startswith("mine fails at level 0 (rules): all rules: 2 of 22 rules broken. ")
    assert verdict.endswith("It first differs from paper at level 1 (registrations, room): pair 1: transposed")


def test_each_claim_depends_on_its_own_checks():
    other_method = level(1, "registrations", replace(SAME, outcome="failed"), GOOD)
    assert not report(KEPT, other_method).passed
    assert report(KEPT, other_method, claim="as-good").passed
    worse = level(1, "registrations", SAME, replace(GOOD, outcome="failed"))
    assert report(KEPT, worse).passed
    assert not report(KEPT, worse, claim="as-good").passed


def test_informative_checks_support_no_claim():
    timed = level(
        5,
        "time",
        Check("time", "room", "informative", "never", "1 ms"),
        Check("pace", "room", "failed", "never", "slow"),
    )
    assert timed.outcome("equal") == "informative"
    assert level(4, "maps", Check("map", "", "not applicable", "never", "none")).outcome("equal") == "not applicable"
    assert not report(timed).passed
    assert report(timed).verdict == "no verdict on mine: no level could be run"


@pytest.mark.parametrize("claim", ["equal", "as-good"])
def test_the_json_form_follows_the_schema(claim: Claim):
    found = report(KEPT, level(1, "registrations", SAME, GOOD), claim=claim).as_json()
    jsonschema = pytest.importorskip("jsonschema")
    jsonschema.validate(json.loads(json.dumps(found)), SCHEMA)
    assert found["levels"][1]["checks"][0]["decides"] is (claim == "equal")


def test_compiled_files_are_the_library_or_those_of_the_package(tmp_path):
    assert plan.compiled_files(f"lib:{tmp_path / 'libmine.so'}") == [(tmp_path / "libmine.so").resolve()]
    assert plan.compiled_files("paper") == []
    assert {file.suffix for file in plan.compiled_files("embedded")} <= {".so"}
