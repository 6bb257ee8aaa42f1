"""Acceptance reports: the verdict, deciding checks, and the JSON form."""

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from xml.etree import ElementTree

import pytest

import evalkit.commands.validate as package
from evalkit.commands.validate import plan
from evalkit.commands.validate.acceptance import AcceptanceLevel, AcceptanceReport, Check, Claim, as_junit
from evalkit.commands.validate.comparison_terms import ComparisonTerms, choose_margin
from evalkit.commands.validate.difference_causes import TRACE_ALONE, name_traces
from evalkit.commands.validate.first_screen import GOOD as GREEN_TEXT
from evalkit.commands.validate.first_screen import first_figures
from evalkit.commands.validate.known_motion import judge_gap
from evalkit.commands.validate.level_answers import format_divergence, rules_level, waive
from evalkit.commands.validate.rules.rule import RuleResult

SCHEMA = json.loads((Path(package.__file__).parent / "acceptance.schema.json").read_text(encoding="utf-8"))
EFFORT = {"pairs": 4, "scans": 8, "timed": 8}
GREEN = GREEN_TEXT.encode()
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
    expected = "mine is equivalent to paper within 1e-09 m at every level that was run (rules, registrations)"
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


def test_the_other_claim_is_proposed_where_nothing_but_equality_fails():
    other, broken = replace(SAME, outcome="failed"), replace(KEPT.checks[0], outcome="failed")
    proposed = "another method than paper? --claim as-good, without --only, asks whether it is no worse"
    assert report(KEPT, level(1, "registrations", other)).next_step == proposed
    assert report(level(0, "rules", broken), level(1, "registrations", other)).next_step == ""
    assert report(KEPT, level(1, "registrations", SAME)).next_step == ""
    worse = replace(GOOD, outcome="failed")
    assert report(KEPT, level(1, "registrations", other, worse), claim="as-good").next_step == ""


def test_a_method_within_single_precision_is_asked_whether_it_is_meant_to_be():
    same = report(KEPT, level(1, "registrations", SAME))
    asked = "meant to compute in double precision? --margin exact says where it first does not"
    assert replace(same, margin="float32").next_step == asked
    assert same.next_step == ""


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


def test_a_check_with_too_few_data_gives_no_verdict_and_names_the_line_that_decides():
    unclear = replace(GOOD, outcome="not shown", margin="5 mm", detail="about 900 values would show it")
    found = report(KEPT, level(3, "trajectories", GOOD, unclear), claim="as-good")
    assert not found.passed
    assert found.levels[1].outcome("as-good") == "not shown"
    assert found.verdict.startswith("it is not shown that mine is as good as paper, nor that it is worse; level 3")
    assert found.verdict.endswith("as good: no larger; margin 5 mm; about 900 values would show it")
    assert report(KEPT, level(3, "trajectories", unclear, SAME)).passed  # it decides another claim


def test_the_stamp_of_the_page_agrees_with_its_word_and_a_small_difference_is_no_praise_where_others_failed():
    measured = {"intervals": [{}], "largest_m": 7.7e-16, "margin": {"metres": 1e-9}}
    same, wrong = replace(SAME, data=measured), replace(SAME, outcome="failed")
    (stamp, bar), _ = first_figures(report(KEPT, level(1, "registrations", same)))
    assert b">equivalent to the reference; 2 checks<" in stamp.svg
    assert GREEN in bar.svg
    (stamp, bar), _ = first_figures(report(KEPT, level(1, "registrations", same, wrong)))
    assert b">FAILED<" in stamp.svg
    assert b">not all of 3 checks passed<" in stamp.svg
    assert GREEN not in bar.svg
    assert bar.caption.endswith(" Other checks failed.")


def test_the_bar_of_the_page_leaves_out_answers_that_rounding_decides_and_takes_poses_in_the_mean():
    rounded = {"intervals": [{}], "largest_m": 2e-5, "excepted": 3, "margin": {"metres": 2.6e-4}}
    nearer = {"intervals": [{}], "largest_m": 6e-5, "margin": {"metres": 1e-4}}
    checks = [replace(SAME, data=data) for data in (rounded, nearer)]
    (_, bar), _ = first_figures(report(KEPT, level(1, "registrations", *checks)))
    assert bar.title == "Difference on scans: measured 60 µm, allowed 100 µm"
    assert "3 answers that rounding decides do not count" in bar.caption
    assert GREEN in bar.svg
    rows = [
        {"unit": "m", "quantity": "x", "low": -3e-10, "high": 2e-10},
        {"unit": "m", "quantity": "x-disturbed", "low": -1.0, "high": 1.0},
        {"unit": "rad", "quantity": "theta", "low": -1.0, "high": 1.0},
    ]
    poses = replace(SAME, data={"intervals": rows, "margin": {"metres": 1e-9}})
    (_, bar), _ = first_figures(report(KEPT, level(2, "lockstep", poses)))
    assert bar.title == "Difference on scans: measured 300 pm, allowed 1 nm"
    assert bar.caption.startswith("Largest mean difference of the poses")


def test_a_waived_check_does_not_refute_and_keeps_its_reason():
    wrong = replace(SAME, name="field inliers", outcome="failed")
    waived = waive(level(1, "registrations", SAME, wrong), {"inliers": "counts sources"})
    assert [one.outcome for one in waived.checks] == ["passed", "waived"]
    assert waived.checks[1].detail == "waived: counts sources"
    assert report(KEPT, waived).passed
    broken = [RuleResult("order", "It holds.", "failed", "it does not"), RuleResult("wall", "It holds.", "passed", "")]
    assert rules_level(broken, waivers={"order": "it samples"}).outcome("equal") == "passed"
    assert rules_level(broken, waivers={"wall": "unused"}).outcome("equal") == "failed"


def test_one_exception_that_ends_several_rules_is_said_once_and_breaks_the_first():
    def raised(name, observed):
        return RuleResult(name, f"It holds: {name}.", "failed", observed, raised=True)

    results = [
        raised("order", "raises E: nan"), RuleResult("wall", "It holds.", "failed", "it does not"),
        raised("large", "raises E: nan"), raised("buffers", "raises E: nan"), raised("thread", "raises other"),
        RuleResult("moves", "It holds.", "passed", "yes"),
    ]  # fmt: skip
    level = rules_level(results)
    assert level.checks[0].observed == (
        "3 of 6 rules broken: order, wall, thread; not judged, as the exception of order ends them: large, buffers"
    )
    by_name = {one.name: one for one in level.checks}
    assert [name for name, one in by_name.items() if "raises E" in one.observed] == ["rule order"]
    large = by_name["rule large"]
    assert (large.outcome, large.observed) == ("not judged", "an exception ends it, as in rule order")
    assert [one.name for one in level.failed("equal")] == ["all rules", "rule order", "rule wall", "rule thread"]
    assert (level.passed("equal"), level.outcome("equal")) == ([], "failed")
    suite = ElementTree.fromstring(as_junit(report(level))).find("testsuite")
    assert suite is not None
    assert (suite.get("tests"), suite.get("failures"), suite.get("skipped")) == ("7", "4", "2")
    skipped = [one.get("message", "") for one in suite.iter("skipped")]
    assert skipped == [f"an exception ends it, as in rule order. It holds: {name}." for name in ("large", "buffers")]
    waived = rules_level(results, waivers={"order": "noise"}).checks
    assert waived[0].observed.startswith("3 of 6 rules broken: wall, large, thread, 1 waived; not judged, as the exc")
    everything = dict.fromkeys(("order", "wall", "large", "buffers", "thread"), "known")
    assert rules_level(results, waivers=everything).outcome("equal") == "passed"


def test_rules_that_were_not_asked_are_not_judged_and_counted():
    reason = "its process had ended 3 times"
    results = [RuleResult("order", "It holds.", "failed", "the process was terminated by SIGABRT")]
    results += [RuleResult(name, "It holds.", "not judged", reason) for name in ("wall", "large")]
    level = rules_level(results)
    assert level.checks[0].observed == f"1 of 3 rules broken: order; 2 not judged: {reason}"
    assert [one.outcome for one in level.checks] == ["failed", "failed", "not judged", "not judged"]


@pytest.mark.parametrize(
    ("what", "said"),
    [
        ("B raises ZeroDivisionError: A or B", "lib:./mine.so raises ZeroDivisionError: A or B"),
        ("B stops after 3 iterations, A after 4", "lib:./mine.so stops after 3 iterations, paper after 4"),
    ],
)
def test_a_first_difference_names_both_sides_and_keeps_the_text_of_an_exception(what, said):
    first = {"what": what, "stage": "pair", "scan": 2, "iteration": None, "quantity": "answer", "kind": "different"}
    terms = SimpleNamespace(reference="paper", backend="lib:./mine.so")
    assert format_divergence({"first": first}, terms, "pair") == f"pair 2, answer: different: {said}"


def test_a_state_that_may_break_other_rules_comes_first():
    def broken(name):
        return RuleResult(name, "It holds.", "failed", "it does not")

    level = rules_level([broken("first"), broken("deterministic"), broken("fresh")])
    assert level.checks[0].observed == (
        "3 of 3 rules broken: fresh (a new object depends on earlier ones: memory outside the object, such as a static "
        "variable), and perhaps by the same cause: first, deterministic"
    )
    assert [one.name for one in level.checks[1:]] == ["rule fresh", "rule first", "rule deterministic"]
    assert rules_level([broken("fresh")]).checks[0].observed == "1 of 1 rules broken: fresh"
    level = rules_level([broken("deterministic"), broken("read-only")])
    assert level.checks[0].observed == (
        "2 of 2 rules broken: read-only (a call writes to its arguments, which later questions share), and perhaps by "
        "the same cause: deterministic"
    )


def test_the_first_rule_whose_answer_shows_a_mistake_comes_first_but_for_a_state():
    follows, moves, fresh = (RuleResult(name, "It holds.", "failed", "x") for name in ("follows", "moves", "fresh"))
    radians = RuleResult("radians", "It holds.", "failed", "0.3: in degrees?", cause="in degrees?")
    level = rules_level([follows, moves, radians, replace(radians, rule="metres", cause="in mm?")])
    assert level.checks[0].observed == (
        "4 of 4 rules broken: radians (in degrees?), and perhaps by the same cause: follows, moves, metres"
    )
    assert level.checks[1].observed == "It holds. Observed: 0.3: in degrees?"
    assert rules_level([follows, radians, fresh]).checks[1].name == "rule fresh"


@pytest.mark.parametrize("end", [{"raised": True}, {"also_breaks": "in-time"}, {"also_breaks": "alive"}])
def test_a_rule_on_state_that_an_exception_or_an_end_breaks_says_nothing_of_state(end):
    ended = RuleResult("stateless", "It holds.", "failed", "no answer within 10 s", **end)
    level = rules_level([ended, RuleResult("wall", "It holds.", "failed", "it does not")])
    assert level.checks[0].observed == "2 of 2 rules broken: stateless, wall"
    waived = rules_level([RuleResult("fresh", "It holds.", "failed", "x"), ended], waivers={"fresh": "one cache"})
    assert waived.checks[0].observed == "1 of 2 rules broken: stateless, 1 waived"


def test_a_loss_is_worse_only_where_its_interval_lies_beyond_the_margin():
    assert judge_gap(0.1, 0.0, 0.2, 0.3, 50)[0] == "passed"
    assert judge_gap(0.6, 0.4, 0.8, 0.3, 50)[0] == "failed"
    outcome, hint = judge_gap(0.0, -0.5, 0.5, 0.25, 50)  # a half width of 0.5 must shrink to 0.25: four times the data
    assert outcome == "not shown"
    assert "about 200 values instead of 50" in hint


def test_single_precision_is_chosen_only_where_every_result_shows_it_and_all_answers_repeat():
    def result(exact, single, unrepeated=0):
        first = {"kind": "precision"}
        return {
            name: {"equivalent": equal, "level": "answers", "beyond_rounding": int(not equal), "unanswered": 0,
                   "first": None if equal else first}
            for name, equal in (("exact", exact), ("float32", single))
        } | {"unrepeated": unrepeated}  # fmt: skip

    both = ["exact", "float32"]
    assert choose_margin({"pairs": result(False, True), "scans": result(False, True)}, both) == "float32"
    assert choose_margin({"pairs": result(False, True), "scans": result(True, True)}, both) == "exact"
    assert choose_margin({"pairs": result(False, True, unrepeated=1), "scans": result(False, True)}, both) == "exact"
    assert choose_margin({"pairs": result(True, True), "scans": result(True, True)}, both) == "exact"


def test_single_precision_is_not_chosen_where_most_poses_are_equal_in_double_precision():
    def chosen(apart, unanswered=0):
        found = {"equivalent": False, "level": "answers", "beyond_rounding": 0, "unanswered": unanswered,
                 "questions": 132, "apart": apart, "first": {"kind": "different"}}  # fmt: skip
        return choose_margin({"scans": {"exact": found, "float32": found | {"unanswered": 0}}}, ["exact", "float32"])

    assert [chosen(1), chosen(66), chosen(67), chosen(132)] == ["exact", "exact", "float32", "float32"]
    assert chosen(0, unanswered=132) == "float32"  # no answer contradicts it


def test_a_library_in_single_precision_with_a_fault_is_shown_by_what_exceeds_its_rounding():
    def questions(clear):
        wrong = {"equivalent": False, "level": "answers", "beyond_rounding": 3, "unanswered": 0,
                 "first": {"kind": "neighbours"}}  # fmt: skip
        families = {"clear": {"first": clear and {"kind": clear}}, "edges": {"first": {"kind": "neighbours"}}}
        return {"questions": {"exact": wrong | {"families": families}, "float32": wrong}}

    both = ["exact", "float32"]
    assert choose_margin(questions("precision"), both) == "float32"  # even well separated points show rounding
    assert choose_margin(questions("step"), both) == "exact"
    assert choose_margin(questions(None), both) == "exact"


def test_a_trace_that_differs_alone_is_named_by_the_step_of_the_drawn_questions():
    half = {"kind": "step", "quantity": "pose", "what": "0.5 times the least-squares step"}
    families = {"clear": {"wrong": 0}, "scales": {"wrong": 2, "first": half}}
    unnamed = replace(SAME, outcome="failed", observed=f"pair 1, answer: field: {TRACE_ALONE} inliers: in an iteration")
    terms = ComparisonTerms("mine", "paper", "exact", 0.5)
    named = name_traces([unnamed, SAME], {"seed 1": {"exact": {"families": families, "where": ""}}}, terms)
    assert named[0].observed == f"{unnamed.observed}; step: 0.5 times the least-squares step"
    assert named[1] == SAME


def test_the_verdict_names_what_is_waived_beside_equivalent():
    waived = replace(SAME, name="field inliers", outcome="waived")
    found = report(KEPT, level(1, "registrations", SAME, waived)).verdict
    assert found.endswith("is equivalent to paper within 1e-09 m at every level that was run (rules, registrations; "
                          "waived: field inliers)")  # fmt: skip


def test_the_junit_file_has_a_case_for_each_check_and_a_failure_for_each_that_refutes():
    wrong = replace(SAME, outcome="failed", observed="pair 3: <units>\x00")
    skipped = Check("mapper", "", "not applicable", "never", "none")
    made = replace(report(KEPT, level(1, "registrations", SAME, wrong, GOOD, skipped)), subject="lib:\x01mine")
    found = ElementTree.fromstring(as_junit(made))
    assert found.get("name") == "evalkit validate lib:mine"
    suites = {suite.get("name"): suite for suite in found}
    one = suites["1 registrations"]
    assert (one.get("tests"), one.get("failures"), one.get("skipped")) == ("4", "1", "1")
    assert [case.find("failure").get("message") for case in one if case.find("failure") is not None] == [
        "pair 3: <units>"
    ]
