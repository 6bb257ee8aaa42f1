"""Open a recording with its reader, to see what comes of the parameters that are suggested."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import chain, islice, takewhile

from evalkit.core.errors import EvalkitError
from evalkit.core.pose import Pose
from evalkit.plugins import registry
from evalkit.plugins.parameters import Value
from evalkit_datasets.commands.inspect.inspector import Inspection
from evalkit_datasets.readers.reader_common import WITHOUT_ODOMETRY

MAX_WITHOUT_ODOMETRY = 0.1
"""A larger share of the scans without odometry is a warning, and no few scans that could be left out."""


@dataclass(frozen=True)
class ReaderTrial:
    """The result of opening a recording with a reader; ``problem``: why it failed.

    ``before_odometry``: number of scans before the first one with odometry, 0 if they are more than a tenth.
    """

    scans: int = 0
    truth: str = ""
    notes: Mapping[str, int] = field(default_factory=dict)
    mounting: Pose = field(default_factory=Pose)
    problem: str = ""
    before_odometry: int = 0


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
    """Open a recording and take its first scans: one, or those before its odometry."""
    try:
        sequence = registry.dataset(reader).make(**parameters)
        frames = iter(sequence.frames())
        first = next(frames)
        without = sequence.notes().get(WITHOUT_ODOMETRY, 0)
        begin = islice(chain([first], frames), without if without <= MAX_WITHOUT_ODOMETRY * len(sequence) else 0)
        late = sum(1 for _ in takewhile(lambda frame: frame.odom_from_base is None, begin))
    except EvalkitError as error:
        return ReaderTrial(problem=str(error))
    truth = sequence.truth()
    known = truth.how if truth.trajectory is not None or truth.relations is not None else ""
    return ReaderTrial(len(sequence), known, sequence.notes(), first.base_from_sensor, before_odometry=late)
