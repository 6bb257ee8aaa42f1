"""The corrections of a SLAM one by one, for the player: the path before and after each, and the closures between."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from evalkit.core import se2
from evalkit.core.arrays import spread_indices
from evalkit.core.loop_closure import LoopClosure
from evalkit.core.path_correction import PathCorrection
from evalkit.core.run_result import RunResult
from evalkit.core.se2 import Floats, Stamps
from evalkit.report.formatting import format_length
from evalkit.report.html.array_encoding import pack_array, quantise
from evalkit.results.run_record import RunRecord

MAX_POSES = 6_000
"""Poses of all corrections of a sequence on the page, at about 10 bytes each."""

MAX_LISTED = 5
"""Earlier closures whose times are listed in the words of a correction."""

MILLIMETRE = 1e-3


@dataclass(frozen=True, slots=True)
class ShownCorrection:
    """One correction in the player: its name in links, its label in the list of ``method``, and its JSON.

    Positions are in the world.
    ``content``: ``name``, ``run``, ``at`` (ms since the first scan), ``words``, ``path`` (packed rows of x, y before
    and what was added to them, mm), ``edges``: on both paths, x, y (m) of the later and of the earlier scan of each
    closure, the latest closure first.
    """

    name: str
    method: str
    label: str
    content: dict[str, Any]


def attribute_closures(result: RunResult) -> tuple[list[tuple[PathCorrection, list[LoopClosure]]], list[LoopClosure]]:
    """Return each correction with the closures accepted since the one before, and the closures after the last.

    A method may correct its path some scans after the closure that caused it; it does not report which one.
    """
    pairs: list[tuple[PathCorrection, list[LoopClosure]]] = [(one, []) for one in result.path_corrections]
    corrected_ns = [one.stamp_ns for one in result.path_corrections]
    after: list[LoopClosure] = []
    for closure in sorted((one for one in result.loop_closures if one.accepted), key=lambda one: one.stamp_ns):
        place = int(np.searchsorted(corrected_ns, closure.stamp_ns))
        (pairs[place][1] if place < len(pairs) else after).append(closure)
    return pairs, after


def name_correction(method: str, number: int) -> str:
    """Return the name of a correction in links; ``number`` from 1."""
    return f"{method} {number}"


def list_corrections(records: Sequence[RunRecord], stamps: Stamps) -> list[ShownCorrection]:
    """Return the corrections of all runs; ``stamps`` (N,): of all scans that a run answered."""
    count = sum(len(record.result.path_corrections) for record in records)
    most = max(MAX_POSES // max(count, 1), 2)
    return [
        _show(record, number, correction, closures, stamps, most)
        for record in records
        for number, (correction, closures) in enumerate(attribute_closures(record.result)[0], start=1)
    ]


def describe_corrections(records: Sequence[RunRecord]) -> list[str]:
    """Return how the path before is known, and a sentence for each SLAM of which something is not shown."""
    how = "Before a correction: the path that the previous correction left, with the poses given since."
    shown = [how] if any(record.result.path_corrections for record in records) else []
    return shown + [sentence for record in records if (sentence := _describe_missing(record.method, record.result))]


def _describe_missing(method: str, result: RunResult) -> str:
    corrected = result.steps["corrected"]
    if result.final is None:
        return ""
    if result.paths_left_out:
        return f"Not all corrections of {method} can be shown one by one: {result.paths_left_out}."
    if not result.path_corrections and (corrected == 1).any():
        return f"The results of {method} are of an earlier version, which kept no path before and after a correction."
    if not any(one.accepted for one in result.loop_closures):
        return ""
    if (corrected < 0).all():
        return f"{method} does not report when it corrects its path: its corrections cannot be shown one by one."
    left = len(attribute_closures(result)[1])
    closures = "closure" if left == 1 else f"{left} closures"
    return f"{method} reports no correction after the last {closures} it accepted." if left else ""


def _show(
    record: RunRecord,
    number: int,
    correction: PathCorrection,
    closures: Sequence[LoopClosure],
    stamps: Stamps,
    most: int,
) -> ShownCorrection:
    placed = record.scores.final or record.scores
    before, after = (
        se2.compose(placed.world_from_start.row, poses)[:, :2] for poses in (correction.before, correction.after)
    )
    rows = spread_indices(len(before), most)
    steps = [quantise(path[rows], MILLIMETRE) for path in (before, after)]
    name, moved = name_correction(record.method, number), format_length(float(correction.moved_m[-1]))
    label = f"{_seconds(correction.stamp_ns, stamps)}: robot moved {moved}"
    if closures:
        label += f", closure at {_seconds(closures[-1].stamp_ns, stamps)}"
    content = {
        "name": name,
        "run": record.method,
        "at": int((correction.stamp_ns - stamps[0]) // 1_000_000),
        "words": _describe(record.method, correction, closures, stamps),
        "path": pack_array(np.hstack([steps[0], steps[1] - steps[0]])),
        "edges": {
            side: [_edge(one, correction.stamps_ns, path) for one in reversed(closures)]
            for side, path in (("before", before), ("after", after))
        },
    }
    return ShownCorrection(name, record.method, label, content)


def _edge(closure: LoopClosure, stamps: Stamps, path: Floats) -> list[float]:
    """Return x, y (m) of the later and the earlier frame on a path (N, 2), between its poses by time."""
    ends = np.array([closure.stamp_ns, closure.other_stamp_ns]) - stamps[0]
    found = [np.interp(ends, stamps - stamps[0], path[:, axis]) for axis in (0, 1)]
    return [round(float(value), 3) for value in np.column_stack(found).ravel()]


def _describe(method: str, correction: PathCorrection, closures: Sequence[LoopClosure], stamps: Stamps) -> str:
    """Return what a correction moved, and the closures since the one before."""
    moved = correction.moved_m
    most = int(np.argmax(moved))
    scan = int(np.searchsorted(stamps, correction.stamp_ns)) + 1
    sentences = [
        f"{method} corrected its path at t = {_seconds(correction.stamp_ns, stamps)} (scan {scan}). "
        f"The robot's position one scan before moved by {format_length(float(moved[-1]))}; that of "
        f"t = {_seconds(int(correction.stamps_ns[most]), stamps)} moved most, by {format_length(float(moved[most]))}."
    ]
    if not closures:
        return f"{sentences[0]} It accepted no loop closure since its last correction."
    *earlier, last = closures
    late_s = (correction.stamp_ns - last.stamp_ns) * 1e-9
    when = f"{late_s:.1f} s before" if late_s >= 0.05 else "at this scan"
    other = _seconds(last.other_stamp_ns, stamps)
    sentences.append(f"Last accepted closure: {when}, at {_seconds(last.stamp_ns, stamps)}, back to {other}.")
    if earlier:
        listed = ", ".join(_seconds(one.stamp_ns, stamps) for one in earlier[:MAX_LISTED])
        more = f" and {len(earlier) - MAX_LISTED} more" if len(earlier) > MAX_LISTED else ""
        sentences.append(f"Closures before it, since the last correction: at {listed}{more}; until then no correction.")
    return " ".join(sentences)


def _seconds(stamp_ns: int, stamps: Stamps) -> str:
    return f"{(stamp_ns - int(stamps[0])) * 1e-9:.1f} s"
