"""The command ``evalkit inspect``."""

from __future__ import annotations

import shlex
from collections.abc import Iterator, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import typer

from evalkit.core.errors import BadData, EvalkitError
from evalkit.io.json_values import indent_json, replace_non_finite
from evalkit.io.output_files import write_texts
from evalkit.terminal.console import out, print_json
from evalkit.terminal.options import READER, Json
from evalkit.terminal.text_list import print_hanging
from evalkit_datasets.commands.inspect.finding import Level, format_count
from evalkit_datasets.commands.inspect.inspector import CARMEN, Inspection, find_reader_name, inspect_recording
from evalkit_datasets.commands.inspect.layout_proposal import LayoutProposal, propose_layout
from evalkit_datasets.commands.inspect.log_streams import COLUMNS_KIND
from evalkit_datasets.commands.inspect.suggested_config import SuggestedConfig, suggest_config
from evalkit_datasets.parsing import bag_file
from evalkit_datasets.parsing.carmen_parser import is_carmen

STYLES: Mapping[Level, str] = {"problem": "red", "warning": "yellow", "note": ""}


def inspect(
    file: Annotated[
        Path, typer.Argument(help="A bag (ROS 1 or 2), a CARMEN log, or a text log in columns.", show_default=False)
    ],
    reader: Annotated[str, typer.Option(**READER)] = "",
    ground_truth: Annotated[
        Path | None, typer.Option(help="Ground-truth trajectory (TUM) to check with it.", show_default=False)
    ] = None,
    folder: Annotated[
        Path | None, typer.Option("--out", "-o", help="Write a page with plots there.", show_default=False)
    ] = None,
    save: Annotated[bool, typer.Option("--save", help="Save the proposed layout of a text log beside it.")] = False,
    as_json: Json = False,
) -> None:
    """Inspect a recording: its contents, its defects, and the command that runs it.

    For a text log in columns without a layout, it proposes one. Exit code 1 if no command can run it.
    """
    if not file.exists():
        raise BadData(str(file), "", "no such file or folder", "give the path of a bag or a log")
    given = {} if ground_truth is None else {"ground_truth": str(ground_truth)}
    if not reader and (proposal := _propose(file)) is not None:
        _print_proposal(file, given, proposal, as_json, save)
        raise typer.Exit(0 if save else 1)
    recording = inspect_recording(file, reader)
    advice = suggest_config(recording, given)
    page = None if folder is None else _write_page(folder, recording, advice)
    if as_json:
        print_json(inspection_to_json(recording, advice) | {"page": str(page) if page else None})
    else:
        _print_inspection(recording, advice)
        if page is not None:
            out.print(str(page.resolve()))
    if advice is None or advice.problem:
        raise typer.Exit(1)


def _propose(file: Path) -> LayoutProposal | None:
    """Return a layout for a text log in columns that has none beside it."""
    if file.is_dir() or file.suffix in bag_file.SUFFIXES or find_reader_name(file) != CARMEN or is_carmen(file):
        return None
    try:
        return propose_layout(file)
    except EvalkitError:
        return None  # the inspection says why


def _print_proposal(file: Path, given: Mapping[str, str], proposal: LayoutProposal, as_json: bool, save: bool) -> None:
    if save:
        write_texts(file.parent, {f"{file.name}.toml": proposal.toml})
    if as_json:
        print_json({"file": str(file), "kind": COLUMNS_KIND, "scans": proposal.scans, "layout": proposal.toml})
        return
    print_hanging(out, f"{file.name}: text log in columns; {proposal.scans} scans can be read with this layout", "bold")
    out.print(f"\n{proposal.toml}", soft_wrap=True)
    done = f"saved as {file}.toml: check it" if save else f"check it, save it as {file}.toml (--save)"
    words = [str(file), *(word for name, value in given.items() for word in (f"--{name.replace('_', '-')}", value))]
    print_hanging(out, f"{done}, and inspect the log again: evalkit inspect {shlex.join(words)}")


def inspection_to_json(recording: Inspection, advice: SuggestedConfig | None) -> dict[str, Any]:
    """Return all measurements as JSON values; numbers that are not finite become null."""
    values: dict[str, Any] = replace_non_finite(
        {
            "file": str(recording.path),
            "kind": recording.kind,
            "bytes": recording.bytes,
            "topics": [asdict(topic) for topic in recording.topics],
            "lidars": [asdict(lidar) for lidar in recording.lidars],
            "odometry": [asdict(one) | {"like_wheels": one.like_wheels} for one in recording.odometries],
            "turns": {name: asdict(turn) for name, turn in recording.turns.items()},
            "frames": asdict(recording.frames),
            "poses_from": recording.poses_from,
            "truth_inside": recording.truth_inside,
            "remarks": list(recording.remarks),
            "findings": [asdict(finding) for finding in recording.findings],
            "run": None if advice is None else asdict(advice),
        }
    )
    return values


def _write_page(folder: Path, recording: Inspection, advice: SuggestedConfig | None) -> Path:
    """Write ``index.html`` and ``inspection.json`` and return the path of the page."""
    from evalkit.report.html.blocks import render  # noqa: PLC0415 - loads jinja2
    from evalkit_datasets.commands.inspect.page import build_document  # noqa: PLC0415 - loads matplotlib

    content = indent_json(inspection_to_json(recording, advice))
    write_texts(folder, {"inspection.json": content, "index.html": render(build_document(recording, advice))})
    return folder / "index.html"


def _print_inspection(recording: Inspection, advice: SuggestedConfig | None) -> None:
    print_hanging(out, f"{recording.path.name}: {recording.kind}, {recording.bytes / 1e6:.1f} MB", "bold")
    for text in _describe_streams(recording):
        print_hanging(out, text)
    for finding in recording.findings:
        more = f"; {finding.advice}" if finding.advice else ""
        print_hanging(out, f"{finding.level}: {finding.about}: {finding.what}{more}", STYLES[finding.level])
    if advice is None:
        return
    for reason in advice.reasons:
        style = next((STYLES[level] for level in STYLES if reason.startswith(f"{level}: ")), None)
        print_hanging(out, f"chosen: {reason}" if style is None else reason, style or "green")
    for defect in advice.defects:
        print_hanging(out, f"known defect: {defect}")
    opened = f"opened: {format_count(advice.scans, 'scan')}{', with ground truth' if advice.truth else ''}"
    print_hanging(out, f"does not run: {advice.problem}" if advice.problem else opened)
    block = f"\n{advice.table}\n{advice.command}"  # lines stay whole, to be copied
    out.print(block, soft_wrap=True)


def _describe_streams(recording: Inspection) -> Iterator[str]:
    """Yield one text for each lidar, odometry and mounting."""
    for lidar in recording.lidars:
        time, returns = lidar.timing, lidar.returns
        yield (
            f"lidar {lidar.topic}, frame '{lidar.frame}': {time.count} scans in {time.duration_s:.1f} s "
            f"({time.rate_hz:.2f} Hz, jitter {1e3 * time.jitter_s:.1f} ms, {format_count(time.gap_count, 'gap')}), "
            f"{lidar.beams} beams over {lidar.field_of_view_deg:.0f} deg, {lidar.limits}, "
            f"{100 * returns.hits:.1f} % hits, {100 * returns.invalid:.1f} % invalid"
        )
    for one in recording.odometries:
        yield (
            f"odometry {one.topic}, {one.parent} to {one.child}: {one.timing.count} poses, {one.path_m:.1f} m, "
            f"{one.turned_deg:.0f} deg, standing {100 * one.standing:.0f} %"
        )
    yield from map(str, recording.frames.mountings)
