"""Record which functions one scan calls: the data behind the flow charts of Figures 2 to 5."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from types import FrameType
from typing import Any

from evalkit.core.scan import Frame
from evalkit.odometry import frontend
from evalkit.plugins import registry

RECORDED = frozenset(
    {
        "evalkit.odometry.frontend", "evalkit.odometry.local_map", "evalkit_baselines.paper.association",
        "evalkit_baselines.paper.grid",
        "evalkit_baselines.paper.icp",
    }
)  # fmt: skip
"""Modules whose function calls are recorded; calls made through other modules are attributed to the caller."""


@dataclass
class TracedCall:
    """One recorded call: qualified function name, stage of the front end, and nested calls."""

    name: str
    stage: str = ""
    calls: list[TracedCall] = field(default_factory=list)

    @property
    def key(self) -> str:
        """Name and stage."""
        return f"{self.name} {self.stage}".rstrip()

    def walk(self) -> Iterator[TracedCall]:
        """This call and all nested calls, in calling order."""
        yield self
        for call in self.calls:
            yield from call.walk()

    def to_json(self) -> dict[str, Any]:
        """Convert to JSON values."""
        return {"name": self.name, "stage": self.stage, "calls": [call.to_json() for call in self.calls]}

    @classmethod
    def from_json(cls, to_json: Mapping[str, Any]) -> TracedCall:
        """Read a call from the JSON values of ``to_json``."""
        return cls(to_json["name"], to_json["stage"], [cls.from_json(call) for call in to_json["calls"]])


def record_calls(action: Callable[[], object]) -> TracedCall:
    """Run an action and return its calls as a tree below a nameless root."""
    root = TracedCall("")
    open_calls: list[TracedCall | None] = [root]

    def on_event(frame: FrameType, event: str, _argument: object) -> None:
        if event == "call":
            call = _recorded_call(frame)
            if call is not None:
                next(each for each in reversed(open_calls) if each is not None).calls.append(call)
            open_calls.append(call)
        elif event == "return" and len(open_calls) > 1:
            open_calls.pop()

    before = sys.getprofile()
    sys.setprofile(on_event)
    try:
        action()
    finally:
        sys.setprofile(before)
    return root


def _recorded_call(frame: FrameType) -> TracedCall | None:
    name = frame.f_code.co_qualname
    if frame.f_globals.get("__name__") not in RECORDED or "<" in name or name.endswith(("__init__", "__post_init__")):
        return None
    return TracedCall(name, str(frame.f_locals.get("stage", "")) if name == "FrontEnd._register" else "")


def trace_drive(
    *, sequence: Mapping[str, Any], parameters: Mapping[str, Any], mapper: Mapping[str, Any]
) -> dict[str, Any]:  # fmt: skip
    """Calls of one scan of a drive through the laboratory: the scan that called the most different functions.

    Keys: "scan", its number; "calls", the tree of ``TracedCall`` of the front end, then of the mapper.
    """
    lab = registry.dataset("lab").make(**sequence)
    spec = registry.backend("paper")
    odometry = frontend.make_odometry(spec, frontend.complete_parameters("paper", spec, parameters))
    drawn = registry.mapper("log-odds").make(**mapper)

    def scan(frame: Frame) -> None:
        start_from_base = odometry.update(frame).pose
        deskewed = frame.scan.deskewed(frame.base_from_sensor, frame.start_from_end)
        drawn.update(deskewed, start_from_base @ frame.base_from_sensor)

    found = [record_calls(lambda frame=frame: scan(frame)) for frame in lab.frames()]  # type: ignore[misc]  # bound now
    best = max(range(len(found)), key=lambda index: len({call.key for call in found[index].walk()}))
    return {"scan": best, "calls": found[best].to_json()}
