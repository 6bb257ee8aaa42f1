"""Suggest how to run a recording: an experiment's table and a command, tried before they are suggested."""

from __future__ import annotations

import json
import math
import re
import shlex
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import numpy as np

from evalkit.core.errors import BadData, DataMissing, EvalkitError
from evalkit.core.pose import Pose
from evalkit.core.se2 import wrap
from evalkit.plugins import registry
from evalkit.plugins.parameters import Value
from evalkit.plugins.specs import Choice
from evalkit_datasets.commands.inspect.finding import InspectionFinding
from evalkit_datasets.commands.inspect.frame_tree import mirror_if_upside_down
from evalkit_datasets.commands.inspect.inspector import Inspection, inspect_recording, measured_directions
from evalkit_datasets.commands.inspect.lidar_findings import SET_BACK, check_body, is_default_code
from evalkit_datasets.commands.inspect.lidar_stats import LidarStats
from evalkit_datasets.commands.inspect.mounting_angle import MountingAngle, estimate_mounting_angle
from evalkit_datasets.commands.inspect.odometry_findings import DIRECTION, STAMPS, is_apart
from evalkit_datasets.commands.inspect.turn_comparison import SHIFT_STEP_S
from evalkit_datasets.parsing.range_minimum import RANGE_MIN
from evalkit_datasets.parsing.robots import count_common_spaces
from evalkit_datasets.parsing.transforms import own_name, with_prefix_of
from evalkit_datasets.parsing.truth_files import TruthPaths, load_truth
from evalkit_datasets.recordings import catalog, data_sets

TILT_WORDS = ("vertical",)
MAPPER = "mapper."
PROBLEM = "problem"  # the name of a choice that sets nothing
STATED_BY: Mapping[str, frozenset[str]] = {
    DIRECTION: frozenset({"base_from_sensor", "fields"}),
    STAMPS: frozenset({"stamp_shift_s"}),
    SET_BACK: frozenset({"start", "limit"}),
}
"""Parameters of a user who has read a finding, by what it is about: it is not repeated."""

MIN_MOUNTING_DEG, MAX_SQUARE_DEG = 5.0, 2.0
"""A smaller heading is not applied; a heading this close to a multiple of 90 deg is taken as that."""

USUAL_CELL_M, LARGE_CELL_M = 0.05, 0.1

MIN_SKEW_M = 0.1
"""Motion within a scan that moves points by less, at the median range, is not told: two usual cells."""

TRUTH_NAMES = ("truth", "ground[-_]?truth", "gt", "reference", "mocap", "vicon", "optitrack")
"""Words (regular expressions) that the name of a file with a true trajectory begins with."""

MAX_LISTED = 5


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


def suggest_config(recording: Inspection, given: Mapping[str, Value] | None = None) -> SuggestedConfig | None:
    """Return a configuration for a recording, or None if it contains no laser scan.

    ``given``: parameters of the reader that are not searched.
    """
    if not recording.lidars:
        return None
    choices, tried = _choose(recording, given or {})
    reader = _find_reader(recording)
    chosen = {one.name: one.value for one in choices if one.value is not None} | dict(given or {})
    parameters = {"path": str(recording.path)} | {k: v for k, v in chosen.items() if not k.startswith(MAPPER)}
    reasons = [one.reason for one in choices if one.name != PROBLEM]  # problems are findings already
    dataset, drive, defects = _find_catalogued(recording.path)
    if dataset:
        reasons.append(_describe_catalogued(dataset, drive))
    return SuggestedConfig(
        reader, parameters, _format_table(reader, recording.path, chosen), _format_command(parameters),
        tuple(reasons), tried.scans, tried.truth, tried.notes, tried.problem, dataset, defects,
    )  # fmt: skip


def choose_parameters(reader: str, given: Mapping[str, Value]) -> tuple[Choice, ...]:
    """Return what was found in and beside the recording ``given["path"]``, without the parameters that are given.

    For a catalogued recording, it also says by which data set it runs with its ground truth.
    """
    recording = inspect_recording(Path(str(given["path"])), reader, given)
    if not recording.lidars:
        return ()
    dataset, drive, _ = _find_catalogued(recording.path)
    catalogued = [Choice("use", None, _describe_catalogued(dataset, drive))] if dataset else []
    return (*_choose(recording, given)[0], *catalogued)


def _choose(recording: Inspection, given: Mapping[str, Value]) -> tuple[tuple[Choice, ...], _Trial]:
    """Return the choices beside the given parameters, and the result of opening the recording with both."""
    topic = str(given.get("topic", "")).lstrip("/")
    lidar = next((one for one in recording.lidars if one.topic.lstrip("/") == topic), best_lidar(recording)[0])
    choosers: Mapping[str, Callable[[Inspection], Iterator[Choice]]] = {
        "carmen": _choose_for_log,
        "rosbag": partial(_choose_for_bag, lidar=lidar),
    }
    choose = choosers.get(_find_reader(recording), _choose_for_columns)
    choices = [*_repeat_problems(recording, given), *choose(recording), *_find_truth_files(recording, given)]
    choices += [*_repeat_body(lidar, given), *_repeat_sweep(recording, lidar, given), *_choose_cells(lidar)]
    choices = [one for one in choices if one.name not in given]
    values = {one.name: one.value for one in choices if one.value is not None and not one.name.startswith(MAPPER)}
    tried = _try_reader(_find_reader(recording), {"path": str(recording.path), **values, **given})
    if "base_from_sensor" not in given and not tried.problem:  # then the recorded mounting is unknown
        choices += _choose_mounting(recording, lidar, tried.mounting)
    if tried.mounting != Pose() and "base_from_sensor" not in given:
        x, y, yaw_deg = tried.mounting.x, tried.mounting.y, math.degrees(tried.mounting.theta)
        where = f"the lidar is mounted at x {x:.3f} m, y {y:.3f} m, rotated by {yaw_deg:.1f} deg: as recorded"
        choices.append(Choice("base_from_sensor", None, where))
    return tuple(choices), tried


def _find_reader(recording: Inspection) -> str:
    return recording.streams.reader


def best_lidar(recording: Inspection) -> tuple[LidarStats, str]:
    """Return the lidar to use and the reason; requires at least one lidar."""
    tilted = {mounting.sensor for mounting in recording.frames.mountings if mounting.problem}
    level = [one for one in recording.lidars if one.frame not in tilted and not _is_tilted_by_name(one)] or list(
        recording.lidars
    )
    best = max(level, key=measured_directions)
    if len(recording.lidars) == 1:
        whose = " of its robot; the topics of other robots are left out, choose another by --topic"
        return best, f"the only lidar{whose if recording.streams.left_out else ''}"
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


def _choose_for_bag(recording: Inspection, lidar: LidarStats) -> Iterator[Choice]:
    _, why = best_lidar(recording)
    yield Choice("topic", lidar.topic, f"topic {lidar.topic}: {why}")
    if fields := _find_fields(recording, lidar.topic):
        yield Choice("fields", fields, f"fields of {lidar.kind} by their names and values: {fields}; check the units")
    messages = [one for one in recording.odometries if one.topic != "tf"]
    usable = [one for one in messages or recording.odometries if one.like_wheels]
    apart = [one for one in usable if is_apart(lidar, one)]
    usable = [one for one in usable if one not in apart]
    if not usable:
        why = "its motion is not that of wheels" if recording.odometries else "the bag has none"
        why = "its times are not those of the scans" if apart else why
        yield Choice("odometry", "none", f"odometry none: {why}")
        return
    own = [one for one in usable if one.child in with_prefix_of(lidar.frame, [own_name(one.child)])] or usable
    near = max(own, key=lambda one: count_common_spaces(one.topic, lidar.topic))
    named = next((one for one in own if one.topic.lstrip("/") == "odom"), near)
    what = f"odometry {named.topic} of frame '{named.child}': {named.path_m:.1f} m"
    yield Choice("odometry", named.topic if len(messages) > 1 else None, what)
    if named.topic == "tf" and sum(one.topic == "tf" for one in usable) > 1:
        yield Choice("base_frame", named.child, f"base frame {named.child}: that of this odometry")


def _choose_mounting(recording: Inspection, lidar: LidarStats, recorded: Pose) -> Iterator[Choice]:
    """Choose the heading that straight drives show where nothing states it; say where it contradicts what is stated."""
    angle = _measure_mounting(recording, lidar)
    if angle is None:
        if _find_reader(recording) == "rosbag" and lidar.frame not in recording.frames.names:
            why = "the lidar is taken as the base: no transform states its mounting, and no straight drive shows it"
            yield Choice("base_from_sensor", None, f"{why}; beside a ground truth, give base_from_sensor")
        return
    off_deg = math.degrees(float(wrap(math.radians(angle.heading_deg) - recorded.theta)))
    if abs(off_deg) < MIN_MOUNTING_DEG:
        return
    seen = f"{angle.heading_deg:.0f} deg (standard error {angle.error_deg:.1f} deg) on {angle.pairs} straight drives"
    stated = recorded != Pose() or any(mounting.sensor == lidar.frame for mounting in recording.frames.mountings)
    if stated or _find_reader(recording) != "rosbag":
        what = f"lidar heading {math.degrees(recorded.theta):.0f} deg, as recorded, but the scans show {seen}: check it"
        yield Choice("base_from_sensor", None, what, warns=True)
        return
    square = 90.0 * round(angle.heading_deg / 90.0)
    near = abs(angle.heading_deg - square) <= max(3.0 * angle.error_deg, MAX_SQUARE_DEG)
    heading = math.radians(square if near else angle.heading_deg)
    why = f"base_from_sensor 0 0 {heading:.4f}: no transform states the mounting; the scans show a heading of {seen}"
    yield Choice("base_from_sensor", f"0 0 {heading:.4f}", f"{why}{', taken as square' if near else ''}")


def _measure_mounting(recording: Inspection, lidar: LidarStats) -> MountingAngle | None:
    """Return the heading of a lidar by the first odometry that moves like wheels and turns as the scans do."""
    laser = next((one for one in recording.streams.lasers if one.topic == lidar.topic), None)
    for wheels, stats in zip(recording.streams.wheels, recording.odometries, strict=True):
        turn = recording.turns.get(f"{wheels.topic} {wheels.child}")
        if laser is not None and stats.like_wheels and (turn is None or turn.scale > 0.0):
            return estimate_mounting_angle(wheels, mirror_if_upside_down(laser, recording.frames))
    return None


def _choose_for_log(recording: Inspection) -> Iterator[Choice]:
    codes = [code.low_m for code in recording.lidars[0].returns.codes if code.low_m < 50.0]
    unknown = [low for low in codes if not is_default_code(low)]
    if unknown:
        why = f"range_max_m {min(unknown):g} m: ranges of this length or more mean no return"
        yield Choice("range_max_m", min(unknown), why)
    if not recording.poses_from and recording.odometries and not recording.odometries[0].like_wheels:
        yield Choice("odometry", "none", "odometry none: the motion of its poses is not that of wheels")


def _repeat_problems(recording: Inspection, given: Mapping[str, Value]) -> Iterator[Choice]:
    """Say before a comparison what makes its numbers wrong, such as ranges in another unit."""
    said: set[str] = set()  # the same odometry may come as messages and as tf
    for finding in (one for one in recording.findings if one.level == "problem" or one.about in (DIRECTION, STAMPS)):
        unused = finding.about.startswith("odometry ") and given.get("odometry") == "none"
        stated = not STATED_BY.get(finding.about, frozenset()).isdisjoint(given)
        if not unused and not stated and finding.what not in said:
            yield _repeat(finding)
        said.add(finding.what)


def _repeat_body(lidar: LidarStats, given: Mapping[str, Value]) -> Iterator[Choice]:
    """Say before a comparison that the lidar sees the robot itself, unless its ranges are left out already."""
    body = lidar.returns.body
    if body is not None and float(str(given.get(RANGE_MIN.name, 0.0))) < body.range_min_m:
        yield from map(_repeat, check_body(lidar))


def _repeat_sweep(recording: Inspection, lidar: LidarStats, given: Mapping[str, Value]) -> Iterator[Choice]:
    """Say before a comparison that scans may be skewed by the motion within them, where that is large and not known.

    If the turns of the odometry show that scans are taken at their stamps, they are not; if they show the middle of a
    revolution, a finding on the stamps says so.
    """
    if "sweep_s" in given or given.get("odometry") == "none" or not lidar.may_be_swept:
        return
    sweep_s, known_s = lidar.revolution_s, 0.5 * lidar.revolution_s - SHIFT_STEP_S
    turns = recording.turns.values()
    if any(turn.is_shifted or turn.shift_interval[1] < known_s for turn in turns):
        return
    wheels = [one for one in recording.odometries if one.like_wheels and one.unit is None and not is_apart(lidar, one)]
    turned_deg = sweep_s * max((one.fastest_deg_s for one in wheels), default=0.0)
    moved_m = sweep_s * max((one.fastest_m_s for one in wheels), default=0.0)
    if max(moved_m, math.radians(turned_deg) * lidar.returns.median_m) < MIN_SKEW_M:
        return
    what = (
        f"{lidar.topic}: its time_increment is 0 or less, and no turn shows whether all beams are fired at once: if it "
        f"turns once a scan, the robot moves by up to {moved_m:.2f} m and {turned_deg:.0f} deg within a scan"
    )
    yield Choice(PROBLEM, None, f"warning: {what}; then use --set sweep_s={sweep_s:.2g}", warns=True)


def _repeat(finding: InspectionFinding) -> Choice:
    advice = f"; {finding.advice}" if finding.advice else ""
    return Choice(PROBLEM, None, f"{finding.level}: {finding.about}: {finding.what}{advice}", warns=True)


def _choose_for_columns(_recording: Inspection) -> Iterator[Choice]:
    return iter(())


def _choose_cells(lidar: LidarStats) -> Iterator[Choice]:
    """Choose larger cells than usual if neighbouring beams are more than two usual cells apart at the median range."""
    apart_m = lidar.returns.median_m * math.radians(abs(lidar.step_deg))
    if apart_m > 2.0 * USUAL_CELL_M:
        why = f"map cells of {LARGE_CELL_M:g} m: at the median range, {lidar.returns.median_m:.1f} m, beams are "
        yield Choice(f"{MAPPER}resolution_m", LARGE_CELL_M, f"{why}{apart_m:.2f} m apart")


def _find_truth_files(recording: Inspection, given: Mapping[str, Value]) -> Iterator[Choice]:
    """Find relations and reference trajectory in the same folder that overlap the recording in time.

    Without a name that says so a trajectory may as well be that of a method: it is told, and not chosen.
    """
    for name, ending in (("relations", "*.relations"), ("ground_truth", "*.tum")):
        if name not in given:
            yield from _choose_truth(recording, name, sorted(recording.path.parent.glob(ending)))


def _choose_truth(recording: Inspection, name: str, files: list[Path]) -> Iterator[Choice]:
    """Choose the only file with the name of a truth; say which other ones, or several, could be chosen."""
    what, option = name.replace("_", " "), f"--{name.replace('_', '-')}"
    named = [file for file in files if is_named_as_truth(file, recording.path)]
    problems = {file: _find_truth_problem(recording, name, file) for file in named}
    fitting = [file for file in named if not problems[file]]
    yield from (Choice(name, None, f"{what} {file.name} not taken: {why}") for file, why in problems.items() if why)
    if len(fitting) == 1:
        yield Choice(name, str(fitting[0]), f"{what} {fitting[0].name}: in the same folder, and overlaps in time")
        return
    others = fitting or [file for file in files if file not in named and _overlaps(recording, name, file)]
    if others:
        listed = ", ".join(file.name for file in others[:MAX_LISTED]) + (", ..." if len(others) > MAX_LISTED else "")
        why = "several have the name of a truth" if fitting else "no name says that it is the truth"
        yield Choice(name, None, f"no {what} taken of {listed}, in the same folder: {why}; choose with {option} FILE")


def is_named_as_truth(file: Path, recording: Path) -> bool:
    """Return whether a file is called like its recording ("drive.tum") or a truth ("gt.tum", "drive-truth.tum").

    The name of a recording may go on behind a hyphen ("drive-merged.log"), unless it begins with a date. Behind the
    name of the recording and the word of a truth anything may follow ("drive-reference-by-hand.tum").
    """
    name, whole = file.stem.lower(), recording.name.split(".")[0].lower()
    begin = whole.split("-")[0]
    own = {whole, recording.stem.lower(), *([] if begin.isdigit() else [begin])}
    words = "|".join(TRUTH_NAMES)
    if name in own or re.fullmatch(rf"({words})([-_.]?(2d|\d+))?", name):
        return True
    rests = (name[len(each) + 1 :] for each in own if name.startswith((f"{each}-", f"{each}_", f"{each}.")))
    return any(re.match(rf"({words})([-_.]|$)", rest) for rest in rests)


def _find_truth_problem(recording: Inspection, name: str, file: Path) -> str:
    """Return why a recording cannot be read with a truth, "" if it can."""
    tried = _try_reader(_find_reader(recording), _minimal_parameters(recording) | {name: str(file)})
    return tried.problem or ("" if tried.truth else "no pose of it lies within the scans")


def _overlaps(recording: Inspection, name: str, file: Path) -> bool:
    """Return whether a file can be read and overlaps the scans in time, without opening the recording again."""
    stamps = np.sort(recording.streams.lasers[0].stamps_ns)
    try:
        truth, _ = load_truth(TruthPaths(**{name: str(file)}), stamps, (int(stamps[0]), int(stamps[-1])))
    except EvalkitError:
        return False
    return truth.trajectory is not None or truth.relations is not None


def _find_fields(recording: Inspection, topic: str) -> str:
    return next((laser.fields for laser in recording.streams.lasers if laser.topic == topic), "")


def _minimal_parameters(recording: Inspection) -> dict[str, Value]:
    topic = recording.lidars[0].topic
    own: dict[str, dict[str, Value]] = {
        "carmen": {"odometry": "none"},
        "rosbag": {"odometry": "none", "topic": topic, "fields": _find_fields(recording, topic)},
    }
    return {"path": str(recording.path), **own.get(_find_reader(recording), {})}


@dataclass(frozen=True)
class _Trial:
    """The result of opening a recording with a reader; ``problem``: why it failed."""

    scans: int = 0
    truth: str = ""
    notes: Mapping[str, int] = field(default_factory=dict)
    mounting: Pose = field(default_factory=Pose)
    problem: str = ""


def _try_reader(reader: str, parameters: Mapping[str, Value]) -> _Trial:
    try:
        sequence = registry.dataset(reader).make(**parameters)
        first = next(iter(sequence.frames()))
    except EvalkitError as error:
        return _Trial(problem=str(error))
    truth = sequence.truth()
    known = truth.how if truth.trajectory is not None or truth.relations is not None else ""
    return _Trial(len(sequence), known, sequence.notes(), first.base_from_sensor)


def _find_catalogued(path: Path) -> tuple[str, str, tuple[str, ...]]:
    """Return the data set made of this file, "" if none, the drive if not its first, and the file's known defects."""
    for file in [path] if path.is_file() else sorted(path.iterdir()):
        for card in catalog.load_catalog().values():
            if not card.bytes or file.stat().st_size != card.bytes:
                continue
            try:
                catalog.verify(card, file)
            except (BadData, DataMissing):
                continue
            dataset = next((name for name in data_sets.FILES if card.name in data_sets.recordings_of(name)), "")
            return dataset, _find_drive(dataset, card.name), card.defects
    return "", "", ()


def _find_drive(dataset: str, file: str) -> str:
    drives = data_sets.DATASETS[dataset].get("drives", {}) if dataset else {}
    return next((name for name in list(drives)[1:] if drives[name] == file), "")


def _describe_catalogued(dataset: str, drive: str) -> str:
    use = f'use = "{dataset}"' + (f', drive = "{drive}",' if drive else "")
    return f"it is a catalogued recording: {use} runs it with its parameters and ground truth"


def _format_table(reader: str, path: Path, chosen: Mapping[str, Value]) -> str:
    lines = ["[[sequence]]", f'use = "{reader}"', f"label = {json.dumps(path.name.split('.')[0])}"]
    values = {"path": str(path), **chosen}
    lines += [f"{name} = {json.dumps(value)}" for name, value in values.items() if not name.startswith(MAPPER)]
    cells = [f"{k.removeprefix(MAPPER)} = {json.dumps(v)}" for k, v in values.items() if k.startswith(MAPPER)]
    return "\n".join([*lines, *(["", "[mapper]", *cells] if cells else [])]) + "\n"


def _format_command(parameters: Mapping[str, Value]) -> str:
    words = ["evalkit", "compare", str(parameters["path"])]
    for name, value in parameters.items():
        if name in {"topic", "relations", "ground_truth"}:
            words += [f"--{name.replace('_', '-')}", str(value)]
        elif name != "path":
            words += ["--set", f"{name}={value}"]
    return shlex.join(words)
