"""Which stages a scan goes through, recorded from the running code: what Figures 2 to 5 are drawn from."""

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
"""Calls of functions of these modules are recorded; what others call counts as called by those that called them."""


@dataclass
class Call:
    """A function that ran: its name within its module, of which stage of the front end, and what it called in turn."""

    name: str
    stage: str = ""
    calls: list[Call] = field(default_factory=list)

    @property
    def key(self) -> str:
        """Name and stage."""
        return f"{self.name} {self.stage}".rstrip()

    def within(self) -> Iterator[Call]:
        """This call and all below it, in the order they began."""
        yield self
        for call in self.calls:
            yield from call.within()

    def told(self) -> dict[str, Any]:
        """As JSON values."""
        return {"name": self.name, "stage": self.stage, "calls": [call.told() for call in self.calls]}

    @classmethod
    def read(cls, told: Mapping[str, Any]) -> Call:
        """The call ``told`` tells of."""
        return cls(told["name"], told["stage"], [cls.read(call) for call in told["calls"]])


def recorded(action: Callable[[], object]) -> Call:
    """What an action calls, as a tree below a nameless root."""
    root = Call("")
    open_calls: list[Call | None] = [root]

    def hear(frame: FrameType, event: str, _argument: object) -> None:
        if event == "call":
            call = _call(frame)
            if call is not None:
                next(each for each in reversed(open_calls) if each is not None).calls.append(call)
            open_calls.append(call)
        elif event == "return" and len(open_calls) > 1:
            open_calls.pop()

    before = sys.getprofile()
    sys.setprofile(hear)
    try:
        action()
    finally:
        sys.setprofile(before)
    return root


def _call(frame: FrameType) -> Call | None:
    name = frame.f_code.co_qualname
    if frame.f_globals.get("__name__") not in RECORDED or "<" in name or name.endswith(("__init__", "__post_init__")):
        return None
    return Call(name, str(frame.f_locals.get("stage", "")) if name == "FrontEnd._register" else "")


def drive(
    *, sequence: Mapping[str, Any], parameters: Mapping[str, Any], mapper: Mapping[str, Any]
) -> dict[str, Any]:  # fmt: skip
    """What one scan of a drive through the laboratory goes through: of all scans the one that asked for most.

    "scan": its number; "calls": the tree of ``Call`` of the front end, then of the mapper.
    """
    lab = registry.dataset("lab").make(**sequence)
    spec = registry.backend("paper")
    odometry = frontend.odometry(spec, frontend.complete_parameters("paper", spec, parameters))
    drawn = registry.mapper("log-odds").make(**mapper)

    def scan(frame: Frame) -> None:
        start_from_base = odometry.update(frame).pose
        deskewed = frame.scan.deskewed(frame.base_from_sensor, frame.start_from_end)
        drawn.update(deskewed, start_from_base @ frame.base_from_sensor)

    found = [recorded(lambda frame=frame: scan(frame)) for frame in lab.frames()]  # type: ignore[misc]  # bound now
    best = max(range(len(found)), key=lambda index: len({call.key for call in found[index].within()}))
    return {"scan": best, "calls": found[best].told()}
