"""Typed tasks: a module-level function with its arguments, and a key that identifies the result."""

from __future__ import annotations

import hashlib
import json
import re
import time
import traceback
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field, is_dataclass, replace
from functools import cache
from inspect import signature
from typing import Any, Generic, ParamSpec, TypeVar

from evalkit.plugins.code_hash import hash_code

Result = Mapping[str, Any]
"""What every task returns: JSON values, and NumPy arrays at the top level. Narrower types are ``TypedDict`` classes."""

Parameters = ParamSpec("Parameters")
R = TypeVar("R", bound=Result)
R_co = TypeVar("R_co", bound=Result, covariant=True)


@dataclass(frozen=True)
class Task(Generic[R_co]):
    """One computation: ``function(**arguments)``, run in any process that can import the function.

    Build it with ``make_task``, which checks the arguments' types. The arguments are JSON values, dataclasses of such
    values, and module-level functions. ``name`` identifies the result among those of one call of ``run_tasks``.
    ``modules``: modules that the result depends on and that the function's module does not import, such as plug-ins.
    ``limit_s``: wall clock time, after which the task's process is ended; 0 for no limit. ``own_process``: whether the
    function only starts a process and watches it, so that it needs no other one.
    """

    name: str
    function: Callable[..., R_co]
    arguments: Mapping[str, Any] = field(default_factory=dict)
    modules: tuple[str, ...] = ()
    limit_s: float = 0.0
    own_process: bool = False

    def __post_init__(self) -> None:
        if not function_name(self.function).partition(":")[2].isidentifier():
            raise ValueError(f"task '{self.name}': {self.function!r} is no function at the top level of a module")

    @property
    def key(self) -> str:
        """The stem of the result's file name; it changes with everything that can change the result."""
        name = function_name(self.function)
        code = _hash_code((name.partition(":")[0], *self.modules))
        identity = json.dumps([name, dict(self.arguments), code], sort_keys=True, default=_argument_as_json)
        word = re.sub(r"[^\w.=+-]+", "-", self.name)[:80].strip("-.") or "task"
        word = word.encode()[:80].decode(errors="ignore")  # file systems limit names in bytes
        return f"{word}-{hashlib.sha256(identity.encode()).hexdigest()[:12]}"

    def depending_on(self, *modules: str) -> Task[R_co]:
        """The same task with further modules that the result depends on."""
        return replace(self, modules=(*self.modules, *modules))

    def with_limit(self, limit_s: float) -> Task[R_co]:
        """The same task with a limit of wall clock time."""
        return replace(self, limit_s=limit_s)

    def run(self) -> tuple[R_co, float]:
        """Compute the result in this process; return the result and the seconds it took.

        An exception of the function carries its traceback as a note, which survives the way between processes.
        """
        started = time.perf_counter()
        try:
            result = self.function(**self.arguments)
        except Exception as error:
            error.add_note(traceback.format_exc())
            raise
        return result, time.perf_counter() - started


AnyTask = Task[Result]


def make_task(
    name: str, function: Callable[Parameters, R], /, *args: Parameters.args, **kwargs: Parameters.kwargs
) -> Task[R]:
    """The task that calls a module-level function with these arguments.

    Raises TypeError if the arguments do not fit the function, ValueError if it is not at the top level of a module.
    """
    return Task(name, function, dict(signature(function).bind(*args, **kwargs).arguments))


def function_name(function: Callable[..., object]) -> str:
    """A function's place as "module:name"."""
    return f"{function.__module__}:{function.__qualname__}"


def _argument_as_json(value: object) -> object:
    """The JSON form of an argument that ``json`` cannot encode."""
    if is_dataclass(value) and not isinstance(value, type):
        return asdict(value)
    if callable(value):
        return function_name(value)
    raise TypeError(f"an argument of a task is a {type(value).__name__}, expected JSON values, dataclasses, functions")


@cache  # hundreds of tasks depend on the same sources
def _hash_code(modules: tuple[str, ...]) -> str:
    return hash_code(modules, ("numpy", "scipy"))
