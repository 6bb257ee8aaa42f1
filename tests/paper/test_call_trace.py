"""Figures 2 to 5: the stages are recorded, not drawn from memory."""

import pytest

from evalkit_paper import call_trace, flowchart_chapter
from evalkit_paper.call_trace import Call
from evalkit_paper.flowchart_chapter import MAPPING, PIPELINE, REGISTRATION, TWO_STAGES, path


def recording(**settings):
    chosen = flowchart_chapter.CHAPTER.settings("test", {"laps": 0.02, **settings})
    (task,) = flowchart_chapter.CHAPTER.tasks(chosen)
    return chosen, {task.name: task.run()[0]}


def ran(words, below="", **settings):
    _, results = recording(**settings)
    return set(path(Call.from_json(results["stages"]["calls"]), words, below).stages)


def tree(*names):
    """Calls one below the other by indentation: "a", " b", " c"."""
    root = Call("")
    above = [root]
    for name in names:
        depth = len(name) - len(name.lstrip())
        made = Call(name.strip())
        del above[depth + 1 :]
        above[-1].calls.append(made)
        above.append(made)
    return root


def test_a_path_lists_what_ran_in_order_and_folds_a_round():
    drawn = path(tree("a", " x", "b", "c", "b", "c", "b", "c", "d"), dict.fromkeys("abcd", ""))
    assert (drawn.stages, drawn.first, drawn.last, drawn.times) == (["a", "b", "c", "d"], 1, 2, 3)


def test_what_is_below_a_stage_comes_after_it_and_what_is_not_named_is_looked_through():
    assert path(tree("a", " unnamed", "  b", "c"), dict.fromkeys("abc", "")).stages == ["a", "b", "c"]
    assert path(tree("a", " b", "c"), dict.fromkeys("abc", ""), below="a").stages == ["a", "b"]


def test_calls_are_recorded_below_their_callers():
    root = call_trace.record_calls(lambda: call_trace.frontend.points_within(call_trace.frontend.np.zeros((2, 2)), 1.0))
    assert [each.name for each in root.walk()] == ["", "points_within"]


def test_a_tree_of_calls_survives_the_way_through_json():
    root = tree("a", " b", "c")
    assert Call.from_json(root.to_json()).to_json() == root.to_json()


@pytest.mark.parametrize(
    ("words", "settings", "gone"),
    [
        (PIPELINE, {"scan_to_scan": False}, {"FrontEnd._register s2s"}),
        (PIPELINE, {"scan_to_map": False}, {"FrontEnd._register s2m"}),
        (TWO_STAGES, {"scan_to_map": False}, {"FrontEnd._register s2m", "KeyframeMap.cloud"}),
        (TWO_STAGES, {"deskew": False}, {"Motion.within_scan"}),
        (TWO_STAGES, {"local_radius_m": 0.0}, {"points_within"}),
        (REGISTRATION, {"one_to_one": False}, {"closest_only"}),
    ],
    ids=["scan to scan", "scan to map", "scan to map of two", "deskew", "local radius", "one to one"],
)
def test_a_stage_switched_off_leaves_its_figure_and_nothing_else(words, settings, gone):
    assert ran(words) - ran(words, **settings) == gone


def test_another_choice_is_another_stage():
    assert ran(MAPPING) - ran(MAPPING, traversal="bresenham") == {"exact"}
    assert ran(MAPPING, traversal="bresenham") - ran(MAPPING) == {"bresenham"}
    assert ran(MAPPING) ^ ran(MAPPING, once_per_scan=False) == {"LogOddsGrid._once", "LogOddsGrid._every"}
    assert ran(TWO_STAGES) ^ ran(TWO_STAGES, local_map="grid") >= {"KeyframeMap.cloud", "GridMap.cloud"}


def test_a_box_stands_on_the_page_for_every_stage_that_ran():
    chosen, results = recording()
    (section,) = flowchart_chapter.CHAPTER.sections(chosen, results)
    figures = section.blocks[1].figures
    assert [figure.title[:8] for figure in figures] == ["Figure 2", "Figure 3", "Figure 4", "Figure 5"]
    drawn = path(Call.from_json(results["stages"]["calls"]), REGISTRATION, "FrontEnd._register s2m")
    assert drawn.times > 1
    assert [REGISTRATION[key] for key in drawn.stages[drawn.first :]] == [
        REGISTRATION[key] for key in ("Association.of", "closest_only", "rigid", "Icp._error")
    ]
    assert len(flowchart_chapter.CHAPTER.findings(chosen, results)) == 2
