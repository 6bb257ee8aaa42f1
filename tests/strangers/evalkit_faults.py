"""Third-party plug-ins, one for each fault that evalkit must survive, and a tiny sequence to run them on."""

from __future__ import annotations

import ctypes
import math
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

import numpy as np
import psutil

from evalkit.core.errors import DataMissing
from evalkit.core.grid import OccupancyGrid
from evalkit.core.ground_truth import Truth
from evalkit.core.odometry_estimate import OdometryEstimate
from evalkit.core.pose import Pose
from evalkit.core.scan import Frame, Scan
from evalkit.core.trajectory import Trajectory
from evalkit.plugins.parameters import Parameter
from evalkit.plugins.specs import DatasetSpec, MapperSpec, OdometrySpec

STEP_M = 0.1
STEP_NS = 100_000_000


class NoPose(Pose):
    """A pose without validation."""

    def __post_init__(self) -> None:
        """Skip the validation."""


def _spin() -> None:
    while True:
        math.sqrt(2.0)


def _leak() -> None:
    kept = []
    while True:
        kept.append(np.ones(1_000_000))
        time.sleep(0.01)


def _sleeper(own_session: bool = False) -> None:
    """Start a sleeping child, with the run's folder on its command line so that it can be found."""
    command = [sys.executable, "-c", "import time; time.sleep(600)", sys.argv[-1]]
    subprocess.Popen(command, start_new_session=own_session)


def _daemon() -> None:
    """Start a grandchild in its own session whose parent ends at once."""
    if os.fork() == 0:
        _sleeper(own_session=True)
        os._exit(0)
    os.wait()
    time.sleep(600)


def _hold() -> None:
    """Wait in C without releasing the interpreter lock."""
    ctypes.PyDLL(None).sleep(600)


def _spin_in_child() -> None:
    subprocess.run([sys.executable, "-c", "while True: pass", sys.argv[-1]], check=True)


def _leak_in_child() -> None:
    leak = "import time\nkept = []\nwhile True: kept.append(b'x' * 8_000_000); time.sleep(0.01)"
    subprocess.run([sys.executable, "-c", leak, sys.argv[-1]], check=True)


def _flood() -> None:
    """Print 40 MiB of output and raise."""
    for _ in range(40):
        os.write(1, b"the wheel squeaks " * 58_254 + b"\n")
        time.sleep(0.01)
    os.write(2, b"the wheel is off\n")
    os._exit(9)


def _hide() -> None:
    """Leave a process without a parent here, in its own session, with an empty environment and a plain name."""
    middle = os.fork()
    if middle == 0:
        os.setsid()
        hidden = os.fork()
        if hidden:
            (Path(sys.argv[-1]) / "hidden.pid").write_text(str(hidden))
            os._exit(0)
        os.chdir("/")
        os.execve("/bin/sleep", ["sleep", "600"], {})
    os.waitpid(middle, 0)


def _kill_supervisor() -> None:
    """Kill the process between this one and evalkit; the system ends this one too."""
    os.kill(os.getppid(), signal.SIGKILL)
    time.sleep(600)


def _hide_and_exit() -> None:
    _hide()
    os._exit(9)


def _child() -> None:
    _sleeper()
    _sleeper(own_session=True)
    time.sleep(600)


def _orphan() -> None:
    _sleeper()
    raise RuntimeError("left a child behind")


def _garbage() -> None:
    os.write(1, b"\xff\xfe\x00garbage\x1b[31m\n" * 100_000)
    os.write(2, b"\x1b[2J the wheel is off \x07\n")
    os._exit(9)


def _remove_folder() -> None:
    shutil.rmtree(Path(sys.argv[-1]))


def _forge() -> None:
    """Overwrite the outcome of the run."""
    (Path(sys.argv[-1]) / "outcome.json").write_text('{"notes": ' + "[" * 100_000)
    time.sleep(600)


def _claim_interruption() -> None:
    """Say that the machine ended the run, which would be made again for nothing."""
    (Path(sys.argv[-1]) / "outcome.json").write_text('{"cause": "interrupted", "reason": "not my fault"}')
    os._exit(0)


def _claim_numbers() -> None:
    """Say that more was done, in numbers out of range, and end."""
    forged = '{"cause": "completed", "expected": -5, "every": -1, "peak_memory_bytes": -7, "notes": {"a": [1]}'
    (Path(sys.argv[-1]) / "outcome.json").write_text(forged + ', "remarks": [1]}')
    os._exit(0)


def _scribble() -> None:
    """Append bytes of its own to the answers."""
    with (Path(sys.argv[-1]) / "steps.bin").open("ab") as file:
        file.write(b"\xff" * 1000)
    os._exit(9)


def _swell() -> None:
    """Make the file of the answers larger than any memory."""
    os.truncate(Path(sys.argv[-1]) / "steps.bin", 2**41)
    os._exit(9)


def _plant_pipe() -> None:
    """Replace the outcome of the run by a pipe that nobody writes to."""
    os.mkfifo(Path(sys.argv[-1]) / "outcome.json")
    time.sleep(600)


def _plant_links() -> None:
    """Replace the run's output and outcome by links to a file beside its folder, and write more than fits."""
    folder = Path(sys.argv[-1])
    (folder / "output.txt").unlink()
    for name in ("output.txt", "outcome.json", "result.json", "steps.bin.part", "outcome.json.part"):
        (folder / name).unlink(missing_ok=True)
        (folder / name).symlink_to(folder.parent / "victim.txt")
    _flood()


def _exhaust() -> None:
    raise MemoryError("cannot allocate 7 TiB")


def _linger() -> None:
    threading.Thread(target=time.sleep, args=(600,)).start()


def _fail() -> None:
    raise RuntimeError("lost the plot")


FAULTS: dict[str, Callable[[], object]] = {
    "none": lambda: None,
    "segfault": lambda: ctypes.string_at(0),
    "sigkill": lambda: os.kill(os.getpid(), signal.SIGKILL),
    "unnamed-signal": lambda: os.kill(os.getpid(), signal.SIGRTMIN + 5),
    "kill-parent": lambda: os.kill(psutil.Process(os.getppid()).ppid(), signal.SIGKILL),  # above the supervisor
    "kill-supervisor": _kill_supervisor,
    "hidden": _hide,
    "hidden-exit": _hide_and_exit,
    "wait": lambda: time.sleep(0.3),
    "abort": os.abort,
    "exit": lambda: os._exit(3),
    "sys-exit": lambda: sys.exit(0),
    "raise": _fail,
    "memory-error": _exhaust,
    "hang": lambda: time.sleep(600),
    "spin": _spin,
    "leak": _leak,
    "hold": _hold,
    "daemon": _daemon,
    "spin-in-child": _spin_in_child,
    "leak-in-child": _leak_in_child,
    "flood": _flood,
    "matrix": lambda: np.eye(3),
    "nan": lambda: Pose(math.nan, 0.0, 0.0),
    "unchecked-nan": lambda: NoPose(math.nan, 0.0, 0.0),
    "no-pose": lambda: (1.0, 2.0, 3.0),
    "child": _child,
    "orphan": _orphan,
    "garbage": _garbage,
    "chdir": lambda: os.chdir("/"),
    "remove-folder": _remove_folder,
    "forge": _forge,
    "claim-interruption": _claim_interruption,
    "claim-numbers": _claim_numbers,
    "scribble": _scribble,
    "swell": _swell,
    "pipe": _plant_pipe,
    "links": _plant_links,
    "linger": _linger,
    "far": lambda: Pose(1e6, -1e6, 1.0),
    "farthest": lambda: Pose(1e300, -1e300, 1.0),
}


class Faulty:
    """An Odometry with correct poses until its fault occurs at scan number ``at`` (from 0)."""

    def __init__(self, fault: str, at: int) -> None:
        self._fault, self._at, self._seen = FAULTS[fault], at, 0

    def update(self, frame: Frame) -> object:
        """Return the pose, or the faulty answer."""
        self._seen += 1
        answer = self._fault() if self._seen > self._at else None
        if answer is None:
            answer = Pose((self._seen - 1) * STEP_M, 0.0, 0.0)
        return OdometryEstimate(answer) if isinstance(answer, Pose) else answer


class Lots:
    """An Odometry with random poses."""

    def __init__(self) -> None:
        self._drawn = np.random.default_rng()
        self._begun = False

    def update(self, frame: Frame) -> OdometryEstimate:
        """Return a random pose within 40 cm of the start."""
        pose = Pose(*self._drawn.uniform(-0.2, 0.2, 2), 0.0) if self._begun else Pose()
        self._begun = True
        return OdometryEstimate(pose)


class Straight:
    """Scans of a box of 8 x 4 m from a base that moves 0.1 m per scan along x.

    ``backwards``: the number of a scan with a stamp before that of the previous one; 0: none. ``file``: must exist.
    ``reads_until``: a file; indexing the recording ends once it exists, or after two minutes.
    """

    def __init__(self, scans: int, backwards: int, file: str, breaks: bool, reads_until: str = "") -> None:
        end_s = time.monotonic() + 120.0
        while reads_until and not Path(reads_until).exists() and time.monotonic() < end_s:
            time.sleep(0.01)
        if gone := _gone(file):
            raise DataMissing("straight", gone, "bring it back")
        self._stamps = np.arange(scans) * STEP_NS
        self._given = self._stamps.copy()
        if backwards:
            self._given[backwards] = 0
        self._breaks = breaks

    def __len__(self) -> int:
        return len(self._stamps)

    def frames(self) -> Iterator[Frame]:
        """Return the frames."""
        angles = np.linspace(-math.pi, math.pi, 72, endpoint=False)
        for index, stamp in enumerate(self._given.tolist()):
            x = 1.0 + index * STEP_M
            with np.errstate(divide="ignore"):
                along = np.where(np.cos(angles) > 0, 8.0 - x, x) / np.abs(np.cos(angles))
                aside = 2.0 / np.abs(np.sin(angles))
            scan = Scan(stamp, np.minimum(along, aside), angles, 0.1, 20.0)
            yield Frame(scan, odom_from_base=Pose(index * STEP_M, 0.0, 0.0))

    def truth(self) -> Truth:
        """Return the exact trajectory."""
        if self._breaks:
            raise RuntimeError("the truth is out there")
        poses = np.zeros((len(self), 3))
        poses[:, 0] = 1.0 + np.arange(len(self)) * STEP_M
        return Truth("exact", Trajectory(self._stamps, poses))

    def notes(self) -> Mapping[str, int]:
        """Return no notes."""
        return {}


def _gone(file: str, **_others: object) -> str:
    return f"{file} is gone" if file and not Path(file).exists() else ""


class FaultyMapper:
    """A Mapper of one empty cell that raises or ends its process."""

    def __init__(self, fault: str, only_past_m: float) -> None:
        self._fault, self._only_past_m = FAULTS[fault], only_past_m

    def update(self, scan: Scan, world_from_sensor: Pose) -> None:
        """Fail at a pose beyond ``only_past_m``."""
        if world_from_sensor.x > self._only_past_m:
            self._fault()

    def grid(self) -> OccupancyGrid:
        """Return one cell."""
        return OccupancyGrid(np.zeros((1, 1), dtype=np.float32), np.zeros((1, 1), dtype=np.bool_), 0.05, 0.0, 0.0)


FAULT = Parameter("fault", "none", "", "what goes wrong", choices=tuple(FAULTS))

FAULTY = OdometrySpec(
    make=Faulty,
    summary="fails in the way set by its parameter",
    citation="Murphy",
    licence="MIT",
    parameters=(FAULT, Parameter("at", 8, "scans", "after how many good answers", low=0)),
)

LOTS = OdometrySpec(
    make=Lots,
    summary="draws lots",
    citation="Murphy",
    licence="MIT",
)

ABSENT = OdometrySpec(
    make=Faulty,
    summary="needs what is not here",
    citation="Murphy",
    licence="MIT",
    missing=lambda: "the library 'nowhere' is not installed; pip install nowhere",
)

MAPPER = MapperSpec(
    make=FaultyMapper,
    summary="fails in the way set by its parameter",
    citation="Murphy",
    licence="MIT",
    parameters=(FAULT, Parameter("only_past_m", -1e9, "m", "goes wrong where x is greater")),
)

STRAIGHT = DatasetSpec(
    make=Straight,
    summary="a straight drive through a box",
    sensor="72 beams",
    truth="exact",
    citation="Murphy",
    licence="MIT",
    parameters=(
        Parameter("scans", 12, "", "how many", low=1),
        Parameter("backwards", 0, "", "which scan has a stamp before the others; 0: none", low=0),
        Parameter("file", "", "", "a file that must be there"),
        Parameter("breaks", False, "", "whether the truth cannot be read"),
        Parameter("reads_until", "", "", "a file: it has been looked through once this exists"),
    ),
    missing=_gone,
)
