"""Read ground truth files: relations (Kuemmerle et al. 2009), true trajectories, measured distances."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path
from typing import Any

import numpy as np

from evalkit.core.arrays import Bools
from evalkit.core.errors import BadData, brief
from evalkit.core.ground_truth import Relations, Truth
from evalkit.core.measured_distances import Span, SpanEnd
from evalkit.core.se2 import Stamps
from evalkit.core.trajectory import Trajectory
from evalkit.io.input_files import read_text
from evalkit.io.text_lines import iter_rows, parse_numbers
from evalkit.io.timestamps import format_stamp, parse_stamp_ns
from evalkit.io.toml import parse_toml
from evalkit.plugins.parameters import Parameter
from evalkit.plugins.result_files import read_trajectory

TOLERANCE_NS = 100_000_000
"""Truth up to this far before the first or after the last scan is kept: the matching limit of the relations."""

PARAMETERS: tuple[Parameter, ...] = (
    Parameter("relations", "", "", "path of Kuemmerle relations for this recording; empty: none"),
    Parameter(
        "ground_truth",
        "",
        "",
        "path of a true trajectory, same clock: TUM, or BAG?topic=/pose, BAG?tf=map,base; empty: none",
    ),
    Parameter("spans", "", "", "path of distances measured with a tape (TOML), times by the same clock; empty: none"),
)

RELATIONS_LAYOUT = "t1 t2 x y z roll pitch yaw"

SPANS_FILE = "a TOML file with one [[span]] per distance: from, to, metres"
SPAN_END = "expected a time in seconds, { at = seconds, point = [x, y] } or { wall = [x, y] }"
SPAN_KEYS = ("name", "from", "to", "metres", "sigma_m")
DEFAULT_SIGMA_M = 0.01


@dataclass(frozen=True)
class TruthPaths:
    """Paths of ground truth files, "" for none.

    ``how`` describes the origin of the truth for the report; "" for files given by the user, or none.
    """

    relations: str = ""
    ground_truth: str = ""
    spans: str = ""
    how: str = ""

    def __bool__(self) -> bool:
        return bool(self.relations or self.ground_truth or self.spans)


def load_truth(paths: TruthPaths, taken_ns: Stamps, recording_ns: tuple[int, int]) -> tuple[Truth, dict[str, int]]:
    """Return the truth within the time of the scans taken (N,), and counts of what was cut off or corrected, by name.

    ``recording_ns``: stamps of the first and the last scan of the whole recording. Raises BadData if no entry of a
    file lies within them: the file belongs to another recording.
    """
    counts: dict[str, int] = {}
    relations, trajectory = None, None
    spans: tuple[Span, ...] = ()
    if paths.relations:
        relations, counts["relations outside the scans"] = _load_relations(paths.relations, taken_ns, recording_ns)
    if paths.ground_truth:
        file = read_trajectory(paths.ground_truth)
        poses = file.trajectory
        _check_times(Path(paths.ground_truth), "ground-truth trajectory", poses.stamps_ns[None], recording_ns)
        inside = _is_within(poses.stamps_ns, taken_ns)
        counts |= {f"ground truth: {name}": count for name, count in file.notes.items()}
        counts["ground-truth poses outside the scans"] = int((~inside).sum())
        trajectory = Trajectory(poses.stamps_ns[inside], poses.poses[inside]) if inside.any() else None
    if paths.spans:
        spans, counts["measured distances outside the scans"] = _load_spans(paths.spans, taken_ns, recording_ns)
    how = paths.how or ("files given by the user" if paths else "none")
    truth = Truth(how, trajectory, relations, spans=spans)
    return truth, {name: count for name, count in counts.items() if count}


def read_relations(path: Path) -> Relations:
    """Return the relations in file order: pose of the robot at t2 in its frame at t1, in m and rad.

    Not sorted, and duplicates are kept: t2 before t1 and repeated pairs occur in the published files. Raises
    DataMissing if there is no such file and BadData, with the line, if it is invalid.
    """
    first, second, motions = [], [], []
    for line, words in iter_rows(path, RELATIONS_LAYOUT, f"a file of relations ({RELATIONS_LAYOUT})"):
        try:
            first.append(parse_stamp_ns(words[0]))
            second.append(parse_stamp_ns(words[1]))
        except ValueError as error:
            raise BadData(str(path), f"line {line}", str(error), f"expected '{RELATIONS_LAYOUT}'") from None
        x, y, *rest = values = parse_numbers(path, line, words[2:], RELATIONS_LAYOUT)
        if not np.isfinite(values).all():
            raise BadData(str(path), f"line {line}", "a value is not finite", "remove the relation from the file")
        motions.append((x, y, rest[-1]))
    if not motions:
        raise BadData(str(path), "", "no relation in it", f"expected lines '{RELATIONS_LAYOUT}'")
    return Relations(np.array(first), np.array(second), np.array(motions))


def read_spans(path: Path) -> tuple[Span, ...]:
    """Return measured distances in file order.

    An end of a span is a time in seconds (the robot at that time), ``{ at = seconds, point = [x, y] }`` (a point in m
    in the robot's frame at that time) or ``{ wall = [x, y] }`` (the wall of the map nearest to that point).
    ``sigma_m`` defaults to 0.01. Raises DataMissing if there is no such file and BadData if it is invalid.
    """
    try:  # Decimal: a float would lose the nanoseconds of a present-day time
        content = parse_toml(read_text(path, SPANS_FILE), Decimal)
    except ValueError as error:
        raise BadData(str(path), "", f"not valid TOML ({error})", f"give {SPANS_FILE}") from None
    rows = content.get("span")
    if not isinstance(rows, list) or not rows or set(content) != {"span"}:
        raise BadData(str(path), "", "expected tables [[span]] and nothing else", f"give {SPANS_FILE}")
    return tuple(_parse_span(path, number, row) for number, row in enumerate(rows, start=1))


def _load_relations(path: str, taken_ns: Stamps, recording_ns: tuple[int, int]) -> tuple[Relations | None, int]:
    """Return the relations within the scans, None if there are none, and the number of those outside."""
    relations = read_relations(Path(path))
    times = np.stack([relations.first_ns, relations.second_ns])
    _check_times(Path(path), "relations", times, recording_ns)
    inside = np.asarray(_is_within(times, taken_ns).all(axis=0))
    kept = None
    if inside.any():
        kept = Relations(relations.first_ns[inside], relations.second_ns[inside], relations.first_from_second[inside])
    return kept, int((~inside).sum())


def _load_spans(path: str, taken_ns: Stamps, recording_ns: tuple[int, int]) -> tuple[tuple[Span, ...], int]:
    """Return the measured distances whose times lie within the scans, and the number of the others."""
    spans = read_spans(Path(path))
    times = [[end.stamp_ns for end in (span.first, span.second) if end.stamp_ns is not None] for span in spans]
    if stamps := [stamp for each in times for stamp in each]:
        _check_times(Path(path), "file of measured distances", np.array([stamps]), recording_ns)
    inside = [bool(_is_within(np.array(each, dtype=np.int64), taken_ns).all()) for each in times]
    return tuple(span for span, kept in zip(spans, inside, strict=True) if kept), inside.count(False)


def _is_within(times_ns: Stamps, scans_ns: Stamps) -> Bools:
    return np.asarray((times_ns >= scans_ns[0] - TOLERANCE_NS) & (times_ns <= scans_ns[-1] + TOLERANCE_NS))


def _check_times(path: Path, kind: str, times_ns: Stamps, recording_ns: tuple[int, int]) -> None:
    """Raise BadData if no entry (columns of times (K, N)) lies within the time of the recording."""
    if _is_within(times_ns, np.array(recording_ns)).all(axis=0).any():
        return
    begin, end = format_stamp(int(times_ns.min())), format_stamp(int(times_ns.max()))
    scans = f"{format_stamp(recording_ns[0])} to {format_stamp(recording_ns[1])} s"
    raise BadData(
        str(path),
        "",
        f"its times, {begin} to {end} s, do not overlap the recording, {scans}",
        f"give the {kind} of this recording, or none",
    )


def _parse_span(path: Path, number: int, row: object) -> Span:
    place = f"span {number}"
    if not isinstance(row, dict):
        raise BadData(str(path), place, f"{brief(row)} is not a table", f"give {SPANS_FILE}")
    _check_keys(path, place, row, SPAN_KEYS)
    for key in ("from", "to", "metres"):
        if key not in row:
            raise BadData(str(path), place, f"missing key '{key}'", f"give {SPANS_FILE}")
    name = str(row.get("name", place))
    first, second = (_parse_end(path, f"{place}, {key}", row[key]) for key in ("from", "to"))
    lengths = [_parse_number(path, f"{place}, {key}", row.get(key, DEFAULT_SIGMA_M)) for key in ("metres", "sigma_m")]
    try:
        return Span(name, first, second, *lengths)
    except ValueError as error:
        raise BadData(str(path), place, str(error), "give positive numbers") from None


def _parse_end(path: Path, place: str, value: object) -> SpanEnd:
    if not isinstance(value, dict):
        return SpanEnd(stamp_ns=_parse_time(path, place, value))
    _check_keys(path, place, value, ("wall",) if "wall" in value else ("at", "point"))
    if "wall" in value:
        return SpanEnd(*_parse_point(path, place, value["wall"]))
    if "at" not in value:
        raise BadData(str(path), place, "neither 'at' nor 'wall'", SPAN_END)
    return SpanEnd(*_parse_point(path, place, value.get("point", [0, 0])), _parse_time(path, place, value["at"]))


def _parse_time(path: Path, place: str, value: object) -> int:
    try:
        if isinstance(value, bool) or not isinstance(value, (int, str, Decimal)):
            raise ValueError(f"{brief(value)} is not a time in seconds")
        return parse_stamp_ns(str(value))
    except ValueError as error:
        raise BadData(str(path), place, str(error), SPAN_END) from None


def _parse_point(path: Path, place: str, value: object) -> tuple[float, float]:
    if not isinstance(value, list) or len(value) != 2:
        raise BadData(str(path), place, f"'{brief(str(value))[1:-1]}' is not a point", SPAN_END)
    x, y = (_parse_number(path, place, each) for each in value)
    return x, y


def _parse_number(path: Path, place: str, value: object) -> float:
    number = float(value) if isinstance(value, (int, float, Decimal)) and not isinstance(value, bool) else math.nan
    if not math.isfinite(number):  # 1e400 is infinite, though not as a decimal
        raise BadData(str(path), place, f"'{brief(str(value))[1:-1]}' is not a number", "give a number in metres")
    return number


def _check_keys(path: Path, place: str, row: Mapping[str, Any], keys: tuple[str, ...]) -> None:
    for key in row:
        if key not in keys:
            raise BadData(str(path), place, f"unknown key {brief(key)}", f"known: {', '.join(keys)}")
