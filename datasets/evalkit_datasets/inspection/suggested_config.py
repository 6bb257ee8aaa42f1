"""How to run a recording: the table of an experiment and the command, tried before they are prescribed."""

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
from evalkit_datasets.inspection.findings import LidarStats, is_known
from evalkit_datasets.inspection.inspector import Inspection, worth
from evalkit_datasets.rosbag import RosBag

TILT_WORDS = ("vertical",)


@dataclass(frozen=True)
class SuggestedConfig:
    """What would run it. ``table``: of an experiment; ``command``: of the terminal; ``reasons``: for every choice.

    ``scans`` and ``notes``: what the reader said when it was tried; ``problem``: why it does not run, "" where it does.
    ``catalogued``: the data set that is this very file, with its truth, "" if none; ``defects``: known of it.
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


def suggest_config(found: Inspection) -> SuggestedConfig | None:
    """What would run it, None where there is no laser scan in it."""
    if not found.lidars:
        return None
    is_log = found.kind == "CARMEN log"
    parameters: dict[str, Value] = {"path": str(found.path)}
    reasons: list[str] = []
    for choice in (_log_choices if is_log else _bag_choices, _truth_beside):
        own, why = choice(found)
        parameters |= own
        reasons += why
    reader = "carmen" if is_log else "rosbag"
    tried = _tried(reader, parameters)
    if tried.seat != Pose():
        x, y, turn = tried.seat.x, tried.seat.y, math.degrees(tried.seat.theta)
        reasons.append(f"the lidar sits on the base at x {x:.3f} m, y {y:.3f} m, turned by {turn:.1f} deg: as recorded")
    dataset, defects = _catalogued(found.path)
    if dataset:
        reasons.append(f'it is the catalogued recording: use = "{dataset}" runs it with its own settings and truth')
    return SuggestedConfig(
        reader, parameters, _table(reader, found.path, parameters), _command(parameters), tuple(reasons),
        tried.scans, tried.truth, tried.notes, tried.problem, dataset, defects,
    )  # fmt: skip


def best_lidar(found: Inspection) -> tuple[LidarStats, str]:
    """The lidar to take, and why; of at least one."""
    tilted = {seat.sensor for seat in found.frames.mountings if seat.problem}
    level = [one for one in found.lidars if one.frame not in tilted and not _by_name_tilted(one)] or list(found.lidars)
    best = max(level, key=worth)
    if len(found.lidars) == 1:
        return best, "the only lidar"
    seen = f"{best.field_of_view_deg:.0f} deg, {100 * best.returns.hits:.0f} % hits, {best.timing.rate_hz:.1f} Hz"
    others = ", ".join(
        f"{one.topic} ({one.field_of_view_deg:.0f} deg, {100 * one.returns.hits:.0f} %)"
        + ("" if one in level else ", not level")
        for one in found.lidars
        if one is not best
    )
    return best, f"it measures the most directions ({seen}); others: {others}"


def _by_name_tilted(lidar: LidarStats) -> bool:
    return any(word in lidar.topic.lower() for word in TILT_WORDS)


def _bag_choices(found: Inspection) -> tuple[dict[str, Value], list[str]]:
    lidar, why = best_lidar(found)
    parameters: dict[str, Value] = {"topic": lidar.topic}
    reasons = [f"topic {lidar.topic}: {why}"]
    messages = [one for one in found.drivings if one.topic != "tf"]
    usable = [one for one in messages or found.drivings if one.like_wheels]
    if not usable:
        parameters["odometry"] = "none"
        reasons.append("odometry none: " + ("none of it moves as wheels do" if found.drivings else "there is none"))
        return parameters, reasons
    named = next((one for one in usable if one.topic.lstrip("/") == "odom"), usable[0])
    if len(messages) > 1:
        parameters["odometry"] = named.topic
    bases = [one.child for one in usable if one.topic == "tf"]
    if named.topic == "tf" and len(bases) > 1:
        parameters["base_frame"] = named.child
    reasons.append(f"odometry {named.topic} of frame '{named.child}': {named.path_m:.1f} m")
    return parameters, reasons


def _log_choices(found: Inspection) -> tuple[dict[str, Value], list[str]]:
    parameters: dict[str, Value] = {}
    reasons = []
    codes = [code.low_m for code in found.lidars[0].returns.codes if code.low_m < 50.0]
    unknown = [low for low in codes if not is_known(low)]
    if unknown:
        parameters["range_max_m"] = min(unknown)
        reasons.append(f"range_max_m {min(unknown):g}: what is as long or longer means no return")
    if not found.poses_from and found.drivings and not found.drivings[0].like_wheels:
        parameters["odometry"] = "none"
        reasons.append("odometry none: the poses in it do not move as wheels do")
    return parameters, reasons


def _truth_beside(found: Inspection) -> tuple[dict[str, Value], list[str]]:
    """Relations and reference trajectories in the same folder that share the recording's time, the best-named first."""
    folder, stem = found.path.parent, found.path.name.split(".")[0].split("-")[0]
    reader = "carmen" if found.kind == "CARMEN log" else "rosbag"
    parameters: dict[str, Value] = {}
    reasons = []
    for name, ending in (("relations", "*.relations"), ("reference", "*.tum")):
        files = sorted(folder.glob(ending), key=lambda file: (not file.name.startswith(stem), "gmapping" in file.name))
        for file in files:
            tried = _tried(reader, _least(found) | {name: str(file)})
            if not tried.problem and tried.truth:
                parameters[name] = str(file)
                reasons.append(f"{name} {file.name}: lies beside it and shares its time")
                break
    return parameters, reasons


def _least(found: Inspection) -> dict[str, Value]:
    parameters: dict[str, Value] = {"path": str(found.path), "odometry": "none"}
    return parameters if found.kind == "CARMEN log" else parameters | {"topic": found.lidars[0].topic}


@dataclass(frozen=True)
class _Tried:
    """What a reader said when it was really made; ``problem``: why it was not."""

    scans: int = 0
    truth: str = ""
    notes: Mapping[str, int] = field(default_factory=dict)
    seat: Pose = field(default_factory=Pose)
    problem: str = ""


def _tried(reader: str, parameters: Mapping[str, Value]) -> _Tried:
    make = Carmen if reader == "carmen" else RosBag
    try:
        sequence = make(**parameters)  # type: ignore[arg-type]  # names and types as the reader's own spec has them
        first = next(iter(sequence.frames()))
    except EvalkitError as error:
        return _Tried(problem=str(error))
    truth = sequence.truth()
    known = truth.how if truth.trajectory is not None or truth.relations is not None else ""
    return _Tried(len(sequence), known, sequence.notes(), first.base_from_sensor)


def _catalogued(path: Path) -> tuple[str, tuple[str, ...]]:
    """The data set made of this very file, and what is known to be wrong with the file."""
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


def _table(reader: str, path: Path, parameters: Mapping[str, Value]) -> str:
    lines = ["[[sequence]]", f'use = "{reader}"', f"label = {json.dumps(path.name.split('.')[0])}"]
    return "\n".join([*lines, *(f"{name} = {json.dumps(value)}" for name, value in parameters.items())]) + "\n"


def _command(parameters: Mapping[str, Value]) -> str:
    words = ["evalkit", "compare", str(parameters["path"])]
    for name, value in parameters.items():
        if name in {"topic", "relations", "reference"}:
            words += [f"--{name}", str(value)]
        elif name != "path":
            words += ["--set", f"{name}={value}"]
    return shlex.join(words)
