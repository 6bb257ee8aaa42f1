"""Specs of plug-ins: factory, description, parameters and requirements.

A spec is a module-level value next to its class; importing it does not import the library that the class uses.
A kind of back end is a subclass of ``BackendSpec``.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, is_dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal

from evalkit.plugins.parameters import EXCERPT, MAP, NUISANCE, RESERVED, Parameter, Value, declared_parameters

if TYPE_CHECKING:
    from evalkit.core.grid import OccupancyGrid
    from evalkit.plugins.protocols import Mapper, Odometry, Registration, Sequence, Slam

GUESS_NOT_REPORTED = "not reported"
NOT_STATED = "not stated"

BackendKind = Literal["registration", "odometry", "slam", "map"]

Role = Literal["", "reference", "baseline", "peer"]
"""Role of a back end in a comparison.

"reference": the readable implementation that others are validated against. "baseline": every other method must beat it.
"peer": an established implementation, shown beside a validated one for context.
"""

MapUse = Literal["matches", "reads", "starts there"]
"""What a back end does with a known map: evalkit matches its scans with the map; it is given the file; or it runs as
without a map, from the same start."""

Excerpt = Literal["full", "quick"]

RunsIn = Literal["evalkit", "program", "device"]
"""Where a back end computes: in evalkit's own process, in that of a program, or on a device that a program asks."""

FIRST_STAGE = "s2s."
"""Prefix of a registration's parameter that applies to the scan-to-scan stage only."""


def nothing_missing(**_parameters: Value) -> str:
    """The ``missing`` of a plug-in that needs nothing beyond evalkit."""
    return ""


@dataclass(frozen=True)
class BackendSpec:
    """Common fields of all kinds of back end.

    ``make(**parameters)`` makes it. ``role``: see ``Role``. ``requires``: distributions whose versions belong to a
    result. ``missing()`` returns why it cannot run here and how to change that, or "". ``broken``: why it does not work
    although it exists (a program without a valid description), or ""; its runs fail with this reason.
    ``digest``: changes with the parts that are not Python source (a shared library, a program, a file of results).
    ``guess``: what its registration starts from, for the report. ``tuned_on``: the data sets that defaults of this back
    end alone were chosen on: its results there are optimistic. Settings that were chosen for all back ends on the same
    runs with the same budget do not count. ``default``: among the methods of a comparison that names none; one of each
    family of methods is enough. ``reference``: the back end whose answers it is meant to give, its twin; a validation
    that names no reference compares it with that one. "": with the first of role "reference". ``runs_in``: see
    ``RunsIn``. ``device``: the name of the device on which it computes, or "": runs on one device follow each other.
    """

    make: Callable[..., Any]
    summary: str
    citation: str
    licence: str
    guess: str = GUESS_NOT_REPORTED
    role: Role = ""
    requires: tuple[str, ...] = ()
    parameters: tuple[Parameter, ...] = ()
    missing: Callable[[], str] = nothing_missing
    broken: str = ""
    digest: str = ""
    tuned_on: tuple[str, ...] = ()
    default: bool = False
    reference: str = ""
    runs_in: RunsIn = "evalkit"
    device: str = ""

    kind: ClassVar[BackendKind]
    recorded: ClassVar[bool] = False
    """True where the answers were computed elsewhere, so that only the scans of that recording have one."""

    @property
    def map_use(self) -> MapUse:
        """What it does with a known map."""
        return "reads" if any(each.name == MAP for each in self.parameters) else "starts there"


@dataclass(frozen=True)
class RegistrationSpec(BackendSpec):
    """A back end that registers clouds; evalkit's front end makes it an odometry.

    ``frontend``: front-end settings with another default for this back end. ``scan_to_scan``: its own parameters with
    another default in the scan-to-scan stage.
    """

    make: Callable[..., Registration]
    guess: str = "wheel odometry where recorded, else constant velocity"
    frontend: Mapping[str, Value] = field(default_factory=dict)
    scan_to_scan: Mapping[str, Value] = field(default_factory=dict)

    kind: ClassVar[BackendKind] = "registration"

    @property
    def map_use(self) -> MapUse:
        """What evalkit's front end does with a known map."""
        return "matches"

    def first_stage_parameters(self) -> tuple[Parameter, ...]:
        """Return the parameters ``s2s.NAME`` with different defaults in the scan-to-scan stage."""
        return tuple(
            make_first_stage_parameter(each, self.scan_to_scan[each.name])
            for each in self.parameters
            if each.name in self.scan_to_scan
        )

    def make_stages(self, parameters: Mapping[str, Value]) -> tuple[Registration, Registration]:
        """Make the registrations of both stages, scan-to-scan first, from complete parameters."""
        make_first, make_second = self.stage_makers(parameters)
        return make_first(), make_second()

    def stage_makers(
        self, parameters: Mapping[str, Value]
    ) -> tuple[Callable[[], Registration], Callable[[], Registration]]:
        """Return what makes the registration of each stage, as ``make_stages`` does."""
        own = {each.name: parameters[each.name] for each in self.parameters}
        first = {key.removeprefix(FIRST_STAGE): v for key, v in parameters.items() if key.startswith(FIRST_STAGE)}
        return partial(self.make, **{**own, **first}), partial(self.make, **own)


@dataclass(frozen=True)
class OdometrySpec(BackendSpec):
    """A back end that is an odometry itself."""

    make: Callable[..., Odometry]

    kind: ClassVar[BackendKind] = "odometry"


@dataclass(frozen=True)
class SlamSpec(OdometrySpec):
    """A back end that is an odometry itself and corrects poses it has given."""

    make: Callable[..., Slam]

    kind: ClassVar[BackendKind] = "slam"


@dataclass(frozen=True)
class RecordedOdometrySpec(OdometrySpec):
    """An odometry that returns poses computed elsewhere, at these ``addresses`` (``plugins.result_files``)."""

    addresses: tuple[str, ...] = ()

    recorded: ClassVar[bool] = True


@dataclass(frozen=True)
class RecordedSlamSpec(SlamSpec):
    """A SLAM that returns poses computed elsewhere, at these ``addresses``."""

    addresses: tuple[str, ...] = ()

    recorded: ClassVar[bool] = True


@dataclass(frozen=True)
class MapSpec(BackendSpec):
    """A map made elsewhere, in the world's frame: it is scored as a map and answers no scan."""

    make: Callable[..., OccupancyGrid]

    kind: ClassVar[BackendKind] = "map"
    recorded: ClassVar[bool] = True


def spec_of_class(made: type) -> BackendSpec | None:
    """Return the spec of a class that is itself a registration (``register``) or an odometry (``update``), else None.

    An odometry with ``trajectory`` and ``loop_closures`` is a SLAM.

    The summary is the first line of its docstring; its parameters are the fields that it declares with ``parameter``.
    """
    make: Callable[..., Any] = made
    summary = (made.__doc__ or made.__name__).strip().splitlines()[0]
    parameters = declared_parameters(made) if is_dataclass(made) else ()
    if hasattr(made, "register"):
        return RegistrationSpec(make, summary, NOT_STATED, NOT_STATED, parameters=parameters)
    if hasattr(made, "update") and hasattr(made, "trajectory") and hasattr(made, "loop_closures"):
        return SlamSpec(make, summary, NOT_STATED, NOT_STATED, parameters=parameters)
    if hasattr(made, "update"):
        return OdometrySpec(make, summary, NOT_STATED, NOT_STATED, parameters=parameters)
    return None


@dataclass(frozen=True)
class MapperSpec:
    """A mapper: ``make(**parameters)`` makes a new Mapper.

    ``default``: used where no mapper is named. ``differs``: in what its maps are meant to differ from the default's, ""
    where they are meant to be equal; a validation says it.
    """

    make: Callable[..., Mapper]
    summary: str
    citation: str
    licence: str
    requires: tuple[str, ...] = ()
    parameters: tuple[Parameter, ...] = ()
    missing: Callable[[], str] = nothing_missing
    default: bool = False
    differs: str = ""


@dataclass(frozen=True, slots=True)
class Published:
    """A published result for the same recording: mean and standard deviation in the unit of ``metric``.

    ``metric``: the name of the metric it is compared with; "" for the first relation metric in metres.
    ``spread_metric``: the name of the metric that corresponds to ``spread``, "" for none.
    """

    label: str
    value: float
    spread: float | None
    source: str
    metric: str = ""
    spread_metric: str = ""


@dataclass(frozen=True, slots=True)
class Choice:
    """A parameter chosen for a recording, and the reason as a sentence without a full stop.

    ``name``: a parameter of the reader, or "mapper.NAME" of the mapper. ``value``: None if the reader finds it itself.
    ``warns``: the reason is a doubt about the data, which the report repeats.
    """

    name: str
    value: Value | None
    reason: str
    warns: bool = False


@dataclass(frozen=True)
class DatasetSpec:
    """A data set or a reader: ``make(**parameters)`` makes a Sequence.

    ``seeded``: has a parameter ``seed`` that makes repetitions differ. ``suffixes``: endings of the files that a reader
    opens (then it has a parameter ``path``). ``truth``: how the ground truth was made. ``defects``: known errors in the
    data. ``degenerate``: why the geometry does not determine the pose, "" where it does. ``published``: published
    results. ``missing(**parameters)`` returns which files are not here and how to get them, or "".
    ``thinned_by``: name of the parameter n that takes every n-th scan of the sensor, "" where every scan is taken;
    without it the period of the sensor is estimated too long. ``excerpts``: parameters of a part of the data that is
    long enough to validate an implementation; commands without a given sequence use the data sets that have one.
    ``recognises(path)``: whether a file is one of a reader's by its content, whatever its suffix; None: never.
    ``choose(parameters)``: what a reader finds in a file and beside it; ``parameters``: those given, the path included.
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
    recognises: Callable[[Path], bool] | None = None
    parameters: tuple[Parameter, ...] = ()
    missing: Callable[..., str] = nothing_missing
    thinned_by: str = ""
    excerpts: Mapping[Excerpt, Mapping[str, Value]] = field(default_factory=dict)
    choose: Callable[[Mapping[str, Value]], Iterable[Choice]] | None = None

    def open(self, parameters: Mapping[str, Value]) -> Sequence:
        """Make the sequence of a run, perturbed if the parameters contain the reserved ones of a perturbation."""
        own = {name: value for name, value in parameters.items() if name not in RESERVED}
        return self.perturb(self.make(**own), parameters)

    def perturb(self, sequence: Sequence, parameters: Mapping[str, Value]) -> Sequence:
        """Return the sequence under the perturbation that the reserved parameters name, as it is if they name none."""
        if NUISANCE not in parameters:
            return sequence
        from evalkit.plugins.nuisance import perturb_sequence  # noqa: PLC0415 - loads NumPy

        return perturb_sequence(sequence, int(parameters[NUISANCE]), int(parameters.get(EXCERPT, 0)))


def make_first_stage_parameter(parameter: Parameter, default: Value) -> Parameter:
    """Return the parameter of the scan-to-scan stage that corresponds to a registration's parameter."""
    meaning = f"first stage only: {parameter.meaning}"
    return replace(parameter, name=FIRST_STAGE + parameter.name, default=default, meaning=meaning)
