"""The HTML page of an inspection: content, findings, plots and suggested configuration."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from evalkit.core.se2 import Floats
from evalkit.report.html import charts
from evalkit.report.html.blocks import (
    Block,
    Bullets,
    Cell,
    Column,
    Command,
    Document,
    Figure,
    Figures,
    Fold,
    Section,
    Table,
    Text,
    Tone,
)
from evalkit.report.html.charts import Axis, Curve, Points
from evalkit.report.html.method_colours import HUES
from evalkit_datasets.commands.inspect.finding import Level, format_count
from evalkit_datasets.commands.inspect.inspector import Inspection
from evalkit_datasets.commands.inspect.lidar_stats import LidarStats
from evalkit_datasets.commands.inspect.odometry_stats import OdometryStats
from evalkit_datasets.commands.inspect.streams import LaserStream
from evalkit_datasets.commands.inspect.suggested_config import SuggestedConfig

TONES: dict[Level, Tone] = {"problem": "bad", "warning": "warn", "note": ""}
MAX_POINTS = 2000  # points of a line: more are not visible


def build_document(recording: Inspection, advice: SuggestedConfig | None) -> Document:
    """Return the page."""
    sections = [
        Section("Findings", list(_render_findings(recording)), "findings"),
        Section("How to run it", list(_render_config(advice)), "run"),
        Section("Lidars", [_render_lidar_table(recording.lidars), *_render_lidar_figures(recording)], "lidars"),
        Section("Odometry", list(_render_odometry(recording)), "odometry"),
        Section("Frames and topics", list(_render_frames(recording)), "frames"),
    ]
    counts = {level: sum(one.level == level for one in recording.findings) for level in TONES}
    lead = ", ".join(format_count(count, level) for level, count in counts.items() if count) or "no findings"
    return Document("evalkit inspect", recording.path.name, f"{lead}.", sections, list_facts(recording))


def list_facts(recording: Inspection) -> tuple[tuple[str, str], ...]:
    """Return the main properties of the recording as pairs of name and text."""
    spans = [lidar.timing for lidar in recording.lidars]
    seconds = max((one.duration_s for one in spans), default=0.0)
    return (
        ("kind", recording.kind),
        ("size", f"{recording.bytes / 1e6:.1f} MB"),
        ("duration", f"{seconds:.1f} s"),
        ("scans", ", ".join(f"{lidar.timing.count} on {lidar.topic}" for lidar in recording.lidars) or "none"),
        ("ground truth in it", recording.truth_inside or "none"),
    )


def _render_findings(recording: Inspection) -> Iterator[Block]:
    rows: list[list[Cell | str]] = [
        [Cell(f.level, tone=TONES[f.level]), f.about, f.what, f.advice] for f in recording.findings
    ]
    yield Table(("", "stream", "finding", "what to do"), rows, sortable=False)
    if recording.remarks:
        yield Fold("Comments in the file", [Bullets(recording.remarks)])


def _render_config(advice: SuggestedConfig | None) -> Iterator[Block]:
    if advice is None:
        yield Text("The recording contains no laser scan: it cannot be run.", "warn")
        return
    if advice.problem:
        yield Text(f"Opening it fails: {advice.problem}", "warn")
    else:
        yield Text(f"Opened: {advice.scans} scans; ground truth: {advice.truth or 'none'}.")
    yield Command(advice.command)
    yield Text("The same as a sequence in an experiment file:")
    yield Command(advice.table)
    yield Bullets(advice.reasons)
    if advice.notes:
        yield Bullets([f"the reader: {count} {name}" for name, count in advice.notes.items()])
    if advice.defects:
        yield Fold("Known defects of this recording", [Bullets(advice.defects)])


def _render_lidar_table(lidars: tuple[LidarStats, ...]) -> Table:
    columns = (
        "lidar", Column("scans", number=True), Column("beams", number=True), Column("field of view", "deg", True),
        Column("limits"), Column("rate", "Hz", True), Column("jitter", "ms", True), Column("hits", "%", True),
        Column("no return", "%", True), Column("invalid", "%", True), Column("99 % of hits within", "m", True),
        Column("step", "mm", True), Column("sweep", "s", True),
    )  # fmt: skip
    return Table(columns, [_make_lidar_row(lidar) for lidar in lidars], caption="Shares are of all beams.")


def _make_lidar_row(lidar: LidarStats) -> list[str | Cell]:
    stats = lidar.returns
    no_return = stats.infinite + stats.at_maximum + stats.beyond_maximum + sum(code.share for code in stats.codes)
    return [
        lidar.topic, str(lidar.timing.count), str(lidar.beams), f"{lidar.field_of_view_deg:.1f}", lidar.limits,
        f"{lidar.timing.rate_hz:.2f}", f"{1e3 * lidar.timing.jitter_s:.1f}", f"{100 * stats.hits:.1f}",
        f"{100 * no_return:.1f}", f"{100 * stats.invalid:.1f}", f"{stats.p99_m:.2f}", f"{1e3 * stats.step_m:g}",
        f"{lidar.sweep_s:.3f}",
    ]  # fmt: skip


def _render_lidar_figures(recording: Inspection) -> Iterator[Block]:
    for lidar, laser in zip(recording.lidars, recording.streams.lasers, strict=True):
        drawn = [
            Figure(_plot_scan(laser), f"{lidar.topic}: a scan from the middle", "In the frame of the lidar."),
            Figure(_plot_ranges(laser, lidar), f"{lidar.topic}: ranges", "All finite ranges of at most 500 scans."),
            Figure(_plot_directions(laser, lidar), f"{lidar.topic}: hits by direction",
                   "A direction without hits is blocked by the robot, or has nothing in range."),
        ]  # fmt: skip
        if len(laser.stamps_ns) > 2:
            drawn.append(Figure(_plot_periods(laser), f"{lidar.topic}: time between scans", "A peak is a gap."))
        if lidar.clock is not None and lidar.clock.max_s - lidar.clock.min_s > 1e-4:
            drawn.append(Figure(_plot_offsets(laser), f"{lidar.topic}: stamp minus time of recording", ""))
        yield Figures(drawn)


def _plot_scan(laser: LaserStream) -> bytes:
    ranges = laser.ranges[len(laser.ranges) // 2]
    same = len(laser.angles) == len(ranges)
    first, last = float(laser.angles[0]), float(laser.angles[-1])
    angles = laser.angles if same else np.linspace(first, last, len(ranges))
    high = laser.range_max_m if np.isfinite(laser.range_max_m) else 50.0
    hits = np.isfinite(ranges) & (ranges > 0.0) & (ranges < high)
    points = ranges[hits, None] * np.stack([np.cos(angles[hits]), np.sin(angles[hits])], axis=-1)
    layers = [Points("hits", points, HUES[0], 2.0), Points("lidar", np.zeros((1, 2)), "#b42318", 5.0)]
    return charts.scatter(layers, Axis("x [m]"), Axis("y [m]"))


def _plot_ranges(laser: LaserStream, lidar: LidarStats) -> bytes:
    some = np.concatenate(laser.ranges[:: max(len(laser.ranges) // 500, 1)])
    levels = {"declared maximum": lidar.range_max_m} if lidar.range_max_m is not None else {}
    return charts.histogram({lidar.topic: some[np.isfinite(some)]}, Axis("range [m]"), 80, levels)


def _plot_directions(laser: LaserStream, lidar: LidarStats) -> bytes:
    table = np.array([row for row in laser.ranges if len(row) == len(laser.angles)])
    low, high = lidar.range_min_m or 1e-9, lidar.range_max_m or np.inf
    plain = np.isfinite(table) & (table >= low) & (table < high)
    for code in lidar.returns.codes:
        plain &= (table < code.low_m) | (table > code.high_m)
    curve = Curve(lidar.topic, np.degrees(laser.angles), np.asarray(100.0 * plain.mean(axis=0), dtype=np.float64))
    return charts.lines([curve], Axis("direction [deg]"), Axis("hits [%]", low=0.0, high=102.0))


def _plot_periods(laser: LaserStream) -> bytes:
    distinct = np.unique(laser.stamps_ns)
    curve = Curve("period", (distinct[1:] - distinct[0]) * 1e-9, np.diff(distinct) * 1e-9)
    return charts.lines([curve], Axis("time [s]"), Axis("time since the previous scan [s]", low=0.0))


def _plot_offsets(laser: LaserStream) -> bytes:
    recorded = laser.recorded_ns if laser.recorded_ns is not None else laser.stamps_ns
    seconds: Floats = np.asarray((recorded - recorded[0]) * 1e-9, dtype=np.float64)
    ahead: Floats = np.asarray((laser.stamps_ns - recorded) * 1e-9, dtype=np.float64)
    return charts.lines(
        [Curve("offset", seconds, ahead)],
        Axis("time of recording [s]"), Axis("stamp minus recording [s]"),
    )  # fmt: skip


def _render_odometry(recording: Inspection) -> Iterator[Block]:
    if not recording.odometries:
        yield Text("None.")
        return
    columns = (
        "odometry", "frames", Column("poses", number=True), Column("rate", "Hz", True), Column("path", "m", True),
        Column("turned", "deg", True), Column("standing", "%", True), Column("fastest", "m/s", True),
        Column("sideways", "%", True, "slip perpendicular to the arc of a step"), Column("jumps", number=True),
        Column("speed by twist", number=True, tip="1: poses and speeds in the messages agree"),
        Column("turn by scans", number=True, tip="1: odometry and scans rotate alike"),
    )  # fmt: skip
    yield Table(columns, [_make_odometry_row(recording, one) for one in recording.odometries])
    poses = [wheels.poses[np.argsort(wheels.stamps_ns, kind="stable")] for wheels in recording.streams.wheels]
    drawn = [
        Points(one.topic, _thin(rows[:, :2]), HUES[at % len(HUES)], 1.4, joined=True)
        for at, (one, rows) in enumerate(zip(recording.odometries, poses, strict=True))
    ]
    yield Figures([Figure(charts.scatter(drawn, Axis("x [m]"), Axis("y [m]")), "Paths", "Each in its own frame.")])


def _make_odometry_row(recording: Inspection, one: OdometryStats) -> list[str | Cell]:
    turn = recording.turns.get(f"{one.topic} {one.child}")
    return [
        one.topic, f"{one.parent} to {one.child}", str(one.timing.count),
        f"{one.timing.count / max(one.timing.duration_s, 1e-9):.1f}", f"{one.path_m:.1f}", f"{one.turned_deg:.0f}",
        f"{100 * one.standing:.0f}", f"{one.fastest_m_s:.2f}", _format_number(100 * one.sideways, 1),
        str(one.jump_count), _format_number(one.twist.scale if one.twist else float("nan"), 2),
        _format_number(turn.scale if turn else float("nan"), 2),
    ]  # fmt: skip


def _render_frames(recording: Inspection) -> Iterator[Block]:
    frames = recording.frames
    yield from (Text(f"{mounting}.") for mounting in frames.mountings)
    if frames.links:
        rows = [[k.parent, k.child, "static" if k.static else "moving", str(k.messages)] for k in frames.links]
        yield Fold(f"tf tree: {format_count(len(frames.names), 'frame')}, roots {', '.join(frames.roots)}",
                   [Table(("parent", "child", "", Column("messages", number=True)), rows)])  # fmt: skip
    topics = [
        [topic.name, topic.kind, str(topic.count), _format_number(topic.rate_hz, 1)] for topic in recording.topics
    ]
    yield Table(("topic", "type", Column("messages", number=True), Column("rate", "Hz", True)), topics)


def _format_number(value: float, digits: int) -> str:
    return f"{value:.{digits}f}" if np.isfinite(value) else "-"


def _thin(points: Floats) -> Floats:
    return points[:: max(len(points) // MAX_POINTS, 1)]
