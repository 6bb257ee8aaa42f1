"""Figures 2 to 5: pipeline and flow charts, drawn from the recorded function calls of one scan."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from types import FrameType
from typing import Any, Literal

from evalkit.core.scan import Frame
from evalkit.execution.task import AnyTask, make_task
from evalkit.odometry import frontend
from evalkit.plugins import registry
from evalkit.plugins.parameters import Parameter
from evalkit.report.html import charts
from evalkit.report.html.blocks import Figure, Figures, Section, Text
from evalkit.report.html.charts import Box
from evalkit_paper import verdicts
from evalkit_paper.chapter import Chapter, Finding, Judgement, Results, Settings

ANCHOR = "figures-2-to-5"
RECORDED = "stages"

Words = Mapping[str, str]

PIPELINE: Words = {
    "MotionPrior.predict": "first guess: odometry since the last scan",
    "FrontEnd._source": "points of the scan (eq. 1)",
    "FrontEnd._register s2s": "register with the last scan",
    "FrontEnd._register s2m": "register with the local map",
    "FrontEnd.keep": "keep for the next scans",
    "LogOddsGrid.update": "add to the log-odds grid",
}
REGISTRATION: Words = {
    "CloudCache.get": "index the reference Q",
    "Association.find": "nearest q of every moved p (eq. 2)",
    "select_closest": "one to one: of several p the closest keeps q",
    "fit_motion": "centroids, K, theta and t; move the source (eq. 3, 4, 9)",
    "fit_to_lines": "least squares to the lines; move the source",
    "Icp._error": "error of the pairs (eq. 5)",
}
TWO_STAGES: Words = {
    "MotionPrior.predict": "first guess: odometry since the last scan",
    "MotionPrior.within_scan": "undo the motion within the scan",
    "select_near": "keep points within the local radius",
    "voxel_means": "one mean per voxel",
    "FrontEnd._register s2s": "ICP with the last scan (S2S)",
    "KeyframeMap.cloud": "local map: last keyframes",
    "VoxelMap.cloud": "local map: lasting voxels",
    "GridMap.cloud": "local map: occupied cells",
    "FrontEnd._register s2m": "ICP with the local map (S2M)",
    "FrontEnd.is_keyframe": "new keyframe?",
    "KeyframeMap.add": "add its points to the local map",
    "VoxelMap.add": "add its points to the local map",
    "GridMap.add": "add it to the local map",
    "MotionPrior.store": "pose: result, and start of the next scan",
}
MAPPING: Words = {
    "LogOddsGrid.update": "end points of the beams in the world",
    "LogOddsGrid._window": "window of cells around them",
    "exact": "cells each beam passes (Amanatides, Woo)",
    "bresenham": "cells each beam passes (Bresenham)",
    "LogOddsGrid._count_once": "once per scan: occupied before free",
    "LogOddsGrid._count_every": "every beam counts",
    "LogOddsGrid._add": "add l_occ and l_free, clamp (eq. 10)",
}
STAGES: Mapping[str, Sequence[str]] = {
    "Figure 2": ("MotionPrior.predict", "FrontEnd._register s2s", "FrontEnd._register s2m", "LogOddsGrid.update"),
    "Figure 3": ("Association.find", "select_closest", "fit_motion", "Icp._error"),
    "Figure 4": ("FrontEnd._register s2s", "FrontEnd._register s2m", "MotionPrior.store"),
    "Figure 5": ("LogOddsGrid.update", "exact", "LogOddsGrid._add"),
}
"""Stages that the paper's figures show, in their order."""

LAST = frozenset({"LogOddsGrid._add"})
"""Functions whose own work comes after the calls they make."""

RECORDED_MODULES = frozenset(
    {
        "evalkit.odometry.frontend", "evalkit.odometry.local_map", "evalkit.odometry.motion_prior",
        "evalkit_baselines.paper.association",
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

    @classmethod
    def from_json(cls, values: Mapping[str, Any]) -> TracedCall:
        """Read a call from the values of ``dataclasses.asdict``."""
        return cls(values["name"], values["stage"], [cls.from_json(call) for call in values["calls"]])


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
    name, module = frame.f_code.co_qualname, frame.f_globals.get("__name__")
    if module not in RECORDED_MODULES or "<" in name or name.endswith(("__init__", "__post_init__")):
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
    return {"scan": best, "calls": asdict(found[best])}


@dataclass(frozen=True, slots=True)
class Path:
    """Stages in the order they ran; stages [first, last] ran ``times`` times."""

    stages: Sequence[str]
    first: int = 0
    last: int = 0
    times: int = 1


def path(root: TracedCall, words: Words, below: str = "") -> Path:
    """Stages of ``words`` that ran below the first call of ``below``; a repeated round appears once."""
    start = next((call for call in root.walk() if call.key == below), None) if below else root
    ran = list(_in_order(start, words)) if start is not None else []
    first = next((index for index, key in enumerate(ran) if ran.count(key) > 1), None)
    if first is None:
        return Path(ran)
    begins = [index for index, key in enumerate(ran) if key == ran[first]]
    rounds = [ran[begin:end] for begin, end in zip(begins, [*begins[1:], len(ran)], strict=True)]
    longest = max(rounds[:-1], key=len)
    rest = rounds[-1][len(longest) :]
    return Path([*ran[:first], *longest, *rest], first, first + len(longest) - 1, len(rounds))


def _in_order(call: TracedCall, words: Words) -> Sequence[str]:
    below = [key for inner in call.calls for key in _in_order(inner, words)]
    if call.key not in words:
        return below
    return [*below, call.key] if call.key in LAST else [call.key, *below]


def chart(drawn: Path, words: Words, begin: str, end: str, again: str = "") -> bytes:
    """Render the flow chart of a path; ``again`` is the question that ends its repeated round."""
    texts = [begin, *(words[key] for key in drawn.stages), end]
    boxes = [Box(str(row), text, 0.0, float(row), _kind(row, len(texts), text)) for row, text in enumerate(texts)]
    arrows = [(str(row), str(row + 1), "yes" if texts[row].endswith("?") else "") for row in range(len(texts) - 1)]
    if drawn.times > 1:
        first, last = drawn.first + 1, drawn.last + 1
        boxes.append(Box("again", f"{again} (here after {drawn.times} rounds)", 1.0, float(last), "choice"))
        arrows[last] = ("again", str(last + 1), "yes")
        arrows += [(str(last), "again", ""), ("again", str(first), "no")]
    return charts.flow(boxes, arrows)


def _kind(row: int, count: int, text: str) -> Literal["step", "choice", "end"]:
    if row in (0, count - 1):
        return "end"
    return "choice" if text.endswith("?") else "step"


PARAMETERS = (
    Parameter("laps", 0.03, "", "laps of the laboratory, to find a scan that runs all stages", low=0.02, high=1.0),
    Parameter("rate_hz", 5.0, "Hz", "revolutions a second", low=5.0, high=15.0),
    Parameter("scan_to_scan", True, "", "the first stage"),
    Parameter("scan_to_map", True, "", "the second stage"),
    Parameter("deskew", True, "", "undo the motion within a scan"),
    Parameter("one_to_one", True, "", "the one-to-one filter"),
    Parameter("local_radius_m", 12.0, "m", "ignore points farther away; 0: keep all", low=0.0),
    Parameter("local_map", "keyframes", "", "the local map", choices=("keyframes", "scans", "grid")),
    Parameter("traversal", "exact", "", "cells that a beam passes", choices=("exact", "bresenham")),
    Parameter("once_per_scan", True, "", "a scan changes a cell once"),
)

_FRONT_END = ("scan_to_scan", "scan_to_map", "deskew", "one_to_one", "local_radius_m", "local_map")
_MAPPER = ("traversal", "once_per_scan")


def tasks(settings: Settings) -> tuple[AnyTask, ...]:
    """The one computation."""
    recording = make_task(
        RECORDED, trace_drive, sequence={"laps": settings["laps"], "rate_hz": settings["rate_hz"]},
        parameters={"keyframe_distance_m": 0.1, **{name: settings[name] for name in _FRONT_END}},
        mapper={name: settings[name] for name in _MAPPER},
    )  # fmt: skip
    return (recording.depending_on("evalkit_datasets.worlds.synthetic", "evalkit_baselines.paper"),)


def sections(settings: Settings, results: Results) -> tuple[Section, ...]:
    """The section of this chapter."""
    del settings
    root = TracedCall.from_json(results[RECORDED]["calls"])
    figures = [
        Figure(chart(path(root, words, below), words, begin, end, "change under epsilon, or 40 rounds?"), title)
        for title, words, below, begin, end in _drawings(root)
    ]
    text = (
        f"Recorded from the running code, not drawn by hand: the calls of scan {results[RECORDED]['scan'] + 1} of a "
        "drive through the laboratory, in order. A stage that is switched off in this chapter's settings is missing "
        "from its figure; a repeated round is drawn once, with its number of repetitions."
    )
    return (Section("Figures 2 to 5: pipeline and flow charts", (Text(text), Figures(figures, small=True)), ANCHOR),)


def _drawings(root: TracedCall) -> tuple[tuple[str, Words, str, str, str], ...]:
    """Title, words, first call, begin and end of every figure."""
    keys = {call.key for call in root.walk()}
    register = "FrontEnd._register s2m" if "FrontEnd._register s2m" in keys else "FrontEnd._register s2s"
    return (
        ("Figure 2: the pipeline", PIPELINE, "", "scan, wheel odometry", "pose and map"),
        ("Figure 3: registration", REGISTRATION, register, "source P, reference Q, guess", "R, t"),
        ("Figure 4: two stages", TWO_STAGES, "FrontEnd.update", "scan", "next scan"),
        ("Figure 5: mapping", MAPPING, "LogOddsGrid.update", "scan and its pose", "occupancy grid"),
    )


def findings(settings: Settings, results: Results) -> tuple[Finding, ...]:
    """The findings on Figures 1 to 5: a figure is reproduced if its stages ran, in its order."""
    del settings
    root = TracedCall.from_json(results[RECORDED]["calls"])
    photo = Judgement("not reproducible in software", "a photo; the simulation has its lidar and speeds")
    found = [Finding("Figure 1", "photo of the vehicle", "none", photo, ANCHOR)]
    for title, words, below, begin, end in _drawings(root):
        ran, wanted = path(root, words, below), STAGES[title[:8]]
        found.append(Finding(
            title, f"from '{begin}' to '{end}' through {len(wanted)} stages",
            f"{len(ran.stages)} recorded stages" + (f", a round of them {ran.times} times" if ran.times > 1 else ""),
            verdicts.judge_stages(ran.stages, wanted), ANCHOR,
        ))  # fmt: skip
    return tuple(found)


CHAPTER = Chapter("stages", PARAMETERS, tasks, sections, findings)
