"""Inspect a bag again with the parameters that mend its problems."""

from __future__ import annotations

import shlex
from collections.abc import Iterator, Mapping, Sequence

from evalkit.plugins.parameters import Value
from evalkit.plugins.specs import Choice
from evalkit_datasets.commands.inspect.finding import FIELDS, InspectionFinding
from evalkit_datasets.commands.inspect.inspector import Inspection, inspect_recording
from evalkit_datasets.commands.inspect.lidar_findings import SET_BACK
from evalkit_datasets.commands.inspect.reader_trial import find_fields

PARTS = ("start", "limit")
SAME_S = 0.05
"""The same odometry, as messages and as tf, may be recorded at times that differ by less."""


def inspect_mended(
    recording: Inspection, given: Mapping[str, Value], topic: str
) -> tuple[Inspection, dict[str, Value]]:
    """Return the inspection of a bag with all problems mended that have one mend, and the parameters that do it.

    The same inspection, and none, where there is no such problem or the mends leave one. ``topic``: that of the lidar
    that is used.
    """
    mends = _find_mends(recording, given, topic)
    if not mends or recording.streams.reader != "rosbag":
        return recording, {}
    mended = inspect_recording(recording.path, "rosbag", {"topic": topic, **given, **mends})
    return (recording, {}) if _select_problems(mended.findings, topic) else (mended, mends)


def tell_mends(recording: Inspection, topic: str, mends: Mapping[str, Value]) -> Iterator[Choice]:
    """Choose the parameters that mend a recording, each with the problems that it mends, as a doubt for the report."""
    found = [*_select_problems(recording.findings, topic), *_select_set_back(recording.findings, topic)]
    for name, value in mends.items():
        texts = dict.fromkeys(
            f"{one.about}: {one.what}" for one in found if one.mend is not None and one.mend[0] == name
        )
        mended = f"mended by {shlex.join(['--set', f'{name}={value}'])}"
        yield Choice(name, value, f"warning: {'; '.join(texts)}; {mended}", warns=True)


def _find_mends(recording: Inspection, given: Mapping[str, Value], topic: str) -> dict[str, Value]:
    """Return the parameters that mend what is wrong with a lidar, and with all odometries alike."""
    found = _select_problems(recording.findings, topic)
    pairs = [one.mend for one in found if one.about == topic and one.mend is not None]
    for name in dict.fromkeys(one.mend[0] for one in found if one.about != topic and one.mend is not None):
        values = [one.mend[1] for one in found if one.about != topic and one.mend is not None and one.mend[0] == name]
        if len(values) == len(recording.odometries) and all(_is_close(value, values[0]) for value in values):
            pairs.append((name, values[0]))
    if given.keys().isdisjoint(PARTS):
        pairs += [one.mend for one in _select_set_back(recording.findings, topic) if one.mend is not None]
    mends = {name: value for name, value in pairs if name != "fields"}
    words = [str(value) for name, value in pairs if name == "fields"]
    if words and not find_fields(recording, topic):
        mends["fields"] = " ".join([FIELDS.removeprefix("fields="), *words])
    return {} if not mends.keys().isdisjoint(given) else mends


def _select_set_back(findings: Sequence[InspectionFinding], topic: str) -> list[InspectionFinding]:
    """Return the clock of a lidar that was set back, if a part of the recording is free of it."""
    found = [one for one in findings if one.about == SET_BACK and one.what.startswith(f"the stamps of {topic} ")]
    return [one for one in found if one.mend is not None]


def _is_close(one: Value, other: Value) -> bool:
    if isinstance(one, float) and isinstance(other, float):
        return abs(one - other) <= SAME_S
    return one == other


def _select_problems(findings: Sequence[InspectionFinding], topic: str) -> list[InspectionFinding]:
    """Return the problems with one mend that concern a lidar or an odometry."""
    concerned = (one for one in findings if one.about == topic or one.about.startswith("odometry "))
    return [one for one in concerned if one.mend is not None]
