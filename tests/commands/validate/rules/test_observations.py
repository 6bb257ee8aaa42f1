"""What a rule observes in a fixture written by hand: each fault is named, and what cannot be observed is not judged."""

import itertools
import math
import subprocess
import sys
import time
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import psutil
import pytest

from evalkit.commands.validate.rules import (
    dataset_rules,
    elsewhere,
    endurance,
    odometry_rules,
    odometry_state_rules,
    process_state,
    range_rules,
    registration_rules,
    resource_rules,
    state_rules,
)
from evalkit.commands.validate.rules.endurance import LEAK_BYTES, ResourceUse
from evalkit.commands.validate.rules.odometry_fixture import last_pose
from evalkit.commands.validate.rules.rule import RuleBroken, RuleNotApplicable, RuleNotJudged, check_rule
from evalkit.core.errors import BackendEnded, BackendRefused, BadData
from evalkit.core.ground_truth import Truth
from evalkit.core.match import Match
from evalkit.core.odometry_estimate import OdometryEstimate
from evalkit.core.pose import Pose
from evalkit.core.trajectory import Trajectory
from evalkit.plugins.protocols import NoAnswer

STEADY = np.full(endurance.BATCHES, 5e3)
STATE = {"rounding": 1, "open files": 3, "threads": 1}


def measured(**changes):
    flat = ResourceUse(50, np.zeros(endurance.BATCHES + 1), STEADY, 0.0, STATE, STATE, LEAK_BYTES, 0.0)
    return SimpleNamespace(endurance=replace(flat, **changes), runs_in="evalkit")


def test_resources_that_grow_are_named_with_their_amount():
    calls = 50 * endurance.BATCHES
    growing = np.linspace(0.0, 1000.0 * calls, endurance.BATCHES + 1)
    with pytest.raises(RuleBroken, match=f"grows by 1000 bytes with each question, in {calls} calls"):
        resource_rules.check_memory(measured(heap=growing))
    with pytest.raises(RuleBroken, match=f"each instance leaves {2 * LEAK_BYTES:.0f} bytes behind"):
        resource_rules.check_memory(measured(instances=2.0 * LEAK_BYTES))
    rising, rising_again = (
        np.linspace(5e3, 50e3, endurance.BATCHES),
        np.linspace(60e3, 150e3, endurance.BATCHES),
    )
    with pytest.raises(RuleBroken, match=f"5 us at first, 150 us after {3 * calls} calls: every call costs more"):
        resource_rules.check_slowdown(measured(call_ns=rising, call_again_ns=rising_again))
    with pytest.raises(RuleBroken, match="threads: 1 before, 2 after the calls"):
        resource_rules.check_threads(measured(after=STATE | {"threads": 2}))
    with pytest.raises(RuleBroken, match=f"{calls} calls write 1000000 bytes to files"):
        resource_rules.check_files(measured(filed=1e6))
    assert (
        resource_rules.check_memory(measured()) == f"{calls} calls and {endurance.INSTANCES} instances leave "
        "nothing behind"
    )


def growing_with(cost, rest_us=0.0):
    """Times (ns) of batches of 50 calls, and of 100 in a second measurement: a rest, and what grows with the calls."""
    first, again = 75.0 + 50.0 * np.arange(endurance.BATCHES), 600.0 + 100.0 * np.arange(endurance.BATCHES)
    noise = 1.0 + 0.02 * np.random.default_rng(1).uniform(-1.0, 1.0, (2, endurance.BATCHES))
    return 1e3 * (rest_us + cost(np.stack([first, again]))) * noise


@pytest.mark.parametrize(
    ("cost", "rest_us"),
    [
        (lambda calls: 0.1 * calls, 5.0),  # a list is searched
        (lambda calls: 0.1 * calls, 100.0),
        (np.sqrt, 0.0),
        (lambda calls: 10.0 * 2.0 ** np.floor(np.log2(calls)) / 64.0, 1.0),  # a table that doubles its size is cleared
        (lambda calls: 20.0 * np.floor(calls / 200.0), 20.0),  # a file of a log is full
    ],
    ids=["linear", "linear-beside-much-else", "root", "doubling", "steps"],
)
def test_calls_that_become_slower_in_both_measurements_are_found(cost, rest_us):
    taken_ns, again_ns = growing_with(cost, rest_us)
    with pytest.raises(RuleBroken, match="every call costs more than the one before"):
        resource_rules.check_slowdown(measured(call_ns=taken_ns, call_again_ns=again_ns))


RAMP = np.linspace(67e3, 103e3, endurance.BATCHES)
"""Times (ns) of calls while other programs slow the machine down."""


@pytest.mark.parametrize(
    "again_ns",
    [
        np.full(endurance.BATCHES, 103e3), RAMP[::-1], RAMP, np.full(endurance.BATCHES, 67e3),
        103e3 + 8e3 * np.sin(np.arange(endurance.BATCHES)),
        np.append(np.full(endurance.BATCHES - 1, 103e3), 180e3), np.zeros(0),
    ],
    ids=["stays slow", "recovers", "becomes slow again", "is quick again", "varies", "one slow moment", "not measured"],
)  # fmt: skip
def test_a_machine_that_becomes_slow_once_is_no_fault_of_the_calls(again_ns):
    observed = resource_rules.check_slowdown(measured(call_ns=RAMP, call_again_ns=again_ns))
    assert observed.startswith("a call takes 67 us at first, ")
    steady_ns = np.linspace(67e3, 68e3, endurance.BATCHES)  # measured again because of its memory
    observed = resource_rules.check_slowdown(measured(call_ns=steady_ns, call_again_ns=again_ns))
    assert observed.startswith("a call takes 67 us at first, ")


@pytest.mark.parametrize(("leaves", "found"), [(lambda number: number == 15, 0.0), (lambda number: number > 0, 300e3)])
def test_what_one_instance_leaves_in_a_cache_is_no_leak_of_every_instance(leaves, found):
    kept, made = [], itertools.count(1)

    def make():
        if leaves(next(made)):
            kept.append(bytearray(300_000))

    def make_nothing(): ...

    clock = itertools.count()
    left = endurance._measure_instances(make, lambda _: make_nothing, lambda: float(next(clock)), 1.0)
    assert left == pytest.approx(found, rel=0.1)


def test_calls_are_measured_a_second_time_only_where_they_seem_to_become_slower(monkeypatch):
    """A clock that counts: a steady call takes 100 us, one that searches a list 10 us more than the one before."""
    now_ns = length = 0

    def steady():
        nonlocal now_ns
        now_ns += 100_000

    def growing():
        nonlocal now_ns, length
        length += 1
        now_ns += 100_000 + 10_000 * length

    monkeypatch.setattr(endurance, "INSTANCES", 20)
    monkeypatch.setattr(endurance, "BUDGET_S", 0.0)  # the fewest calls
    monkeypatch.setattr(endurance, "_work", steady)
    clock = SimpleNamespace(
        thread_time_ns=lambda: now_ns,
        perf_counter_ns=time.perf_counter_ns,
        process_time=time.process_time,
        clock_gettime_ns=lambda _: 0,
    )
    monkeypatch.setattr(endurance, "time", clock)
    use = endurance.measure_resource_use(object, lambda _: steady, process_state.StateWatch())
    assert (use.calls, use.call_again_ns.tolist()) == (40, [])
    assert set(use.call_ns) == {1e5}
    use = endurance.measure_resource_use(object, lambda _: growing, process_state.StateWatch())
    assert (use.calls, len(use.call_again_ns)) == (120, endurance.BATCHES)
    with pytest.raises(RuleBroken, match="every call costs more than the one before"):
        resource_rules.check_slowdown(SimpleNamespace(endurance=use, runs_in="evalkit"))


def test_resources_that_are_not_known_here_are_not_judged():
    with pytest.raises(RuleNotApplicable, match="bytes that it writes"):
        resource_rules.check_files(measured(filed=math.nan))
    with pytest.raises(RuleNotApplicable, match="floating-point controls"):
        resource_rules.check_floating_point(measured(after=STATE | {"rounding": 0}))


def test_an_exception_in_another_thread_is_raised_in_this_one():
    with pytest.raises(ZeroDivisionError):
        elsewhere.in_another_thread(lambda: 1 // 0)
    assert elsewhere.in_another_thread(lambda: 7) == 7


def answering(answers, copies=0):
    return lambda *_: {"answers": answers, "copies": copies}


def test_answers_of_another_process_and_of_its_copies_are_compared(monkeypatch):
    own = SimpleNamespace(elsewhere={"address": {}}, first_answers=[(0.0, 1.0, 2.0, True)])
    monkeypatch.setattr(state_rules, "run_elsewhere", answering([[0.0, 1.0, 2.0, True]]))
    assert state_rules.check_process(own) == "1 answers in another process are the same to the bit"
    monkeypatch.setattr(state_rules, "run_elsewhere", answering([[0.0, 1.0, 2.5, True]]))
    with pytest.raises(RuleBroken, match=r"another answer in another process: theta 2\.5, before 2\.0"):
        state_rules.check_process(own)
    monkeypatch.setattr(state_rules, "run_elsewhere", answering([["raises ValueError"]]))
    with pytest.raises(RuleBroken, match=r"another outcome in another process: raises ValueError, before 0\.0"):
        state_rules.check_process(own)
    monkeypatch.setattr(state_rules, "run_elsewhere", answering([[0.0, 1.0, 2.0, True]], copies=2))
    with pytest.raises(RuleBroken, match=f"2 of {elsewhere.FORKS} copies of a process, with other numbers"):
        state_rules.check_process(own)
    monkeypatch.setattr(odometry_state_rules, "run_elsewhere", answering([[0.0, 1.0, 2.0]], copies=3))
    driven = SimpleNamespace(elsewhere={"address": {}}, first_answers=np.array([[0.0, 1.0, 2.0]]))
    with pytest.raises(RuleBroken, match=f"3 of {elsewhere.FORKS} copies of a process"):
        odometry_state_rules.check_process(driven)
    driven.first_answers = driven.first_answers + 1.0
    with pytest.raises(RuleBroken, match="in another process scan 1 has another answer"):
        odometry_state_rules.check_process(driven)
    with pytest.raises(RuleNotApplicable, match="no address"):
        odometry_state_rules.check_process(SimpleNamespace(elsewhere={}))


def test_a_process_that_ends_early_breaks_the_rule(monkeypatch):
    monkeypatch.setattr(elsewhere.sandbox, "run", lambda *_: {elsewhere.sandbox.ENDED: "killed by signal 11"})
    with pytest.raises(RuleBroken, match="in another process with other values in fresh memory: killed by signal 11"):
        elsewhere.run_elsewhere(dict, {})


def test_a_cloud_larger_than_the_guarded_memory_is_refused():
    with state_rules.shared_memory() as region:
        many = SimpleNamespace(points=np.zeros((region.PAGES * 4096, 2)))
        with pytest.raises(ValueError, match=f"region: {many.points.nbytes} bytes do not fit into"):
            region.cloud(many)


class Driven:
    """A fixture of odometry rules whose drives end as a function says."""

    def __init__(self, run):
        self.run = run
        self.seed = 0
        self.runs_in = "evalkit"

    def make(self):
        def update(frame):
            (row,) = self.run([frame])
            if np.isnan(row).any():
                raise NoAnswer("nothing")
            return OdometryEstimate(Pose.of(row))

        return SimpleNamespace(update=update)

    def _drive(self):
        return odometry_rules.drive(3)

    @property
    def short(self):
        return self._drive()

    @property
    def first_answers(self):
        return np.zeros((3, 3))


def raising(error):
    def run(_frames):
        raise error

    return run


def test_the_time_of_a_call_is_also_that_of_the_program_that_it_asks(monkeypatch):
    """Each call takes a program 1 us more than the one before, and this process 100 us."""
    now_ns, spent_ns, calls = 0, 0, itertools.count()

    def call():
        nonlocal now_ns, spent_ns
        now_ns += 100_000
        spent_ns += 1000 * next(calls)

    def steady():
        nonlocal now_ns
        now_ns += 100_000

    clock = SimpleNamespace(
        thread_time_ns=lambda: now_ns, perf_counter_ns=time.perf_counter_ns, clock_gettime_ns=lambda _: spent_ns
    )
    monkeypatch.setattr(endurance, "time", clock)
    monkeypatch.setattr(endurance, "_work", steady)
    monkeypatch.setattr(endurance, "_child_clocks", lambda: [7])
    monkeypatch.setattr(endurance, "_heap_bytes", float)  # not measured here: it looks at every process of the machine
    _, taken_ns, _ = endurance._run_batches(call, 1, 1e5)
    assert taken_ns == pytest.approx(100_000 + 1000 * np.arange(endurance.BATCHES), rel=1e-12)


def test_the_processes_of_the_system_are_inspected_only_after_one_was_started(monkeypatch):
    searches, starts, search = [], [1000], psutil.Process.children

    def children(self, **options):
        searches.append(options)
        return search(self, **options)

    monkeypatch.setattr(psutil.Process, "children", children)
    monkeypatch.setattr(endurance, "count_starts", lambda: starts[0])
    endurance._find_children.cache_clear()
    before = set(endurance._children())
    with subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE) as program:
        starts[0] += 1
        found = [set(endurance._children()) - before for _ in range(5)]
        program.stdin.close()
        program.wait()
        assert [{one.pid for one in each} for each in found] == [{program.pid}] * 5
    assert not set(endurance._children()) - before  # it has ended
    assert len(searches) == 2
    starts[0] = None  # not known: it is looked each time
    assert not {one for _ in range(3) for one in endurance._children()} - before
    assert len(searches) == 5


def test_the_slowest_call_is_named(monkeypatch):
    monkeypatch.setattr(endurance, "_heap_bytes", float)
    calls = iter(range(1000))

    def call():
        time.sleep(0.05 if next(calls) == 7 else 0.0)

    *_, slowest_ns = endurance._run_batches(call, 2, 1e4)
    assert slowest_ns >= 5e7
    use = ResourceUse(4, np.zeros(11), np.full(10, 1e4), 0.0, {}, {}, slowest_ns=3e8)
    observed = resource_rules.check_slowdown(SimpleNamespace(endurance=use, runs_in="evalkit"))
    assert observed.endswith("us after 40 calls; the slowest took 300 ms, waiting included")


def test_the_first_beam_is_not_judged_where_the_first_answer_is_wrong():
    def run(frames):
        return np.tile([0.05, 0.0, 0.0], (len(frames), 1))

    with pytest.raises(RuleNotJudged, match="the first answer is not the identity, see the rule first"):
        odometry_rules.check_first_beam(Driven(run))


def test_an_odometry_without_answers_or_that_writes_to_its_scans_is_named():
    silent = Driven(lambda frames: np.full((len(frames), 3), math.nan))
    with pytest.raises(RuleBroken, match="no answer to any of 8 scans"):
        odometry_rules.check_starts(silent)
    with pytest.raises(RuleBroken, match="no answer to any of the last 7 scans"):
        odometry_rules.check_first_beam(silent)
    with pytest.raises(RuleBroken, match=r"it writes to a scan \(assignment destination is read-only\): use a copy"):
        odometry_rules.check_read_only(Driven(raising(ValueError("assignment destination is read-only"))))
    with pytest.raises(ValueError, match="another"):
        odometry_rules.check_read_only(Driven(raising(ValueError("another"))))

    def change(frames):
        for frame in frames:
            frame.scan.ranges.flags.writeable = True
            frame.scan.ranges[0] = 1.0

    with pytest.raises(RuleBroken, match="a scan changed in the call"):
        odometry_rules.check_read_only(Driven(change))


def test_a_scan_of_many_beams_is_asked_for_also_where_one_of_a_single_beam_is_refused():
    truth = odometry_rules.drive(6).truth

    def run(frames):
        for frame in frames:
            beams = len(frame.scan.ranges)
            if beams == 1:
                raise BackendRefused("ours", "it refuses a scan of 1 beam", "send more")
            if beams > odometry_rules.BEAMS and len(steps) == 3:
                raise BackendEnded("ours", "it was killed by signal 11", "mend it")
        return truth

    driven, steps = Driven(run), []
    driven.note_progress = steps.append
    with pytest.raises(BackendEnded, match="killed by signal 11"):
        odometry_rules.check_values(driven)
    assert steps == ["a scan of 1 beams", "a scan of 20160 beams", "a scan of 20160 beams"]


def test_an_odometry_that_refuses_scans_with_holes_breaks_a_rule_that_says_so():
    refused = BackendRefused("ours", "it refuses nan", "fill the holes")
    result = check_rule(odometry_rules.RULES["values"], Driven(raising(refused)))
    assert (result.outcome, result.observed) == ("failed", f"raises BackendRefused: {refused}")
    assert result.sentence.startswith("It tracks scans with nan and inf among the ranges; ")


def test_answers_that_depend_on_the_time_of_the_first_stamp_are_named():
    def late(frames):
        return np.full((len(frames), 3), 1e-3 * (1 + (frames[0].scan.stamp_ns > 2**31)))

    with pytest.raises(RuleBroken, match=r"from 1700000000123456789 ns on, answers differ by up to 0\.002"):
        odometry_rules.check_stamps(Driven(late))
    with pytest.raises(RuleBroken, match="with stamps from 1700000000123456789 ns on: raises BadData"):
        odometry_rules.check_stamps(Driven(raising(BadData("a scan", "", "is too late", "ask earlier"))))


@pytest.mark.parametrize(
    ("answer", "said"),
    [
        (Pose(), "returns a Pose, expected an evalkit.Match"),
        (Match(Pose(), 1, 1, 0.0, 3), "converged is 1, expected True or False"),
        (Match(Pose(), True, -1, 0.0, 3), "iterations -1, inliers 3, error 0.0: expected none below 0"),
    ],
)
def test_an_answer_with_values_of_another_type_or_range_is_named(answer, said):
    with pytest.raises(RuleBroken, match=said):
        range_rules.validate_match(answer)


def registering(answer):
    """A fixture of a registration with one answer, to which the pair it is asked is given."""
    return SimpleNamespace(
        register=lambda pair: answer(pair.target, pair.source, pair.guess).target_from_source,
        shared=SimpleNamespace(register=answer), note_progress=lambda: None, runs_in="evalkit",
    )  # fmt: skip


def match(pose, inliers=20):
    return Match(pose, True, 3, 0.01, inliers)


def test_a_guess_that_is_made_worse_and_a_distant_answer_beside_a_wall_are_named():
    worse = registering(lambda _target, _source, guess: match(guess @ Pose(0.5, 0.0, 0.0)))
    with pytest.raises(RuleBroken, match=r"cm at 4 m, .* cm remained"):
        registration_rules.check_moves(worse)
    far = registering(lambda _target, _source, guess: match(guess @ Pose(2.0, 0.0, 0.0)))
    with pytest.raises(RuleBroken, match="beside a single wall the answer is far off"):
        registration_rules.check_wall(far)

    def refuse(*_):
        raise ValueError("a wall alone")

    assert registration_rules.check_wall(registering(refuse)) == "raises ValueError: a wall alone"

    def wrong_type(*_):
        return None

    with pytest.raises(RuleBroken, match="returns a NoneType"):
        registration_rules.check_wall(registering(wrong_type))
    with pytest.raises(RuleBroken, match="writes to the points of a cloud"):
        registration_rules.check_read_only(registering(raising_any(ValueError("array is not writeable"))))
    with pytest.raises(ValueError, match="a wall alone"):
        registration_rules.check_read_only(registering(refuse))


def raising_any(error):
    def answer(*_):
        raise error

    return answer


def test_another_answer_to_the_same_points_in_another_order_is_named():
    counts = iter((100, 97))
    other = registering(lambda *_: match(Pose(), next(counts)))
    pair = registration_rules.clear_pair()
    with pytest.raises(RuleBroken, match=r"in another order: .* by 97 pairs instead of .* by 100"):
        range_rules._require_same(other, pair, pair, "points in another order")


def dataset(frames=None, truth=None, count=3):
    frames = odometry_rules.drive(3).frames if frames is None else frames
    sequence = SimpleNamespace(truth=lambda: truth, frames=lambda: iter(frames))
    return SimpleNamespace(frames=frames, sequence=sequence, count=count)


def test_a_data_set_with_other_types_than_it_declares_is_named():
    with pytest.raises(RuleBroken, match=r"frames\(\) yields a dict"):
        dataset_rules.check_opens(dataset(({},)))
    scans = [SimpleNamespace(scan=SimpleNamespace(stamp_ns=stamp)) for stamp in (1, 2.5)]
    with pytest.raises(RuleBroken, match=r"a stamp is 2\.5, expected whole nanoseconds"):
        dataset_rules.check_stamps(dataset(scans))
    with pytest.raises(RuleBroken, match=r"truth\(\) returns a NoneType"):
        dataset_rules.check_truth(dataset())
    with pytest.raises(RuleBroken, match=r"truth\(\)\.how is empty"):
        dataset_rules.check_truth(dataset(truth=Truth("")))
    assert dataset_rules.check_truth(dataset(truth=Truth("a tape"))) == "no trajectory; a tape"
    late = Trajectory(np.array([10**12, 2 * 10**12]), np.zeros((2, 3)))
    with pytest.raises(RuleBroken, match="the true trajectory covers 0 % of the frames"):
        dataset_rules.check_truth(dataset(truth=Truth("a tape", late)))
    reject = type("Rejects", (), {"sequence": property(raising_any(TypeError("laps")))})()
    with pytest.raises(RuleBroken, match=r"make\(\) rejects its declared parameters: laps"):
        dataset_rules.check_parameters(reject)


def test_a_drive_without_a_last_answer_has_no_last_pose():
    with pytest.raises(RuleBroken, match="it has no answer to the last scan"):
        last_pose(np.array([[0.0, 0.0, 0.0], [math.nan] * 3]))
