"""A board on a serial line as a back end: ``exec:python -m evalkit.external.serial_board /dev/ttyACM0``.

Translates the lines of PROTOCOL.md to the messages of the example firmware
(``baselines/evalkit_baselines/embedded/board/firmware.c``), with frames that survive loss and damage. ``--command``
starts a program instead of opening a device: an emulator, or the firmware built for this computer.
"""

from __future__ import annotations

import argparse
import json
import math
import shlex
import struct
import sys
from array import array
from collections.abc import Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from typing import Any

from evalkit.external.serial_line import BAUDS, BoardRefused, Line, LineError, Link, open_command, open_device
from evalkit.external.shared_device import SharedDevice

VERSION = 3
KINDS = {"r": "registration", "o": "odometry", "s": "slam"}
REALS = {4: "f", 8: "d"}
HAS_ODOMETRY, HAS_MOTION = 1, 2
POSES = 20
"""Scans of a SLAM whose corrected poses one message asks for."""

OUTCOMES = (
    "chi2 {:.1f}, overlap {:.2f}",
    "{:.0f} points, fewer than {:.0f}",
    "score at most {:.4f}, not above {:g}",
    "ambiguous: another motion has {:.2f} of the score {:.2f}",
    "overlap {:.3f} < {:g}",
    "degenerate: position known to {:.3f} m > {:g} m",
    "chi2 {:.1f} > {:.1f}",
    "contradicted: {:.3f} < {:g} of what could be seen there",
)
"""What decided on a candidate, with its numbers; the order is that of ek_loop_outcome (loop_finder.h)."""

CLOSURE = "<2I5d2I"
"""A candidate of a SLAM: later and earlier keyframe, pose, two numbers, what decided, flags."""

ACCEPTED, FOUND_AGAIN = 1, 4
REMARKS = {2: "not confirmed yet: ", 4: "found again after a lost track: ", 8: "withdrawn, contradicts other loops: ",
           16: "no room for more loops: "}  # fmt: skip
MIN_TIMEOUT_S, MAX_TIMEOUT_S = 0.001, 3600.0


@dataclass(frozen=True)
class Firmware:
    """What a board says about itself."""

    real: str
    """``array`` type of its numbers: f or d."""
    points: int
    """Largest number of beams or of points of a source."""
    targets: int
    kinds: str
    summary: str
    parameters: tuple[tuple[str, str, bool | int | float], ...]
    """Kinds that take it, name and default of each."""


def parse_hello(answer: bytes) -> Firmware:
    """Parse the answer to H; raises LineError."""
    try:
        version, real, _, points, targets = struct.unpack_from("<HBBII", answer)
        if version != VERSION:
            remedy = "build it from the core of this evalkit"
            raise LineError(f"the firmware is of version {version}, expected {VERSION}; {remedy}")
        kinds, summary, *lines = answer[12:].decode("ascii").splitlines()
        parameters = tuple((takers, name, parse_default(text)) for takers, name, text in map(str.split, lines))
        if real not in REALS or not kinds or set(kinds) - set(KINDS):
            raise ValueError
    except (struct.error, ValueError):
        raise LineError(f"the board answers {answer[:40]!r} to H, which is no greeting of this firmware") from None
    return Firmware(REALS[real], points, targets, kinds, summary, parameters)


def parse_default(text: str) -> bool | int | float:
    """Return the default of a parameter: true, false, a whole number, or another number."""
    if text in ("true", "false"):
        return text == "true"
    return int(text) if text.lstrip("-").isdigit() else float(text)


class Board:
    """Answers the questions of PROTOCOL.md from a board."""

    def __init__(self, link: Link, kind: str, device: str) -> None:
        self._link = link
        self._device = device
        self.firmware = parse_hello(self._ask(b"H"))
        self._kind = kind or self.firmware.kinds[0]
        if self._kind not in self.firmware.kinds:
            offered = ", ".join(KINDS[one] for one in self.firmware.kinds)
            raise LineError(f"the firmware is no {KINDS[self._kind]}; it offers: {offered}")
        self._parameters = [one[1:] for one in self.firmware.parameters if self._kind in one[0]]
        self._numbers: list[float] | None = None  # values of the parameters, once the session is created
        self._ended_by = 0  # the process that has ended it
        self._tracked: list[tuple[int, list[float]]] = []  # of a SLAM: keyframe and odom_from_base of each scan,
        self._keyframe_stamps_ns: list[int] = []

    def answer(self, question: Mapping[str, Any]) -> dict[str, Any]:
        """Return the answer to a question; raises LineError where the board does not answer or refuses."""
        if self._ended_by:
            raise BoardRefused(
                f"another program (process {self._ended_by}) has used the board, and the session is lost; "
                "let one command at a time use it"
            )
        ask = question["ask"]
        if ask == "hello":
            return self._describe()
        if ask == "create":
            return self._create(question["parameters"])
        if ask == "register":
            return self._register(question)
        if ask == "update":
            return self._update(question)
        if ask == "trajectory":
            return {"poses": self._correct(question["from"], question["count"])}
        if ask == "loop_closures":
            return {"loop_closures": self._list_closures()[question["from"] :][: question["count"]]}
        raise LineError(f"no message for the question {ask}")

    def _ask(self, message: bytes) -> bytes:
        answer = self._link.ask(message)
        if answer[:1] == b"a":
            return answer[1:]
        raise BoardRefused(f"the board refuses: {answer[1:].decode('ascii', 'replace') or 'empty answer'}")

    def _describe(self) -> dict[str, Any]:
        limits = f"{8 * array(self.firmware.real).itemsize} bits"
        return {
            "protocol": 1,
            "kind": KINDS[self._kind],
            "summary": f"{self.firmware.summary}, {limits}, at most {self.firmware.points} points",
            "device": self._device,
            "parameters": [
                {
                    "name": name,
                    "default": default,
                    "unit": "m" if name.endswith("_m") else "",
                    "meaning": "of the firmware",
                }
                for name, default in self._parameters
            ],
        }

    def resume(self, other: int) -> None:
        """Begin the session again, after another process has used the board; one that has a state is lost."""
        if self._kind != "r" and self._numbers is not None:
            self._ended_by = other
            return
        self._link.restart()
        if self._numbers is not None:
            self._start(self._numbers)

    def _create(self, values: Mapping[str, Any]) -> dict[str, Any]:
        numbers = [float(values[name]) for name, _ in self._parameters]
        self._start(numbers)
        self._numbers = numbers
        return {}

    def _start(self, numbers: Sequence[float]) -> None:
        self._ask(b"C" + self._kind.encode() + struct.pack(f"<{len(numbers)}d", *numbers))

    def _reals(self, values: Sequence[float]) -> bytes:
        content = array(self.firmware.real, values)
        if sys.byteorder == "big":
            content.byteswap()
        return content.tobytes()

    def _register(self, question: Mapping[str, Any]) -> dict[str, Any]:
        source, target = question["source"], question["target"]
        self._check(len(source) // 2, self.firmware.points, "points of a source")
        self._check(len(target) // 2, self.firmware.targets, "points of a target")
        head = struct.pack("<3d2I", *question["guess"], len(source) // 2, len(target) // 2)
        answer = self._ask(b"R" + head + self._reals(source) + self._reals(target))
        *pose, error, converged, iterations, inliers, elapsed_ns = self._unpack("<4d3IQ", answer)
        return {
            "pose": pose,
            "converged": bool(converged),
            "iterations": iterations,
            "error_m": error if math.isfinite(error) else None,
            "inliers": inliers,
            "elapsed_ns": elapsed_ns,
        }

    def _update(self, question: Mapping[str, Any]) -> dict[str, Any]:
        ranges = [math.inf if one is None else math.nan if one == "nan" else one for one in question["ranges"]]
        self._check(len(ranges), self.firmware.points, "beams of a scan")
        odometry, motion = question["odom_from_base"], question["start_from_end"]
        flags = HAS_ODOMETRY * (odometry is not None) + HAS_MOTION * (motion is not None)
        poses = [number for pose in (odometry, motion) if pose is not None for number in pose]
        head = struct.pack("<5d", question["range_min_m"], question["range_max_m"], *question["base_from_sensor"])
        head += struct.pack("<2q2I", question["stamp_ns"], question["time_increment_ns"], len(ranges), flags)
        head += struct.pack(f"<{len(poses)}d", *poses)
        answer = self._ask(b"U" + head + self._reals(ranges) + self._reals(question["angles"]))
        if self._kind != "s":
            *pose, elapsed_ns = self._unpack("<3dQ", answer)
            return {"pose": pose, "elapsed_ns": elapsed_ns}
        *pose, elapsed_ns, keyframe, x, y, theta, corrected = self._unpack("<3dQI3dI", answer)
        self._tracked.append((keyframe, [x, y, theta]))
        if keyframe == len(self._keyframe_stamps_ns):
            self._keyframe_stamps_ns.append(question["stamp_ns"])
        return {"pose": pose, "elapsed_ns": elapsed_ns, "corrected": bool(corrected)}

    def _correct(self, first: int, count: int) -> list[float]:
        """Return the corrected poses of scans, three numbers for each."""
        poses: list[float] = []
        wanted = self._tracked[first : first + count]
        for begin in range(0, len(wanted), POSES):
            some = wanted[begin : begin + POSES]
            content = b"".join(struct.pack("<I3d", keyframe, *pose) for keyframe, pose in some)
            poses += self._unpack(f"<{3 * len(some)}d", self._ask(b"T" + struct.pack("<I", len(some)) + content))
        return poses

    def _list_closures(self) -> list[dict[str, Any]]:
        """Return all candidates for loops so far."""
        closures: list[dict[str, Any]] = []
        total = 1
        while len(closures) < total:
            answer = self._ask(b"L" + struct.pack("<I", len(closures)))
            (total,) = self._unpack("<I", answer[:4])
            if total and not answer[4:]:
                raise LineError(f"the board has {total} candidates for loops and answers none")
            try:
                closures += [self._read_closure(*one) for one in struct.iter_unpack(CLOSURE, answer[4:])]
            except (struct.error, IndexError):
                raise LineError(f"the board answers {answer[:60]!r} to L, which are no candidates for loops") from None
        return closures

    def _read_closure(self, later: int, earlier: int, *numbers: Any) -> dict[str, Any]:
        *pose, first, second, outcome, flags = numbers
        remarks = "".join(text for flag, text in REMARKS.items() if flags & flag)
        return {
            "stamp_ns": self._keyframe_stamps_ns[later],
            "other_stamp_ns": self._keyframe_stamps_ns[earlier],
            "pose": pose,
            "accepted": bool(flags & ACCEPTED),
            "found_again": bool(flags & FOUND_AGAIN),
            "reason": remarks + OUTCOMES[outcome].format(first, second),
        }

    def _check(self, count: int, most: int, what: str) -> None:
        if count > most:
            what = f"{count} {what}, but the firmware takes at most {most}; build it with more, or send fewer"
            raise BoardRefused(what)

    def _unpack(self, layout: str, answer: bytes) -> tuple[Any, ...]:
        try:
            return struct.unpack(layout, answer)
        except struct.error:
            raise LineError(f"the board answers {len(answer)} bytes, expected {struct.calcsize(layout)}") from None


class Bridge:
    """The board of a command line, which is opened with the first question; a device is shared with other bridges."""

    def __init__(self, arguments: argparse.Namespace) -> None:
        self._arguments = arguments
        self._shared = SharedDevice(arguments.device) if arguments.device else None
        self._line: Line | None = None
        self._link: Link | None = None
        self.board: Board | None = None

    def answer(self, question: Mapping[str, Any]) -> dict[str, Any]:
        """Return the answer of the board; raises LineError."""
        with self._shared.turn() if self._shared is not None else nullcontext(0) as other:
            if self.board is not None and other:
                self.board.resume(other)
            return self._open().answer(question)

    def _open(self) -> Board:
        if self.board is None:
            given = self._arguments
            if self._line is None:
                self._line = (
                    open_command(shlex.split(given.command)) if given.command else open_device(given.device, given.baud)
                )
            self._link = Link(self._line, given.timeout, given.tries)
            kind = {name: letter for letter, name in KINDS.items()}.get(given.kind, "")
            self.board = Board(self._link, kind, given.device or "board behind a program")
        return self.board

    def close(self) -> None:
        """Close the line, and say how often frames were sent again."""
        if self._link is not None and self._link.repeats:
            sys.stderr.write(f"serial_board: {self._link.repeats} frames were sent again\n")
        if self._line is not None:
            self._line.close()


def parse_seconds(text: str) -> float:
    """Return a time from 1 ms to 1 h; anything else is a usage error."""
    try:
        seconds = float(text)
    except ValueError:
        seconds = math.nan
    if not MIN_TIMEOUT_S <= seconds <= MAX_TIMEOUT_S:
        raise argparse.ArgumentTypeError(f"found '{text}', expected {MIN_TIMEOUT_S:g} to {MAX_TIMEOUT_S:g} seconds")
    return seconds


def parse_tries(text: str) -> int:
    """Return a number from 1 on; anything else is a usage error."""
    if not (text.isascii() and text.isdigit()) or int(text) < 1:
        raise argparse.ArgumentTypeError(f"found '{text}', expected a whole number from 1 on")
    return int(text)


def main() -> int:
    """Answer every line of standard input with a line, until its end, or until the board does not answer."""
    parser = argparse.ArgumentParser(prog="serial_board", description=__doc__.partition("\n")[0] if __doc__ else "")
    parser.add_argument("device", nargs="?", help="serial device of the board, such as /dev/ttyACM0")
    parser.add_argument("--command", help="start this program and talk to its standard input and output instead")
    parser.add_argument("--baud", type=int, choices=BAUDS, default=115_200)
    parser.add_argument("--kind", choices=sorted(KINDS.values()), help="default: the first one of the firmware")
    parser.add_argument("--timeout", type=parse_seconds, default=0.5, help="seconds until a frame is sent again")
    parser.add_argument("--tries", type=parse_tries, default=12, help="number of times that a frame is sent at most")
    arguments = parser.parse_args()
    if bool(arguments.device) == bool(arguments.command):
        parser.error("give a serial device, or --command")
    bridge = Bridge(arguments)
    try:
        for question in sys.stdin:
            try:
                answer = bridge.answer(json.loads(question))
            except LineError as error:
                if bridge.board is not None and not isinstance(error, BoardRefused):
                    sys.stderr.write(f"serial_board: {error}\n")
                    return 1  # the session on the board is lost
                answer = {"failed": str(error)}
            sys.stdout.write(json.dumps(answer) + "\n")
            sys.stdout.flush()
    finally:
        bridge.close()
    return 0


if __name__ == "__main__":
    sys.exit(main())
