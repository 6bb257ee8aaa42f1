"""Suggest how to run a recording: an experiment's table and a command, tried before they are suggested."""

from __future__ import annotations

import json
import math
import shlex
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

from evalkit.config.adhoc_experiment import label_of, word_of
from evalkit.core.errors import BadData, DataMissing
from evalkit.core.pose import Pose
from evalkit.core.se2 import wrap
from evalkit.plugins.parameters import Value
from evalkit.plugins.specs import Choice
from evalkit_datasets.commands.inspect.frame_tree import list_frames, mirror_if_upside_down
from evalkit_datasets.commands.inspect.inspector import Inspection, inspect_recording, measured_directions
from evalkit_datasets.commands.inspect.lidar_findings import is_default_code
from evalkit_datasets.commands.inspect.lidar_stats import LidarStats
from evalkit_datasets.commands.inspect.mended_inspection import inspect_mended, tell_mends
from evalkit_datasets.commands.inspect.mounting_angle import MountingAngle, estimate_mounting_angle
from evalkit_datasets.commands.inspect.odometry_findings import is_apart
from evalkit_datasets.commands.inspect.reader_trial import (
    MAX_WITHOUT_ODOMETRY,
    ReaderTrial,
    find_fields,
    try_reader,
)
from evalkit_datasets.commands.inspect.repeated_findings import PROBLEM, repeat_body, repeat_problems, repeat_sweep
from evalkit_datasets.commands.inspect.truth_choices import find_truth_files
from evalkit_datasets.commands.inspect.truth_doubts import find_truth_doubts
from evalkit_datasets.parsing.robots import count_common_spaces
from evalkit_datasets.parsing.transforms import own_name, with_prefix_of
from evalkit_datasets.readers import reader_common
from evalkit_datasets.readers.rosbag import NO_MOUNTING
from evalkit_datasets.recordings import catalog, data_sets

TILT_WORDS = ("vertical",)
MAPPER = "mapper."

MIN_MOUNTING_DEG, MAX_SQUARE_DEG = 5.0, 2.0
"""A smaller heading is not applied; a heading this close to a multiple of 90 deg is taken as that."""

UNKNOWN_PLACE = (
    "give base_from_sensor if you know it: else wheel odometry looks worse in turns, and a ground truth of the base "
    "does not fit"
)
"""What an unknown place of the lidar on its base does to the results."""

USUAL_CELL_M, LARGE_CELL_M = 0.05, 0.1


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
    lidar = _select_lidar(recording, given or {})
    recording, mends = inspect_mended(recording, given or {}, lidar.topic)
    choices, tried = _choose(recording, {**(given or {}), **mends})
    choices = (
        *(Choice(name, value, f"{name} {value}: mends a problem above") for name, value in mends.items()),
        *choices,
    )
    reader = recording.streams.reader
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

    A problem with a single mend is mended.
    For a catalogued recording, it also says by which data set it runs with its ground truth.
    """
    found = inspect_recording(Path(str(given["path"])), reader, given)
    if not found.lidars:
        return ()
    topic = _select_lidar(found, given).topic
    recording, mends = inspect_mended(found, given, topic)
    dataset, drive, _ = _find_catalogued(recording.path)
    catalogued = [Choice("use", None, _describe_catalogued(dataset, drive))] if dataset else []
    return (*tell_mends(found, topic, mends), *_choose(recording, {**given, **mends})[0], *catalogued)


def _choose(recording: Inspection, given: Mapping[str, Value]) -> tuple[tuple[Choice, ...], ReaderTrial]:
    """Return the choices beside the given parameters, and the result of opening the recording with both."""
    lidar = _select_lidar(recording, given)
    choosers: Mapping[str, Callable[[Inspection], Iterator[Choice]]] = {
        "carmen": _choose_for_log,
        "rosbag": partial(_choose_for_bag, lidar=lidar),
    }
    choose = choosers.get(recording.streams.reader, _choose_for_columns)
    choices = [*repeat_problems(recording, given), *choose(recording), *find_truth_files(recording, given)]
    choices += [*repeat_body(lidar, given), *repeat_sweep(recording, lidar, given)]
    if not any(one.level == "problem" and one.about == lidar.topic for one in recording.findings):
        choices += _choose_cells(lidar)
    choices = [one for one in choices if one.name not in given]
    values = {one.name: one.value for one in choices if one.value is not None and not one.name.startswith(MAPPER)}
    tried = try_reader(recording.streams.reader, {"path": str(recording.path), **values, **given})
    choices += _tell_scans_without_odometry(recording, tried)
    if tried.before_odometry and "start" not in given:
        choice, tried = _begin_with_odometry(tried, int(given.get("every", 1)))
        choices.append(choice)
    truth = str({**values, **given}.get("ground_truth", ""))
    if truth and not tried.problem:
        choices += find_truth_doubts(recording, lidar, truth)
    if "base_from_sensor" not in given and not tried.problem:  # then the recorded mounting is unknown
        choices += _choose_mounting(recording, lidar, tried)
    if tried.mounting != Pose() and "base_from_sensor" not in given:
        x, y, yaw_deg = tried.mounting.x, tried.mounting.y, math.degrees(tried.mounting.theta)
        where = f"the lidar is mounted at x {x:.3f} m, y {y:.3f} m, rotated by {yaw_deg:.1f} deg: as recorded"
        choices.append(Choice("base_from_sensor", None, where))
    return tuple(choices), tried


def _select_lidar(recording: Inspection, given: Mapping[str, Value]) -> LidarStats:
    topic = str(given.get("topic", "")).lstrip("/")
    return next((one for one in recording.lidars if one.topic.lstrip("/") == topic), best_lidar(recording)[0])


def _tell_scans_without_odometry(recording: Inspection, tried: ReaderTrial) -> Iterator[Choice]:
    """Warn of scans before or after the odometry, where no other clock is known that explains them."""
    without = tried.notes.get(reader_common.WITHOUT_ODOMETRY, 0)
    if without <= MAX_WITHOUT_ODOMETRY * tried.scans or any(one.clock_shift_s for one in recording.odometries):
        return
    clock = ", or has another clock (give --set stamp_shift_s)" if recording.streams.reader == "rosbag" else ""
    what = f"{without} of {tried.scans} scans have no odometry at their time: it begins late or ends early{clock}"
    yield Choice("odometry", None, what, warns=True)


def _begin_with_odometry(tried: ReaderTrial, every: int) -> tuple[Choice, ReaderTrial]:
    """Return the choice that skips the few scans before the odometry begins, and what the reader then opens."""
    late, without = tried.before_odometry, reader_common.WITHOUT_ODOMETRY
    left = tried.notes[without] - late
    notes = {name: count for name, count in {**tried.notes, without: left}.items() if count}
    start = late * every
    scans = "first scan" if start == 1 else f"first {start} scans"
    why = f"start {start}: skips the {scans}, before the odometry begins: methods that need it cannot start there"
    return Choice("start", start, why), replace(tried, scans=tried.scans - late, notes=notes)


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
    if fields := find_fields(recording, lidar.topic):
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


def _choose_mounting(recording: Inspection, lidar: LidarStats, tried: ReaderTrial) -> Iterator[Choice]:
    """Choose the heading that straight drives show where nothing states it; say where it contradicts what is stated."""
    angle, missing = _measure_mounting(recording, lidar), _describe_missing_mounting(recording, lidar, tried)
    if angle is None:
        if missing:
            why = f"the lidar is taken as the base: {missing}, and no straight drive shows it"
            yield Choice("base_from_sensor", None, f"{why}; {UNKNOWN_PLACE}")
        return
    off_deg = math.degrees(float(wrap(math.radians(angle.heading_deg) - tried.mounting.theta)))
    if abs(off_deg) < MIN_MOUNTING_DEG and not missing:
        return
    seen = f"{angle.heading_deg:.0f} deg (standard error {angle.error_deg:.1f} deg) on {angle.pairs} straight drives"
    if not missing:
        stated = f"lidar heading {math.degrees(tried.mounting.theta):.0f} deg, as recorded"
        mend = _state_mounting(recording, tried.mounting, angle.heading_deg)
        why = f"warning: {stated}, but the scans show {seen}; if they are right, {mend}"
        yield Choice("base_from_sensor", None, why, warns=True)
        return
    square = 90.0 * round(angle.heading_deg / 90.0)
    near = (
        abs(angle.heading_deg - square) <= max(3.0 * angle.error_deg, MAX_SQUARE_DEG) or abs(off_deg) < MIN_MOUNTING_DEG
    )
    heading = math.radians(square if near else angle.heading_deg)
    why = f"base_from_sensor 0 0 {heading:.4f}: {missing}; the scans show a heading of {seen}"
    where = f"x and y are unknown, taken as 0; {UNKNOWN_PLACE}"
    value = f"0 0 {heading:.4f}"
    yield Choice("base_from_sensor", value, f"{why}{', taken as square' if near else ''}; {where}", warns=True)


def _state_mounting(recording: Inspection, mounting: Pose, heading_deg: float) -> str:
    """Return how another heading of a lidar is stated, at the place that is recorded."""
    place = f"{mounting.x:.4g}", f"{mounting.y:.4g}"
    if recording.streams.reader == "columns":
        return f"write base_from_sensor = [{', '.join(place)}, {heading_deg:.1f}] in the layout"
    return f"give --set 'base_from_sensor={' '.join(place)} {math.radians(heading_deg):.4f}'"


def _describe_missing_mounting(recording: Inspection, lidar: LidarStats, tried: ReaderTrial) -> str:
    """Return that no transform in a bag states the mounting on the base that the reader takes, "" if one does."""
    mounting = next((one for one in recording.frames.mountings if one.sensor == lidar.frame), None)
    known = mounting is not None or tried.mounting != Pose()
    if recording.streams.reader != "rosbag" or (known and NO_MOUNTING not in tried.notes):
        return ""
    if mounting is not None and mounting.unlinked:
        return f"no transform from '{mounting.unlinked}' to '{lidar.frame}' (it is on '{mounting.base}')"
    frames = recording.frames
    if frames.names and lidar.frame not in frames.names:
        return f"no transform states the mounting of '{lidar.frame}', but those of {list_frames(frames)}"
    return "no transform states the mounting"


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


def _choose_for_columns(_recording: Inspection) -> Iterator[Choice]:
    return iter(())


def _choose_cells(lidar: LidarStats) -> Iterator[Choice]:
    """Choose larger cells than usual if neighbouring beams are more than two usual cells apart at the median range."""
    apart_m = lidar.returns.median_m * math.radians(abs(lidar.step_deg))
    if apart_m > 2.0 * USUAL_CELL_M:
        why = f"map cells of {LARGE_CELL_M:g} m: at the median range, {lidar.returns.median_m:.1f} m, beams are "
        yield Choice(f"{MAPPER}resolution_m", LARGE_CELL_M, f"{why}{apart_m:.2f} m apart")


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
    lines = ["[[sequence]]", f'use = "{reader}"', f"label = {json.dumps(label_of(path).split('.')[0])}"]
    values = {"path": str(path), **chosen}
    lines += [f"{name} = {json.dumps(value)}" for name, value in values.items() if not name.startswith(MAPPER)]
    cells = [f"{k.removeprefix(MAPPER)} = {json.dumps(v)}" for k, v in values.items() if k.startswith(MAPPER)]
    return "\n".join([*lines, *(["", "[mapper]", *cells] if cells else [])]) + "\n"


def _format_command(parameters: Mapping[str, Value]) -> str:
    words = ["evalkit", "compare", word_of(Path(str(parameters["path"])))]
    for name, value in parameters.items():
        if name in {"topic", "relations", "ground_truth"}:
            words += [f"--{name.replace('_', '-')}", str(value)]
        elif name != "path":
            words += ["--set", f"{name}={value}"]
    return shlex.join(words)
