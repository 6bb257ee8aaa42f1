"""Programs as back ends: a correct one is followed, an incorrect one fails with a reason."""

import gc
import json
import sys
import textwrap
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import psutil
import pytest

from evalkit.config.experiment_file import experiment_from_tables
from evalkit.core.errors import BackendFailed, BackendLate, BadParameter, UnknownName
from evalkit.core.ground_truth import Truth
from evalkit.core.loop_closure import LoopClosure
from evalkit.core.pose import Pose
from evalkit.core.run_result import RunResult
from evalkit.core.scan import Frame, Scan
from evalkit.external import process
from evalkit.external import program as program_module
from evalkit.external.program import Program
from evalkit.metrics import runtime
from evalkit.metrics.metric import Evidence
from evalkit.plugins import registry
from evalkit.results.final_files import CLOSURES, FINAL, PATHS, parse_final, parse_paths

FOLLOWS = """
import json, sys, time
def say(**answer): print(json.dumps(answer), flush=True)
for line in sys.stdin:
    q = json.loads(line)
    if q["ask"] == "hello":
        HELLO
    elif q["ask"] == "create":
        say()
    else:
        x = q["odom_from_base"][0]
        ANSWER
"""
HELLO = 'say(protocol=1, kind="odometry", summary="the wheels, over a pipe", parameters=[])'
ANSWER = "say(pose=[x, 0.0, 0.0], elapsed_ns=5_000_000)"


@pytest.fixture
def program(tmp_path):
    """Write a program that returns the wheel odometry except for the given lines; returns its method name."""

    def write(answer=ANSWER, hello=HELLO):
        path = tmp_path / "program.py"
        text = FOLLOWS
        for word, lines, indent in (("HELLO", hello, 8), ("ANSWER", answer, 8)):
            text = text.replace(" " * indent + word, textwrap.indent(textwrap.dedent(lines).strip(), " " * indent))
        path.write_text(text)
        return f"exec:{sys.executable} -I -S {path}"

    return write


def reason(outcome, status="failed"):
    assert outcome.status == status, outcome
    return outcome.reason


def test_the_device_time_of_a_program_is_reported_with_the_round_trip(program, run_backend):
    outcome, steps = run_backend(program())
    assert outcome.status == "complete"
    assert steps["x"].tolist() == pytest.approx((run_backend.truth[:, 0] + run_backend.drift_m).tolist(), abs=1e-15)
    assert set(steps["device_ns"].tolist()) == {5_000_000}
    assert (steps["wall_ns"] > 0).all()


def test_cpu_time_includes_the_cpu_time_of_the_program(program, run_backend):
    spin = "end = time.process_time() + 0.005\nwhile time.process_time() < end: pass\n" + ANSWER
    _, steps = run_backend(program(spin))
    assert (steps["cpu_ns"] >= 5_000_000).all()


def test_a_named_device_has_device_time_and_no_cpu_time(program, run_backend):
    _, steps = run_backend(program(hello=HELLO.replace("summary=", 'device="a board", summary=')))
    run = RunResult(steps, len(steps))
    scores = {m.name: m.compute(Evidence(run, Truth("none"))) for m in runtime.METRICS}
    assert scores["cpu_median_ms"].reason == "not measured on this machine: no CPU time"
    assert scores["device_median_ms"].value == pytest.approx(5.0)
    assert scores["real_time_factor"].value == pytest.approx(100.0 / 5.0)  # a scan every 100 ms


def test_a_back_end_that_reports_no_device_time_has_none(program, run_backend):
    _, steps = run_backend(program("say(pose=[x, 0.0, 0.0])"))
    run = RunResult(steps, len(steps))
    score = next(m for m in runtime.METRICS if m.name == "device_median_ms").compute(Evidence(run, Truth("none")))
    assert (score.value, score.reason) == (None, "the back end reports no device time")


@pytest.mark.parametrize(
    ("answer", "said"),
    [
        ("hang()", "no answer within 0.5 s"),
        ("hang()", "see where it hangs, flush the output after every line, or set"),
        ("sys.stdout.write('{\"pose\":'); sys.stdout.flush(); hang()", '8 bytes without a newline: {"pose":; end'),
        ("sys.stdout.write('x' * 3_000_000)", "the answer exceeds 1048576 bytes"),
        ("print('Loading map...', flush=True)", "not one line of JSON: Loading map..."),
        ("print('{\"pose\":[nan,0,0]}', flush=True)", "the answer has nan in 'pose': JSON has no such number"),
        ('print(\'{"pose":[0,-inf,0],"n":1}\', flush=True)', "the answer has -inf in 'pose'"),
        ('print(\'{"pose":[1,0,0],"elapsed_ns":0,5}\', flush=True)', "the answer has a decimal comma in 'elapsed_ns'"),
        ("say(poses=[x, 0.0, 0.0])", "the answer has no 'pose', expected three numbers"),
        ('print(\'{"said":"a nan",}\', flush=True)', "not one line of JSON"),
        ("print('{}\\n{}', flush=True)", "not one line of JSON"),
        ("print('[1, 2]', flush=True)", "expected a JSON object"),
        ("sys.stderr.write('no such device: /dev/lidar'); sys.exit(3)", "ended with code 3 instead of answering"),
        ("sys.stderr.write('no such device: /dev/lidar'); sys.exit(3)", "last message: no such device: /dev/lidar"),
        ("import os; os.kill(os.getpid(), 11)", "ended with SIGSEGV"),
        ("sys.stdout.close(); import os; os.close(1); time.sleep(120)", "closed its output without an answer"),
        ("say(pose=[x, float('nan'), 0.0])", "expected finite numbers"),
        ("say(pose=[x, 0.0])", "expected three numbers"),
        ("say(pose=[x, 0.0, 0.0], elapsed_ns='long')", "'elapsed_ns': 'long', expected a number"),
        ("say(pose=[x, 0.0, 0.0], elapsed_ns=-1)", "'elapsed_ns': -1, expected a number from 0"),
        ("say(pose=[10**400, 0.0, 0.0])", "expected finite numbers"),
        ("say(pose=[x, 0.0, 0.0], elapsed_ns=10**400)", "expected a number from 0, less than"),
        ("print('[' * 100_000, flush=True)", "the answer is not one line of JSON"),
        ("print('x' * 5_000_000, flush=True)", "the answer exceeds 1048576 bytes: xxx"),
        ("import os, signal; os.kill(os.getpid(), signal.SIGRTMIN + 5)", "ended with signal 39"),
        ("say(failed='lost the wall')", "reports a failure: lost the wall"),
        ("sys.stderr.write('error 7\\n' * 200_000); hang()", "error 7 | error 7; see where it hangs"),
    ],
)
def test_a_program_with_an_invalid_answer_fails_with_a_reason(
    program, run_backend, monkeypatch, tmp_path, answer, said
):
    """A program that hangs says so in a file: the clock of its limit begins there, however late it gets a core."""
    hangs = tmp_path / "hangs"
    begun = []

    def seconds_since_it_hangs():
        if not begun and hangs.exists():
            begun.append(time.monotonic())
        return time.monotonic() - begun[0] if begun else 0.0

    if "hang()" in answer:
        clock = SimpleNamespace(monotonic=seconds_since_it_hangs, clock_gettime_ns=time.clock_gettime_ns)
        monkeypatch.setattr(program_module, "time", clock)
        answer = answer.replace("hang()", f"open({str(hangs)!r}, 'w').close(); time.sleep(120)")
    if "closed" in said:
        monkeypatch.setattr(program_module, "EXIT_WAIT_S", 0.5)
    outcome, steps = run_backend(program(answer), answer_timeout_s=0.5 if "sleep" in answer else 300.0)
    assert said in reason(outcome)
    assert len(steps) == 0


@pytest.mark.parametrize(("elapsed_s", "cpu_s", "late"), [(0.4, 0.1, False), (0.4, 0.0, True), (1.0, 0.1, True)])
def test_a_program_that_others_keep_from_computing_has_three_times_its_limit(
    program, monkeypatch, tmp_path, elapsed_s, cpu_s, late
):
    """It is asked at 0 s, the clock then stands at ``elapsed_s``, and it answers after some readings of the clock."""
    go, readings = tmp_path / "go", []

    def monotonic():
        readings.append(len(readings))
        if len(readings) > 5:
            go.touch()
        return elapsed_s if len(readings) > 1 else 0.0

    waits = f"import os\nwhile not os.path.exists({str(go)!r}): time.sleep(0.01)\n{ANSWER}"
    follower = registry.backend(program(waits)).make(answer_timeout_s=0.3)
    frame = Frame(Scan(0, np.ones(1), np.zeros(1), 0.1, 9.0), odom_from_base=Pose(2.0))
    monkeypatch.setattr(program_module.Program, "cpu_ns", lambda _: int(1e9 * cpu_s * (len(readings) > 1)))
    monkeypatch.setattr(program_module, "time", SimpleNamespace(monotonic=monotonic))
    if late:
        with pytest.raises(BackendLate, match=r"no answer within 0\.3 s"):
            follower.update(frame)
    else:
        assert follower.update(frame).pose.x == 2.0


def test_a_program_may_flood_its_standard_error_and_still_answer(program, run_backend):
    outcome, steps = run_backend(program("sys.stderr.write('x' * 500_000)\n" + ANSWER))
    assert (outcome.status, len(steps)) == ("complete", len(run_backend.truth))


def test_a_program_ends_with_what_it_has_started(tmp_path, has_ended):
    """The shell starts another program and waits for it: killing the shell alone would leave it."""
    script = tmp_path / "program.sh"
    script.write_text('sleep 900 & echo "{\\"pid\\": $!}"; read question; wait\n')
    session = Program("mine", ["sh", str(script)], 300.0)
    pid = json.loads(session._stdout.readline())["pid"]
    assert psutil.pid_exists(pid)
    del session
    gc.collect()
    assert has_ended(pid)


def test_output_without_a_request_is_detected_before_the_next_answer(program, run_backend):
    outcome, _ = run_backend(program(ANSWER + "\nprint('done', flush=True)"))
    assert "wrote a line without a question" in reason(outcome) or "not one line of JSON" in reason(outcome)


def test_answers_before_the_end_are_kept(program, run_backend):
    outcome, steps = run_backend(program(f"if q['stamp_ns'] > 600_000_000: sys.exit(1)\n{ANSWER}"))
    assert "ended with code 1" in reason(outcome)
    assert len(steps) == 7


@pytest.mark.parametrize(
    ("hello", "said"),
    [
        ("say(protocol=2)", "'protocol': 2, expected 1"),
        ("say(protocol=1, kind='mapper')", "'kind': found 'mapper'"),
        ("say(protocol=1, kind='odometry', parameters=[{'name': 'a b', 'default': 1}])", "'parameters'"),
        ("say(protocol=1, kind='registration', parameters=[{'name': 'keyframes', 'default': 1}])", "unique names"),
        ("say(protocol=1, kind='odometry', parameters=[{'name': 'a', 'default': float('nan')}])", "finite number"),
        ("say(protocol=1, kind=['odometry'])", "'kind': found ['odometry']"),
        ("say(protocol=1, kind='odometry', summary='\\ud800')", "not one line of JSON"),
        ("say(protocol=1, kind='odometry', summary='x' * 3000)", "a text of at most 2000 characters"),
        ("say(protocol=1, kind='odometry', parameters=[{'name': 'a', 'default': 10**400}])", "finite number"),
        ("say(protocol=1, kind='odometry', parameters=[{'name': 'a' * 101, 'default': 1}])", "at most 100 letters"),
        ("say(protocol=1, kind='odometry', parameters=[{'name': 'answer_timeout_s', 'default': 1}])", "unique names"),
        ("say(protocol=1, kind='odometry', parameters=[{'name': 'a', 'default': 1}] * 2)", "unique names"),
        ("say(protocol=1, kind='odometry', parameters=[{'name': f'p{i}'} for i in range(9999)])", "at most 1000"),
        ("print('hello!', flush=True)", "not one line of JSON: hello!"),
        ("time.sleep(120)", "no answer within 0.3 s"),
    ],
)
def test_a_program_without_a_valid_description_has_failed(program, run_backend, monkeypatch, hello, said):
    monkeypatch.setattr(process, "HELLO_S", 0.3 if "sleep" in hello else 300.0)
    outcome, _ = run_backend(program(hello=hello))
    assert said in reason(outcome)
    assert outcome.expected == len(run_backend.truth)  # counted as a program that answered no scan


def test_a_parameter_of_a_program_may_have_any_name(program, run_backend):
    names = ["name", "argv", "declared", "self", "answer", "class", "label"]
    listed = ", ".join(f"{{'name': {name!r}, 'default': 1}}" for name in names)
    method = program(hello=f"say(protocol=1, kind='odometry', parameters=[{listed}])")
    outcome, _ = run_backend(method)
    assert (outcome.status, outcome.reason) == ("complete", "")


def test_a_program_without_a_description_may_have_settings(program):
    name = program(hello="sys.exit(7)")
    content = {"method": [{"use": name, "max_iterations": 3}], "sequence": [{"use": "room"}]}
    (method,) = experiment_from_tables(content, "x.toml", "x", "compare x.toml").methods
    assert method.missing == ""
    assert "ended with code 7 instead of answering" in registry.backend(name).broken


def test_only_a_program_that_does_not_exist_is_unavailable(tmp_path):
    for words in ("./nowhere-to-be-found x", str(tmp_path)):
        spec = registry.backend(f"exec:{words}")
        assert ("no program found" in spec.missing(), spec.broken) == (True, "")


def test_an_invalid_command_line_is_an_error_in_the_experiment():
    for rest, said in (("", "expected exec:PROGRAM"), ("'a", "correct the quotation marks")):
        with pytest.raises(BadParameter, match=said):
            registry.backend(f"exec:{rest}")


@pytest.mark.parametrize("form", ["--token={}", "--token {}", "-password {}", "--my-api-key={}"])
def test_a_secret_is_refused_without_being_shown_and_taken_from_the_environment(tmp_path, monkeypatch, form):
    path = tmp_path / "echo"
    path.write_text('#!/bin/sh\nread question\necho "$*"\n')  # its first line is no description: it is quoted
    path.chmod(0o755)
    with pytest.raises(BadParameter, match=r"found 'a secret.*expected .*\$NAME") as error:
        registry.backend(f"exec:{path} {form.format('hunter2')}")
    assert "hunter2" not in str(error.value)
    with pytest.raises(BadParameter, match="environment variable that is set"):
        registry.backend(f"exec:{path} {form.format('$ABSENT')}")
    monkeypatch.setenv("PRESENT", "hunter2")
    assert "hunter2" in registry.backend(f"exec:{path} {form.format('$PRESENT')}").broken


def test_a_program_for_another_machine_is_reported(tmp_path, foreign_elf):
    path = tmp_path / "icp"
    path.write_bytes(foreign_elf)
    assert "chmod" in registry.backend(f"exec:{path}").broken
    path.chmod(0o755)
    assert "is built for 64-bit RISC-V" in registry.backend(f"exec:{path}").broken


def test_an_unknown_scheme_lists_the_known_ones():
    with pytest.raises(UnknownName, match=r"no scheme named 'execute'.*known: exec, file, lib"):
        registry.backend("execute:./x")


def test_parameters_of_an_experiment_are_passed_to_the_program(program, run_backend):
    listed = '[dict(name="offset_m", default=0.0, unit="m", meaning="added to x"), dict(name="on", default=True)]'
    name = program("say(pose=[x + s['offset_m'] * s['on'], 0.0, 0.0])", HELLO.replace("[]", listed))
    path = Path(name.split()[-1])
    path.write_text(path.read_text().replace("        say()\n", "        s = q['parameters']; say()\n"))
    plan = experiment_from_tables(
        {"method": [{"use": name, "offset_m": 2}], "sequence": [{"use": "room"}]}, "x.toml", "x", "compare x.toml"
    )
    (method,) = plan.methods
    assert (method.label, method.missing) == (name, "")
    assert method.parameters == {"offset_m": 2.0, "on": True, "answer_timeout_s": 10.0}
    _, steps = run_backend(name, **method.parameters)
    assert steps["x"][0] == pytest.approx(2.0)


def test_a_missing_program_with_parameters_has_a_row_with_a_reason():
    content = {"method": [{"use": "exec:./nowhere", "max_iterations": 3}], "sequence": [{"use": "room"}]}
    (method,) = experiment_from_tables(content, "x.toml", "x", "compare x.toml").methods
    assert "no program found" in method.missing


def test_the_cache_key_contains_the_content_of_the_program(program):
    name = program()
    before = registry.hash_run_code(name, "room")
    assert before == registry.hash_run_code(name, "room")
    program(ANSWER + "  # another build")
    assert before != registry.hash_run_code(name, "room")


def test_no_return_is_null_and_invalid_is_nan_in_the_request(program):
    name = program("say(pose=[float([v is None for v in q['ranges']].index(True)), q['ranges'].index('nan'), 0.0])")
    follower = registry.backend(name).make(answer_timeout_s=300.0)
    scan = Scan(0, np.array([1.0, np.inf, np.nan]), np.zeros(3), 0.1, 9.0)
    assert follower.update(Frame(scan, odom_from_base=Pose())).pose.row.tolist() == [1.0, 2.0, 0.0]


def test_a_request_is_one_ascii_line_in_the_order_of_the_protocol(tmp_path):
    heard = tmp_path / "heard"
    script = tmp_path / "echo.py"
    script.write_text(
        "import sys\n"
        f"heard = open({str(heard)!r}, 'wb', buffering=0)\n"
        'answers = [\'{"protocol":1,"kind":"odometry"}\', \'{}\', \'{"pose":[0,0,0]}\']\n'
        "for line, answer in zip(sys.stdin.buffer, answers):\n"
        "    heard.write(line)\n"
        "    print(answer, flush=True)\n"
    )
    follower = registry.backend(f"exec:{sys.executable} -I -S {script}").make(answer_timeout_s=300.0)
    follower.update(Frame(Scan(7, np.array([1.5]), np.array([0.25]), 0.1, 9.0)))
    hello, create, update = heard.read_bytes().splitlines()
    assert hello == b'{"ask":"hello","protocol":1}'
    assert create == b'{"ask":"create","parameters":{}}'
    assert update.startswith(b'{"ask":"update","stamp_ns":7,"time_increment_ns":0,"range_min_m":0.1,"range_max_m":9.0,')
    assert update.endswith(b'"odom_from_base":null,"start_from_end":null,"angles":[0.25],"ranges":[1.5]}')
    assert json.loads(update)["base_from_sensor"] == [0.0, 0.0, 0.0]


SLAM_HELLO = HELLO.replace('"odometry"', '"slam"')
SLAM = """
kept = globals().setdefault("kept", [])
if q["ask"] == "update":
    kept.append([q["stamp_ns"], q["odom_from_base"][0]])
    say(pose=[kept[-1][1] - kept[0][1], 0.0, 0.0], corrected=len(kept) == 3)
elif q["ask"] == "trajectory":
    part = [[x - kept[0][1], 0.01 * (x != kept[0][1]), 0.0] for _, x in kept][q["from"] : q["from"] + q["count"]]
    say(poses=[value for pose in part for value in pose])
else:
    say(loop_closures=[
        {"stamp_ns": kept[k][0], "other_stamp_ns": kept[0][0], "pose": [k, 0, 0], "accepted": k > 20, "reason": "k"}
        for k in range(1, len(kept))
    ][q["from"] : q["from"] + q["count"]])
"""


def slam_program(program, answer=SLAM):
    name = program(answer, SLAM_HELLO)
    path = Path(name.split()[-1])
    path.write_text(path.read_text().replace('x = q["odom_from_base"][0]', "pass"))
    return name


def test_a_program_corrects_its_poses_in_parts(program, run_backend, monkeypatch, tmp_path):
    monkeypatch.setattr(process, "PART", 13)
    outcome, steps = run_backend(slam_program(program))
    assert (outcome.status, outcome.reason) == ("complete", "")
    assert np.flatnonzero(steps["corrected"] == 1).tolist() == [2]
    (folder,) = (path.parent for path in tmp_path.glob(f"*/{FINAL}"))
    files = {name: (folder / name).read_bytes() for name in (FINAL, CLOSURES)}
    final, closures = parse_final(files, steps["stamp_ns"])
    assert final.poses[:, 0] == pytest.approx(steps["x"], abs=1e-12)
    assert final.poses[:, 1].tolist() == [0.0, *[0.01] * 39]
    assert [one.other_from_base.x for one in closures] == list(range(1, 40))
    assert sum(one.accepted for one in closures) == 19
    (path,) = parse_paths((folder / PATHS).read_bytes(), steps["stamp_ns"])
    assert (path.stamp_ns, path.stamps_ns.tolist()) == (steps["stamp_ns"][2], steps["stamp_ns"][:2].tolist())
    assert path.moved_m.tolist() == [0.0, 0.01]


def test_a_program_that_has_no_path_before_the_end_refuses_it_and_completes(program, run_backend, tmp_path):
    early = (
        'elif q["ask"] == "trajectory" and len(kept) < 40:\n    say(failed="not yet")\nelif q["ask"] == "trajectory":'
    )
    outcome, steps = run_backend(slam_program(program, SLAM.replace('elif q["ask"] == "trajectory":', early)))
    assert (outcome.status, len(steps)) == ("complete", 40)
    assert outcome.paths_left_out.startswith("no path after scan 3: BackendRefused: ")
    assert "not yet" in outcome.paths_left_out
    assert not list(tmp_path.glob(f"*/{PATHS}"))


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        (
            "say(poses=[",
            "say(poses=[0.0] + [",
            "'10 numbers (3.333 poses)', expected 9 (3 poses from pose 0 on: one for",
        ),
        ("0.01 * (x", "1e999 * (x", "the answer has 'poses[1]': nan, expected a finite number"),
        ('"accepted": k > 20', '"accepted": 1', "objects with stamp_ns, other_stamp_ns, pose, accepted"),
        ('"stamp_ns": kept[k][0]', '"stamp_ns": -1', "other_stamp_ns: expected a time before -1"),
        (
            '"stamp_ns": kept[k][0]',
            '"stamp_ns": 7',
            "the answer has 'loop_closures[0].stamp_ns': 7, expected the stamp",
        ),
        ("corrected=len(kept) == 3", "corrected=3", "the answer has 'corrected': 3, expected true or false"),
        ('[q["from"] : q["from"] + q["count"]])', "* 40)", "the answer has 'loop_closures': '1560 entries'"),
        ("part = [[x", "import os; os._exit(3)\n    part = [[x", "ended"),
    ],
)
def test_a_program_with_a_wrong_correction_fails_with_a_reason(program, run_backend, old, new, said):
    assert old in SLAM
    outcome, _ = run_backend(slam_program(program, SLAM.replace(old, new)))
    assert said in reason(outcome)


def test_a_program_that_never_stops_to_report_loop_closures_fails(program, run_backend, monkeypatch):
    monkeypatch.setattr(process, "MAX_CLOSURES", 100)
    monkeypatch.setattr(process, "PART", 30)
    endless = SLAM.replace('[q["from"] : q["from"] + q["count"]])', "[:30])")
    outcome, _ = run_backend(slam_program(program, endless))
    assert "the answer has 'loop_closures': 120, expected at most 100 in all" in reason(outcome)


class Answers:
    """A program that has one answer to every question."""

    def __init__(self, **answer):
        self.answer = answer

    def ask(self, _question):
        return self.answer

    def malformed(self, key, found, expected):
        return BackendFailed("a program", f"'{key}': {found}, expected {expected}", "mend it")


def session(program):
    made = object.__new__(process.ProgramSession)
    made.program = program
    return made


CLOSURE = {"stamp_ns": 5, "other_stamp_ns": 3, "pose": [1.0, 2.0, 0.1], "accepted": True, "reason": "near"}


def test_loop_closures_of_a_program_are_read_as_they_are():
    found = session(Answers(loop_closures=[CLOSURE])).ask_closures(0)
    assert found == [LoopClosure(5, 3, Pose(1.0, 2.0, 0.1), True, "near")]


@pytest.mark.parametrize("found_again", [True, False, None])
def test_a_program_says_of_a_closure_whether_it_found_a_lost_track_again(found_again):
    (found,) = session(Answers(loop_closures=[CLOSURE | {"found_again": found_again}])).ask_closures(0)
    assert found.found_again is found_again


@pytest.mark.parametrize(
    ("answer", "said"),
    [
        ({"loop_closures": "none"}, "expected a list"),
        ({"loop_closures": [3]}, "3, expected objects with stamp_ns"),
        ({"loop_closures": [CLOSURE | {"stamp_ns": 2**63}]}, "expected objects with stamp_ns"),
        ({"loop_closures": [CLOSURE | {"other_stamp_ns": 0.5}]}, "expected objects with stamp_ns"),
        ({"loop_closures": [CLOSURE | {"accepted": 1}]}, "expected objects with stamp_ns"),
        ({"loop_closures": [CLOSURE | {"found_again": 1}]}, "'found_again': 1, expected true or false"),
        ({"loop_closures": [CLOSURE] * 100_000}, "100000 entries, expected at most"),
    ],
)
def test_loop_closures_that_cannot_be_are_refused(answer, said):
    with pytest.raises(BackendFailed, match=said):
        session(Answers(**answer)).ask_closures(0)


@pytest.mark.parametrize(
    ("entry", "said"),
    [
        (3, "'trace': 3, expected a list of objects"),
        ({"pairs": [1]}, "expected indices of source and target in turns"),
        ({"pairs": [1, -1]}, "expected indices of source and target in turns"),
        ({"pairs": [1, 2.5]}, "expected indices of source and target in turns"),
    ],
)
def test_a_trace_that_cannot_be_is_refused(entry, said):
    with pytest.raises(BackendFailed, match=said):
        session(Answers())._iteration(entry)
