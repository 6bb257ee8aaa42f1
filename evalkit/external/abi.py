"""ctypes declarations of the C interface in ``evalkit_backend.h``, and its check when a library is loaded."""

from __future__ import annotations

import contextlib
import ctypes
import json
import sys
from collections.abc import Iterator
from ctypes import CFUNCTYPE, POINTER, c_char_p, c_double, c_int32, c_int64, c_size_t, c_void_p
from pathlib import Path
from typing import ClassVar, Literal

from evalkit.core.errors import BackendFailed
from evalkit.execution.parent import end_with_parent

VERSION = 1

REQUEST, ANSWER = "request.json", "answer.json"
"""Files of ``main``: [name, file] of a library, and its description."""

KINDS: dict[int, Literal["registration", "odometry", "slam"]] = {1: "registration", 2: "odometry", 3: "slam"}


class PoseStruct(ctypes.Structure):
    """``evalkit_pose``."""

    _fields_: ClassVar = [("x", c_double), ("y", c_double), ("theta", c_double)]
    x: float
    y: float
    theta: float


class MatchStruct(ctypes.Structure):
    """``evalkit_match``."""

    _fields_: ClassVar = [
        ("target_from_source", PoseStruct), ("error_m", c_double),
        ("converged", c_int32), ("iterations", c_int32), ("inliers", c_int32),
    ]  # fmt: skip
    target_from_source: PoseStruct
    error_m: float
    converged: int
    iterations: int
    inliers: int


class GuardedMatch(ctypes.Structure):
    """An answer, and a value after it that a library may not change."""

    _fields_: ClassVar = [("answer", MatchStruct), ("after", c_int64)]
    answer: MatchStruct
    after: int


class FrameStruct(ctypes.Structure):
    """``evalkit_frame``."""

    _fields_: ClassVar = [
        ("stamp_ns", c_int64), ("time_increment_ns", c_int64),
        ("ranges", POINTER(c_double)), ("angles", POINTER(c_double)), ("beams", c_size_t),
        ("range_min_m", c_double), ("range_max_m", c_double),
        ("base_from_sensor", PoseStruct), ("odom_from_base", POINTER(PoseStruct)),
        ("start_from_end", POINTER(PoseStruct)),
    ]  # fmt: skip


class LoopClosureStruct(ctypes.Structure):
    """``evalkit_loop_closure``."""

    _fields_: ClassVar = [
        ("stamp_ns", c_int64), ("other_stamp_ns", c_int64), ("other_from_base", PoseStruct), ("accepted", c_int32),
        ("reason", c_char_p),
    ]  # fmt: skip
    stamp_ns: int
    other_stamp_ns: int
    other_from_base: PoseStruct
    accepted: int
    reason: bytes | None


Trace = CFUNCTYPE(None, c_void_p, c_double, c_int32, POINTER(PoseStruct))

_COMMON: dict[str, tuple[object, list[object]]] = {
    "evalkit_create": (c_void_p, [POINTER(c_char_p), POINTER(c_char_p), c_size_t]),
    "evalkit_destroy": (None, [c_void_p]),
}
_UPDATE: list[object] = [c_void_p, POINTER(FrameStruct), POINTER(PoseStruct)]
_CALLS: dict[str, dict[str, list[object]]] = {
    "registration": {
        "evalkit_register": [
            c_void_p, POINTER(c_double), c_size_t, POINTER(c_double), c_size_t, POINTER(PoseStruct), Trace, c_void_p,
            POINTER(MatchStruct),
        ],
    },
    "odometry": {"evalkit_update": _UPDATE},
    "slam": {"evalkit_update": _UPDATE, "evalkit_trajectory": [c_void_p, POINTER(PoseStruct), c_size_t]},
}  # fmt: skip
_OPTIONAL: dict[str, tuple[object, list[object]]] = {
    "evalkit_summary": (c_char_p, []),
    "evalkit_parameters": (c_char_p, []),
    "evalkit_last_error": (c_char_p, [c_void_p]),
    "evalkit_loop_closures": (c_size_t, [c_void_p, POINTER(LoopClosureStruct), c_size_t]),
    "evalkit_found_again": (c_int32, [c_void_p, c_size_t]),
    "evalkit_corrected": (c_int32, [c_void_p]),
    "evalkit_pairs": (POINTER(c_int32), [c_void_p, POINTER(c_size_t)]),
}


def load(name: str, file: Path) -> ctypes.CDLL:
    """Load a library and declare the types of its functions.

    Raises BackendFailed where the library does not fit the interface.
    """
    try:
        with _kept_arithmetic():
            library = ctypes.CDLL(str(file))
    except OSError as error:
        raise BackendFailed(name, f"does not load ({error})", "build it for this machine, with all it needs") from None
    _declare(name, library, "evalkit_abi", c_int32, [])
    if (found := library.evalkit_abi()) != VERSION:
        remedy = "compile it with the evalkit_backend.h of this evalkit"
        raise BackendFailed(name, f"has version {found} of the interface, expected {VERSION}", remedy)
    _declare(name, library, "evalkit_kind", c_int32, [])
    if (kind := library.evalkit_kind()) not in KINDS:
        remedy = "expected 1 (registration), 2 (odometry) or 3 (SLAM)"
        raise BackendFailed(name, f"evalkit_kind returned {kind}", remedy)
    for function, (result, arguments) in _COMMON.items():
        _declare(name, library, function, result, arguments)
    for call, arguments in _CALLS[KINDS[kind]].items():
        _declare(name, library, call, c_int32, arguments)
    for function, (result, arguments) in _OPTIONAL.items():
        if hasattr(library, function):
            _declare(name, library, function, result, arguments)
    return library


@contextlib.contextmanager
def _kept_arithmetic() -> Iterator[None]:
    """Keep this thread's floating-point controls through the loading of a library.

    One that is linked with -ffast-math flushes small numbers to zero in everything that runs beside it.
    """
    environment, libc = (ctypes.c_uint32 * 16)(), ctypes.CDLL(None)
    known = hasattr(libc, "fegetenv") and libc.fegetenv(ctypes.byref(environment)) == 0
    try:
        yield
    finally:
        if known:
            libc.fesetenv(ctypes.byref(environment))


def main() -> int:
    """Write the description of the library in the folder's ``REQUEST``, or why it is unusable, to ``ANSWER``."""
    end_with_parent()
    folder = Path(sys.argv[1]).resolve()  # a library may change the working directory
    name, file = json.loads((folder / REQUEST).read_text(encoding="utf-8"))
    try:
        library = load(name, Path(file))
        description: dict[str, object] = {
            "kind": KINDS[library.evalkit_kind()],
            "summary": _call_for_text(library, "evalkit_summary"),
            "parameters": _call_for_text(library, "evalkit_parameters"),
        }
    except BackendFailed as error:
        description = {"failed": error.args[1:]}
    (folder / ANSWER).write_text(json.dumps(description), encoding="utf-8")
    return 0


def _call_for_text(library: ctypes.CDLL, function: str) -> str:
    found = getattr(library, function, None)
    returned = found() if found is not None else None
    return returned.decode(errors="replace") if returned else ""


def _declare(name: str, library: ctypes.CDLL, function: str, result: object, arguments: list[object]) -> None:
    """Set the types of a function; raises BackendFailed if the library lacks it."""
    try:
        found = getattr(library, function)
    except AttributeError:
        remedy = 'declare it as in evalkit_backend.h (in C++ within extern "C")'
        raise BackendFailed(name, f"lacks the function {function}", remedy) from None
    found.restype, found.argtypes = result, arguments


if __name__ == "__main__":
    sys.exit(main())
