"""A shared library with evalkit's C interface (``evalkit_backend.h``) as a back end: ``lib:./libmine.so``.

Its description is read in a separate process, so a crash while loading does not end evalkit.
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

from evalkit.core.arrays import Ints
from evalkit.core.errors import BackendFailed
from evalkit.core.match import Iteration, Match
from evalkit.core.odometry_estimate import OdometryEstimate
from evalkit.core.pose import Pose
from evalkit.core.scan import Cloud, Frame
from evalkit.core.se2 import Floats
from evalkit.core.timing import Cost, Stopwatch
from evalkit.execution.subprocesses import signal_name
from evalkit.external import abi, elf
from evalkit.external.declaration import (
    broken_spec,
    compute_digest,
    format_value,
    make_spec,
    missing_spec,
    override_defaults,
    parse_parameter_lines,
    read_declaration,
    split_words,
)
from evalkit.plugins.parameters import Parameter, Value
from evalkit.plugins.specs import BackendSpec, RegistrationSpec

LOADING_S = 20.0
"""Time limit for loading a library and reading its description."""

TRACE = Parameter("trace", False, "", "record every iteration; costs time in the call")


def scheme(rest: str) -> BackendSpec:
    """Make the spec of ``lib:PATH [NAME=VALUE ...]``; the library declares its kind and its parameters."""
    name = f"lib:{rest}"
    path, *words = split_words(name, rest)
    file = Path(path).resolve()
    digest = compute_digest(file)
    if not file.is_file():
        return missing_spec(name, f"no such file: {file.name}; build it, or correct its path", digest)
    if why := _find_unusable_reason(file):
        return broken_spec(name, why, digest)
    try:
        declared = read_declaration(name, _describe_library(name, file, digest))
    except BackendFailed as error:
        return broken_spec(name, "; ".join(error.args[1:]), digest)
    own = (TRACE,) if declared.spec_type is RegistrationSpec else ()
    make = LibraryRegistration if declared.spec_type is RegistrationSpec else LibraryOdometry
    return make_spec(
        declared, override_defaults(name, (*declared.parameters, *own), words), partial(make, name, file), digest
    )


class LibraryRegistration:
    """A Registration: ``evalkit_register`` of a library."""

    def __init__(self, name: str, file: Path, *, trace: bool = False, **parameters: Value) -> None:
        self._instance = Instance(name, file, parameters)
        self._trace = trace

    def register(self, target: Cloud, source: Cloud, guess: Pose) -> Match:
        """Register with the library; raises BackendFailed where it reports an error or its pose is not finite."""
        history: list[Iteration] = []
        conversion = Stopwatch()

        def record(_listener: object, error_m: float, inliers: int, pose: Any) -> None:
            pairs = self._instance.traced_pairs(len(source))
            history.append(Iteration(error_m, inliers, _from_abi_pose(pose.contents), pairs))

        with conversion:
            onto, points = _to_contiguous(target.points), _to_contiguous(source.points)
            start, answer = _to_abi_pose(guess), abi.MatchStruct()
            answer.target_from_source.x = np.nan  # detected if the library does not set it
            trace = abi.Trace(record) if self._trace else abi.Trace()
        self._instance.call(
            "evalkit_register", _to_pointer(onto), len(target), _to_pointer(points), len(source),
            ctypes.byref(start), trace, None, ctypes.byref(answer),
        )  # fmt: skip
        with conversion:
            pose = self._instance.check_pose(answer.target_from_source)
        return Match(
            pose, bool(answer.converged), answer.iterations, answer.error_m, answer.inliers, tuple(history),
            Cost(conversion.cpu_ns),
        )  # fmt: skip


class LibraryOdometry:
    """An Odometry: ``evalkit_update`` of a library."""

    def __init__(self, name: str, file: Path, **parameters: Value) -> None:
        self._instance = Instance(name, file, parameters)

    def update(self, frame: Frame) -> OdometryEstimate:
        """Process one scan; raises BackendFailed where the library reports an error or its pose is not finite."""
        conversion = Stopwatch()
        with conversion:
            scan = frame.scan
            ranges, angles = _to_contiguous(scan.ranges), _to_contiguous(scan.angles)
            question = abi.FrameStruct(
                scan.stamp_ns, scan.time_increment_ns, _to_pointer(ranges), _to_pointer(angles), len(ranges),
                scan.range_min_m, scan.range_max_m, _to_abi_pose(frame.base_from_sensor),
                _to_pose_pointer(frame.odom_from_base), _to_pose_pointer(frame.start_from_end),
            )  # fmt: skip
            answer = abi.PoseStruct(np.nan, np.nan, np.nan)  # detected if the library does not set it
        self._instance.call("evalkit_update", ctypes.byref(question), ctypes.byref(answer))
        with conversion:
            pose = self._instance.check_pose(answer)
        return OdometryEstimate(pose, cost=Cost(conversion.cpu_ns))


class Instance:
    """An instance made by ``evalkit_create``; ``evalkit_destroy`` is called when it is garbage-collected."""

    def __init__(self, name: str, file: Path, parameters: dict[str, Value]) -> None:
        self._name = name
        self._library = abi.load(name, file)
        names = (ctypes.c_char_p * len(parameters))(*(key.encode() for key in parameters))
        values = (ctypes.c_char_p * len(parameters))(
            *(format_value(setting).encode() for setting in parameters.values())
        )
        self._self: int | None = self._library.evalkit_create(names, values, len(parameters))
        if self._self is None:
            raise BackendFailed(name, f"evalkit_create returned NULL{self._last_error()}", "see what it needs")
        weakref.finalize(self, self._library.evalkit_destroy, self._self)

    def call(self, function: str, *arguments: object) -> None:
        """Call a function of the instance; raises BackendFailed with its last error where it returns an error code."""
        code = getattr(self._library, function)(self._self, *arguments)
        if code:
            raise BackendFailed(
                self._name, f"{function} returned error {code}{self._last_error()}", "see what it needs"
            )

    def traced_pairs(self, most: int) -> Ints | None:
        """Return the pairs (K, 2) of the current iteration, at most ``most``; None where the library reports none."""
        find = getattr(self._library, "evalkit_pairs", None)
        count = ctypes.c_size_t()
        found = find(self._self, ctypes.byref(count)) if find is not None else None
        if not found or count.value > most:
            return None
        return np.array(found[: 2 * count.value], dtype=np.int64).reshape(-1, 2)

    def check_pose(self, row: abi.PoseStruct) -> Pose:
        """Return the pose of an answer; raises BackendFailed where it is not finite."""
        if not np.isfinite([row.x, row.y, row.theta]).all():
            found = f"reported success with a pose that is not finite: ({row.x}, {row.y}, {row.theta})"
            raise BackendFailed(self._name, found, "set the pose of the answer; without a better one, to the guess")
        return _from_abi_pose(row)

    def _last_error(self) -> str:
        last_error = getattr(self._library, "evalkit_last_error", None)
        message = last_error(self._self) if last_error is not None else None
        return f": {message.decode(errors='replace')[:300]}" if message else ""


@cache
def _describe_library(name: str, file: Path, _digest: str) -> dict[str, Any]:
    """Run ``abi.main`` on a library in a separate process; the digest distinguishes builds in the cache."""
    nowhere = subprocess.DEVNULL  # the output of a library is unbounded
    with tempfile.TemporaryDirectory(prefix="evalkit-look-") as place:
        answer = Path(place) / "answer.json"
        command = [sys.executable, "-P", "-m", abi.__name__, name, str(file), str(answer)]
        try:
            code = subprocess.run(
                command, stdin=nowhere, stdout=nowhere, stderr=nowhere, timeout=LOADING_S, check=False
            ).returncode
        except subprocess.TimeoutExpired:
            return {"failed": (f"was not loaded within {LOADING_S:g} s", "check its initialisation code")}
        if code or not answer.exists():
            how = signal_name(-code) if code < 0 else f"code {code}"
            return {"failed": (f"loading it ended the process with {how}", "correct its initialisation code")}
        content: dict[str, Any] = json.loads(answer.read_bytes())
    return content if "failed" in content else content | {"parameters": parse_parameter_lines(content["parameters"])}


def _find_unusable_reason(file: Path) -> str:
    try:
        why = elf.find_unusable_reason(file, library=True)
    except OSError as error:
        why = f"cannot be read ({error.strerror})"
    return f"{file.name} {why}; build it as a shared library on this machine" if why else ""


def _to_contiguous(array: Floats) -> Floats:
    return np.ascontiguousarray(array, dtype=np.float64)


def _to_pointer(array: Floats) -> Any:
    return array.ctypes.data_as(ctypes.POINTER(ctypes.c_double))


def _to_abi_pose(pose: Pose) -> abi.PoseStruct:
    return abi.PoseStruct(pose.x, pose.y, pose.theta)


def _to_pose_pointer(pose: Pose | None) -> Any:
    return None if pose is None else ctypes.pointer(_to_abi_pose(pose))


def _from_abi_pose(row: abi.PoseStruct) -> Pose:
    return Pose(row.x, row.y, row.theta)
