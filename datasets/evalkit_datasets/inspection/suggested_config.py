"""Suggest how to run a recording: an experiment's table and a command, tried before they are suggested."""

from __future__ import annotations

import json
import math
import shlex
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from evalkit.core.errors import BadData, DataMissing, EvalkitError
from evalkit.core.pose import Pose
from evalkit.plugins.parameters import Value
from evalkit_datasets import catalog, recorded
from evalkit_datasets.carmen import Carmen
from evalkit_datasets.inspection.findings import LidarStats, is_default_code
from evalkit_datasets.inspection.inspector import Inspection, measured_directions
from evalkit_datasets.rosbag import RosBag

TILT_WORDS = ("vertical",)


@dataclass(frozen=True)
class SuggestedConfig:
    """A configuration for a recording: the table of an experiment, the command, and the reason of every choice.

    ``scans``, ``truth`` and ``notes``: result of opening it with the reader; ``problem``: why that fails, "" if it does
    not. ``catalogued``: the data set made of this file, "" if none; ``defects``: known defects of the file.
    """

    reader: str
    parameters: Mapping[str, Value]
    table: str
    command: str
    reasons: tuple[str, ...]
    scans: int = 0
    truth: str = ""
    notes: Mapping[str, int] = field(default_factory=dict)
    problem: str = ""
    catalogued: str = ""
    defects: tuple[str, ...] = ()


def suggest_config(recording: Inspection) -> SuggestedConfig | None:
    """Return a configuration for a recording, or None if it contains no laser scan."""
    if not recording.lidars:
        return None
    is_log = recording.kind == "CARMEN log"
    parameters: dict[str, Value] = {"path": str(recording.path)}
    reasons: list[str] = []
    for choice in (_choose_for_log if is_log else _choose_for_bag, _find_truth_files):
        chosen, why = choice(recording)
        parameters |= chosen
        reasons += why
    reader = "carmen" if is_log else "rosbag"
    tried = _try_reader(reader, parameters)
    if tried.mounting != Pose():
        x, y, yaw_deg = tried.mounting.x, tried.mounting.y, math.degrees(tried.mounting.theta)
        reasons.append(f"the lidar is mounted at x {x:.3f} m, y {y:.3f} m, rotated by {yaw_deg:.1f} deg: as recorded")
    dataset, defects = _find_catalogued(recording.path)
    if dataset:
        reasons.append(f'it is a catalogued recording: use = "{dataset}" runs it with its parameters and ground truth')
    return SuggestedConfig(
        reader, parameters, _format_table(reader, recording.path, parameters), _format_command(parameters),
        tuple(reasons), tried.scans, tried.truth, tried.notes, tried.problem, dataset, defects,
    )  # fmt: skip


def best_lidar(recording: Inspection) -> tuple[LidarStats, str]:
    """Return the lidar to use and the reason; requires at least one lidar."""
    tilted = {mounting.sensor for mounting in recording.frames.mountings if mounting.problem}
    level = [one for one in recording.lidars if one.frame not in tilted and not _is_tilted_by_name(one)] or list(
        recording.lidars
    )
    best = max(level, key=measured_directions)
    if len(recording.lidars) == 1:
        return best, "the only lidar"
    view = f"{best.field_of_view_deg:.0f} deg, {100 * best.returns.hits:.0f} % hits, {best.timing.rate_hz:.1f} Hz"
    others = ", ".join(
        f"{one.topic} ({one.field_of_view_deg:.0f} deg, {100 * one.returns.hits:.0f} %)"
        + ("" if one in level else ", not level")
        for one in recording.lidars
        if one is not best
    )
    return best, f"it measures the most directions ({view}); others: {others}"


def _is_tilted_by_name(lidar: LidarStats) -> bool:
    return any(word in lidar.topic.lower() for word in TILT_WORDS)


def _choose_for_bag(recording: Inspection) -> tuple[dict[str, Value], list[str]]:
    lidar, why = best_lidar(recording)
    parameters: dict[str, Value] = {"topic": lidar.topic}
    reasons = [f"topic {lidar.topic}: {why}"]
    messages = [one for one in recording.odometries if one.topic != "tf"]
    usable = [one for one in messages or recording.odometries if one.like_wheels]
    if not usable:
        parameters["odometry"] = "none"
        reasons.append(
            "odometry none: " + ("its motion is not that of wheels" if recording.odometries else "the bag has none")
        )
        return parameters, reasons
    named = next((one for one in usable if one.topic.lstrip("/") == "odom"), usable[0])
    if len(messages) > 1:
        parameters["odometry"] = named.topic
    bases = [one.child for one in usable if one.topic == "tf"]
    if named.topic == "tf" and len(bases) > 1:
        parameters["base_frame"] = named.child
    reasons.append(f"odometry {named.topic} of frame '{named.child}': {named.path_m:.1f} m")
    return parameters, reasons


def _choose_for_log(recording: Inspection) -> tuple[dict[str, Value], list[str]]:
    parameters: dict[str, Value] = {}
    reasons = []
    codes = [code.low_m for code in recording.lidars[0].returns.codes if code.low_m < 50.0]
    unknown = [low for low in codes if not is_default_code(low)]
    if unknown:
        parameters["range_max_m"] = min(unknown)
        reasons.append(f"range_max_m {min(unknown):g}: ranges of this length or more mean no return")
    if not recording.poses_from and recording.odometries and not recording.odometries[0].like_wheels:
        parameters["odometry"] = "none"
        reasons.append("odometry none: the motion of its poses is not that of wheels")
    return parameters, reasons


def _find_truth_files(recording: Inspection) -> tuple[dict[str, Value], list[str]]:
    """Return relations and reference trajectory in the same folder that overlap the recording in time."""
    folder, stem = recording.path.parent, recording.path.name.split(".")[0].split("-")[0]
    reader = "carmen" if recording.kind == "CARMEN log" else "rosbag"
    parameters: dict[str, Value] = {}
    reasons = []
    for name, ending in (("relations", "*.relations"), ("ground_truth", "*.tum")):
        files = sorted(folder.glob(ending), key=lambda file: (not file.name.startswith(stem), "gmapping" in file.name))
        for file in files:
            tried = _try_reader(reader, _minimal_parameters(recording) | {name: str(file)})
            if not tried.problem and tried.truth:
                parameters[name] = str(file)
                reasons.append(f"{name.replace('_', ' ')} {file.name}: in the same folder, and overlaps in time")
                break
    return parameters, reasons


def _minimal_parameters(recording: Inspection) -> dict[str, Value]:
    parameters: dict[str, Value] = {"path": str(recording.path), "odometry": "none"}
    return parameters if recording.kind == "CARMEN log" else parameters | {"topic": recording.lidars[0].topic}


@dataclass(frozen=True)
class _Trial:
    """The result of opening a recording with a reader; ``problem``: why it failed."""

    scans: int = 0
    truth: str = ""
    notes: Mapping[str, int] = field(default_factory=dict)
    mounting: Pose = field(default_factory=Pose)
    problem: str = ""


def _try_reader(reader: str, parameters: Mapping[str, Value]) -> _Trial:
    make = Carmen if reader == "carmen" else RosBag
    try:
        sequence = make(**parameters)  # type: ignore[arg-type]  # names and types are those of the reader's spec
        first = next(iter(sequence.frames()))
    except EvalkitError as error:
        return _Trial(problem=str(error))
    truth = sequence.truth()
    known = truth.how if truth.trajectory is not None or truth.relations is not None else ""
    return _Trial(len(sequence), known, sequence.notes(), first.base_from_sensor)


def _find_catalogued(path: Path) -> tuple[str, tuple[str, ...]]:
    """Return the data set made of this file, "" if none, and the known defects of the file."""
    for file in [path] if path.is_file() else sorted(path.iterdir()):
        for card in catalog.load_catalog().values():
            if not card.bytes or file.stat().st_size != card.bytes:
                continue
            try:
                catalog.verify(card, file)
            except (BadData, DataMissing):
                continue
            dataset = next((name for name, files in recorded.FILES.items() if files[0] == card.name), "")
            return dataset, card.defects
    return "", ()


def _format_table(reader: str, path: Path, parameters: Mapping[str, Value]) -> str:
    lines = ["[[sequence]]", f'use = "{reader}"', f"label = {json.dumps(path.name.split('.')[0])}"]
    return "\n".join([*lines, *(f"{name} = {json.dumps(value)}" for name, value in parameters.items())]) + "\n"


def _format_command(parameters: Mapping[str, Value]) -> str:
    words = ["evalkit", "compare", str(parameters["path"])]
    for name, value in parameters.items():
        if name in {"topic", "relations", "ground_truth"}:
            words += [f"--{name.replace('_', '-')}", str(value)]
        elif name != "path":
            words += ["--set", f"{name}={value}"]
    return shlex.join(words)
