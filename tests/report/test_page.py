"""The page: complete, self-contained, and with all data escaped."""

import io
import re
from dataclasses import replace
from html.parser import HTMLParser
from importlib.resources import files

import numpy as np
import pytest
from PIL import Image, ImageColor

from evalkit.config.experiment import Method, RunSpec, SequenceSpec
from evalkit.core.grid import OccupancyGrid
from evalkit.core.run_result import LostTrack, Score
from evalkit.metrics import all_metrics
from evalkit.metrics.validated import load_validation
from evalkit.report import MethodCard, SequenceCard, write_report
from evalkit.report.analysis.analysis import analyse
from evalkit.report.formatting import format_number
from evalkit.report.html.appendix import _build_metrics
from evalkit.report.html.maps import MapWindow, compute_greys, find_window, render_map
from evalkit.report.html.method_colours import assign_strokes
from evalkit.report.html.report_page import draw_maps, render_report
from evalkit.report.html.report_tables import by_rank, failure_texts, headline_table


def load(sheet):
    return files("evalkit.report.html").joinpath(f"templates/{sheet}.css").read_text(encoding="utf-8")


class Tags(HTMLParser):
    """Parser that collects (tag, attributes) and checks that every element is closed."""

    VOID = ("meta", "img", "br", "link", "input")

    def __init__(self):
        super().__init__()
        self.found, self.open, self.text = [], [], ""

    def handle_starttag(self, tag, attrs):
        self.found.append((tag, dict(attrs)))
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.found.append((tag, dict(attrs)))

    def handle_endtag(self, tag):
        assert self.open.pop() == tag
        self.text += " " if tag in ("td", "th", "dt", "span") else ""

    def handle_data(self, data):
        self.text += data


@pytest.fixture(scope="module")
def html(demo, tmp_path_factory):
    return write_report(demo, tmp_path_factory.mktemp("report")).read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def tags(html):
    parser = Tags()
    parser.feed(html)
    parser.close()
    return parser


def test_every_opened_tag_is_closed(tags):
    assert tags.open == []


def test_names_with_scripts_are_escaped(tags, html):
    assert "<script>alert" not in html
    assert "<script>alert(1)</script>" in tags.text
    assert sum(tag == "script" for tag, _ in tags.found) == 1


HIDDEN = "\x00\x1b[31m\x85\u202e\uffff"
EVIL = (
    HIDDEN
    + "</script><!--<script>alert(1)//--></style>\u2028\"'><img src=x onerror=alert(1)>{{7*7}}javascript:alert(1)"
)


def test_data_is_escaped_in_every_place(build, record, tmp_path):
    made = record(EVIL, EVIL, {"ate_rmse_m": 0.1, "cpu_median_ms": 1.0}, status="failed", reason=EVIL, answered=30)
    made = replace(
        made, result=replace(made.result, notes={EVIL: 3}), truth=replace(made.truth, how=EVIL),
        scores=replace(made.scores, alignment=EVIL), command=EVIL,
        spec=RunSpec("key", Method(EVIL, EVIL, {EVIL: EVIL}), SequenceSpec(EVIL, EVIL, {EVIL: EVIL}, (0,)), 0),
    )  # fmt: skip
    card = MethodCard(EVIL, EVIL, EVIL, (), EVIL, missing=EVIL)
    sequence = SequenceCard(EVIL, EVIL, EVIL, EVIL, EVIL, defects=(EVIL,))
    comparison = build(
        [made], title=EVIL, description=EVIL, environment={EVIL: EVIL}, methods={EVIL: card},
        sequences={EVIL: sequence}, command=EVIL, mapper=EVIL, fairness=(EVIL,),
    )  # fmt: skip
    html = write_report(comparison, tmp_path).read_text(encoding="utf-8")
    parser = Tags()
    parser.feed(html)
    parser.close()
    assert parser.open == []
    assert sum(tag == "script" for tag, _ in parser.found) == 1
    assert not [tag for tag, attributes in parser.found if "onerror" in attributes or attributes.get("src") == "x"]
    assert not [tag for tag, attributes in parser.found if attributes.get("href", "").startswith("javascript:")]
    script = html[html.index("<script") : html.rindex("</script>")]
    assert "</script" not in script
    assert "<!--" not in script
    assert "49javascript" not in html
    assert not set(html) & set(HIDDEN.replace("[31m", ""))
    assert r"\u202e\uffff&lt;/script&gt;" in html


def test_nothing_is_loaded_from_elsewhere(tags):
    for tag, attributes in tags.found:
        for name in ("src", "srcset", "data", "action", "poster", "background"):
            assert attributes.get(name, "data:").startswith("data:"), tag
        assert tag not in ("iframe", "object", "embed")
        if tag == "link":  # waits for a part of this page
            assert (attributes["rel"], attributes["href"][0]) == ("expect", "#")
        assert "@import" not in attributes.get("style", "")
        if attributes.get("href", "").startswith("http"):
            assert tag == "a"


def test_the_content_policy_forbids_loading(tags):
    policies = [a["content"] for tag, a in tags.found if a.get("http-equiv") == "Content-Security-Policy"]
    assert policies[0].startswith("default-src 'none'")


def test_links_within_the_page_have_targets(tags):
    anchors = [attributes["id"] for _, attributes in tags.found if "id" in attributes]
    assert len(anchors) == len(set(anchors))
    targets = {a["href"][1:].partition("?")[0] for _, a in tags.found if a.get("href", "").startswith("#")}
    assert targets <= set(anchors)


def test_runs_of_a_recording_that_did_not_complete_are_named_as_perturbations(record):
    def make(seed, **how):
        sequence = SequenceSpec("cave", "cave", {}, (None, 1, 2), perturbed=True)
        made = record("a", "cave", {}, seed=seed, **how)
        return replace(made, spec=replace(made.spec, sequence=sequence))

    late = {"status": "timeout", "reason": "900 s passed", "answered": 45}
    crashed = {"status": "crashed", "reason": "signal 11", "answered": 0}
    assert failure_texts([make(None, **late), make(1, **late), make(2, **crashed)]) == [
        "a timed out without perturbation and perturbation 1 after 45 of 60 scans: 900 s passed",
        "a crashed perturbation 2: signal 11",
    ]


def test_every_run_has_its_command_and_its_files(tags, demo):
    links = {attributes.get("href") for _, attributes in tags.found}
    for record in demo.records:
        assert record.command in tags.text
        file = f"trajectories/{record.key}.tum".replace("(", "%28").replace(")", "%29")
        assert (file in links) == (len(record.result.steps) > 0)


def test_every_number_links_to_its_runs(tags, demo):
    links = [a["href"] for tag, a in tags.found if tag == "a" and "-runs-" in a.get("href", "")]
    assert {"#sequence-1-runs-1", "#sequence-2-runs-1"} <= set(links)
    rows = [a["id"] for tag, a in tags.found if tag == "tr" and "-runs-" in a.get("id", "")]
    pairs = {(record.method, record.sequence) for record in demo.records}
    assert len(rows) == len(pairs)
    assert {href[1:] for href in links} <= set(rows)


def test_rows_and_not_cells_are_tab_stops(tags):
    stops = [a for tag, a in tags.found if tag == "a" and "-runs-" in a.get("href", "") and "tabindex" not in a]
    cells = [a for tag, a in tags.found if tag == "a" and "-runs-" in a.get("href", "") and a.get("tabindex") == "-1"]
    assert len(stops) == 11  # one per row: six methods on room, four on fr079, one on intel
    assert len(cells) > 3 * len(stops)


def test_failed_runs_are_counted_and_shown_with_their_reason(tags):
    text = " ".join(tags.text.split())
    assert "1 of 3" in text
    for said in (
        "crashed seed 1 after 31 of 60 scans: signal 11 (segmentation fault)",
        "timed out seed 2 after 45 of 60 scans: 900 s passed",
        "not installed seeds 0, 1, 2: no module named 'absent'; pip install absent",
        "data missing intel: no such folder; run: evalkit data get intel",
        "failed no odometry was recorded",
    ):
        assert said in text


def test_arrows_point_to_the_better_direction(html):
    heading = {
        name: re.search(rf"{name}.*?</th>", html[html.index("<table") :], re.DOTALL)[0]
        for name in ("ATE RMSE", "Map F1")
    }
    assert "↓" in heading["ATE RMSE"]
    assert "↑" in heading["Map F1"]


def test_a_score_without_a_value_is_a_dash_with_its_reason(tags):
    reasons = {a["title"] for tag, a in tags.found if tag == "td" and "title" in a}
    assert "failed: no odometry was recorded" in reasons
    assert "not installed: no module named 'absent'; pip install absent" in reasons


def test_metrics_without_any_value_are_listed_with_the_reason(tags):
    text = " ".join(tags.text.split())
    assert "Not shown, because no method has a value: relation error, mean (no relations_mean_m here)." in text


def headings(table):
    return [column.label for column in table.headings()]


def table_of(comparison, label):
    analysis = analyse(comparison)
    sequence = next(one for one in analysis.sequences if one.label == label)
    return headline_table(analysis, sequence, 1, {})


def test_only_methods_that_completed_every_run_can_be_best(demo):
    table = table_of(demo, "room")
    rows = table.cells()
    best = {name: [row[0].text for row in rows if row[at].tone == "good"] for at, name in enumerate(headings(table))}
    assert best["ATE RMSE"] == ["plane"]
    assert best["Map F1 at 10 cm"] == ["plane"]
    assert best["CPU time per scan, median"] == ["paper"]


def test_methods_are_in_the_order_of_their_ranks(demo):
    names = [row[0].text for row in table_of(demo, "room").cells()]
    assert names == ["plane", "paper", "wheel", "lost", "<script>alert(1)</script>", "absent"]
    assert names == by_rank(analyse(demo).sequences[0])


def test_the_deciding_metrics_and_the_costs_come_first(demo):
    names = [headings(table_of(demo, label)) for label in ("room", "fr079")]
    assert names[0][2:4] == ["ATE RMSE", "CPU time per scan, median"]
    assert names[1][1:3] == ["Relation error, mean", "CPU time per scan, median"]


def test_single_complete_runs_have_no_column_of_counts(record, build):
    once = [record(name, "room", {"ate_rmse_m": 0.1}, seed=None) for name in "ab"]
    assert headings(table_of(build(once), "room")) == ["Method", "ATE RMSE"]
    twice = [record(name, "room", {"ate_rmse_m": 0.1}, seed=seed) for name in "ab" for seed in (0, 1)]
    assert headings(table_of(build(twice), "room")) == ["Method", "Runs complete", "ATE RMSE"]


def test_with_a_true_map_consistency_is_not_in_the_first_table(record, build):
    def shown(truth):
        runs = [record(who, "room", {"map_f1": 0.9, "split_distance_m": 0.1}, truth=truth) for who in "ab"]
        return headings(table_of(build(runs), "room"))[1:]

    assert shown(True) == ["Map F1 at 10 cm"]
    assert shown(False) == ["Map F1 at 10 cm", "Halves of the run apart"]


def test_the_driven_path_is_shown_with_the_description_of_the_data_set(tags):
    text = " ".join(tags.text.split())
    assert "The data set A sequence called room." in text
    assert "Scans answered 31 of 60 to 60 of 60, by run" in text


def test_methods_worse_than_the_baseline_are_marked(demo):
    rows = table_of(demo, "room").cells()
    assert [row[0].text for row in rows if ("worse than the baseline", "warn") in row[0].chips] == ["lost"]


def test_published_results_are_sorted_among_the_measured_ones(tags):
    text = " ".join(tags.text.split())
    table = text[text.index("Comparison with published results") :]
    places = [table.index(f"{name} {value}") for name, value in (("plane", "51 mm"), ("graph mapping", "56 mm"))]
    assert places == sorted(places)
    assert table.index("scan matching 258 mm") < table.index("paper reference 270 mm")


@pytest.mark.parametrize(
    ("percent", "excerpt", "said"),
    [
        (5.4, 400, "the runs are of excerpts of 400 scans with 5.4 % of its relations."),
        (60.0, 0, "the runs are of a part of it with 60 % of its relations."),
        (97.0, 0, ""),
        (97.0, 400, ""),
    ],
)
def test_a_part_of_a_recording_is_not_compared_with_published_results(demo, percent, excerpt, said):
    covered = "relations_answered_percent"
    runs = [
        replace(
            run,
            scores=replace(run.scores, by_metric={**run.scores.by_metric, covered: Score(percent, 100)}),
            spec=replace(run.spec, sequence=replace(run.spec.sequence, excerpt_scans=excerpt)),
        )
        for run in demo.records
    ]
    metric = next(one for one in all_metrics() if one.name == covered)
    text = render_report(analyse(replace(demo, records=tuple(runs), metrics=(*demo.metrics, metric))))
    assert ("Comparison with published results" in text) == (not said)
    assert ("Not compared with published results, which are of the whole" in text) == bool(said)
    assert said in text


@pytest.mark.parametrize(
    ("seeds", "perturbed", "shown"),
    [
        ((0,), False, "the single run of each method"),
        ((None,), False, "the single run of each method"),
        ((2, 3), False, "seed 2 only"),
        ((None, 1, 2), True, "the run without perturbation only"),
        ((1, 2), True, "perturbation 1 only"),
    ],
)
def test_figures_say_which_of_the_runs_they_show(record, build, seeds, perturbed, shown):
    runs = [record(name, "room", {"ate_rmse_m": 0.1}, seed=seed) for name in "ab" for seed in seeds]
    own = [
        replace(one, spec=replace(one.spec, sequence=replace(one.spec.sequence, perturbed=perturbed))) for one in runs
    ]
    text = render_report(analyse(build(own)))
    assert f"Figures show {shown}." in text


def test_counted_data_defects_are_printed(tags):
    assert "2 scans out of order" in " ".join(tags.text.split())


def test_walls_are_black_at_their_position_in_a_map():
    log_odds = np.full((40, 80), -4.0, dtype=np.float32)
    log_odds[5, 10] = 4.0
    observed = np.ones((40, 80), dtype=bool)
    observed[:, 70:] = False
    grid = OccupancyGrid(log_odds, observed, 0.1, -1.0, 2.0)
    shown = MapWindow(-1.0, 7.0, 2.0, 6.0)
    levels = compute_greys(grid, shown)
    rows, columns = np.nonzero(levels == 0)
    metres = 8.0 / levels.shape[1]
    assert -1.0 + (columns.mean() + 0.5) * metres == pytest.approx(0.05, abs=0.02)
    assert 6.0 - (rows.mean() + 0.5) * metres == pytest.approx(2.55, abs=0.02)
    assert levels[0, 0] == 15
    assert levels[0, -1] == 12
    read = np.asarray(Image.open(io.BytesIO(render_map(grid, shown))))
    assert np.array_equal(read, levels * 17)


def test_a_diverged_map_does_not_shrink_the_others():
    def room(size):
        cells = np.ones((size, size), dtype=bool)
        return OccupancyGrid(np.zeros((size, size)), cells, 1.0, 0.0, 0.0)

    assert find_window([room(10), room(11), room(500)]) == MapWindow(0.0, 11.0, 0.0, 11.0)
    assert find_window([]) is None


def test_maps_of_lost_runs_do_not_shrink_the_others(record, build):
    """A map of 18 m is below twice the size of one of 10 m: only the loss keeps it from setting the window."""

    def run(name, size, lost=None):
        made = record(name, "room", {"ate_rmse_m": 0.1})
        grid = OccupancyGrid(np.zeros((size, size)), np.ones((size, size), dtype=bool), 1.0, 0.0, 0.0)
        return replace(made, truth=replace(made.truth, grid=None), scores=replace(made.scores, grid=grid, lost=lost))

    def shown(*runs):
        comparison = build(runs)
        sequence = analyse(comparison).sequences[0]
        text = render_report(analyse(comparison))
        return draw_maps(comparison, sequence, assign_strokes("ab")).window.size_m, "may be cut" in text

    turned = LostTrack(5.0, "a jump")
    assert shown(run("a", 10), run("b", 18, turned)) == ((10.0, 10.0), True)
    assert shown(run("a", 10), run("b", 18)) == ((18.0, 18.0), False)
    assert shown(run("a", 10, turned), run("b", 18, turned)) == ((18.0, 18.0), True)


def luminance(colour):
    parts = [one / 12.92 if one <= 0.04045 else ((one + 0.055) / 1.055) ** 2.4 for one in colour]
    return float(np.dot(parts, (0.2126, 0.7152, 0.0722)))


def contrast(*colours):
    low, high = sorted(map(luminance, colours))
    return (high + 0.05) / (low + 0.05)


def test_a_name_in_the_colour_of_its_method_can_be_read():
    """WCAG 2.2 asks for 4.5 to 1; names have the hue of their line, mixed with that of the text."""
    share = 0.01 * float(
        re.search(r"--own-ink: color-mix\(in srgb, var\(--own, var\(--ink\)\) (\d+)%", load("report"))[1]
    )
    dark, light = (dict(re.findall(r"--([\w-]+): (#[0-9a-f]{6})", part)) for part in load("page").split(":root {")[:2])
    assert contrast((0, 0, 0), (1, 1, 1)) == pytest.approx(21.0)
    assert light["ink"] != dark["ink"]
    for colours in (light, dark):
        rgb = {name: np.array(ImageColor.getrgb(colour)) / 255 for name, colour in colours.items()}
        for hue in (*(f"hue-{number}" for number in range(5)), "grey"):
            text = share * rgb[hue] + (1.0 - share) * rgb["ink"]
            assert min(contrast(text, rgb["ground"]), contrast(text, rgb["paper"])) >= 4.5


def test_the_table_of_all_metrics_does_not_repeat_the_loss_in_every_row(record, build):
    made = [record(name, "room", {"ate_rmse_m": 0.1, "drift_percent": 1.0}) for name in "ab"]
    lost = replace(made[1], scores=replace(made[1].scores, lost=LostTrack(5.0, "a jump")))
    text = render_report(analyse(build([made[0], lost])))
    table = text[text.index('aria-label="All metrics on room') :]
    assert "lost at" not in table[: table.index("</table>")]
    assert "lost at 5 s" in text


def test_a_group_without_a_headline_metric_has_no_more_metrics_than_those():
    closures = [metric for metric in all_metrics() if metric.group == "loop closures"]
    assert not any(metric.headline for metric in closures)
    assert _build_metrics(closures)[-1].title == f"{len(closures)} metrics"


def test_the_heading_of_a_sequence_names_the_tied_methods(record, build):
    runs = [record(name, "room", {"ate_rmse_m": 0.1}, seed=seed) for name in "ab" for seed in range(3)]
    assert "tied: a and b" in render_report(analyse(build(runs)))


@pytest.mark.parametrize(("others", "detectable"), [([1.15, 2.87], "over 20.00\u00a0m"), ([1.0, 3.03], "1.00\u00a0m")])
def test_runs_that_do_not_even_detect_ten_times_the_value_say_so(record, build, others, detectable):
    """Log-ratios with standard errors 0.092 and 0.005; two runs detect 82 of them: factors of 1,800 and 1.5."""
    values = {"a": [1.0, 3.0], "b": others}
    runs = [
        record(name, "room", {"ate_rmse_m": error}, seed=seed)
        for name, own in values.items()
        for seed, error in enumerate(own)
    ]
    assert f">{detectable}</td>" in render_report(analyse(build(runs)))


def test_nine_methods_have_nine_line_styles():
    chosen = assign_strokes([f"c{i}" for i in range(9)], ["c0"])
    assert len(set(chosen.values())) == 9


def test_a_method_keeps_its_colour_in_every_report_where_no_other_has_it():
    few, many = assign_strokes(["plane", "kiss-icp"]), assign_strokes(["kiss-icp", "plane", "ndt", "pl-icp"])
    assert {name: many[name] for name in few} == few
    assert assign_strokes(["kiss-icp", "plane"]) == few


def test_methods_of_one_report_differ_in_colour_and_where_colours_run_out_in_mark():
    """The first two have the same colour by their names."""
    five = assign_strokes(["kiss-icp", "paper-map-line", "a", "b", "c"])
    assert len({stroke.colour for stroke in five.values()}) == 5
    nine = assign_strokes([f"c{i}" for i in range(9)])
    assert len({(stroke.colour, stroke.mark) for stroke in nine.values()}) == 9


def test_the_rank_agreement_of_map_metrics_is_shown_with_them(html):
    shown = html[html.index('id="rank-agreement"') : html.index('id="metric-map_entropy"')]
    assert "evalkit.commands.metric_validation validate" in shown
    validation = load_validation()
    for name in ("map_entropy", "wall_thickness_m", "split_distance_m", "corners"):
        assert f'href="#metric-{name}"' in shown
        assert format_number(validation.agreement_of(name).overall.value, 2) in shown
    assert all(world in shown for world in validation.worlds)


def test_the_first_picture_comes_after_few_words(html, record_property):
    answer = html[html.index('id="answer"') :]
    before = re.sub(r"<[^>]+>", " ", answer[: answer.index("<img")]).split()
    record_property("words before the first picture", len(before))
    assert len(before) <= 150


def test_every_image_has_its_size(tags):
    images = [a for tag, a in tags.found if tag == "img" and "src" in a]
    assert images
    assert all(int(a["width"]) > 0 and int(a["height"]) > 0 for a in images)
