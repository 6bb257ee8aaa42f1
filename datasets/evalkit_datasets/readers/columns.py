"""Read a text log in columns (CSV, TSV, blanks) as a Sequence: a line is a scan, its time and, if known, odometry."""

from __future__ import annotations

import shlex
from array import array
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from decimal import Decimal, DecimalException
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from evalkit.core.arrays import Ints
from evalkit.core.errors import BadData, brief
from evalkit.core.ground_truth import Truth
from evalkit.core.pose import Pose
from evalkit.core.scan import Frame, Scan
from evalkit.core.se2 import Floats, Stamps, wrap
from evalkit.io.text_lines import iter_lines, parse_columns
from evalkit.io.timestamps import order_stamps, parse_stamp_ns
from evalkit.plugins.parameters import Parameter
from evalkit.plugins.specs import DatasetSpec
from evalkit_datasets.parsing import truth_files
from evalkit_datasets.parsing.buffers import sort_by_rank
from evalkit_datasets.parsing.carmen_parser import is_carmen
from evalkit_datasets.parsing.columns_layout import (
    ANGLE_UNITS,
    DECIMAL_COMMA,
    LENGTH_UNITS,
    TIME_DIGITS,
    ColumnsLayout,
    TickColumns,
    has_decimal_comma,
    is_described,
    layout_from_table,
    read_layout,
    split_columns,
)
from evalkit_datasets.parsing.truth_files import TruthPaths
from evalkit_datasets.readers import reader_common

EXPECTED = "a text log in columns"
MAX_CLOCK_NS = 4e18


@dataclass(frozen=True, slots=True, eq=False)
class _Ranges:
    """The ranges (B,) of one line, in m."""

    ranges: Floats


class Columns:
    """The Sequence of a text log whose columns a TOML file describes (``layout``; by default FILE.toml beside it).

    The border of evalkit: times become integer ns and increase, ranges become m with inf for no return and nan for
    values that are zero, negative or outside the limits, angles become counter-clockwise, tick counts become a pose
    ``odom_from_base`` of a differential drive. Counters that wrap are assumed to move by less than half of their range
    (the clock: by less than the range) between two lines.
    """

    def __init__(
        self,
        path: str,
        layout: str | Mapping[str, Any] = "",
        relations: str = "",
        ground_truth: str = "",
        spans: str = "",
        start: int = 0,
        every: int = 1,
        limit: int = 0,
        how: str = "",
    ) -> None:
        self._path = reader_common.check_exists("columns", path)
        self._layout = (
            read_layout(Path(layout or f"{path}.toml"))
            if isinstance(layout, str)
            else layout_from_table("layout", layout)
        )
        self.first_damage = ""  # the first line that was dropped, and why
        self._beams = Counter[int]()  # how many scans have a number of ranges
        stamps, lines, values, damaged = self._read_columns()
        poses = _compute_poses(self._layout, values)
        order = order_stamps(stamps)
        keep = order.keep
        self._counts = {
            reader_common.DAMAGED_LINES: damaged,
            "scans with fewer or more ranges than most": self._beams.total() - max(self._beams.values()),
            "scans out of order": order.backwards,
            reader_common.REPEATED_STAMPS: order.repeated,
        }
        which = reader_common.select_scans(start, every, limit)
        self.recorded_odometry = stamps[keep], poses[keep]  # times (N,) and poses (N, 3) before jumps are taken out
        joined, jumps = reader_common.join_jumps(stamps[keep], poses[keep])
        self._counts |= jumps
        self._stamps, self._lines, self._poses = stamps[keep][which], lines[keep][which], joined[which]
        if not len(self):
            raise BadData(str(path), "", f"start {start} lies beyond its {len(keep)} scans", "start earlier")
        span = int(stamps[keep[0]]), int(stamps[keep[-1]])
        paths = TruthPaths(relations, ground_truth, spans, how)
        self._truth, cut = truth_files.load_truth(paths, self._stamps, span)
        self._counts |= cut

    def __len__(self) -> int:
        return len(self._stamps)

    def frames(self) -> Iterator[Frame]:
        """Yield the scans in order of time, read from the log one by one."""
        layout = self._layout.scan
        x, y, heading_deg = self._layout.base_from_sensor
        mounting = Pose(x, y, float(np.radians(heading_deg)))
        ranks = np.argsort(self._lines)
        lines = sort_by_rank(zip(ranks.tolist(), self._iter_scans(ranks), strict=True))
        for stamp, line, row in zip(self._stamps, lines, self._poses, strict=True):
            angles = layout.angles(len(line.ranges))
            limits = layout.range_min_m, layout.range_max_m
            scan = Scan(int(stamp), line.ranges, angles, *limits, round(layout.turned_s * 1e9 / (len(angles) - 1)))
            yield Frame(scan, mounting, reader_common.pose_or_none(row))

    def truth(self) -> Truth:
        """Return the truth of the files given."""
        return self._truth

    def notes(self) -> Mapping[str, int]:
        """Return the number of defects handled, by name."""
        return reader_common.drop_zeros(self._counts)

    def _iter_words(self) -> Iterator[tuple[int, list[bytes]]]:
        """Yield line number and words of every line with content."""
        comment = self._layout.comment.encode()
        for number, line in enumerate(iter_lines(self._path, EXPECTED), start=1):
            if number > self._layout.header_lines and not (comment and line.startswith(comment)):
                if has_decimal_comma(line):
                    what, remedy = DECIMAL_COMMA
                    raise BadData(
                        str(self._path), f"line {number}", what, remedy.format(file=shlex.quote(str(self._path)))
                    )
                words = split_columns(line)
                if len(words) < self._layout.min_columns and line.rstrip().endswith((b",", b";")):
                    words.append(b"nan")  # the last column is empty
                if any(word != b"nan" for word in words):
                    yield number, words

    def _read_columns(self) -> tuple[Stamps, Ints, Floats, int]:
        """Return stamps (N,), line numbers (N,) and odometry (N, K) of the valid lines, and the number of others."""
        layout = self._layout
        counts, lines, values = array("q"), array("q"), array("d")
        damaged = 0
        for number, words in self._iter_words():
            try:
                if len(words) < layout.min_columns:
                    raise ValueError(f"{len(words)} columns, {layout.min_columns} expected")
                row = [float(parse_columns(words, column, column + 1)[0]) for column in layout.odometry_columns]
                if not np.isfinite(row).all():
                    raise ValueError("a value of the odometry is not finite")
                stamp = _parse_time_ns(words[layout.time.column - 1].decode("latin-1"), layout.time.unit)
                ranges = self._parse_ranges(words)
            except ValueError as error:
                self.first_damage = self.first_damage or f"line {number}: {str(error)[:160]}"
                damaged += 1
                continue
            self._beams[len(ranges)] += 1
            counts.append(stamp)
            lines.append(number)
            values.extend(row)
        if not len(lines):
            what = f"{self.first_damage}; no valid line" if damaged else "no line with content"
            raise BadData(str(self._path), "", what, "describe its columns in the layout, or give another file")
        range_ns = layout.time.wraps_at * 10 ** (9 - TIME_DIGITS[layout.time.unit])
        if len(counts) * float(range_ns) > MAX_CLOCK_NS:
            raise BadData(str(self._path), "", f"{len(counts)} wraps of the clock are too long", "check time.wraps_at")
        stamps = _unwrap(np.array(counts, dtype=np.int64), range_ns, backwards=False)
        table = np.array(values, dtype=np.float64).reshape(len(lines), len(layout.odometry_columns))
        return stamps, np.array(lines, dtype=np.int64), table, damaged

    def _parse_ranges(self, words: list[bytes]) -> Floats:
        """Return the ranges (B,) in m: inf for no return, nan for what is no range; raises ValueError."""
        layout = self._layout.scan
        last = layout.first - 1 + layout.beams if layout.beams else len(words)
        raw = parse_columns(words, layout.first - 1, last)
        metres = raw * LENGTH_UNITS[layout.unit]
        valid = (metres > 0.0) & (metres >= layout.range_min_m) & (metres < layout.range_max_m)
        no_return = np.isin(raw, layout.no_return) | (metres >= layout.range_max_m)
        return np.where(no_return, np.inf, np.where(valid, metres, np.nan))

    def _iter_scans(self, ranks: Ints) -> Iterator[_Ranges]:
        """Yield the scans taken in file order; raises BadData if the log has changed since it was first read."""
        wanted = iter(self._lines[ranks].tolist())
        line = next(wanted)
        for number, words in self._iter_words():
            if number == line:
                try:
                    yield _Ranges(self._parse_ranges(words))
                except ValueError:
                    break
                line = next(wanted, 0)
                if not line:
                    return
        raise BadData(
            str(self._path), "", "the log has changed since it was first read", "do not modify it during a run"
        )


def _parse_time_ns(text: str, unit: str) -> int:
    """Return a time in a unit in ns, exactly; raises ValueError."""
    try:
        return parse_stamp_ns(str(Decimal(text).scaleb(-TIME_DIGITS[unit])))
    except DecimalException:
        raise ValueError(f"{brief(text)} is not a time in {unit}") from None


def _unwrap(counts: Floats | Stamps, wraps_at: int, backwards: bool) -> Any:
    """Return counts (N,) continued over the wraps of their counter, which may run ``backwards`` as well."""
    if not wraps_at:
        return counts
    below = wraps_at // 2 if backwards else 0
    steps = (np.diff(counts) + below) % wraps_at - below
    return np.concatenate([counts[:1], counts[0] + np.cumsum(steps)])


def _compute_poses(layout: ColumnsLayout, values: Floats) -> Floats:
    """Return ``odom_from_base`` (N, 3) of odometry columns (N, K), nan without odometry."""
    if layout.pose is not None:
        scale = np.array([LENGTH_UNITS[layout.pose.unit]] * 2 + [ANGLE_UNITS[layout.pose.heading_unit]])
        poses: Floats = values * scale
        return np.column_stack([poses[:, :2], wrap(poses[:, 2])])
    return np.full((len(values), 3), np.nan) if layout.ticks is None else integrate_ticks(layout.ticks, values)


def integrate_ticks(wheels: TickColumns, counts: Floats) -> Floats:
    """Return the poses (N, 3) of a differential drive from its counts (N, 2), left and right; the first is the origin.

    Between two lines both wheels turn evenly: the robot moves on an arc.
    """
    metres = np.pi * wheels.wheel_diameter_m / wheels.ticks_per_turn
    travelled = np.column_stack([_unwrap(column, wheels.wraps_at, backwards=True) for column in counts.T]) * metres
    left, right = np.diff(travelled, axis=0).T
    turns = (right - left) / wheels.track_m * wheels.turn_factor
    headings = np.concatenate([[0.0], np.cumsum(turns)])
    middle = headings[:-1] + 0.5 * turns
    chords = 0.5 * (left + right) * np.sinc(0.5 * turns / np.pi)
    x, y = (np.concatenate([[0.0], np.cumsum(chords * part)]) for part in (np.cos(middle), np.sin(middle)))
    return np.column_stack([x, y, wrap(headings)])


def _is_described(path: Path) -> bool:
    return is_described(path) and not is_carmen(path)


SPEC = DatasetSpec(
    make=Columns,
    summary="A text log in columns (CSV, TSV, blanks), described by a TOML file",
    sensor="as recorded; the layout states its angles and units",
    truth="files given as parameters",
    citation="-",
    licence="that of the recording",
    suffixes=(".csv", ".tsv", ".txt", ".csv.gz", ".tsv.gz", ".txt.gz"),
    recognises=_is_described,
    parameters=(
        Parameter("path", "", "", "the log"),
        Parameter("layout", "", "", "path of the TOML file that describes the columns; empty: <path>.toml"),
        *truth_files.PARAMETERS,
        *reader_common.SELECTION,
    ),
    missing=partial(reader_common.describe_missing_files, "columns"),
    thinned_by="every",
    choose=partial(reader_common.choose_parameters, "columns"),
)
