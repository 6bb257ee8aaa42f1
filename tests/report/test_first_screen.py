"""The first screen: what is drawn where, and which maps are shown."""

import re
from dataclasses import replace

import numpy as np
import pytest

from evalkit.core.run_result import LostTrack
from evalkit.report.analysis.analysis import analyse
from evalkit.report.html.cost_plot import _find_front, _Point, draw_scatter
from evalkit.report.html.dot_plot import draw_dots
from evalkit.report.html.map_strip import build_tiles, choose_tiles, describe_strip, find_hardest
from evalkit.report.html.method_colours import assign_strokes
from evalkit.report.html.svg import AxisScale, element, log_scale, place_labels, polyline


@pytest.fixture
def room(record, build):
    """Five methods on one sequence: ``plane`` is the best, ``lost`` the worst, ``lib`` a peer."""
    errors = {"paper": 0.06, "plane": 0.01, "wheel": 0.4, "lost": 2.5, "lib": 0.03}
    runs = [
        record(name, "room", {"ate_rmse_m": error * (1 + 0.01 * seed), "cpu_median_ms": 10 * error}, seed=seed,
               error_m=error)
        for name, error in errors.items()
        for seed in range(3)
    ]  # fmt: skip
    made = build(runs)
    return replace(made, methods={**made.methods, "lib": replace(made.methods["lib"], role="peer")})


def strokes_of(comparison):
    return assign_strokes(comparison.method_labels, ("wheel",))


def dots(comparison):
    return draw_dots(analyse(comparison), strokes_of(comparison))


def kinds(markup, method):
    """The classes of the dots of a method."""
    row = markup[markup.index(f'data-of="{method}"') :]
    row = row[: row.index('role="row"')] if 'role="row"' in row else row
    return re.findall(r'class="dot ?([a-z]*)"', row)


def test_a_logarithmic_scale_places_decades_evenly():
    scale = AxisScale(0.01, 1.0)
    assert [scale.share(value) for value in (0.01, 0.1, 1.0)] == pytest.approx([0.0, 0.5, 1.0])
    assert scale.share(1e9) == 1.02
    assert scale.ticks(3) == (0.01, 0.1, 1.0)
    assert AxisScale(0.01, 1.0).ticks(5) == (0.01, 0.03, 0.1, 0.3, 1.0)
    assert AxisScale(0.0281391, 0.0441).ticks(2) == (0.035,)  # no round value within


def test_a_linear_scale_has_round_ticks():
    assert AxisScale(0.0, 47.0, log=False).ticks(5) == (0.0, 10.0, 20.0, 30.0, 40.0)
    assert AxisScale(0.0, 0.5, log=False).share(0.25) == 0.5


def test_equal_values_still_have_a_width():
    scale = log_scale([0.2, 0.2])
    assert scale.high / scale.low >= 1.5
    assert scale.share(0.2) == pytest.approx(0.5)


def test_a_line_is_interrupted_where_a_number_is_missing():
    path = polyline(np.array([[0.0, 0.0], [1.0, 1.0], [np.nan, 2.0], [3.0, 3.0], [4.0, 4.0]]))
    assert 'd="M0 0L1 1M3 3L4 4"' in path


def test_elements_escape_text_and_attributes():
    assert element("b", "<x>", title='"') == '<b title="&#34;">&lt;x&gt;</b>'


def test_labels_cover_neither_points_nor_each_other():
    points = [(50.0, 50.0, "first"), (58.0, 50.0, "second"), (54.0, 52.0, "third")]
    placed = place_labels(points, (200.0, 100.0), 6.0, 9.0)
    assert "first" in placed
    boxes = []
    for name, (x, y, anchor) in placed.items():
        wide = 6.0 * len(name)
        left = {"start": x, "end": x - wide, "middle": x - wide / 2}[anchor]
        boxes.append((left, y - 9.0, left + wide, y + 3.0))
    assert all(
        a[2] <= b[0] or b[2] <= a[0] or a[3] <= b[1] or b[3] <= a[1] for i, a in enumerate(boxes) for b in boxes[:i]
    )


def test_a_label_that_fits_on_no_side_begins_or_ends_at_its_point_and_leaves_what_is_free():
    """At the left edge a long name fits neither to the left nor in the middle; to the right there is another point."""
    points = [(10.0, 50.0, "near the left edge"), (60.0, 50.0, "b")]
    assert place_labels(points[:1], (200.0, 100.0), 6.0, 9.0) == {"near the left edge": (19.0, 54.0, "start")}
    at = place_labels(points, (200.0, 100.0), 6.0, 9.0)["near the left edge"]
    assert at == (7.0, 41.0, "start")
    above = (0.0, 0.0, 200.0, 45.0)
    assert place_labels(points, (200.0, 100.0), 6.0, 9.0, [above])["near the left edge"] == (7.0, 67.0, "start")


def test_the_front_is_what_no_other_beats_in_both():
    points = [("a", 1.0, 5.0), ("b", 1.2, 2.0), ("c", 3.0, 0.5), ("d", 2.0, 3.0), ("e", 3.0, 0.5)]
    drawn = [_Point(name, error, cpu, "") for name, error, cpu in points]
    assert [one.method for one in _find_front(drawn)] == ["c", "b", "a"]


def test_filled_dots_are_best_or_tied_and_others_hollow(room):
    markup = dots(room)
    assert kinds(markup, "plane") == ["tied"]
    assert kinds(markup, "paper") == kinds(markup, "lost") == [""]
    assert "plane on room: 10\u00a0mm, best" in markup
    assert "paper on room: 61\u00a0mm, worse than the best" in markup


def ends(markup, method):
    """The ends (%) of the interval of a method, and the number of arrows where it is cut."""
    row = markup[markup.index(f"{method} on room") :]
    row = row[: row.index("</svg><span")]
    found = re.search(r'<line x1="([\d.]+)%" x2="([\d.]+)%"[^>]*class="span"', row)
    return float(found[1]), float(found[2]), row.count('class="span cut"')


def test_an_interval_is_drawn_to_its_ends_or_its_cut_end_has_an_arrow(record, build):
    """Of two runs the interval is their range: 10 to 40 mm is twice as wide on a logarithmic scale as 10 to 20 mm."""

    def measure(*errors):
        own = [record("wide", "room", {"ate_rmse_m": error}, seed=seed) for seed, error in enumerate(errors)]
        narrow = [record("narrow", "room", {"ate_rmse_m": error}, seed=seed) for seed, error in enumerate((0.01, 0.02))]
        drawn = dots(build([*own, *narrow]))
        return ends(drawn, "wide"), ends(drawn, "narrow")

    (low, high, cut), (its_low, its_high, none) = measure(0.010, 0.040)
    assert (low, cut, none) == (its_low, 0, 0)
    assert high - low == pytest.approx(2.0 * (its_high - its_low), abs=0.3)
    (*_, cut), (its_low, its_high, none) = measure(0.00001, 0.040)  # 0.01 mm would flatten the rest
    assert (cut, none) == (1, 0)
    assert its_high - its_low > 10.0


@pytest.mark.parametrize(
    ("errors", "ticks"),
    [((0.004, 0.03), ["5 mm", "20 mm"]), ((0.11, 0.15), ["110 mm", "160 mm"]), ((0.03, 3.0), ["50 mm", "2 m"])],
)
def test_two_labelled_values_tell_the_scale_of_each_column(record, build, errors, ticks):
    """As round as possible, and far apart: one value does not tell whether a column spans a factor of 1.4 or 100."""
    runs = [
        record(name, "room", {"ate_rmse_m": error}, seed=seed)
        for name, error in zip("ab", errors, strict=True) for seed in range(3)
    ]  # fmt: skip
    foot = dots(build(runs)).split('class="ticks"')[1]
    assert [text.replace("\u00a0", " ") for text in re.findall(r'class="tick[a-z ]*"[^>]*>([^<]+)<', foot)] == ticks


def test_methods_are_in_the_order_of_the_answer(room):
    names = re.findall(r'class="dots-row series[a-z ]*" data-of="(\w+)"', dots(room))
    assert names == [one.method for one in analyse(room).answer.standings]


def test_a_method_on_its_own_tuning_data_and_a_lost_one_have_other_marks(room):
    tuned = replace(room, methods={**room.methods, "plane": replace(room.methods["plane"], tuned_on=("room",))})
    assert kinds(dots(tuned), "plane") == ["tuned"]
    assert kinds(dots(tuned), "lib") == ["tied"]
    lost = [
        replace(run, scores=replace(run.scores, lost=LostTrack(212.0, "it slipped"))) if run.method == "lost" else run
        for run in room.records
    ]
    assert kinds(dots(replace(room, records=tuple(lost))), "lost") == ["lost"]


def test_single_runs_are_drawn_without_a_verdict(record, build):
    once = build(
        [record(name, "cave", {"ate_rmse_m": e}, seed=None, error_m=e) for name, e in (("a", 0.1), ("b", 0.9))]
    )
    markup = dots(once)
    assert kinds(markup, "a") == kinds(markup, "b") == ["unranked"]
    assert "one run" in markup


def test_a_missing_value_has_its_reason(record, build, room):
    failed = [record("z", "room", {}, seed=seed, status="crashed", reason="signal 11", answered=0) for seed in range(3)]
    assert '<span class="why">crashed</span>' in dots(build([*room.records, *failed]))
    assert "crashed" not in dots(room)


def test_the_map_strip_has_answer_peer_baseline_and_worst_in_one_window(room):
    analysis = analyse(room)
    assert choose_tiles(analysis, analysis.sequences[0]) == [
        ("plane", "answer"), ("lib", "established"), ("wheel", "baseline"), ("lost", "worst"),
    ]  # fmt: skip
    tiles = build_tiles(analysis, 0, strokes_of(room))
    assert len({tile.figure.size for tile in tiles}) == 1
    assert tiles[0].caption == "10\u00a0mm · 0.10\u00a0ms"
    assert tiles[0].link == "#sequence-1-player?by=plane&on=own&play=1"


def test_the_caption_of_a_map_says_how_many_runs_lost_the_track_and_when_the_first_did(room):
    """The value is the median of all runs, the loss is not that of the drawn run: the caption says so."""
    at_s = {0: 27.0, 1: 5.0}
    runs = [
        replace(run, scores=replace(run.scores, lost=LostTrack(at_s[run.seed], "a jump")))
        if run.method == "lost" and run.seed in at_s else run
        for run in room.records
    ]  # fmt: skip
    tiles = {
        tile.method: tile for tile in build_tiles(analyse(replace(room, records=tuple(runs))), 0, strokes_of(room))
    }
    assert tiles["lost"].caption == "2.52\u00a0m · lost in 2 of 3, first at 5 s"
    assert "lost" not in tiles["plane"].caption


def test_without_a_verdict_the_map_strip_names_no_best_and_no_worst(room):
    """One run each: the values are stated, and that the recording does not count."""
    once = replace(room, records=tuple(run for run in room.records if run.seed == 0))
    analysis = analyse(once)
    roles = dict(choose_tiles(analysis, analysis.sequences[0]))
    assert (roles["plane"], roles["lost"]) == ("best value", "worst value")
    assert describe_strip(analysis, analysis.sequences[0]) == ("room: ATE RMSE, CPU time a scan; not counted")
    assert list(roles.values()).count("worst value") == 1
    whole = analyse(room)
    assert describe_strip(whole, whole.sequences[0]) == "room: ATE RMSE, CPU time a scan"


def test_only_the_last_map_is_the_worst_also_where_it_is_the_answer(record, build):
    """``b`` is best on the room that counts, and last on a recording that was run once."""
    runs = [
        record(name, "room", {"ate_rmse_m": error * (1 + 0.01 * seed)}, seed=seed, error_m=error)
        for name, error in (("b", 0.01), ("a", 0.1), ("c", 0.2)) for seed in range(3)
    ]  # fmt: skip
    once = [
        record(name, "hall", {"split_distance_m": value}, seed=None, truth=False)
        for name, value in (("a", 0.1), ("c", 0.2), ("b", 0.3))
    ]
    analysis = analyse(build([*runs, *once]))
    hall = next(one for one in analysis.sequences if one.label == "hall")
    assert choose_tiles(analysis, hall) == [("a", ""), ("c", ""), ("b", "answer")]


def test_a_tuned_method_is_in_the_map_strip_only_if_it_is_the_answer_or_the_best_beside_it(record, build, room):
    methods = {**room.methods, "plane": replace(room.methods["plane"], tuned_on=("room",))}
    analysis = analyse(replace(room, methods=methods))
    assert [method for method, _ in choose_tiles(analysis, analysis.sequences[0])] == ["lib", "paper", "wheel", "lost"]
    hall = [
        record(name, sequence, {"ate_rmse_m": error * (1 + 0.01 * seed)}, seed=seed, error_m=error)
        for sequence in ("hall", "yard") for name, error in (("plane", 0.01), ("lib", 0.5)) for seed in range(3)
    ]  # fmt: skip
    both = build([*room.records, *hall])
    analysis = analyse(replace(both, methods={**both.methods, "plane": methods["plane"]}))
    assert analysis.answer.winners == ("plane",)
    assert choose_tiles(analysis, analysis.sequences[0])[0] == ("plane", "answer")
    tile = build_tiles(analysis, 0, strokes_of(both))[0]
    assert tile.caption == "10\u00a0mm · 0.10\u00a0ms · settings chosen here"
    cards = {
        **both.methods,
        **{name: replace(both.methods[name], tuned_on=("room",)) for name in ("plane", "lib", "paper")},
    }
    analysis = analyse(replace(both, methods=cards))
    assert choose_tiles(analysis, analysis.sequences[0]) == [
        ("plane", "answer"), ("lib", "best other tuned"), ("wheel", "baseline"), ("lost", "worst"),
    ]  # fmt: skip


def test_the_hardest_sequence_is_a_recording_before_a_simulation(record, build, room):
    drive = [record(name, "drive", {"ate_rmse_m": e}, seed=None, error_m=e) for name, e in (("a", 0.1), ("b", 0.2))]
    assert find_hardest(analyse(build([*room.records, *drive]))) == 1
    parts = [
        replace(one, spec=replace(one.spec, sequence=replace(one.spec.sequence, perturbed=True, excerpt_scans=400)))
        for name, error in (("a", 0.01), ("b", 5.0))
        for one in (record(name, "parts", {"ate_rmse_m": error}, seed=None, error_m=error),)
    ]
    assert find_hardest(analyse(build([*parts, *drive]))) == 1  # the whole one, though the maps of excerpts differ more
    assert find_hardest(analyse(build([*parts, *room.records]))) == 0
    assert find_hardest(analyse(room)) == 0
    nothing = build([record("a", "room", {}, status="failed", reason="no", answered=0)])
    assert find_hardest(analyse(nothing)) is None
    assert dots(nothing) is None
    assert draw_scatter(analyse(nothing), strokes_of(nothing)) is None


def test_the_scatter_plot_states_its_front_and_the_period_of_the_sensor(room):
    markup = draw_scatter(analyse(room), strokes_of(room))
    assert "no method is both cheaper and more accurate than plane" in markup
    assert "a scan every 100\u00a0ms" in markup
    assert "name part" not in markup
    assert "plane: 0.17 times the error and 0.17 times the CPU time of paper" in markup
    assert markup.count('class="dot tied"') == 5
