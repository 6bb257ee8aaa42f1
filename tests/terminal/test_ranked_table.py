"""The ranked table of a comparison: columns, bars and length, calculated by hand."""

import io
from dataclasses import replace

from rich.console import Console

from evalkit.core.map_start import MapStart
from evalkit.core.pose import Pose
from evalkit.report.analysis.analysis import analyse
from evalkit.terminal.method_names import shorten_address, shorten_names
from evalkit.terminal.ranked_table import MAX_LINES, RankedRow, build_rows, format_rows, print_answer


def make_row(method, value, low=None, high=None, note="", against=""):
    return RankedRow(method, f"{value:g} mm", against, "1.0 ms", note, value, low, high)


def test_a_bar_runs_from_the_lower_to_the_upper_bound_with_a_dot_at_the_value():
    rows = [make_row("a", 2.0, 1.0, 3.0, "best"), make_row("bb", 5.0, 5.0, 5.0)]
    lines = [line.plain for line in format_rows("error, lab", rows, 41)]
    # 41 columns: 2 + "bb" 2 + 2 + "2 mm" 4 + 2 + bar + 2 + "CPU/scan" 8 + 2 + "best" 4, so the bar has 13
    assert lines[0] == "  error, lab               CPU/scan"
    assert lines[1] == "  a   2 mm    ───●──         1.0 ms  best"
    assert lines[2] == "  bb  5 mm              ●    1.0 ms"
    assert all(len(line) <= 41 for line in lines)


def test_values_far_apart_are_on_a_logarithmic_scale():
    rows = [make_row("a", 1.0), make_row("b", 10.0), make_row("c", 100.0)]
    dots = [line.plain.index("●") for line in list(format_rows("", rows, 80))[1:]]
    assert dots[1] - dots[0] in (8, 9)  # the middle of 18 columns
    assert dots[2] - dots[0] == 17


def test_a_narrow_table_has_no_bar_and_equal_values_one_place():
    assert "●" not in "".join(line.plain for line in format_rows("", [make_row("a" * 60, 1.0)], 80))
    assert [line.plain.index("●") for line in list(format_rows("", [make_row("a", 1.0)] * 2, 80))[1:]] == [28, 28]


def test_a_table_is_within_its_width_for_any_name():
    """Of 80 columns, 2 + (4 + 2) + (6 + 2) + (8 + 2) + (4 + 0) are taken, and the name is cut to the rest of 48."""
    rows = [make_row("x" * 30 + "middle" + "y" * 30, 1.0, note="best", against="0.10 x"), make_row("b", 2.0)]
    *_, line, _ = [one.plain for one in format_rows("error, " + "r" * 90, rows, 80)]
    assert line == f"  {'x' * 22}...{'y' * 23}  1 mm  0.10 x    1.0 ms  best"
    for width in (20, 40, 80):
        assert max(len(one.plain) for one in format_rows("error, " + "r" * 90, rows, width)) == width


def test_a_narrow_table_leaves_out_columns_and_cuts_no_number():
    """With 12 of a name, a line takes 2 + 12 + (2 + 4) + (2 + 6) + (2 + 9) + (2 + 8) + (2 + 4) = 55 columns.

    Less 8 against the baseline it is 47, less 11 of the corrected poses 36, less 10 of the CPU time 26.
    """
    row = replace(make_row("wheel-odometry", 1.0, note="tied", against="0.50 x"), corrected="2 mm")
    lines = {width: list(format_rows("", [row], width))[1].plain.split() for width in (55, 47, 36, 30)}
    assert lines[55][1:] == ["1", "mm", "0.50", "x", "2", "mm", "1.0", "ms", "tied"]
    assert lines[47][1:] == ["1", "mm", "2", "mm", "1.0", "ms", "tied"]
    assert lines[36][1:] == ["1", "mm", "1.0", "ms", "tied"]
    assert lines[30] == ["wheel-odometry", "1", "mm", "tied"]


def test_a_narrow_table_cuts_what_follows_the_place_and_no_count():
    """Of 40 columns, 2 + 12 + (2 + 4) + (2 + 16) = 38 are taken; ", cheapest" would take 10 more."""
    rows = [
        make_row("a" * 20, 1.0, note="best or tied 3/3, cheapest"),
        make_row("b" * 20, 2.0, note="best or tied 1/3"),
    ]
    shown = [line.plain for line in format_rows("", rows, 40)][1:]
    assert [line[line.index("best") :] for line in shown] == ["best or tied 3/3", "best or tied 1/3"]


def test_an_address_is_named_by_its_file_unless_two_have_the_same():
    addresses = ("exec:python /opt/my slam/slam.py --fast", "exec:ssh me@board.local ./my_icp", "exec:python slam.py",
                 "lib:../libmine.so epsilon=1", "file:../online.tum?final=../final.tum", "file:run.mcap?topic=/pose",
                 "exec:icp", "tree_icp:SPEC", "paper", "lib:")  # fmt: skip
    assert [shorten_address(one) for one in addresses] == [
        "exec: my", "exec: my_icp", "exec: slam.py", "lib: libmine.so", "file: online.tum", "file: run.mcap",
        "exec: icp", "tree_icp:SPEC", "paper", "lib:",
    ]  # fmt: skip


def test_a_label_that_was_given_and_an_address_whose_file_is_not_its_own_stay_whole(record, build):
    labels = ("exec:a/slam.py", "exec:b/slam.py", "lib:x/icp.so", "exec:given.py")
    runs = [record(name, "room", {"ate_rmse_m": 0.1}) for name in labels]
    runs = [
        replace(one, spec=replace(one.spec, method=replace(one.spec.method, backend=backend)))
        for one, backend in zip(runs, (*labels[:3], "exec:other.py"), strict=True)
    ]
    assert shorten_names(build(runs)) == dict(zip(labels, (*labels[:2], "lib: icp.so", labels[3]), strict=True))


def test_values_that_are_close_are_drawn_close():
    """81 and 103 mm are a quarter apart: from zero, the first is at 79 % of the bar, not at its beginning."""
    dots = [
        line.plain.index("●") for line in list(format_rows("", [make_row("a", 81.0), make_row("b", 103.0)], 80))[1:]
    ]
    assert dots[1] - dots[0] == 4  # of 17 columns


def test_columns_keep_their_headings_below_a_title_that_is_wider_than_the_table():
    rows = [replace(make_row("a", 1.0), corrected="1 mm"), make_row("b", 2.0)]
    title = "distance between the halves of the run, a recording with a long name"
    *over, second, line, _ = [one.plain for one in format_rows(title, rows, 60)]
    assert (" ".join(one.strip() for one in over), second.split()) == (title, ["corrected", "CPU/scan"])
    assert max(map(len, over)) <= 60
    assert (second.index("corrected") + 9, len(second)) == (line.index("1 mm", 20) + 4, line.index("1.0 ms") + 6)


def test_names_that_would_become_equal_are_not_cut():
    names = [f"small-gicp?keyframe_distance_m=0.{n}0&max_iterations=10&local_map_scans=20" for n in (1, 2)]
    lines = [line.plain for line in list(format_rows("", [make_row(name, 1.0) for name in names], 80))[1:]]
    assert [len(line) <= 80 for line in lines] == [True, True]
    assert [name in line for name, line in zip(names, lines, strict=True)] == [True, True]


def test_a_long_ranking_is_cut_to_ten_lines_that_count_the_rest():
    lines = [line.plain for line in format_rows("", [make_row(f"m{n}", float(n)) for n in range(1, 15)], 80)]
    assert len(lines) == MAX_LINES == 10
    assert lines[-1] == "  and 6 more on the page"
    assert len(list(format_rows("", [make_row(f"m{n}", float(n)) for n in range(1, 10)], 80))) == 10


def test_several_data_sets_are_ranked_by_the_mean_ratio_of_errors(record, build):
    errors = {"wheel": 0.5, "paper": 0.1, "plane": 0.05}
    runs = [
        record(name, where, {"ate_rmse_m": error * scale * (1.0 + 0.01 * seed)}, seed=seed)
        for name, error in errors.items()
        for where, scale in (("room", 1.0), ("hall", 3.0))
        for seed in range(4)
    ]
    head, rows = build_rows(analyse(build(runs)))
    assert head == "error by that of paper and wheel, mean over shared data"
    assert [(row.method, round(row.value, 6)) for row in rows] == [("plane", 0.5), ("paper", 1.0), ("wheel", 5.0)]
    assert [row.against for row in rows] == ["0.10 x", "0.20 x", "baseline"]


def test_a_ratio_far_below_one_is_not_zero(record, build):
    runs = [
        record(name, "room", {"ate_rmse_m": error * (1.0 + 0.01 * seed)}, seed=seed)
        for name, error in (("wheel", 0.5), ("plane", 0.0017))
        for seed in range(4)
    ]
    _, rows = build_rows(analyse(build(runs)))
    assert [row.against for row in rows] == ["0.003 x", "baseline"]


def test_one_data_set_that_counts_is_ranked_by_its_own_errors(demo):
    analysis = analyse(demo)
    assert [one.sequence for one in analysis.answer.contests] == ["room"]
    head, rows = build_rows(analysis)
    assert head == "ATE RMSE, room"
    assert rows[0].method == analysis.answer.contests[0].ranked[0].method


def test_the_bar_of_a_recording_is_the_range_of_its_repeated_runs_as_on_the_page(record, build):
    records = []
    for seed, error_m in enumerate((0.104, 0.100, 0.106, 0.103)):
        one = record("icp", "hall", {"ate_rmse_m": error_m}, seed=seed)
        records.append(replace(one, spec=replace(one.spec, sequence=replace(one.spec.sequence, perturbed=True))))
    _, (row,) = build_rows(analyse(build(records)))
    assert (row.low, row.high) == (0.100, 0.106)


def test_the_bar_of_two_runs_is_their_range_as_on_the_page(record, build):
    two = [record("icp", "room", {"ate_rmse_m": error_m}, seed=seed) for seed, error_m in enumerate((0.104, 0.100))]
    _, (row,) = build_rows(analyse(build(two)))
    assert (row.low, row.high) == (0.100, 0.104)


def test_maps_that_rank_in_a_known_map_are_said_to_be_no_place_in_it(record, build):
    """Where the fit to the map has no value, as outside its calibration, the maps drawn are all there is."""
    runs = [record(name, "bag", {"split_distance_m": 0.1}, seed=None, truth=False) for name in ("a", "b")]
    start = MapStart(Pose(), 1, 0.0, True, 0.9)
    in_map = [replace(run, result=replace(run.result, start=start)) for run in runs]
    assert build_rows(analyse(build(runs)))[0] == "halves of the run apart, bag"
    head = build_rows(analyse(build(in_map)))[0]
    assert head == "halves of the run apart, bag (maps alone: not the place in the known map)"


def test_without_a_verdict_the_methods_are_still_listed(record, build):
    """Two methods with the same spread of four runs, and a data set that is not here."""
    runs = [
        record(name, "room", {"ate_rmse_m": error * factor}, seed=seed)
        for name, error in (("a", 0.100), ("b", 0.108))
        for seed, factor in enumerate((0.6, 1.0, 1.4, 1.1))
    ]
    absent = [record(n, "hall", {}, seed=None, status="data-missing", reason="no", answered=0) for n in ("a", "b")]
    analysis = analyse(build([*runs, *absent]))
    head, rows = build_rows(analysis)
    assert (head, [row.method for row in rows]) == ("ATE RMSE, room", ["a", "b"])


def test_the_time_beside_an_error_is_that_of_the_same_data_set(record, build):
    """Two data sets without a verdict: the errors of the first are beside its 5 ms, not the 20 ms of both."""
    runs = [
        record(name, where, {"ate_rmse_m": 0.1, "cpu_median_ms": cpu_ms})
        for name in ("a", "b")
        for where, cpu_ms in (("room", 5.0), ("hall", 35.0))
    ]
    head, rows = build_rows(analyse(build(runs)))
    assert (head, [row.cost for row in rows]) == ("ATE RMSE, room", ["5.0\u00a0ms"] * 2)


def test_every_line_of_the_table_fits_80_columns_and_the_title_is_the_one_of_the_page(demo):
    printed = io.StringIO()
    analysis = analyse(demo)
    print_answer(Console(file=printed, soft_wrap=True), analysis)
    lines = printed.getvalue().splitlines()
    assert lines[0] == analysis.answer.title
    table = lines[lines.index("") + 1 : len(lines) - lines[::-1].index("") - 1]
    assert 2 < len(table) <= MAX_LINES
    assert max(map(len, table)) <= 80


def test_what_the_reader_and_a_method_noted_of_a_recording_is_printed(record, build):
    """Of a log whose time goes back, once for all methods; not the beams without return that every lidar has."""
    notes = {"scans out of order": 1, "odometry out of order": 0, "beams without return": 5, "invalid ranges": 7}
    runs = [record(name, sequence, {"ate_rmse_m": 0.1}) for name in ("a", "b") for sequence in ("back.clf", "room")]
    noted = [
        replace(run, result=replace(run.result, notes=notes if run.sequence == "back.clf" else {})) for run in runs
    ]  # fmt: skip
    printed = io.StringIO()
    noted[0] = replace(noted[0], result=replace(noted[0].result, remarks=("no room for 3 loops: raise loops (1)",)))
    print_answer(Console(file=printed, soft_wrap=True), analyse(build(noted)))
    assert "back.clf: Remark of a: no room for 3 loops: raise loops (1)." in printed.getvalue().splitlines()
    assert [line for line in printed.getvalue().splitlines() if "as read" in line] == [
        "back.clf as read: scans out of order: 1"
    ]
