"""Figures: small, with clipped parts stated, and absent where there is nothing to draw."""

import re
import warnings
from dataclasses import replace

from evalkit.report.html.method_colours import assign_strokes
from evalkit.report.html.run_charts import path_chart
from evalkit.report.html.run_figures import draw_errors, draw_residuals, draw_runtimes, draw_trajectories


def test_a_long_run_is_drawn_with_a_limited_number_of_points(record):
    short = [record("a", "room", {}, answered=600, expected=600)]
    long = [record("a", "room", {}, answered=6000, expected=6000)]
    for draw in (draw_trajectories, draw_errors, draw_residuals):
        assert len(draw(long, assign_strokes(["a"])).svg) < 1.5 * len(draw(short, assign_strokes(["a"])).svg)


def test_clipped_methods_are_named(record):
    pair = [record("near", "room", {}, error_m=0.02), record("far", "room", {}, error_m=30.0)]
    drawn = draw_trajectories(pair, assign_strokes(["near", "far"]))
    assert drawn.remark == "far leaves the frame."


def test_errors_of_very_different_size_share_a_logarithmic_axis(record):
    pair = [record("near", "room", {}, error_m=0.02), record("far", "room", {}, error_m=30.0)]
    assert draw_errors(pair, assign_strokes(["near", "far"])).remark == "Logarithmic axis."
    assert draw_errors(pair[:1], assign_strokes(["near"])).remark == ""


def test_runs_without_answers_have_no_figure(record):
    none = [record("a", "room", {}, status="failed", reason="no odometry", answered=0)]
    assert [
        draw(none, assign_strokes(["a"])) for draw in (draw_trajectories, draw_errors, draw_runtimes, draw_residuals)
    ] == [None] * 4


def test_wheel_odometry_has_no_residuals(record):
    assert draw_residuals([record("wheel", "room", {})], assign_strokes(["wheel"])) is None


def test_a_path_that_runs_away_leaves_the_frame_and_overflows_nothing(record):
    lost = record("lost", "room", {})
    for column, far in (("x", 1e307), ("y", -1e307)):
        steps = lost.result.steps.copy()
        steps[column][30:] = far
        lost = replace(lost, result=replace(lost.result, steps=steps))
    pair = [record("near", "room", {}), lost]
    strokes = assign_strokes(["near", "lost"])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert draw_trajectories(pair, strokes).remark == "lost leaves the frame."
        drawn = str(path_chart(pair, strokes, "near"))
    assert "Lost leaves the frame." in drawn
    assert not {"inf", "nan"} & set(re.findall(r"[a-z]+", drawn.partition("<svg")[2]))
