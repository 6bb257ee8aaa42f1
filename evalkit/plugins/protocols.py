"""The seams: what a back end, a mapper and a sequence must do, and the specs that describe them.

A spec stands beside its class, is importable without the heavy library, and says what is missing and why.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Literal, Protocol

from evalkit.core.errors import BadParameter, UnknownName
from evalkit.core.grid import OccupancyGrid
from evalkit.core.ground_truth import Truth
from evalkit.core.match import Match
from evalkit.core.odometry_estimate import OdometryEstimate
from evalkit.core.pose import Pose
from evalkit.core.scan import Cloud, Frame, Scan

Value = bool | int | float | str

GUESS_NOT_TOLD = "not told"

Role = Literal["", "reference", "baseline", "peer"]
"""What a back end is to the others.

"reference": the readable implementation that others are validated against. "baseline": every other method must beat it.
"peer": an established implementation, shown beside a validated one for context.
"""

Excerpt = Literal["full", "quick"]


class Registration(Protocol):
    """Brings one cloud onto another. Stateless: the same arguments give the same answer, whatever came before."""

    def register(self, target: Cloud, source: Cloud, guess: Pose) -> Match:
        """The motion ``target_from_source``, starting from ``guess``; must not write into its arguments."""
        ...


class Odometry(Protocol):
    """Follows a sensor through one sequence; a fresh object per sequence."""

    def update(self, frame: Frame) -> OdometryEstimate:
        """Process one frame. The estimate's pose is ``start_from_base`` at the first beam; the first is the identity.

        Raises NoAnswer where this frame has no estimate; the next frame follows as usual.
        """
        ...


class NoAnswer(Exception):
    """No error: the scan counts as not answered, and the text says why. Who leaves out too many has failed."""


class Mapper(Protocol):
    """Draws scans with known poses into an occupancy grid."""

    def update(self, scan: Scan, world_from_sensor: Pose) -> None:
        """Adds one scan."""
        ...

    def grid(self) -> OccupancyGrid:
        """All scans so far."""
        ...


class Sequence(Protocol):
    """Scans in the order of time, with what is known about the truth."""

    def __len__(self) -> int:
        """How many frames there will be (for progress; exact unless the file is damaged)."""
        ...

    def frames(self) -> Iterator[Frame]:
        """The frames, stamps strictly increasing; may be called again and gives the same."""
        ...

    def truth(self) -> Truth:
        """What the estimates are held against."""
        ...

    def notes(self) -> Mapping[str, int]:
        """Defects met and handled while reading, counted by name ("scans out of order", "invalid ranges", ...)."""
        ...


@dataclass(frozen=True, slots=True)
class Parameter:
    """One setting of a plug-in: its default tells its type; ``low`` and ``high`` are inclusive."""

    name: str
    default: Value
    unit: str
    meaning: str
    low: float = -math.inf
    high: float = math.inf
    choices: tuple[str, ...] = ()

    def checked(self, owner: str, value: object) -> Value:
        """The value in the default's type; BadParameter names what was found and what is expected."""
        wanted = type(self.default)
        if wanted is float and isinstance(value, int) and not isinstance(value, bool):
            value = float(value)
        if not isinstance(value, wanted) or isinstance(value, bool) != (wanted is bool):
            raise BadParameter(owner, self.name, value, f"{_article(wanted)} ({self.meaning})")
        if isinstance(value, (int, float)) and not self.low <= value <= self.high:
            raise BadParameter(
                owner, self.name, value, f"a number within [{self.low:g}, {self.high:g}] {self.unit}".rstrip()
            )
        if self.choices and value not in self.choices:
            raise BadParameter(owner, self.name, value, f"one of {', '.join(self.choices)}")
        return value


def resolved(owner: str, parameters: tuple[Parameter, ...], given: Mapping[str, object]) -> dict[str, Value]:
    """Every parameter with the given value or its default; unknown names and wrong types are refused."""
    known = {parameter.name: parameter for parameter in parameters}
    for name in given:
        if name not in known:
            raise UnknownName("parameter", name, known, owner)
    return {name: known[name].checked(owner, given.get(name, known[name].default)) for name in known}


def with_defaults(parameters: tuple[Parameter, ...], **defaults: Value) -> tuple[Parameter, ...]:
    """The same parameters with other defaults: how a named variant is made."""
    for name in defaults:
        if name not in {parameter.name for parameter in parameters}:
            raise UnknownName("parameter", name, [parameter.name for parameter in parameters])
    return tuple(replace(p, default=defaults.get(p.name, p.default)) for p in parameters)


def nothing_missing(**_parameters: Value) -> str:
    """The answer of a plug-in that needs nothing beyond evalkit."""
    return ""


@dataclass(frozen=True, slots=True)
class Published:
    """A figure somebody printed for the same recording: mean and standard deviation in the unit of ``metric``.

    ``metric``: the name of the metric it is held against; "" for the first relation metric in metres.
    ``spread_metric``: the name of the metric that is our counterpart of ``spread``, "" for none.
    """

    label: str
    value: float
    spread: float | None
    source: str
    metric: str = ""
    spread_metric: str = ""


@dataclass(frozen=True)
class BackendSpec:
    """A back end: how to make it, what it is, what it needs.

    ``kind``: "registration" (``make(**parameters)`` gives a Registration; evalkit's front end makes it an odometry),
    "odometry" (``make`` gives an Odometry) or "map" (``make`` gives an OccupancyGrid in the world's frame, made
    elsewhere; it answers no scan). ``recorded``: its answers were made elsewhere; nothing else can be asked.
    ``frontend``: front-end settings this back end wants other than the defaults. ``scan_to_scan``: its own parameters
    that differ in the first stage. ``guess``: what it starts from, for the report (an odometry that does not say: "not
    told"). ``role``: see ``Role``.
    ``missing()`` says why it cannot run here and how to mend it, or "". ``broken``: why what is here does not work
    (a program that does not introduce itself), or ""; then its runs have failed, and what could be set is unknown.
    ``digest``: changes with what it consists of beyond its Python sources (a shared library, a program, a file of
    results).
    """

    make: Callable[..., Any]
    kind: Literal["registration", "odometry", "map"]
    summary: str
    citation: str
    licence: str
    guess: str = ""
    role: Role = ""
    requires: tuple[str, ...] = ()
    parameters: tuple[Parameter, ...] = ()
    frontend: Mapping[str, Value] = field(default_factory=dict)
    scan_to_scan: Mapping[str, Value] = field(default_factory=dict)
    missing: Callable[[], str] = nothing_missing
    broken: str = ""
    recorded: bool = False
    digest: str = ""

    def __post_init__(self) -> None:
        if not self.guess:  # evalkit's front end gives registrations theirs; what an odometry does only it can tell
            front_end = "wheel odometry where recorded, else constant velocity"
            object.__setattr__(self, "guess", front_end if self.kind == "registration" else GUESS_NOT_TOLD)


@dataclass(frozen=True)
class MapperSpec:
    """A mapper: ``make(**parameters)`` gives a fresh Mapper."""

    make: Callable[..., Mapper]
    summary: str
    citation: str
    licence: str
    requires: tuple[str, ...] = ()
    parameters: tuple[Parameter, ...] = ()
    missing: Callable[[], str] = nothing_missing


@dataclass(frozen=True)
class DatasetSpec:
    """A data set or a reader: ``make(**parameters)`` gives a Sequence.

    ``seeded``: has a parameter ``seed`` that makes repetitions differ. ``suffixes``: endings of the files a reader
    opens (then it has a parameter ``path``). ``truth``: how the truth was made. ``defects``: what is known to be wrong
    with the data. ``degenerate``: why the geometry cannot fix the pose, "" where it can. ``published``: figures others
    printed for it. ``missing(**parameters)`` says which files are not here and how to get them, or "".
    ``thinned_by``: name of the parameter n that takes every n-th of the sensor's scans, "" where all are taken: without
    it a sensor seems slower than it is. ``excerpts``: parameters of a part of the data that is long enough to validate
    an implementation on; commands without a sequence on their command line use the data sets that have one.
    """

    make: Callable[..., Sequence]
    summary: str
    sensor: str
    truth: str
    citation: str
    licence: str
    defects: tuple[str, ...] = ()
    degenerate: str = ""
    published: tuple[Published, ...] = ()
    seeded: bool = False
    suffixes: tuple[str, ...] = ()
    parameters: tuple[Parameter, ...] = ()
    missing: Callable[..., str] = nothing_missing
    thinned_by: str = ""
    excerpts: Mapping[Excerpt, Mapping[str, Value]] = field(default_factory=dict)


def _article(kind: type) -> str:
    return {bool: "true or false", int: "a whole number", float: "a number", str: "a text"}[kind]
