"""No report states what its runs do not support, and the checker of statements finds planted lies."""

import json
import re
import sys
from dataclasses import replace
from pathlib import Path

import pytest

sys.path.append(str(Path(__file__).parent))

from facts import Facts
from run import TABLES, check_report, read_statements
from statements import check_sentences

from evalkit.config.experiment import SequenceSpec
from evalkit.core.map_start import MapStart
from evalkit.core.pose import Pose
from evalkit.core.run_result import LostTrack, RunConditions
from evalkit.metrics import all_metrics
from evalkit.report.analysis.analysis import analyse
from evalkit.report.html.report_page import render_report
from evalkit.report.results_json import build_results

MAPS = ("split_distance_m", "mom_cm2", "cleared_percent", "s2m_m")
UNREAD = re.compile(r"about \d+|detect a difference of [\d.]+|more than 200|Over \d+ maps.+|S2M|<script>.+?</script>")
"""Numbers that are not recomputed: runs that would settle a difference, and the validation of metrics."""


def _seeds(record, name, values, metric="ate_rmse_m", room="room", **more):
    return [
        record(name, room, {metric: value, "cpu_median_ms": 1.0 + len(name)} | more, seed=seed)
        for seed, value in enumerate(values)
    ]


def _perturbed(records, scans=0):
    """The same runs as perturbations of a recording, or of excerpts of it."""
    return [
        replace(one, spec=replace(one.spec, sequence=SequenceSpec(
            one.sequence, one.sequence, {}, (one.seed,), perturbed=True, excerpt_scans=scans)))
        for one in records
    ]  # fmt: skip


def _remarked(run, *remarks):
    return replace(run, result=replace(run.result, remarks=remarks))


def _disturbed(comparison, *conditions):
    """The same runs, the first ones under these conditions and the others on a quiet machine."""
    runs = comparison.records
    known = (*conditions, *[RunConditions(load=3.0)] * (len(runs) - len(conditions)))
    return replace(comparison, records=tuple(
        replace(run, result=replace(run.result, conditions=own)) for run, own in zip(runs, known, strict=True)
    ))  # fmt: skip


def _lost(records, at_s, found_s=None):
    lost = LostTrack(at_s, "a jump of 4 m", found_s)
    return [replace(one, scores=replace(one.scores, lost=lost)) for one in records]


def _maps(record, **measures):
    scaled = {
        name: [dict(zip(MAPS, (m * (1.0 + 0.01 * seed) for m in own), strict=True)) for seed in range(6)]
        for name, own in measures.items()
    }
    found = [
        record(name, "hall", one, seed=seed, truth=False)
        for name, own in scaled.items()
        for seed, one in enumerate(own)
    ]
    return _perturbed(found)


def _in_map(record, build):
    """Three methods in a known map without truth, of which one only starts there."""
    start = MapStart(Pose(), 1, 0.0, True, 0.9)
    runs = [
        one
        for name, percent in (("a", 2.0), ("b", 9.0), ("slam", 50.0))
        for one in _seeds(record, name, [percent + 0.1 * seed for seed in range(4)], "map_wrong_percent", truth=False)
    ]
    found = build([replace(one, result=replace(one.result, start=start)) for one in runs])
    uses = {"a": "matches", "b": "reads", "slam": "starts there"}
    by_fit = next(metric for metric in all_metrics() if metric.name == "map_wrong_percent")
    found = replace(found, metrics=(*found.metrics, by_fit))
    return replace(found, methods={name: replace(card, map_use=uses[name]) for name, card in found.methods.items()})


def _cases(record, build):
    """Comparisons that bring about each kind of sentence."""

    def pair(a, b, *others, metric="ate_rmse_m", **more):
        return build([*_seeds(record, "a", a, metric, **more), *_seeds(record, "b", b, metric, **more), *others])

    clear = [0.010, 0.011, 0.012], [0.020, 0.022, 0.024]
    wheel = _seeds(record, "wheel", [0.4, 0.41, 0.4])
    winner = pair(*clear, *wheel, *_seeds(record, "paper", [0.9, 0.91, 0.93]))
    yield winner
    yield _disturbed(winner, RunConditions(load=0.2, other_percent=7.1, waited_percent=9.0, busy_threads=2))
    yield _disturbed(winner, RunConditions(steal_percent=2.4), RunConditions(other_percent=40.0, waited_percent=6.0))
    yield pair([0.010, 0.011, 0.025], [0.019, 0.022, 0.024], *_seeds(record, "c", [0.013, 0.3, 0.2]))
    few = {name: (clear[0][0], clear[0][1] * scale) for name, scale in (("a", 1.0), ("b", 4.0), ("c", 40.0))}
    where = (("room", "abc"), ("hall", "abc"), ("cave", "ab"))
    yield build([one for room, own in where for name in own for one in _seeds(record, name, few[name], room=room)])
    yield pair([1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0], [0.5, 1.0, 1.5, 4.2, 4.3, 5.0, 5.8])
    yield pair([1.0, 3.0], [1.15, 2.87])
    far = [0.0117, 0.0118, 0.0119]
    yield pair([0.01] * 3, far)
    yield pair([0.01] * 3, [0.0111] * 3, *_seeds(record, "c", far))
    yield pair([0.0100, 0.0110], [0.0115, 0.01265])
    yield pair([1.0, 1.1], [1.0, 1.1], *_seeds(record, "c", [1.01, 1.1]))
    yield pair([0.0100, 0.0110], [0.0110, 0.01205], *_seeds(record, "c", [0.0113, 0.0124]))
    yield pair([0.051] * 3, [0.058] * 3, metric="relations_mean_m")
    yield pair([0.05, 0.04], [0.09, 0.3], metric="relations_mean_m")
    yield pair([0.90, 0.92, 0.91], [0.70, 0.72, 0.73], metric="map_f1")
    yield pair([0.05], [0.08], *_seeds(record, "paper", [0.02]))
    yield pair([0.05, 0.06], [None, 0.08])
    stopped = record("a", "room", {}, status="interrupted", reason="no space left on device", answered=9, seed=3)
    yield pair(*clear, stopped)
    yield pair(*clear, guess_kept_percent=60.0)
    yield build(
        [
            _remarked(one, "no room for 7 voxels: raise voxels (256).", "no room for 2 loops: raise loops (1)")
            if one.seed
            else one
            for one in _seeds(record, "a", clear[0])
        ]
        + [_remarked(record("b", "room", {"ate_rmse_m": 0.2}), "no odometry in 3 scans")]
    )
    yield build([*_lost(_seeds(record, "a", [1.0, 2.0, 2.1]), 12.0), *_seeds(record, "b", [1.0, 1.2, 1.1])])
    yield build(_lost([*_seeds(record, "a", [1.0, 2.0, 2.1]), *_seeds(record, "b", [1.0, 1.2, 1.1])], 7.0))
    cards = {"room": replace(winner.sequences["room"], degenerate="A corridor without ends.")}
    yield replace(winner, sequences=cards)
    yield _simulated(winner, "room")
    apart = {"a": clear[0], "b": [4.0 * one for one in clear[0]], "c": [40.0 * one for one in clear[0]]}
    rooms = build(
        [one for room in ("room", "hall") for name in apart for one in _seeds(record, name, apart[name], room=room)]
    )
    tuned_there = {"a": replace(rooms.methods["a"], tuned_on=("hall",))}
    yield _simulated(replace(rooms, methods={**rooms.methods, **tuned_there}), "room")
    both = build([*winner.records, *(one for name in "ab" for one in _seeds(record, name, [0.1, 0.2], room="hall"))])
    both = replace(both, sequences={**both.sequences, **cards})
    yield replace(both, methods={name: replace(card, tuned_on=("hall",)) for name, card in both.methods.items()})
    doubtful = {"room": replace(winner.sequences["room"], warnings=("warning: heading 0.5 deg, but the scans show 9",))}
    yield replace(winner, sequences=doubtful)
    yield replace(winner, methods={**winner.methods, "a": replace(winner.methods["a"], tuned_on=("room",))})
    runs = [
        record(name, where, {"ate_rmse_m": error * (1.0 + 0.01 * seed)}, seed=seed)
        for name, error in (("a", 0.1), ("b", 0.2), ("c", 0.3)) for where in ("room", "hall") for seed in range(3)
    ]  # fmt: skip
    three, chosen = build(runs), {"a": ("room",), "b": ("hall",), "c": ("room", "hall")}
    yield replace(three, methods={name: replace(card, tuned_on=chosen[name]) for name, card in three.methods.items()})
    places = {"room": "abc", "hall": "abc", "cave": "abc", "yard": "abc", "lab": "bc"}  # a: two do not count
    limited = build([
        record(name, where, {"ate_rmse_m": error * (1.0 + 0.01 * seed)}, seed=seed)
        for where, own in places.items() for name, error in (("a", 0.1), ("b", 0.2), ("c", 0.3)) if name in own
        for seed in range(2)
    ])  # fmt: skip
    yield replace(limited, methods={**limited.methods, "a": replace(limited.methods["a"], tuned_on=("yard",))})
    alone = {"lab": {"a": 0.01}, "hall": {"b": 0.01}}
    either = {"room": {"a": 0.01, "b": 0.02}, "attic": {"a": 0.02, "b": 0.01}}
    for more in (
        {**either, "yard": {"a": 0.02, "b": 0.02, "c": 0.01}},
        {"room": either["room"], "yard": {"a": 0.01, "b": 0.01}, "cave": {"b": 0.01}},
    ):
        yield build([
            one for where, own in {**alone, **more}.items() for name, error in {**own, "d": 0.1}.items()
            for one in _seeds(record, name, [error, 1.1 * error], room=where, cpu_median_ms=1.0 + "abcd".index(name))
        ])  # fmt: skip
    held = [one for one in three.records if (one.method, one.sequence) == ("a", "room")]
    yield build([*_lost([one for one in three.records if one.sequence == "room" and one.method != "a"], 5.0), *held,
                 *(one for one in three.records if one.sequence == "hall")])  # fmt: skip
    twice = 2 * clear[0], 2 * clear[1]  # perturbations of a recording need six runs for a verdict
    yield build(_perturbed([*_seeds(record, "a", twice[0]), *_seeds(record, "b", twice[1])], scans=400))
    yield build(_perturbed([*_seeds(record, "a", clear[0]), *_seeds(record, "b", clear[1])], scans=400))
    whole = [one for name in "ab" for one in (record(name, "hall", {"ate_rmse_m": 0.1}, seed=s) for s in (None, 1, 2))]
    yield build(_perturbed(whole))
    partly = _perturbed(_seeds(record, "a", clear[0]))
    yield build([*_lost(partly[:1], 5.0, 31.0), *partly[1:], *_perturbed(_seeds(record, "b", clear[1]))])
    yield build([
        *_lost(_seeds(record, "a", clear[0])[:2], 5.0, 31.0), *_seeds(record, "a", clear[0])[2:],
        *(one for name in "bc" for one in _seeds(record, name, clear[1])),
    ])  # fmt: skip
    lost = [one for name in "abc" for one in _lost(_seeds(record, name, clear[0]), 12.0)]
    flat = build([*lost, *_lost(_seeds(record, "d", clear[0], room="corridor"), 5.0)])
    corridor = replace(flat.sequences["corridor"], degenerate="A corridor without ends.")
    yield replace(flat, sequences={**flat.sequences, "corridor": corridor})
    yield build(_maps(record, a=(0.1, 20.0, 5.0, 0.02), b=(0.2, 60.0, 9.0, 0.05), wheel=(0.4, 90.0, 20.0, 0.09)))
    tied = {"a": (0.1, 20.0, 5.0, 0.02), "c": (0.1004, 20.0, 5.0, 0.02), "b": (0.1002, 20.0, 5.0, 0.06)}
    yield build(_maps(record, **tied))
    yield _in_map(record, build)
    yield build(_maps(record, a=(0.1, 90.0, 5.0, 0.02), b=(0.2, 60.0, 9.0, 0.05)))
    rooms = [_seeds(record, name, own, room=room) for room, scale in (("room", 1.0), ("yard", 2.0), ("hall", 0.5))
             for name, own in (("a", [scale * v for v in clear[0]]), ("b", [v / scale for v in clear[1]]))]  # fmt: skip
    yield build([one for own in rooms for one in own])
    yield build([*_rivals(record), *_lost(_seeds(record, "a", [0.1, 0.11, 0.12], room="hall"), 5.0)])
    tied = [one for name in ("a", "b") for one in _seeds(record, name, [0.1, 0.11], room="flat")]
    yield build([*_rivals(record), *tied])
    short = build([
        one for name in "ab" for one in _seeds(record, name, [0.05, 0.06, 0.05], "relations_all_mean_m",
                                               relations_short_mean_m=0.04)
    ])  # fmt: skip
    table = {metric.name: metric for metric in all_metrics()}
    names = ("relations_all_mean_m", "relations_short_mean_m", "cpu_median_ms")
    yield replace(short, metrics=tuple(table[name] for name in names))


def _simulated(comparison, *labels):
    """The comparison where the sequences with these labels are simulated."""
    cards = {label: replace(card, simulated=label in labels) for label, card in comparison.sequences.items()}
    return replace(comparison, sequences=cards)


def _rivals(record):
    """``a`` is best on the two data sets where ``b`` did not run; on the other ``b`` is better, by less than 2 mm."""
    errors = {
        "room": {"a": 0.006, "b": 0.005, "c": 0.03},
        "lab": {"a": 0.01, "c": 0.02},
        "yard": {"a": 0.01, "c": 0.02},
    }
    return [
        one for room, own in errors.items() for name, error in own.items()
        for one in _seeds(record, name, [error * (1.0 + 0.01 * seed) for seed in range(8)], room=room)
    ]  # fmt: skip


def _content(comparison):
    return json.loads(json.dumps(build_results(analyse(comparison))))


@pytest.fixture(scope="module")
def contents(record, build, demo):
    return [_content(demo), *map(_content, _cases(record, build))]


def test_every_statement_of_many_reports_is_true_and_every_kind_occurs(contents):
    seen = set()
    faults = [fault for content in contents for fault in check_report(content, seen=seen)]
    assert faults == []
    rare = {
        "no_headline", "none_ranked", "no_leader", "processors", "no_baseline", "damaged", "take_one",
        "cost_of_each", "without_baseline",
    }  # fmt: skip
    assert {check.__name__ for table in TABLES for _, check in table} - seen - rare == set()


@pytest.fixture(scope="module")
def rendered(demo):
    analysis = analyse(demo)
    return build_results(analysis), render_report(analysis)


def test_every_cell_of_a_page_is_the_median_of_its_runs(rendered):
    assert list(check_report(*rendered)) == []


def test_a_changed_cell_is_found(rendered):
    content, page = rendered
    changed = page.replace("11\u00a0mm", "13\u00a0mm")
    assert any("printed 13 mm, recomputed 0.011" in fault for fault in check_report(content, changed))


def test_every_changed_number_in_any_sentence_is_found(contents):
    """A checker that accepts any number would prove nothing."""
    missed = []
    for content in contents:
        facts = Facts(content)
        for table, text, where in read_statements(content):
            for match in re.finditer(r"\d[\d.]*\d|\d", text):
                if any(one.start() <= match.start() < one.end() for one in UNREAD.finditer(text)):
                    continue
                changed = f"{text[: match.start()]}{_change(match[0])}{text[match.end() :]}"
                if not any(check_sentences(facts, table, changed, *where)):
                    missed.append((text, match[0]))
    assert missed == []


def _change(number):
    return f"{3.0 * float(number) + 7.0:.{len(number.partition('.')[2])}f}"


def test_every_kind_of_sentence_is_refused_where_it_is_not_true(contents):
    """A sentence is moved to other reports until one refuses it; texts of several kinds prove nothing of each."""
    everywhere = [Facts(content) for content in contents]
    refused, seen = set(), set()
    for own, content in zip(everywhere, contents, strict=True):
        for table, text, place in read_statements(content):
            kinds = set()
            list(check_sentences(own, table, text, *place, seen=kinds))
            if len(kinds) == 1 and not kinds <= refused:
                seen |= kinds
                places = ((facts, [where]) for facts in everywhere for where in (facts.runs if place else [None]))
                if any(_is_refused(facts, table, text, where if place else []) for facts, where in places):
                    refused |= kinds
    assert seen - refused == {"speed"}  # the made-up runs have no score of lateness to recompute it from
    assert len(refused) > 30


def _is_refused(facts, table, text, where):
    try:
        return any(check_sentences(facts, table, text, *where))
    except (KeyError, IndexError, ValueError, RuntimeError):
        return True  # it names what is not there
