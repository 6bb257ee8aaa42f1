"""A shared library with evalkit's C interface (``evalkit_backend.h``) as a back end: ``lib:./libmine.so``.

Its description is read in a separate process, so a crash while loading does not end evalkit.
"""

from __future__ import annotations

import ctypes
import json
import tempfile
import weakref
from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from evalkit.core.arrays import Ints
from evalkit.core.errors import BackendFailed, BackendRefused
from evalkit.core.loop_closure import LoopClosure
from evalkit.core.match import Iteration, Match
from evalkit.core.odometry_estimate import OdometryEstimate
from evalkit.core.pose import Pose
from evalkit.core.scan import Cloud, Frame
from evalkit.core.se2 import Floats
from evalkit.core.timing import Cost, Stopwatch
from evalkit.core.trajectory import Trajectory
from evalkit.execution.subprocesses import ChildProcess, signal_name
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
    undescribed_spec,
)
from evalkit.odometry.corrections import MAX_CLOSURES, find_unknown_stamp
from evalkit.plugins.parameters import Parameter, Value
from evalkit.plugins.specs import BackendSpec, OdometrySpec, RegistrationSpec, SlamSpec
from evalkit.results import descriptions

LOADING_S = 20.0
"""Time limit for loading a library and reading its description."""

GUARD = 0x5A5A_A5A5_C3C3_3C3C
"""The value after an answer, which a library may not change."""

TRACE = Parameter("trace", False, "", "record every iteration; costs time in the call")


def scheme(rest: str) -> BackendSpec:
    """Make the spec of ``lib:PATH [NAME=VALUE ...]``; the library declares its kind and its parameters."""
    name = f"lib:{rest}"
    path, *words = split_words(name, rest)
    file = Path(path).resolve()
    digest = compute_digest(file)
    if not file.is_file():
        what = "a folder, not a library" if file.is_dir() else "no such file"
        return missing_spec(name, f"{what}: {path}; build it, or correct its path", digest)
    if why := _find_unusable_reason(file):
        return broken_spec(name, why, digest)
    description = descriptions.describe(name, digest, partial(_describe_library, name, file))
    if description is None:
        return undescribed_spec(name, digest)
    try:
        own = (TRACE,) if description.get("kind") == RegistrationSpec.kind else ()
        declared = read_declaration(name, description, own)
    except BackendFailed as error:
        return broken_spec(name, "; ".join(error.args[1:]), digest)
    make = partial(_CLASS_OF_SPEC[declared.spec_type], name, file)
    return make_spec(declared, override_defaults(name, (*declared.parameters, *own), words), make, digest)


class LibraryRegistration:
    """A Registration: ``evalkit_register`` of a library."""

    def __init__(self, name: str, file: Path, /, *, trace: bool = False, **parameters: Value) -> None:
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
            start, guarded = _to_abi_pose(guess), abi.GuardedMatch(after=GUARD)
            answer = guarded.answer
            answer.target_from_source.x = np.nan  # detected if the library does not set it
            trace = abi.Trace(record) if self._trace else abi.Trace()
        self._instance.call(
            "evalkit_register", _to_pointer(onto), len(target), _to_pointer(points), len(source),
            ctypes.byref(start), trace, None, ctypes.byref(answer),
        )  # fmt: skip
        with conversion:
            self._instance.check_arguments(guarded, start, guess)
            pose = self._instance.check_pose(answer.target_from_source)
        return Match(
            pose, bool(answer.converged), answer.iterations, answer.error_m, answer.inliers, tuple(history),
            Cost(conversion.cpu_ns),
        )  # fmt: skip


class LibraryOdometry:
    """An Odometry: ``evalkit_update`` of a library."""

    def __init__(self, name: str, file: Path, /, **parameters: Value) -> None:
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


class LibrarySlam(LibraryOdometry):
    """A Slam: ``evalkit_trajectory`` and ``evalkit_loop_closures`` of a library."""

    def __init__(self, name: str, file: Path, /, **parameters: Value) -> None:
        super().__init__(name, file, **parameters)
        self._name = name
        self._stamps_ns: list[int] = []

    def update(self, frame: Frame) -> OdometryEstimate:
        """As ``LibraryOdometry.update``, with whether it corrected earlier poses, where the library tells."""
        estimate = super().update(frame)
        self._stamps_ns.append(frame.scan.stamp_ns)
        corrected = self._instance.ask("evalkit_corrected")
        return estimate if corrected is None else replace(estimate, corrected=bool(corrected))

    def trajectory(self) -> Trajectory:
        """Return the corrected poses; raises BackendFailed where the library reports an error or sets too few."""
        poses = np.full((len(self._stamps_ns), 3), np.nan)
        rows = poses.ctypes.data_as(ctypes.POINTER(abi.PoseStruct))
        self._instance.call("evalkit_trajectory", rows, len(poses))
        if not (finite := np.isfinite(poses).all(axis=1)).all():
            what = f"evalkit_trajectory set no finite pose at index {int(np.argmin(finite))} of {len(poses)}"
            raise BackendFailed(self._name, what, "write one pose for each frame that evalkit_update answered")
        return Trajectory(np.array(self._stamps_ns, dtype=np.int64), poses, "start", "base")

    def loop_closures(self) -> tuple[LoopClosure, ...]:
        """Return the library's loop closures, () where it reports none; raises BackendFailed for an invalid one."""
        count = self._instance.ask("evalkit_loop_closures", None, 0) or 0
        if count > MAX_CLOSURES:
            what = f"evalkit_loop_closures returned {count}, at most {MAX_CLOSURES} are stored"
            raise BackendFailed(self._name, what, "report fewer candidates")
        rows = (abi.LoopClosureStruct * count)()
        written = self._instance.ask("evalkit_loop_closures", rows, count) if count else 0
        try:
            found = tuple(_from_abi_closure(row) for row in rows[: min(written or 0, count)])
        except ValueError as error:
            raise BackendFailed(self._name, f"evalkit_loop_closures: {error}", "correct the loop closure") from None
        if unknown := find_unknown_stamp(found, self._stamps_ns):
            index, name, stamp_ns = unknown
            what = f"evalkit_loop_closures set {name} at index {index} to {stamp_ns}, which no answered scan has"
            raise BackendFailed(self._name, what, "set the stamps of two answered scans")
        again = [self._instance.ask("evalkit_found_again", index) for index in range(len(found))]
        return tuple(
            closure if each is None else replace(closure, found_again=bool(each))
            for closure, each in zip(found, again, strict=True)
        )


_CLASS_OF_SPEC: dict[type[BackendSpec], Callable[..., LibraryRegistration | LibraryOdometry]] = {
    RegistrationSpec: LibraryRegistration,
    OdometrySpec: LibraryOdometry,
    SlamSpec: LibrarySlam,
}


class _Texts:
    """Texts for a call. Once erased they are unreadable, but not freed: reading them later fails, and always so."""

    def __init__(self, texts: Iterable[str]) -> None:
        self._buffers = [ctypes.create_string_buffer(text.encode()) for text in texts]
        pointers = [ctypes.cast(one, ctypes.c_char_p) for one in self._buffers]
        self.array = (ctypes.c_char_p * len(pointers))(*pointers)

    def erase(self) -> None:
        """Overwrite the texts, and the pointers to them with NULL."""
        for index, buffer in enumerate(self._buffers):
            buffer.value = b"?" * len(buffer.value)
            self.array[index] = None


class Instance:
    """An instance made by ``evalkit_create``; ``evalkit_destroy`` is called when it is garbage-collected."""

    def __init__(self, name: str, file: Path, parameters: dict[str, Value]) -> None:
        self._name = name
        self._library = abi.load(name, file)
        self._names, self._values = _Texts(parameters), _Texts(map(format_value, parameters.values()))
        count = len(parameters)
        self._self: int | None = self._library.evalkit_create(self._names.array, self._values.array, count)
        self._names.erase()
        self._values.erase()
        if self._self is None:
            raise BackendFailed(name, f"evalkit_create returned NULL{self._last_error()}", "see what it needs")
        weakref.finalize(self, self._library.evalkit_destroy, self._self)

    def call(self, function: str, *arguments: object) -> None:
        """Call a function of the instance; raises BackendFailed with its last error where it returns an error code."""
        code = getattr(self._library, function)(self._self, *arguments)
        if code:
            what = f"{function} returned error {code}{self._last_error()}"
            raise BackendRefused(self._name, what, "see what it needs")

    def ask(self, function: str, *arguments: object) -> int | None:
        """Return the number that an optional function of the instance returns; None where the library lacks it."""
        found = getattr(self._library, function, None)
        return None if found is None else int(found(self._self, *arguments))

    def traced_pairs(self, most: int) -> Ints | None:
        """Return the pairs (K, 2) of the current iteration, at most ``most``; None where the library reports none."""
        find = getattr(self._library, "evalkit_pairs", None)
        count = ctypes.c_size_t()
        found = find(self._self, ctypes.byref(count)) if find is not None else None
        if not found or count.value > most:
            return None
        return np.array(found[: 2 * count.value], dtype=np.int64).reshape(-1, 2)

    def check_arguments(self, guarded: abi.GuardedMatch, start: abi.PoseStruct, guess: Pose) -> None:
        """Raise BackendFailed where the library wrote beyond its answer, or to the guess."""
        if guarded.after != GUARD:
            remedy = "compile it with the evalkit_backend.h of this evalkit, and write within *answer"
            raise BackendFailed(self._name, "evalkit_register wrote beyond its answer", remedy)
        if (start.x, start.y, start.theta) != (guess.x, guess.y, guess.theta):
            raise BackendFailed(self._name, "evalkit_register wrote to the guess, which is read-only", "use a copy")

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


def _describe_library(name: str, file: Path) -> dict[str, Any]:
    """Run ``abi.main`` on a library in a child process; return its description, or why it gives none."""
    with tempfile.TemporaryDirectory(prefix="evalkit-look-") as place:
        folder = Path(place)
        (folder / abi.REQUEST).write_text(json.dumps([name, str(file)]), encoding="utf-8")
        with ChildProcess(abi.__name__, folder) as child:
            late = any(used.exceeds(LOADING_S) for used in child.watch())
        if late:
            return {"failed": [f"was not loaded within {LOADING_S:g} s", "check its initialisation code"]}
        answer, code = folder / abi.ANSWER, child.returncode
        if code or not answer.exists():
            how = signal_name(-code) if code < 0 else f"code {code}"
            return {"failed": [f"loading it ended the process with {how}", "correct its initialisation code"]}
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


def _from_abi_closure(row: abi.LoopClosureStruct) -> LoopClosure:
    reason = (row.reason or b"").decode(errors="replace")
    motion = _from_abi_pose(row.other_from_base)
    return LoopClosure(row.stamp_ns, row.other_stamp_ns, motion, bool(row.accepted), reason)


def _from_abi_pose(row: abi.PoseStruct) -> Pose:
    return Pose(row.x, row.y, row.theta)
