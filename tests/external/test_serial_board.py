"""Firmware on a serial line: the answers of the core to the bit, over a line that loses and damages bytes."""

import importlib.machinery
import importlib.util
import io
import math
import os
import random
import re
import select
import shutil
import subprocess
import sys
import threading
from argparse import Namespace
from dataclasses import replace
from itertools import islice, product
from pathlib import Path

import numpy as np
import pytest

from evalkit.core.pose import Pose
from evalkit.core.scan import Cloud
from evalkit.external import process, serial_board, serial_line, shared_device
from evalkit.external.serial_board import Board, Bridge, parse_default, parse_hello
from evalkit.external.serial_line import BUSY, FIRST, LAST, NO_SESSION, BoardRefused, LineError, Link
from evalkit.odometry import frontend
from evalkit.plugins import registry
from evalkit_baselines.embedded import compiled, registration

CORE = Path(compiled.__file__).parent
CC = shutil.which("cc") or ""
EMULATOR, CROSS = shutil.which("qemu-system-arm") or "", shutil.which("arm-none-eabi-gcc") or ""

pty = pytest.importorskip("pty")
needs_firmware = pytest.mark.skipif(
    not CC or bool(compiled.compiled_missing()), reason="no C compiler, or the core's modules are not built"
)
PARAMETERS = {"max_iterations": 40, "min_pairs": 3, "epsilon": 1e-4, "max_correspondence_m": 0.3, "one_to_one": True}


FLAGS = ["-std=c99", "-O1", "-ffp-contract=off", "-DBOARD_POINTS=256u", f"-I{CORE / 'include'}"]
TRAPS = ["-fsanitize=float-cast-overflow", "-fsanitize-undefined-trap-on-error"]


@pytest.fixture(scope="module")
def make_firmware(tmp_path_factory):
    """Return what links the example firmware, with compiler options, as a program that traps undefined conversions."""
    folder = tmp_path_factory.mktemp("firmware")
    sources = [*(CORE / "src").glob("*.c"), CORE / "board" / "link.c", CORE / "board" / "message.c"]
    subprocess.run([CC, *FLAGS, "-c", *map(str, sources)], cwd=folder, check=True)

    def make(name, *options, port=CORE / "board" / "host.c"):
        parts = [CORE / "board" / "firmware.c", port, *folder.glob("*.o"), "-lm", "-o", folder / name]
        subprocess.run([CC, *FLAGS, *TRAPS, *options, *map(str, parts)], check=True)
        return folder / name

    return make


@pytest.fixture(scope="module")
def firmware(make_firmware):
    return make_firmware("firmware")


class StandIn:
    """A board behind a pseudo-terminal: every byte is damaged, lost or followed by noise with a probability."""

    def __init__(self, program, harm=0.0):
        self._program, self._harm, self._random = program, harm, random.Random(0)
        self._host, device = pty.openpty()
        self.path = os.ttyname(device)
        self.line = serial_line.open_device(self.path, 115200)
        os.close(device)
        self._stop = threading.Event()
        self.harmed = 0
        self._start()

    def _start(self):
        self._board = subprocess.Popen([self._program], stdin=subprocess.PIPE, stdout=subprocess.PIPE, bufsize=0)
        assert self._board.stdin is not None
        assert self._board.stdout is not None
        self._pipes = self._board.stdin, self._board.stdout
        self._thread = threading.Thread(target=self._pump, daemon=True)
        self._thread.start()

    def restart(self):
        self._end()
        self._start()

    def _end(self):
        self._board.terminate()
        self._board.wait()
        self._thread.join()
        for pipe in self._pipes:
            pipe.close()

    def _pump(self):
        ways = {self._host: self._pipes[0].fileno(), self._pipes[1].fileno(): self._host}
        while self._board.poll() is None:
            for readable in select.select(list(ways), [], [], 0.02)[0]:
                content = os.read(readable, 512)
                if not content:
                    return
                os.write(ways[readable], self._damage(content))

    def _damage(self, content):
        damaged = bytearray()
        for byte in content:
            chance = self._random.random()
            self.harmed += chance < self._harm
            if chance < self._harm / 3:
                continue
            damaged.append(byte ^ (1 << self._random.randrange(8)) if chance < 2 * self._harm / 3 else byte)
            if 2 * self._harm / 3 <= chance < self._harm:
                damaged += self._random.randbytes(3)
        return bytes(damaged)

    def close(self):
        self._end()
        self.line.close()
        os.close(self._host)


@pytest.fixture
def stand_in(firmware):
    """Make a board with the given probability of harm per byte."""
    made = []

    def make(harm=0.0):
        made.append(StandIn(firmware, harm))
        return made[-1]

    yield make
    for one in made:
        one.close()


def frames(count, every=4, world="lab", **changed):
    spec = registry.dataset(world)
    sequence = spec.make(**{p.name: p.default for p in spec.parameters} | {"laps": 0.05, "seed": 5} | changed)
    for frame in islice(sequence.frames(), count):
        scan = replace(frame.scan, ranges=frame.scan.ranges[::every], angles=frame.scan.angles[::every])
        yield replace(frame, scan=replace(scan, time_increment_ns=every * scan.time_increment_ns))


def question(frame):
    scan = frame.scan
    ranges = [None if np.isinf(one) else "nan" if np.isnan(one) else one for one in scan.ranges.tolist()]
    return {
        "ask": "update", "stamp_ns": scan.stamp_ns, "time_increment_ns": scan.time_increment_ns,
        "range_min_m": scan.range_min_m, "range_max_m": scan.range_max_m,
        "base_from_sensor": frame.base_from_sensor.row.tolist(), "odom_from_base": frame.odom_from_base.row.tolist(),
        "start_from_end": frame.start_from_end.row.tolist(), "angles": scan.angles.tolist(), "ranges": ranges,
    }  # fmt: skip


def poses_of_the_core(scans):
    spec = registry.backend("embedded-pipeline")
    odometry = frontend.make_odometry(spec, frontend.complete_parameters("embedded-pipeline", spec, PARAMETERS))
    return [odometry.update(frame).pose.row.tolist() for frame in scans]


@needs_firmware
@pytest.mark.parametrize("harm", [0.0, 3e-4])
def test_poses_equal_those_of_the_core_to_the_bit_also_over_a_damaged_line(stand_in, harm):
    line, scans = stand_in(harm), list(frames(15))
    link = Link(line.line, timeout_s=0.05, tries=6000)
    board = Board(link, "o", "stand-in")
    board.answer({"ask": "create", "parameters": PARAMETERS})
    found = [Pose.of(board.answer(question(frame))["pose"]).row.tolist() for frame in scans]
    assert found == poses_of_the_core(scans)
    assert (line.harmed > 10 and link.repeats > 5) if harm else line.harmed == 0


def in_words(reason):
    return re.sub(r"[0-9.]+", "#", reason)


@needs_firmware
def test_a_slam_on_the_board_gives_the_corrections_and_loops_of_the_core_to_the_bit(stand_in):
    scans = list(frames(None, every=8, world="loop", laps=1.3, speed_mps=0.8, rate_hz=5.0, seed=1))
    board = Board(Link(stand_in().line, timeout_s=5.0, tries=60), "s", "stand-in")
    board.answer({"ask": "create", "parameters": {"work": 200_000}})
    online = [board.answer(question(frame)) for frame in scans]
    spec = registry.backend("embedded-slam")
    memory = {
        "beams": 256, "keyframes": 300, "keyframe_points": 60_000, "loops": 16, "voxels": 4096, "map_points": 4096,
        "loop_points": 8192, "score_cells": 65_536,
    }  # fmt: skip
    slam = spec.make(**{p.name: p.default for p in spec.parameters} | memory)
    estimates = [slam.update(frame) for frame in scans]
    assert [Pose.of(one["pose"]).row.tolist() for one in online] == [one.pose.row.tolist() for one in estimates]
    assert [one["corrected"] for one in online] == [one.corrected for one in estimates]
    poses = board.answer({"ask": "trajectory", "from": 0, "count": len(scans)})["poses"]
    assert poses == slam.trajectory().poses.ravel().tolist()
    assert board.answer({"ask": "trajectory", "from": 30, "count": 2})["poses"] == poses[90:96]
    loops = board.answer({"ask": "loop_closures", "from": 0, "count": 1000})["loop_closures"]
    told = [(one["stamp_ns"], one["other_stamp_ns"], Pose.of(one["pose"]), one["accepted"]) for one in loops]
    assert told == [
        (one.stamp_ns, one.other_stamp_ns, one.other_from_base, one.accepted) for one in slam.loop_closures()
    ]
    assert sum(one["accepted"] for one in loops) >= 2
    assert [in_words(one["reason"]) for one in loops] == [in_words(one.reason) for one in slam.loop_closures()]


@needs_firmware
def test_the_command_registers_as_the_core_does(firmware, tmp_path):
    name = f"exec:{sys.executable} -m evalkit.external.serial_board --command {firmware}"
    rng = np.random.default_rng(1)
    target = Cloud(rng.uniform(-3.0, 3.0, (300, 2)))
    source = Cloud(Pose(0.05, -0.03, 0.02).transform(target.points[:120]))
    expected = registration.CompiledIcp(
        "double", **{p.name: p.default for p in registration.PARAMETERS} | PARAMETERS
    ).register(target, source, Pose(0.01, 0.0, 0.0))
    spec = registry.backend(name)
    made = spec.make(**PARAMETERS, answer_timeout_s=300.0)
    found = made.register(target, source, Pose(0.01, 0.0, 0.0))
    assert (found.target_from_source, found.iterations, found.inliers, found.error) == (
        expected.target_from_source, expected.iterations, expected.inliers, expected.error,
    )  # fmt: skip
    nothing = made.register(Cloud(np.zeros((0, 2))), source, Pose(0.5, 0.0, 0.0))
    assert nothing.target_from_source == Pose(0.5, 0.0, 0.0)
    assert not nothing.converged


@needs_firmware
def test_a_guess_that_is_not_finite_is_refused_also_without_points(stand_in):
    board = Board(Link(stand_in().line, timeout_s=0.2, tries=1500), "r", "stand-in")
    board.answer({"ask": "create", "parameters": PARAMETERS})
    with pytest.raises(LineError, match="a number that must be finite is nan"):
        board.answer({"ask": "register", "guess": [math.nan, 0.0, 0.0], "source": [], "target": []})


@needs_firmware
def test_a_board_that_restarts_is_an_error_and_noise_before_the_session_is_not(stand_in):
    line = stand_in()
    line.line.write(b"\x07noise" * 500)
    link = Link(line.line, timeout_s=0.2, tries=1500)
    board = Board(link, "o", "stand-in")
    board.answer({"ask": "create", "parameters": PARAMETERS})
    line.restart()
    with pytest.raises(LineError, match="has started again and lost its state"):
        board.answer(question(next(frames(1))))


@pytest.fixture
def make_bridge(stand_in, monkeypatch, tmp_path):
    """Return what makes another bridge to one device, as other processes have it, that has greeted the board."""
    monkeypatch.setattr(shared_device.tempfile, "gettempdir", lambda: str(tmp_path))
    path, made = stand_in().path, []

    def make(kind):
        made.append(Bridge(Namespace(device=path, command=None, baud=115200, kind=kind, timeout=0.2, tries=1500)))
        assert made[-1].answer({"ask": "hello", "protocol": 1})["kind"] == kind
        return made[-1]

    yield make
    for bridge in made:
        bridge.close()


@needs_firmware
def test_registrations_of_several_programs_take_turns_on_one_board(make_bridge):
    """Each has its own limit of iterations, one and two, which no answer reaches sooner."""
    bridges = [make_bridge("registration") for _ in range(2)]
    for number, bridge in enumerate(bridges, start=1):
        bridge.answer({"ask": "create", "parameters": PARAMETERS | {"max_iterations": number, "epsilon": 0.0}})
    points = np.random.default_rng(0).uniform(-2.0, 2.0, (80, 2))
    asked = {
        "ask": "register", "guess": [0.05, 0.0, 0.02], "source": points.ravel().tolist(),
        "target": points.ravel().tolist(),
    }  # fmt: skip
    for _ in range(2):
        assert [bridge.answer(asked)["iterations"] for bridge in bridges] == [1, 2]


@needs_firmware
def test_a_session_that_another_program_ended_says_which_one(make_bridge):
    one = make_bridge("odometry")
    one.answer({"ask": "create", "parameters": PARAMETERS})
    scans = list(frames(2))
    one.answer(question(scans[0]))
    make_bridge("odometry")
    says = rf"another program \(process {os.getpid()}\) has used the board, and the session is lost; let one command"
    for _ in range(2):
        with pytest.raises(BoardRefused, match=says):
            one.answer(question(scans[1]))


@needs_firmware
def test_what_the_firmware_cannot_take_is_refused_with_a_reason(stand_in):
    line = stand_in()
    link = Link(line.line, timeout_s=0.2, tries=1500)
    board = Board(link, "o", "stand-in")
    with pytest.raises(LineError, match="unknown message, or before C"):
        board.answer(question(next(frames(1))))
    with pytest.raises(LineError, match="800 beams of a scan, but the firmware takes at most 256"):
        board.answer(question(next(frames(1, every=1))))
    for name, wrong in (("max_iterations", 0), ("max_iterations", 1e12), ("min_pairs", -1e12), ("min_pairs", 2.0**31)):
        with pytest.raises(LineError, match="a parameter is outside its range"):
            board.answer({"ask": "create", "parameters": PARAMETERS | {name: wrong}})
    with pytest.raises(LineError, match="too long for the firmware"):
        link.ask(b"U" + bytes(60_000))
    assert board.answer({"ask": "create", "parameters": PARAMETERS}) == {}


@needs_firmware
def test_a_firmware_with_too_little_memory_says_how_much_the_session_needs(make_firmware):
    """With as much as it says the session starts, with a byte less it does not."""

    def create(board_bytes):
        line = StandIn(make_firmware(f"firmware-{board_bytes}", f"-DBOARD_BYTES={board_bytes}u"))
        try:
            board = Board(Link(line.line, timeout_s=0.2, tries=1500), "o", "stand-in")
            return board.answer({"ask": "create", "parameters": PARAMETERS})
        finally:
            line.close()

    with pytest.raises(LineError, match=r"the session needs \d+ bytes, BOARD_BYTES is 4096") as refused:
        create(4096)
    needed = int(re.search(r"needs (\d+)", str(refused.value))[1])
    assert create(needed) == {}
    with pytest.raises(LineError, match=f"needs {needed} bytes, BOARD_BYTES is {needed - 1}"):
        create(needed - 1)


PORT_THAT_PRINTS = """#define port_read read_without_printing
#include "host.c"
#undef port_read
int port_read(void)
{
    printf("waiting\\r\\n");
    return read_without_printing();
}
"""


@needs_firmware
def test_a_firmware_may_print_between_its_answers(make_firmware, tmp_path):
    (tmp_path / "port.c").write_text(PORT_THAT_PRINTS)
    line = StandIn(make_firmware("printing", f"-I{CORE / 'board'}", port=tmp_path / "port.c"))
    try:
        link = Link(line.line, timeout_s=0.2, tries=20)
        board = Board(link, "o", "stand-in")
        board.answer({"ask": "create", "parameters": PARAMETERS})
        scans = list(frames(2))
        found = [Pose.of(board.answer(question(frame))["pose"]).row.tolist() for frame in scans]
        assert found == poses_of_the_core(scans)
        assert link.repeats == 0
    finally:
        line.close()


PORT_WITH_OTHER_CLOCK = """#define port_clock_ns clock_of_this_computer
#include "host.c"
#undef port_clock_ns
uint64_t port_clock_ns(void)
{
    static uint64_t now;
    return now += 17400000000u;
}
"""


@needs_firmware
def test_a_board_may_compute_for_longer_than_a_clock_of_32_bits_counts(make_firmware, tmp_path):
    """17.4 s are four times 2^32 ns and 0.22 s."""
    (tmp_path / "port.c").write_text(PORT_WITH_OTHER_CLOCK)
    line = StandIn(make_firmware("late", f"-I{CORE / 'board'}", port=tmp_path / "port.c"))
    try:
        link = Link(line.line, timeout_s=0.2, tries=1500)
        for kind, asked in (
            ("o", question(next(frames(1)))),
            ("r", {"ask": "register", "guess": [0.0] * 3, "source": [], "target": []}),
        ):
            board = Board(link, kind, "stand-in")
            board.answer({"ask": "create", "parameters": PARAMETERS})
            assert board.answer(asked)["elapsed_ns"] == 17_400_000_000
    finally:
        line.close()


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["--timeout", "nan"], "--timeout: found 'nan', expected 0.001 to 3600 seconds"),
        (["--timeout", "0"], "--timeout: found '0', expected 0.001 to 3600 seconds"),
        (["--tries", "0"], "--tries: found '0', expected a whole number from 1 on"),
    ],
)
def test_a_timeout_that_is_none_and_no_tries_are_refused(monkeypatch, capsys, words, says):
    monkeypatch.setattr("sys.argv", ["serial_board", "--command", "true", *words])
    with pytest.raises(SystemExit, match="2"):
        serial_board.main()
    assert says in capsys.readouterr().err


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux ends a process with its parent")
def test_a_program_behind_the_line_ends_with_a_killed_bridge(has_ended):
    script = (
        "import time; from evalkit.external.serial_line import open_command\n"
        "print(open_command(['sleep', '900']).process.pid, flush=True); time.sleep(900)"
    )
    with subprocess.Popen([sys.executable, "-c", script], stdout=subprocess.PIPE, text=True) as bridge:
        assert bridge.stdout is not None
        behind = int(bridge.stdout.readline())
        bridge.kill()
    assert has_ended(behind)


def test_a_silent_board_is_an_error():
    reader, writer = os.pipe()[0], os.pipe()[1]
    with pytest.raises(
        LineError, match=r"no answer from the board in 3 tries of 0.01 s; no byte has arrived: check the"
    ):
        Link(serial_line.Line(reader, writer), timeout_s=0.01, tries=3).ask(b"H")


class Scripted:
    """A line that gives what it was told to, one piece for each frame, or what a function makes of the frame."""

    def __init__(self, *pieces):
        self._pieces, self._ready = list(pieces), b""

    def write(self, content):
        piece = self._pieces.pop(0) if self._pieces else b""
        self._ready = piece(content) if callable(piece) else piece

    def read(self, _wait_s):
        ready, self._ready = self._ready, b""
        return ready


NOISE = b"\x9a\x11\x00\xf3\x42"


@pytest.mark.parametrize(
    ("pieces", "says"),
    [
        ([NOISE, NOISE], "10 bytes have arrived, and no whole frame among them: check --baud, and that nothing is"),
        ([serial_line.encode_frame(9, LAST, b"a")], "1 answers had arrived before: see where it hangs"),
        ([lambda sent: sent], "the line returns what is sent"),
    ],
)
def test_what_has_arrived_tells_why_there_is_no_answer(pieces, says):
    with pytest.raises(LineError, match=says):
        Link(Scripted(*pieces), timeout_s=1e-3, tries=2).ask(b"H")


@pytest.mark.parametrize(("timeout_s", "tried"), [(0.25, 4), (0.02, 20)])
def test_a_board_that_never_answered_is_asked_for_less_time_than_evalkit_waits(monkeypatch, timeout_s, tried):
    """One second instead of six, and no more than 20 tries."""
    assert serial_line.GREETING_S < process.HELLO_S - 2.0
    monkeypatch.setattr(serial_line, "GREETING_S", 1.0)
    with pytest.raises(LineError, match=f"no answer from the board in {tried} tries of {timeout_s:g} s"):
        Link(Scripted(), timeout_s, tries=20).ask(b"H")


class Slow:
    """A board that says busy and then is silent, until it was asked ``deaf`` times more."""

    def __init__(self, deaf, flags, data):
        self._deaf, self._answer, self._ready, self.asked = deaf, (flags, data), b"", []

    def write(self, content):
        self.asked.append(serial_line.decode_frame(content.strip(b"\0")))
        sequence = self.asked[-1][0]
        if len(self.asked) == 1:
            self._ready = serial_line.encode_frame(sequence, BUSY, b"")
        elif len(self.asked) > self._deaf:
            self._ready = serial_line.encode_frame(sequence, *self._answer)

    def read(self, _wait_s):
        ready, self._ready = self._ready, b""
        return ready


def test_a_busy_board_has_all_its_time_and_is_only_asked_with_empty_frames():
    """Two tries, and five frames without an answer."""
    board = Slow(5, LAST, b"adone")
    link = Link(board, timeout_s=1e-3, tries=2)
    assert link.ask(b"R" + bytes(400)) == b"adone"
    assert board.asked == [(1, FIRST | LAST, b"R" + bytes(400))] + 5 * [(1, 0, b"")]
    assert link.repeats == 0


def test_a_board_that_never_ends_to_compute_is_an_error(monkeypatch):
    monkeypatch.setattr(serial_line, "BUSY_S", 0.01)
    with pytest.raises(LineError, match="has said that it computes"):
        Link(Slow(math.inf, LAST, b""), timeout_s=1e-3, tries=2).ask(b"R")


def test_a_board_that_restarts_while_it_computes_is_an_error():
    with pytest.raises(LineError, match="has started again and lost its state"):
        Link(Slow(1, LAST | NO_SESSION, b""), timeout_s=1e-3, tries=2).ask(b"R")


@needs_firmware
def test_the_firmware_says_busy_before_it_answers(firmware):
    sent = serial_line.encode_frame(1, FIRST | LAST, b"H") + 2 * serial_line.encode_frame(1, 0, b"")
    printed = subprocess.run([firmware], input=sent, capture_output=True, check=True).stdout
    busy, *answers = [serial_line.decode_frame(one) for one in printed.split(b"\0") if one]
    assert busy == (1, BUSY, b"")
    assert [answer[:2] for answer in answers] == 3 * [(1, LAST)]
    assert {parse_hello(answer[2][1:]).kinds for answer in answers} == {"ros"}


@pytest.mark.parametrize(
    ("error", "answers", "code", "said"),
    [
        (BoardRefused("300 points"), ['{"failed": "300 points"}', "{}"], 0, ""),
        (LineError("no answer from the board"), [], 1, "serial_board: no answer from the board\n"),
    ],
)
def test_the_bridge_goes_on_after_a_refusal_and_ends_where_the_board_is_silent(
    monkeypatch, capsys, error, answers, code, said
):
    class Board:
        def __init__(self, *_):
            self._outcomes = [error, None]

        def answer(self, _question):
            if (outcome := self._outcomes.pop(0)) is not None:
                raise outcome
            return {}

    monkeypatch.setattr(serial_board, "Board", Board)
    monkeypatch.setattr(sys, "argv", ["serial_board", "--command", f"{sys.executable} -c 0"])
    monkeypatch.setattr(sys, "stdin", io.StringIO('{"ask":"register"}\n' * 2))
    assert serial_board.main() == code
    printed = capsys.readouterr()
    assert (printed.out.splitlines(), printed.err) == (answers, said)


def test_frames_and_checksums_are_the_published_ones():
    assert serial_line.encode_cobs(bytes([0x11, 0x22, 0x00, 0x33])) == bytes([3, 0x11, 0x22, 2, 0x33])
    assert serial_line.encode_frame(5, FIRST | LAST, b"123456789")[:3] == bytes([16, 5, 3])
    for length in (0, 1, 253, 254, 255, 507, 508, 509, 600):
        for content in (bytes(length), b"\x01" * length, random.Random(length).randbytes(length)):
            coded = serial_line.encode_cobs(content)
            assert 0 not in coded
            assert serial_line.decode_cobs(coded) == content


def test_no_frame_with_one_damaged_byte_is_taken():
    frame = serial_line.encode_frame(9, LAST, bytes(range(60)))[:-1]
    assert serial_line.decode_frame(frame) == (9, LAST, bytes(range(60)))
    for at in range(len(frame)):
        for other in range(1, 256):
            if other != frame[at]:
                assert serial_line.decode_frame(frame[:at] + bytes([other]) + frame[at + 1 :]) is None


def test_every_outcome_of_a_candidate_has_a_text():
    header = (CORE / "include" / "ek" / "loop_finder.h").read_text()
    outcomes = re.search(r"typedef enum \{\s*(EK_LOOP_PASSED.*?)\} ek_loop_outcome;", header, re.DOTALL)
    assert outcomes is not None
    assert len(re.findall(r"^\s*EK_LOOP_\w+", outcomes[1], re.MULTILINE)) == len(serial_board.OUTCOMES)


def test_a_greeting_of_another_version_is_refused():
    assert parse_hello(b"\x03\x00\x04\x00" + bytes(8) + b"os\nmine\nos size 3\ns limit 0.5\n").parameters == (
        ("os", "size", 3), ("s", "limit", 0.5),
    )  # fmt: skip
    assert parse_default("true") is True
    assert parse_default("-2") == -2
    with pytest.raises(LineError, match="the firmware is of version 2, expected 3; build it from the core"):
        parse_hello(b"\x02\x00\x04\x00" + bytes(8) + b"o\nmine\n")
    for answer in (b"", b"\x03\x00\x04\x00" + bytes(8) + b"x\nmine\n"):
        with pytest.raises(LineError, match="which is no greeting of this firmware"):
            parse_hello(answer)


@pytest.mark.thorough
@pytest.mark.skipif(not EMULATOR or not CROSS, reason="no qemu-system-arm, or no arm-none-eabi-gcc")
def test_the_emulated_cortex_m4f_gives_the_bits_of_this_computer(tmp_path):
    subprocess.run([CORE / "board" / "build", tmp_path], check=True)
    subprocess.run(
        [sys.executable, "-m", "evalkit_baselines.embedded.scanlog", "lab", "lab.eksl", "--limit", "20"],
        cwd=tmp_path, check=True,
    )  # fmt: skip
    sources = [str(CORE / "main.c"), *map(str, (CORE / "src").glob("*.c")), "-lm", "-o", str(tmp_path / "here")]
    flags = ["-std=c99", "-O2", "-ffp-contract=off", "-DEK_PORTABLE", f"-I{CORE / 'include'}"]
    for suffix, precision in (("", []), ("-float", ["-DEK_FLOAT"])):
        subprocess.run(["cc", *flags, *precision, *sources], check=True)
        subprocess.run(["./here", "--bits", "lab.eksl", "here.bits"], cwd=tmp_path, check=True)
        words = ["evalkit-run", "--bits", "lab.eksl", "board.bits"]
        subprocess.run(
            [
                EMULATOR, "-M", "mps2-an386", "-display", "none", "-monitor", "none", "-serial", "none",
                "-kernel", f"evalkit-run{suffix}.elf",
                "-semihosting-config", ",".join(["enable=on,target=native", *(f"arg={word}" for word in words)]),
            ],
            cwd=tmp_path, check=True, timeout=600,
        )  # fmt: skip
        assert (tmp_path / "board.bits").read_text() == (tmp_path / "here.bits").read_text()


def load_figures():
    """Return board/figures as a module."""
    loader = importlib.machinery.SourceFileLoader("figures", str(CORE / "board" / "figures"))
    module = importlib.util.module_from_spec(importlib.util.spec_from_loader("figures", loader))
    loader.exec_module(module)
    return module


def test_a_scan_above_its_weighted_tallies_is_counted(capsys):
    figures = load_figures()
    one_of_each = [1.0] * len(figures.KINDS)
    allowed = sum(figures.WEIGHTS["-float"])
    there = [[allowed, 800.0], [allowed + 40.0, 800.0], [0.5 * allowed, 800.0]]
    assert figures.check_scans("drawn", "-float", there, [one_of_each] * 3) == 1
    assert "drawn, float: 3 scans, 1 above" in capsys.readouterr().out


@pytest.fixture(scope="module")
def count(tmp_path_factory):
    """Program board/count of this computer, that counts the passes of loops."""
    if not CC:
        pytest.skip("no C compiler")
    program = tmp_path_factory.mktemp("count") / "count"
    sources = [*CORE.glob("board/count*.c"), *CORE.glob("src/*.c")]
    subprocess.run(
        [CC, "-std=c99", "-DEK_PORTABLE", "-DEK_TALLY", f"-I{CORE / 'include'}", *sources, "-lm", "-o", program],
        check=True,
    )
    return program


def test_the_bounds_of_a_scan_of_the_slam_follow_from_its_parameters(count):
    kinds = load_figures().KINDS
    printed = subprocess.run([count, "sizes", "slam"], capture_output=True, text=True, check=True, timeout=600).stdout
    most = dict(zip(kinds, map(int, printed.split()[2:]), strict=True))
    allowed = 4 * 200_000  # operations, while the robot is lost
    assert most["beam"] == most["prepared beam"] == 360
    # two stages, each again after five and six further starts; after the search of the map; the two matches of a loop
    assert most["iteration"] == 2 * 2 * 40 + 5 * 20 + 6 * 20 + 40 + 2 * 40
    assert most["voxel"] == 2 * 3 * 4096  # the part of the map is taken at most three times
    # the search of a loop and that of the map, each with the first blocks of an angle, of the largest sample
    assert most["lookup"] == allowed + 64 * 599 + 10 * 200_000 + 64 * 199
    assert most["operation of a task"] == allowed + 12 * 41 * 8192  # the largest part: a match in all its iterations


def test_no_scan_of_random_drives_with_the_slam_exceeds_its_bound(count):
    kinds = load_figures().KINDS
    words = [count, "bound", "slam", "5", "5"]
    scans, shares = subprocess.run(words, capture_output=True, text=True, check=True, timeout=600).stdout.splitlines()
    largest = dict(zip(kinds, map(float, shares.split()), strict=True))
    assert scans == "500"
    assert largest["beam"] == largest["scan of the SLAM"] == 1.0
    for kind in ("iteration", "lookup", "operation", "operation of a task", "voxel", "probe"):
        assert 0.0 < largest[kind] <= 1.0


@pytest.mark.thorough
@pytest.mark.skipif(not EMULATOR or not CROSS, reason="no qemu-system-arm, or no arm-none-eabi-gcc")
def test_no_scan_on_the_emulated_cortex_m4f_takes_more_instructions_than_its_bound():
    words = [sys.executable, CORE / "board" / "figures", "--seed", "5", "--sessions", "5", "--bound", "500"]
    printed = subprocess.run(words, capture_output=True, text=True, check=True, timeout=600).stdout
    for method, precision in product(("points", "lines", "slam"), ("double", "float")):
        assert f"random {method}, {precision}: 100 scans, 0 above their weighted tallies" in printed
        assert f"{method}, {precision}: no tally exceeds its bound in 10000 random scans" in printed
    figures = load_figures()
    assert printed.count(" kB | ") == 2 * len({**figures.CONFIGURATIONS, **figures.SLAMS})
    stacks = dict(re.findall(r"\n\| (`.*) \| \d+ B \| (\d+) B \|", printed))
    assert tuple(stacks) == figures.CALLS
    start, with_table = int(stacks["`ek_pipeline_start`"]), int(stacks["`ek_icp_register` on a target with a table"])
    assert 0 < start < int(stacks["`ek_pipeline_update`, points and keyframes"]) < with_table < 8192
