"""Open a recording with its reader, to see what comes of the parameters that are suggested."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from evalkit.core.errors import EvalkitError
from evalkit.core.pose import Pose
from evalkit.plugins import registry
from evalkit.plugins.parameters import Value
from evalkit_datasets.commands.inspect.inspector import Inspection


@dataclass(frozen=True)
class ReaderTrial:
    """The result of opening a recording with a reader; ``problem``: why it failed."""

    scans: int = 0
    truth: str = ""
    notes: Mapping[str, int] = field(default_factory=dict)
    mounting: Pose = field(default_factory=Pose)
    problem: str = ""


def find_fields(recording: Inspection, topic: str) -> str:
    """Return the parameter that names the fields of a topic's messages, "" for usual ones."""
    return next((laser.fields for laser in recording.streams.lasers if laser.topic == topic), "")


def minimal_parameters(recording: Inspection) -> dict[str, Value]:
    """Return the parameters with which the reader needs least: without odometry."""
    topic = recording.lidars[0].topic
    own: dict[str, dict[str, Value]] = {
        "carmen": {"odometry": "none"},
        "rosbag": {"odometry": "none", "topic": topic, "fields": find_fields(recording, topic)},
    }
    return {"path": str(recording.path), **own.get(recording.streams.reader, {})}


def try_reader(reader: str, parameters: Mapping[str, Value]) -> ReaderTrial:
    """Open a recording and take its first scan."""
    try:
        sequence = registry.dataset(reader).make(**parameters)
        first = next(iter(sequence.frames()))
    except EvalkitError as error:
        return ReaderTrial(problem=str(error))
    truth = sequence.truth()
    known = truth.how if truth.trajectory is not None or truth.relations is not None else ""
    return ReaderTrial(len(sequence), known, sequence.notes(), first.base_from_sensor)
