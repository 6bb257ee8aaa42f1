"""Messages over a serial line that may lose or damage bytes: frames, checksums, repetition.

The frames are described in ``baselines/evalkit_baselines/embedded/board/link.h``, the board's side.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import select
import signal
import subprocess
import sys
import time
import zlib
from dataclasses import dataclass, field

DATA_BYTES = 512
"""Largest number of bytes in a frame, besides sequence, flags and checksum."""

LAST, FIRST, NO_SESSION, TOO_LONG, BUSY = 1, 2, 4, 8, 16
CHECKSUM_BYTES = 4
BUSY_S = 600.0
"""Longest wait for a board that computes."""

GREETING_S, MIN_TRIES = 6.0, 3
"""How long a board is asked that has never answered: evalkit, which waits 10 s, shall be told the reason."""

MAX_CODED_BYTES = 4 * DATA_BYTES
"""More bytes without a zero are noise."""

PR_SET_PDEATHSIG = 1  # of Linux's prctl

BAUDS = (9600, 19_200, 38_400, 57_600, 115_200, 230_400, 460_800, 500_000, 576_000, 921_600, 1_000_000, 2_000_000)


class LineError(Exception):
    """The line does not work, or the board does not answer; the text says what to do."""


class BoardRefused(LineError):
    """The firmware cannot take a question; it can be asked the next one."""


@dataclass
class Line:
    """Both directions of a line as file descriptors, without buffers; ``process`` is behind a line to a program."""

    reader: int
    writer: int
    process: subprocess.Popen[bytes] | None = None

    def write(self, content: bytes) -> None:
        """Write all bytes, waiting where the line is slower."""
        waiting = memoryview(content)
        while waiting:
            select.select([], [self.writer], [])
            try:
                waiting = waiting[os.write(self.writer, waiting[:DATA_BYTES]) :]
            except OSError as error:
                raise LineError(f"cannot write to the line: {error.strerror}; is the board connected?") from None

    def read(self, wait_s: float) -> bytes:
        """Return bytes that arrived within the time, or none."""
        if not select.select([self.reader], [], [], max(wait_s, 0.0))[0]:
            return b""
        try:
            content = os.read(self.reader, 4096)
        except OSError as error:
            raise LineError(f"cannot read from the line: {error.strerror}; is the board connected?") from None
        if not content:
            raise LineError("the line was closed; is the board, or the program behind the line, still running?")
        return content

    def flush_input(self) -> None:
        """Throw away what a device has received."""
        if self.process is None:
            import termios  # noqa: PLC0415 - not on Windows

            with contextlib.suppress(termios.error):  # a pipe, in place of a device
                termios.tcflush(self.reader, termios.TCIFLUSH)

    def close(self) -> None:
        """Close the line, and end the program behind it."""
        for descriptor in {self.reader, self.writer}:
            with contextlib.suppress(OSError):
                os.close(descriptor)
        if self.process is not None:
            self.process.terminate()
            self.process.wait()


def open_device(path: str, baud: int) -> Line:
    """Open a serial device in raw mode, 8 data bits, no parity; what it received before is thrown away."""
    try:
        import termios  # noqa: PLC0415 - not on Windows
        import tty  # noqa: PLC0415
    except ImportError:
        raise LineError("serial devices need termios (Linux, macOS); elsewhere use --command") from None
    try:
        descriptor = os.open(path, os.O_RDWR | os.O_NOCTTY)
        tty.setraw(descriptor)
        settings = termios.tcgetattr(descriptor)
        settings[4] = settings[5] = getattr(termios, f"B{baud}")
        termios.tcsetattr(descriptor, termios.TCSANOW, settings)
        termios.tcflush(descriptor, termios.TCIOFLUSH)
    except (OSError, termios.error) as error:
        raise LineError(f"{path}: {error.args[-1]}; give the board's serial device, such as /dev/ttyACM0") from None
    except AttributeError:
        raise LineError(f"{path}: {baud} baud is not possible here; try 115200") from None
    return Line(descriptor, descriptor)


def open_command(words: list[str]) -> Line:
    """Start a program whose standard input and output are the line.

    On Linux it ends with this process, however that ends: evalkit kills a program that does not answer in time.
    """
    try:
        process = subprocess.Popen(
            words,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            bufsize=0,
            preexec_fn=_end_with_parent if sys.platform == "linux" else None,  # noqa: PLW1509 - one thread
        )
    except OSError as error:
        raise LineError(f"{words[0]}: {error.strerror}; correct the command") from None
    if process.stdin is None or process.stdout is None:
        raise LineError(f"{words[0]}: no pipes")
    return Line(os.dup(process.stdout.fileno()), os.dup(process.stdin.fileno()), process)


def _end_with_parent() -> None:
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)


def encode_cobs(content: bytes) -> bytes:
    """Encode bytes without a zero (Cheshire and Baker 1999); the zero that ends a frame is not added."""
    coded = bytearray()
    for part in content.split(b"\0"):
        full = len(part) - len(part) % 254
        for at in range(0, full, 254):
            coded += b"\xff" + part[at : at + 254]
        coded += bytes([len(part) - full + 1]) + part[full:]
    return bytes(coded)


def decode_cobs(coded: bytes) -> bytes | None:
    """Decode bytes without zero; None where a length does not fit."""
    content, at = bytearray(), 0
    while at < len(coded):
        run = coded[at]
        if run == 0 or at + run > len(coded):
            return None
        content += coded[at + 1 : at + run]
        at += run
        if run < 255 and at < len(coded):
            content.append(0)
    return bytes(content)


def encode_frame(sequence: int, flags: int, data: bytes) -> bytes:
    """Return the bytes of a frame with the zero at its end."""
    frame = bytes([sequence, flags]) + data
    return encode_cobs(frame + zlib.crc32(frame).to_bytes(CHECKSUM_BYTES, "little")) + b"\0"


def decode_frame(coded: bytes) -> tuple[int, int, bytes] | None:
    """Return sequence, flags and data of a frame without its zero; None where it is damaged."""
    frame = decode_cobs(coded)
    if frame is None or len(frame) < 2 + CHECKSUM_BYTES:
        return None
    content, checksum = frame[:-CHECKSUM_BYTES], frame[-CHECKSUM_BYTES:]
    return (content[0], content[1], content[2:]) if zlib.crc32(content).to_bytes(4, "little") == checksum else None


@dataclass
class Link:
    """A session with a board: each message is taken once, and answered."""

    line: Line
    timeout_s: float
    """Wait for an answer to a frame; then it is sent again."""
    tries: int
    repeats: int = 0
    """Number of frames that were sent again."""
    received_bytes: int = 0
    received_frames: int = 0
    """Whole frames among the bytes."""
    _sequence: int = 0
    _started: bool = False
    _received: bytearray = field(default_factory=bytearray)

    def restart(self) -> None:
        """Begin a new session with the next message: another program has used the board."""
        self._started = False
        self._received.clear()
        self.line.flush_input()

    def ask(self, message: bytes) -> bytes:
        """Send a message and return its answer; raises LineError."""
        pieces = [message[at : at + DATA_BYTES] for at in range(0, len(message), DATA_BYTES)]
        answer = b""
        for number, piece in enumerate(pieces, start=1):
            flags, answer = self._exchange(LAST if number == len(pieces) else 0, piece)
            if flags & NO_SESSION:
                raise LineError("the board has started again and lost its state; see why it resets")
            if flags & TOO_LONG:
                raise BoardRefused(f"a message of {len(message)} bytes is too long for the firmware; send fewer points")
        return answer

    def _exchange(self, flags: int, data: bytes) -> tuple[int, bytes]:
        self._sequence = (self._sequence + 1) % 256
        flags |= 0 if self._started else FIRST
        frame = encode_frame(self._sequence, flags, data)
        tries = self.tries
        if not self.received_frames:
            tries = min(tries, max(MIN_TRIES, int(GREETING_S / self.timeout_s)))
        for attempt in range(tries):
            self.repeats += bool(attempt)
            separator = b"\0" if attempt or flags & FIRST else b""  # ends what is left of a damaged frame
            self.line.write(separator + frame)
            answer = self._receive(time.monotonic() + self.timeout_s)
            if answer is not None:
                self._started = True
                return self._wait() if answer[0] & BUSY else answer
        raise LineError(f"no answer from the board in {tries} tries of {self.timeout_s:g} s; {self._find_cause()}")

    def _find_cause(self) -> str:
        """Return what may be wrong with a line without an answer, by what has arrived so far."""
        if self.received_frames:
            return f"{self.received_frames} answers had arrived before: see where it hangs, or set a larger --timeout"
        if self.received_bytes:
            return (
                f"{self.received_bytes} bytes have arrived, and no whole frame among them: check --baud, and that "
                "nothing is printed within an answer"
            )
        return "no byte has arrived: check the device, its wires, and that the firmware runs"

    def _wait(self) -> tuple[int, bytes]:
        """Return the answer of a board that has the message and computes; evalkit's answer_timeout_s is the limit.

        The answer may be lost on the line: an empty frame with the same sequence asks for it, at doubled intervals.
        Raises LineError for a board that is silent for more than ``BUSY_S``.
        """
        wait_s = self.timeout_s
        while wait_s < BUSY_S:
            answer = self._receive(time.monotonic() + wait_s)
            if answer is None:
                self.line.write(b"\0" + encode_frame(self._sequence, 0, b""))
                wait_s *= 2.0
            elif not answer[0] & BUSY:
                return answer
        raise LineError("no answer from the board, which has said that it computes; see where it hangs")

    def _receive(self, end: float) -> tuple[int, bytes] | None:
        """Return flags and data of the frame with the current sequence, or None if none came in time."""
        while True:
            coded, zero, rest = self._received.partition(b"\0")
            if zero:
                self._received = bytearray(rest)
                frame = decode_frame(bytes(coded))
                if frame is not None and frame[1] & FIRST:
                    raise LineError("the line returns what is sent: is it the board's device, and is its echo off?")
                self.received_frames += frame is not None
                if frame is not None and frame[0] == self._sequence:
                    return frame[1], frame[2]
                continue
            left_s = end - time.monotonic()
            if left_s <= 0.0:
                return None
            arrived = self.line.read(left_s)
            self.received_bytes += len(arrived)
            self._received += arrived
            if b"\0" not in self._received and len(self._received) > MAX_CODED_BYTES:
                self._received.clear()
