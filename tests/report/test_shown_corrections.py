"""The player shows each correction of a SLAM: the path before and after it, what moved, and the closures since."""

import json
from dataclasses import replace

import numpy as np
import pytest

from evalkit.core.loop_closure import LoopClosure
from evalkit.core.path_correction import PathCorrection
from evalkit.core.pose import Pose
from evalkit.core.run_result import FinalAlignment
from evalkit.core.trajectory import Trajectory
from evalkit.report import write_report
from evalkit.report.html import shown_corrections
from evalkit.report.html.array_encoding import unpack_array
from evalkit.report.html.corrected_runs import add_strokes, with_corrected
from evalkit.report.html.corrected_tables import list_closures
from evalkit.report.html.method_colours import assign_strokes
from evalkit.report.html.player import build_player

STEP_NS = 100_000_000
CORRECTED = (30, 50)
"""The scans that corrected: 3 s and 5 s after the first."""
CLOSED = ((28, 2), (29, 3), (50, 10), (55, 12))


def slam(record, **changes):
    """A SLAM that closes loops at 2.8, 2.9 (corrected at 3.0), 5.0 (corrected at once) and 5.5 s (never corrected).

    The first correction moves pose k by k mm in y, up to 29 mm; the second moves each but the first by 50 mm in x.
    In the world, the corrected poses are 10 m further in x.
    """
    run = record("slam", "room", {})
    stamps, poses = run.result.steps["stamp_ns"], run.result.estimate.poses
    paths = []
    for at, axis in zip(CORRECTED, (1, 0), strict=True):
        after = poses[:at].copy()
        after[1:, axis] += 1e-3 * np.arange(1, at) if axis else 0.05
        paths.append(PathCorrection(int(stamps[at]), stamps[:at], poses[:at], after))
    closures = [LoopClosure(int(stamps[a]), int(stamps[b]), Pose(), True, "near") for a, b in CLOSED]
    rejected = LoopClosure(int(stamps[40]), int(stamps[0]), Pose(), False, "far")
    steps = run.result.steps.copy()
    steps["corrected"] = np.isin(np.arange(len(steps)), CORRECTED)
    final = Trajectory(stamps, poses, "start", "base")
    result = replace(
        run.result, steps=steps, final=final, loop_closures=(*closures, rejected), path_corrections=tuple(paths)
    )
    alignment = FinalAlignment(Pose(10.0, 0.0, 0.0), "first pose", np.zeros(len(steps)))
    return replace(run, result=replace(result, **changes), scores=replace(run.scores, final=alignment))


def player(runs):
    strokes = add_strokes(assign_strokes([run.method for run in runs]))
    return build_player(with_corrected(runs), None, None, strokes)


def test_the_path_before_and_after_each_correction_is_in_the_world_to_a_millimetre(record):
    run = slam(record)
    shown = json.loads(player([run]).content)["corrections"]
    assert [(one["name"], one["at"]) for one in shown] == [("slam 1", 3000), ("slam 2", 5000)]
    for one, path in zip(shown, run.result.path_corrections, strict=True):
        rows = unpack_array(one["path"], (len(path.before), 4))
        assert rows[:, :2] * 1e-3 == pytest.approx(path.before[:, :2] + [10.0, 0.0], abs=0.6e-3)
        assert rows[:, 2:] * 1e-3 == pytest.approx((path.after - path.before)[:, :2], abs=1.1e-3)


def test_a_closure_belongs_to_the_first_correction_after_it(record):
    run = slam(record)
    pairs, rest = shown_corrections.attribute_closures(run.result)
    assert [[one.stamp_ns // STEP_NS for one in closures] for _, closures in pairs] == [[28, 29], [50]]
    assert [one.stamp_ns // STEP_NS for one in rest] == [55]
    first, second = json.loads(player([run]).content)["corrections"]
    assert first["words"] == (
        "slam corrected its path at t = 3.0 s (scan 31). The robot's position one scan before moved by 29\u00a0mm; "
        "that of t = 2.9 s moved most, by 29\u00a0mm. Last accepted closure: 0.1 s before, at 2.9 s, back to 0.3 s. "
        "Closures before it, since the last correction: at 2.8 s; until then no correction."
    )
    assert "moved by 50\u00a0mm" in second["words"]
    assert second["words"].endswith("Last accepted closure: at this scan, at 5.0 s, back to 1.0 s.")
    before, after = run.result.path_corrections[0].before, run.result.path_corrections[0].after
    for side, path in (("before", before), ("after", after)):
        last, earlier = first["edges"][side]
        assert last == pytest.approx([path[29, 0] + 10.0, path[29, 1], path[3, 0] + 10.0, path[3, 1]], abs=1e-3)
        assert earlier[:2] == pytest.approx([path[28, 0] + 10.0, path[28, 1]], abs=1e-3)


def test_the_reader_chooses_a_correction_by_its_time_and_what_it_moved(record):
    made = player([slam(record), record("odometry", "room", {})])
    assert {method: [one.label for one in own] for method, own in made.corrections.items()} == {
        "slam": [
            "3.0 s: robot moved 29\u00a0mm, closure at 2.9 s", "5.0 s: robot moved 50\u00a0mm, closure at 5.0 s",
        ]
    }  # fmt: skip
    assert "slam reports no correction after the last closure it accepted." in made.remarks
    assert "Before a correction: the path that the previous correction left" in made.remarks


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        (
            {"path_corrections": ()},
            "The results of slam are of an earlier version, which kept no path before and after",
        ),
        (
            {"paths_left_out": "the paths of at most 2 corrections are kept"},
            "Not all corrections of slam can be shown one by one: the paths of at most 2 corrections are kept.",
        ),
    ],
)
def test_what_cannot_be_shown_is_said(record, changes, said):
    assert said in player([slam(record, **changes)]).remarks


def test_a_slam_that_does_not_report_corrections_and_one_without_closures(record):
    silent = slam(record, path_corrections=())
    steps = silent.result.steps.copy()
    steps["corrected"] = -1
    made = player([replace(silent, result=replace(silent.result, steps=steps))])
    assert "slam does not report when it corrects its path: its corrections cannot be shown one by one." in made.remarks
    assert json.loads(made.content)["corrections"] == []
    steps["corrected"] = 0
    assert "slam" not in player([slam(record, path_corrections=(), loop_closures=(), steps=steps)]).remarks


def test_the_poses_of_all_corrections_on_a_page_are_bounded(record, monkeypatch):
    monkeypatch.setattr(shown_corrections, "MAX_POSES", 20)
    shown = json.loads(player([slam(record)]).content)["corrections"]
    ends = [run_path.before[[0, -1], 0] + 10.0 for run_path in slam(record).result.path_corrections]
    for one, (first, last) in zip(shown, ends, strict=True):
        rows = unpack_array(one["path"], (10, 4))
        assert rows[[0, -1], 0] * 1e-3 == pytest.approx([first, last], abs=1e-3)


def test_the_list_of_closures_has_the_correction_that_followed(record):
    (fold,) = list_closures([slam(record)], "sequence-1")
    accepted = fold.blocks[0]
    assert [column.label for column in accepted.columns][3:5] == ["Corrected at", "Robot moved"]
    assert [(row[0].text, row[3].text, row[4].text) for row in accepted.rows] == [
        ("2.8", "–", "–"), ("2.9", "3.0", "29\u00a0mm"), ("5.0", "5.0", "50\u00a0mm"), ("5.5", "–", "–"),
    ]  # fmt: skip
    assert accepted.rows[1][3].link == "#sequence-1-player?by=slam&correction=slam%201&on=own&scan=31"
    (fold,) = list_closures([slam(record, path_corrections=())], "sequence-1")
    assert "Corrected at" not in [column.label for column in fold.blocks[0].columns]


COUNT_COLOURS = """(map) => {
  const { data } = map.getContext("2d").getImageData(0, 0, map.width, map.height);
  const pixels = Array.from({ length: data.length / 4 }, (_, i) => data.slice(4 * i, 4 * i + 3).join());
  return ["200,16,46", "61,31,209"].map((colour) => pixels.filter((one) => one === colour).length > 20);
}"""
"""Whether the path before a correction is drawn, and the one after."""


@pytest.mark.slow(20)
def test_a_reader_picks_a_correction_and_one_of_its_paths(record, build, browser, tmp_path):
    page_file = write_report(build([slam(record), record("odometry", "room", {})]), tmp_path)
    page = browser.new_page(viewport={"width": 390, "height": 900})
    complaints = []
    page.on("pageerror", lambda error: complaints.append(str(error)))
    page.goto(f"{page_file.as_uri()}#sequence-1-player?by=slam&correction=slam%201&on=own&scan=31")
    page.wait_for_selector("#sequence-1 .player.ready")
    words, pick = page.locator("#sequence-1 p.correction"), page.locator("#sequence-1 select[data-picks=correction]")
    assert words.inner_text().startswith("slam corrected its path at t = 3.0 s (scan 31).")
    pick.select_option("slam 2")
    assert words.inner_text().startswith("slam corrected its path at t = 5.0 s (scan 51).")
    assert page.locator("#sequence-1 .at").inner_text().startswith("scan 51 of 60")
    side, canvas = page.locator("#sequence-1 select[data-picks=side]"), page.locator("#sequence-1 canvas.map")
    drawn = {}
    for choice in ("both", "before", "after"):
        side.select_option(choice)
        drawn[choice] = canvas.evaluate(COUNT_COLOURS)
    assert drawn == {"both": [True, True], "before": [True, False], "after": [False, True]}
    page.wait_for_url("**side=after**")
    assert "correction=slam%202" in page.url
    assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
    pick.select_option("")
    assert words.inner_text() == ""
    page.close()
    assert complaints == []
