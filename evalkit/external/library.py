"""A shared library with evalkit's C interface (``evalkit_backend.h``) as a back end: ``lib:./libmine.so``.

What it is, is asked in a process of its own, so that a library that cannot even be loaded ends nobody but itself.
"""

from __future__ import annotations

import ctypes
import json
import subprocess
import sys
import tempfile
import weakref
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from evalkit.core.errors import BackendFailed
from evalkit.core.match import Iteration, Match
from evalkit.core.odometry_estimate import OdometryEstimate
from evalkit.core.pose import Pose
from evalkit.core.scan import Cloud, Frame
from evalkit.core.se2 import Floats
from evalkit.core.timing import Cost, Stopwatch
from evalkit.execution.parent_watch import signal_name
from evalkit.external import abi, elf
from evalkit.external.declaration import absent, broken, declaration, digest_of, listed, settings, spec, split, text
from evalkit.plugins.parameters import Parameter, Value
from evalkit.plugins.specs import BackendSpec, RegistrationSpec

LOOK_S = 20.0
"""How long loading a library and asking what it is may take."""

TRACE = Parameter("trace", False, "", "hear of every iteration; costs time in the call")


def scheme(rest: str) -> BackendSpec:
    """The back end ``lib:PATH [NAME=VALUE ...]``: a library of a kind and with parameters of its own telling."""
    name = f"lib:{rest}"
    path, *words = split(name, rest)
    file = Path(path).resolve()
    digest = digest_of(file)
    if not file.is_file():
        return absent(name, f"no such file: {file.name}; build it, or mend its path", digest)
    if why := _unfit(file):
        return broken(name, why, digest)
    try:
        declared = declaration(name, _asked(name, file, digest))
    except BackendFailed as error:
        return broken(name, "; ".join(error.args[1:]), digest)
    own = (TRACE,) if declared.spec_type is RegistrationSpec else ()
    make = LibraryRegistration if declared.spec_type is RegistrationSpec else LibraryOdometry
    return spec(declared, settings(name, (*declared.parameters, *own), words), partial(make, name, file), digest)


class LibraryRegistration:
    """A Registration: ``evalkit_register`` of a library."""

    def __init__(self, name: str, file: Path, *, trace: bool = False, **parameters: Value) -> None:
        self._instance = Instance(name, file, parameters)
        self._trace = trace

    def register(self, target: Cloud, source: Cloud, guess: Pose) -> Match:
        """The library's answer; BackendFailed where it reports an error or its answer is no pose."""
        history: list[Iteration] = []
        conversion = Stopwatch()

        def heard(_listener: object, error_m: float, inliers: int, pose: Any) -> None:
            history.append(Iteration(error_m, inliers, _pose(pose.contents)))

        with conversion:
            onto, points, start, answer = _flat(target.points), _flat(source.points), _row(guess), abi.Match()
            answer.target_from_source.x = np.nan  # to be noticed if it stays
            trace = abi.Trace(heard) if self._trace else abi.Trace()
        self._instance.call(
            "evalkit_register", _doubles(onto), len(target), _doubles(points), len(source),
            ctypes.byref(start), trace, None, ctypes.byref(answer),
        )  # fmt: skip
        with conversion:
            pose = self._instance.finite(answer.target_from_source)
        return Match(
            pose, bool(answer.converged), answer.iterations, answer.error_m, answer.inliers, tuple(history),
            Cost(conversion.cpu_ns),
        )  # fmt: skip


class LibraryOdometry:
    """An Odometry: ``evalkit_update`` of a library."""

    def __init__(self, name: str, file: Path, **parameters: Value) -> None:
        self._instance = Instance(name, file, parameters)

    def update(self, frame: Frame) -> OdometryEstimate:
        """The library's answer; BackendFailed where it reports an error or its answer is no pose."""
        conversion = Stopwatch()
        with conversion:
            scan = frame.scan
            ranges, angles = _flat(scan.ranges), _flat(scan.angles)
            question = abi.Frame(
                scan.stamp_ns, scan.time_increment_ns, _doubles(ranges), _doubles(angles), len(ranges),
                scan.range_min_m, scan.range_max_m, _row(frame.base_from_sensor),
                _reference(frame.odom_from_base), _reference(frame.start_from_end),
            )  # fmt: skip
            answer = abi.Pose(np.nan, np.nan, np.nan)  # to be noticed if it stays
        self._instance.call("evalkit_update", ctypes.byref(question), ctypes.byref(answer))
        with conversion:
            pose = self._instance.finite(answer)
        return OdometryEstimate(pose, cost=Cost(conversion.cpu_ns))


class Instance:
    """What ``evalkit_create`` made, freed when nobody holds it any more."""

    def __init__(self, name: str, file: Path, parameters: dict[str, Value]) -> None:
        self._name = name
        self._library = abi.load(name, file)
        names = (ctypes.c_char_p * len(parameters))(*(key.encode() for key in parameters))
        values = (ctypes.c_char_p * len(parameters))(*(text(setting).encode() for setting in parameters.values()))
        self._self: int | None = self._library.evalkit_create(names, values, len(parameters))
        if self._self is None:
            raise BackendFailed(name, f"evalkit_create gave NULL{self._said()}", "see what it needs")
        weakref.finalize(self, self._library.evalkit_destroy, self._self)

    def call(self, function: str, *arguments: object) -> None:
        """Calls a function of the instance; BackendFailed with its own words where it answers a code."""
        code = getattr(self._library, function)(self._self, *arguments)
        if code:
            raise BackendFailed(self._name, f"{function} answered error {code}{self._said()}", "see what it needs")

    def finite(self, row: abi.Pose) -> Pose:
        """The pose of an answer; BackendFailed where it is none."""
        if not np.isfinite([row.x, row.y, row.theta]).all():
            found = f"reported success with a pose that is not finite: ({row.x}, {row.y}, {row.theta})"
            raise BackendFailed(self._name, found, "fill in the answer; where there is none better, the guess")
        return _pose(row)

    def _said(self) -> str:
        last_error = getattr(self._library, "evalkit_last_error", None)
        said = last_error(self._self) if last_error is not None else None
        return f": {said.decode(errors='replace')[:300]}" if said else ""


@cache
def _asked(name: str, file: Path, _digest: str) -> dict[str, Any]:
    """What ``abi.main`` says of a library in a process of its own; the digest tells one build from the next."""
    nowhere = subprocess.DEVNULL  # a library may print without end
    with tempfile.TemporaryDirectory(prefix="evalkit-look-") as place:
        answer = Path(place) / "answer.json"
        command = [sys.executable, "-P", "-m", abi.__name__, name, str(file), str(answer)]
        try:
            code = subprocess.run(
                command, stdin=nowhere, stdout=nowhere, stderr=nowhere, timeout=LOOK_S, check=False
            ).returncode
        except subprocess.TimeoutExpired:
            return {"failed": (f"was not loaded within {LOOK_S:g} s", "see what it does when loaded")}
        if code or not answer.exists():
            how = signal_name(-code) if code < 0 else f"code {code}"
            return {"failed": (f"loading it ended the process with {how}", "mend what it does when loaded")}
        said: dict[str, Any] = json.loads(answer.read_bytes())
    return said if "failed" in said else said | {"parameters": listed(said["parameters"])}


def _unfit(file: Path) -> str:
    try:
        why = elf.unfit(file, library=True)
    except OSError as error:
        why = f"cannot be read ({error.strerror})"
    return f"{file.name} {why}; build it as a shared library on this machine" if why else ""


def _flat(array: Floats) -> Floats:
    return np.ascontiguousarray(array, dtype=np.float64)


def _doubles(array: Floats) -> Any:
    return array.ctypes.data_as(ctypes.POINTER(ctypes.c_double))


def _row(pose: Pose) -> abi.Pose:
    return abi.Pose(pose.x, pose.y, pose.theta)


def _reference(pose: Pose | None) -> Any:
    return None if pose is None else ctypes.pointer(_row(pose))


def _pose(row: abi.Pose) -> Pose:
    return Pose(row.x, row.y, row.theta)
