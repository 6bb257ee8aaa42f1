"""Figures 2 to 5: the stages of the pipeline are recorded from a run."""

import importlib
from dataclasses import asdict

import pytest

from evalkit_paper import flowchart_chapter
from evalkit_paper.flowchart_chapter import MAPPING, PIPELINE, REGISTRATION, TWO_STAGES, TracedCall, path


def recording(**settings):
    chosen = flowchart_chapter.CHAPTER.settings("test", {"laps": 0.02, **settings})
    (task,) = flowchart_chapter.CHAPTER.tasks(chosen)
    return chosen, {task.name: task.run()[0]}


def run_stages(words, below="", **settings):
    _, results = recording(**settings)
    return set(path(TracedCall.from_json(results["stages"]["calls"]), words, below).stages)


def tree(*names):
    """Build a call tree from lines indented by depth: "a", " b", " c"."""
    root = TracedCall("")
    above = [root]
    for name in names:
        depth = len(name) - len(name.lstrip())
        made = TracedCall(name.strip())
        del above[depth + 1 :]
        above[-1].calls.append(made)
        above.append(made)
    return root


def test_a_path_lists_the_calls_in_order_and_folds_repetitions():
    drawn = path(tree("a", " x", "b", "c", "b", "c", "b", "c", "d"), dict.fromkeys("abcd", ""))
    assert (drawn.stages, drawn.first, drawn.last, drawn.times) == (["a", "b", "c", "d"], 1, 2, 3)


def test_children_follow_their_stage_and_unnamed_calls_are_skipped():
    assert path(tree("a", " unnamed", "  b", "c"), dict.fromkeys("abc", "")).stages == ["a", "b", "c"]
    assert path(tree("a", " b", "c"), dict.fromkeys("abc", ""), below="a").stages == ["a", "b"]


def test_calls_are_recorded_below_their_callers():
    root = flowchart_chapter.record_calls(
        lambda: flowchart_chapter.frontend.select_near(flowchart_chapter.frontend.np.zeros((2, 2)), 1.0)
    )
    assert [each.name for each in root.walk()] == ["", "select_near"]


def test_a_call_tree_survives_json():
    root = tree("a", " b", "c")
    assert TracedCall.from_json(asdict(root)) == root


@pytest.mark.parametrize(
    ("words", "settings", "gone"),
    [
        (PIPELINE, {"scan_to_scan": False}, {"FrontEnd._register s2s"}),
        (PIPELINE, {"scan_to_map": False}, {"FrontEnd._register s2m"}),
        (TWO_STAGES, {"scan_to_map": False}, {"FrontEnd._register s2m", "KeyframeMap.cloud"}),
        (TWO_STAGES, {"deskew": False}, {"MotionPrior.within_scan"}),
        (TWO_STAGES, {"local_radius_m": 0.0}, {"select_near"}),
        (REGISTRATION, {"one_to_one": False}, {"select_closest"}),
    ],
    ids=["scan to scan", "scan to map", "scan to map of two", "deskew", "local radius", "one to one"],
)
def test_a_disabled_stage_is_missing_from_its_figure_and_changes_nothing_else(words, settings, gone):
    assert run_stages(words) - run_stages(words, **settings) == gone


@pytest.mark.parametrize("words", [PIPELINE, REGISTRATION, TWO_STAGES, MAPPING])
def test_every_label_of_a_figure_names_a_function_of_a_recorded_module(words):
    modules = list(map(importlib.import_module, flowchart_chapter.RECORDED_MODULES))
    names = {value.__qualname__ for module in modules
             for value in vars(module).values() if hasattr(value, "__qualname__")}  # fmt: skip
    methods = {f"{value.__qualname__}.{name}" for module in modules
               for value in vars(module).values() if isinstance(value, type) for name in vars(value)}  # fmt: skip
    assert {key.partition(" ")[0] for key in words} <= names | methods


def test_another_option_is_another_stage():
    assert run_stages(MAPPING) - run_stages(MAPPING, traversal="bresenham") == {"exact"}
    assert run_stages(MAPPING, traversal="bresenham") - run_stages(MAPPING) == {"bresenham"}
    assert run_stages(MAPPING) ^ run_stages(MAPPING, once_per_scan=False) == {
        "LogOddsGrid._count_once",
        "LogOddsGrid._count_every",
    }
    assert run_stages(TWO_STAGES) ^ run_stages(TWO_STAGES, local_map="grid") >= {"KeyframeMap.cloud", "GridMap.cloud"}


def test_the_page_has_a_box_for_every_executed_stage():
    chosen, results = recording()
    (section,) = flowchart_chapter.CHAPTER.sections(chosen, results)
    figures = section.blocks[1].figures
    assert [figure.title[:8] for figure in figures] == ["Figure 2", "Figure 3", "Figure 4", "Figure 5"]
    drawn = path(TracedCall.from_json(results["stages"]["calls"]), REGISTRATION, "FrontEnd._register s2m")
    assert drawn.times > 1
    assert [REGISTRATION[key] for key in drawn.stages[drawn.first :]] == [
        REGISTRATION[key] for key in ("Association.find", "select_closest", "fit_motion", "Icp._error")
    ]
    photo, *figures = flowchart_chapter.CHAPTER.findings(chosen, results)
    assert photo.judgement.verdict == "not reproducible in software"
    assert [finding.judgement.verdict for finding in figures] == ["reproduced"] * 4


def test_a_figure_whose_stage_did_not_run_is_not_reproduced():
    chosen, results = recording(one_to_one=False)
    found = {finding.item[:8]: finding.judgement for finding in flowchart_chapter.CHAPTER.findings(chosen, results)}
    assert found["Figure 3"].verdict == "not reproduced"
    assert found["Figure 3"].why == "did not run: select_closest"
    assert found["Figure 2"].verdict == "reproduced"
