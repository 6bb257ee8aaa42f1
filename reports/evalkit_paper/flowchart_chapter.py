"""Figures 2 to 5: pipeline and flow charts, drawn from the recorded function calls of one scan."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from evalkit.execution.task import AnyTask, make_task
from evalkit.plugins.parameters import Parameter
from evalkit.report.html import charts
from evalkit.report.html.blocks import Figure, Figures, Section, Text
from evalkit.report.html.charts import Box
from evalkit_paper import call_trace
from evalkit_paper.call_trace import TracedCall
from evalkit_paper.chapter import Chapter, Finding, Results, Settings

ANCHOR = "figures-2-to-5"
RECORDED = "stages"

Words = Mapping[str, str]

PIPELINE: Words = {
    "Motion.predict": "first guess: odometry since the last scan",
    "FrontEnd._source": "points of the scan (eq. 1)",
    "FrontEnd._register s2s": "register with the last scan",
    "FrontEnd._register s2m": "register with the local map",
    "FrontEnd._keep": "keep for the next scans",
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
    "Motion.predict": "first guess: odometry since the last scan",
    "Motion.within_scan": "undo the motion within the scan",
    "select_near": "keep points within the local radius",
    "voxel_means": "one mean per voxel",
    "FrontEnd._register s2s": "ICP with the last scan (S2S)",
    "KeyframeMap.cloud": "local map: last keyframes",
    "VoxelMap.cloud": "local map: lasting voxels",
    "GridMap.cloud": "local map: occupied cells",
    "FrontEnd._register s2m": "ICP with the local map (S2M)",
    "FrontEnd._is_keyframe": "new keyframe?",
    "KeyframeMap.add": "add its points to the local map",
    "VoxelMap.add": "add its points to the local map",
    "GridMap.add": "add it to the local map",
    "Motion.store": "pose: result, and start of the next scan",
}
MAPPING: Words = {
    "LogOddsGrid.update": "end points of the beams in the world",
    "LogOddsGrid._window": "window of cells around them",
    "exact": "cells each beam passes (Amanatides, Woo)",
    "bresenham": "cells each beam passes (Bresenham)",
    "LogOddsGrid._count_once": "once per scan: occupied before free",
    "LogOddsGrid._count_every": "every beam counts",
    "LogOddsGrid._add": "add l_occ and l_free, clamp (eq. 11)",
}
LAST = frozenset({"LogOddsGrid._add"})
"""Functions whose own work comes after the calls they make."""


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
        RECORDED, call_trace.trace_drive, sequence={"laps": settings["laps"], "rate_hz": settings["rate_hz"]},
        parameters={"keyframe_distance_m": 0.1, **{name: settings[name] for name in _FRONT_END}},
        mapper={name: settings[name] for name in _MAPPER},
    )  # fmt: skip
    return (recording.depending_on("evalkit_datasets.synthetic", "evalkit_baselines.paper"),)


def sections(settings: Settings, results: Results) -> tuple[Section, ...]:
    """The section of this chapter."""
    del settings
    root = TracedCall.from_json(results[RECORDED]["calls"])
    register = "FrontEnd._register s2m" if "FrontEnd._register s2m" in _keys(root) else "FrontEnd._register s2s"
    drawings = (
        ("Figure 2: the pipeline", PIPELINE, "", "scan, wheel odometry", "pose and map"),
        ("Figure 3: registration", REGISTRATION, register, "source P, reference Q, guess", "R, t"),
        ("Figure 4: two stages", TWO_STAGES, "FrontEnd.update", "scan", "next scan"),
        ("Figure 5: mapping", MAPPING, "LogOddsGrid.update", "scan and its pose", "occupancy grid"),
    )
    figures = [
        Figure(chart(path(root, words, below), words, begin, end, "change under epsilon, or 40 rounds?"), title)
        for title, words, below, begin, end in drawings
    ]
    told = (
        f"Recorded from the running code, not drawn by hand: the calls of scan {results[RECORDED]['scan'] + 1} of a "
        "drive through the laboratory, in order. A stage that is switched off in this chapter's settings is missing "
        "from its figure; a repeated round is drawn once, with its number of repetitions."
    )
    return (Section("Figures 2 to 5: pipeline and flow charts", (Text(told), Figures(figures, small=True)), ANCHOR),)


def _keys(root: TracedCall) -> set[str]:
    return {call.key for call in root.walk()}


def findings(settings: Settings, results: Results) -> tuple[Finding, ...]:
    """The findings on Figures 1 to 5."""
    del settings
    root = TracedCall.from_json(results[RECORDED]["calls"])
    counts = [len(path(root, words).stages) for words in (PIPELINE, TWO_STAGES, MAPPING)]
    return (
        Finding(
            "Figure 1", "photo of the vehicle", "none", "not reproducible in software",
            "a photo; the simulated vehicle has its lidar, speeds and sensors, as in section 1", ANCHOR,
        ),
        Finding(
            "Figures 2 to 5", "pipeline, registration, two stages, mapping as flow charts",
            f"drawn from {len(_keys(root)) - 1} functions recorded in one scan: {counts[0]} stages of the pipeline, "
            f"{counts[1]} of both registrations, {counts[2]} of the mapping",
            "reproduced", "the stages are those the code runs; what the paper's charts leave open is a setting",
            ANCHOR,
        ),
    )  # fmt: skip


CHAPTER = Chapter("stages", PARAMETERS, tasks, sections, findings)
