"""Open a ROS 1 or ROS 2 bag for reading, also without its index, and say what is lost of it."""

from __future__ import annotations

import math
import shlex
from collections import Counter
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from evalkit.core.errors import BadData, EvalkitError
from evalkit.io.input_files import check_beginning
from evalkit_datasets.parsing.bag_limits import METADATA, check_topics, list_files
from evalkit_datasets.parsing.unpacking import UnpackedTooMuch, bounded_unpacking

FETCH_AGAIN = "record or fetch the bag again"

DAMAGED_MESSAGES = "damaged messages dropped"
"""Name of a defect in the notes of a reader."""

SUFFIXES = (".bag", ".db3", ".mcap")

MAX_NAMED = 10
"""Files named in a message."""

MAX_DAMAGED = 0.5
"""A bag is refused if a larger share of a topic's messages cannot be decoded: the others may be wrong as well."""


@dataclass(frozen=True, slots=True)
class BagDamage:
    """What is lost of a bag whose index is damaged or missing: bytes behind the damage and of chunks, of all bytes.

    ``is_size_stated``: whether the bag states its size; if not, all that was cut off is lost as well.
    ``is_metadata``: only metadata.yaml is damaged; the file of the bag was read without it.
    """

    lost_bytes: int
    whole_bytes: int
    is_size_stated: bool = False
    is_metadata: bool = False

    @property
    def lost_percent(self) -> int:
        """The share that is lost, rounded up."""
        return math.ceil(100 * self.lost_bytes / max(self.whole_bytes, 1))

    def count(self) -> dict[str, int]:
        """Return the damage as a count by the name of the defect."""
        if self.is_metadata:
            return {"bags with a damaged metadata.yaml, read without it": 1}
        if self.lost_bytes:
            also = "as it is cut short or damaged" if self.is_size_stated else "besides all that was cut off"
            return {f"percent of the bag lost, {also}": self.lost_percent}
        return {"bags without an index, read to the last whole record": 1}

    def describe(self) -> str:
        """Return the damage in words."""
        if self.is_metadata:
            return "its metadata.yaml is damaged: the file of the bag was read without it"
        beyond = "" if self.is_size_stated else "; how much was cut off, the file does not state"
        if not self.lost_bytes:
            return f"its index is damaged or missing: all records in it were read{beyond}"
        lost = f"{self.lost_bytes / 1e6:.2f} of {self.whole_bytes / 1e6:.2f} MB ({self.lost_percent} %)"
        return f"it is cut short or damaged: {lost} are lost{beyond}"


def find_damage(reader: Any) -> BagDamage | None:
    """Return what is lost of a bag where its index is damaged; None where it is not."""
    from evalkit_datasets.parsing import unindexed_bag  # noqa: PLC0415 - loads rosbags

    return unindexed_bag.find_damage(reader)


@dataclass(eq=False)
class MessageDamage:
    """Messages whose bytes cannot be decoded as their type: how many of how many by topic, and where the first is."""

    taken: Counter[str] = field(default_factory=Counter)
    damaged: Counter[str] = field(default_factory=Counter)
    first: dict[str, str] = field(default_factory=dict)

    def decode(self, reader: Any, connection: Any, recorded_ns: int, raw: bytes) -> Any:
        """Return the next message of a topic, None if it is damaged, which is counted."""
        topic = connection.topic
        self.taken[topic] += 1
        try:
            return reader.deserialize(raw, connection.msgtype)
        except MemoryError:
            raise
        except Exception as error:  # noqa: BLE001 - damaged bytes can raise any exception
            self.damaged[topic] += 1
            seconds, rest_ns = divmod(int(recorded_ns), 10**9)
            place = f"message {self.taken[topic]} of {topic}, recorded at {seconds}.{rest_ns:09d}"
            self.first.setdefault(topic, f"{place}: {_brief(error)}")
            return None

    def describe_first(self) -> str:
        """Return where the first damaged message is and why it cannot be decoded, "" if there is none."""
        return next(iter(self.first.values()), "")

    def check_share(self, path: Path) -> None:
        """Raise BadData if most messages of a topic are damaged."""
        for topic, count in self.damaged.items():
            if count > MAX_DAMAGED * self.taken[topic]:
                what = f"{count} of {self.taken[topic]} messages cannot be decoded; the first is {self.first[topic]}"
                convert = f"rosbags-convert --src BAG --dst NEW --exclude-topic {shlex.quote(topic)}"
                raise BadData(str(path), topic, what, f"{FETCH_AGAIN}, or copy it without this topic: {convert}")


def iter_messages(reader: Any, connections: list[Any], damage: MessageDamage) -> Iterator[tuple[Any, Any, int]]:
    """Yield connection, message and time of recording of the messages of connections, in order of recording.

    Messages that cannot be decoded are left out; ``damage`` counts them, and all messages that were taken.
    """
    if connections:  # the reader treats an empty list as all
        for connection, recorded_ns, raw in reader.messages(connections=connections):
            if (message := damage.decode(reader, connection, recorded_ns, raw)) is not None:
                yield connection, message, int(recorded_ns)


def _find_bag(path: Path) -> Path:
    """Return the path to open: the folder, for a .db3 or .mcap file of a whole ROS 2 bag with metadata.

    A file that the metadata does not name, or whose bag lacks another file, is opened alone. Raises BadData for a
    folder that lacks a file of its bag.
    """
    folder = path if path.is_dir() else path.parent
    if path.suffix == ".bag" or not (folder / METADATA).is_file():
        return path
    named = list_files(folder)
    absent = [name for name in named if not (folder / name).is_file()]
    if path.is_file():
        return path if absent or (named and path.name not in named) else folder
    if absent:
        present = [str(folder / name) for name in named if name not in absent]
        remedy = "copy the whole folder" + (f", or give one file: {', '.join(present[:MAX_NAMED])}" if present else "")
        raise BadData(str(path), METADATA, f"names {', '.join(absent[:MAX_NAMED])}, not in the folder", remedy)
    return path


@contextmanager
def open_bag(path: Path) -> Iterator[Any]:
    """Open a bag for reading; raises BadData for every error of the reader, also inside the ``with`` block.

    A ROS 1 bag or MCAP file with a damaged index is read by its records, up to the damage; the only file of a ROS 2
    bag, without metadata that is damaged.
    """
    _check_path(path)
    bag = _find_bag(path)
    check_topics(bag)
    files = [bag] if bag.is_file() else [file for file in bag.iterdir() if file.is_file()]
    for file in files:
        _check_beginning(file)
    try:
        with bounded_unpacking(sum(file.stat().st_size for file in files)), closing(_open_reader(bag)) as reader:
            yield reader
    except EvalkitError:
        raise
    except UnpackedTooMuch as error:
        raise BadData(str(path), "", str(error), "write it again without compression if you trust its origin") from None
    except Exception as error:  # a damaged binary file can raise any exception
        raise BadData(str(path), "", f"not a readable bag ({_brief(error)})", _suggest_repair(bag)) from error


def _brief(error: Exception) -> str:
    return " ".join(str(error).split())[:160].rstrip(".") or type(error).__name__


def _open_reader(bag: Path) -> Any:
    """Return an open reader of a bag; one that needs no index if the index is damaged."""
    from evalkit_datasets.parsing.unindexed_bag import has_magic, open_unindexed  # noqa: PLC0415 - heavy, for bags only

    try:
        reader = _new_reader(bag)
        reader.open()
        if reader.connections or bag.is_dir():
            return reader
        reader.close()  # a ROS 1 bag without any chunk in its index
    except UnpackedTooMuch:
        raise
    except Exception as error:
        for open_otherwise in (_open_without_metadata, open_unindexed):
            try:
                if (opened := open_otherwise(bag)) is not None:
                    return opened
            except UnpackedTooMuch:
                raise
            except Exception:  # noqa: BLE001 - the first error says what is wrong
                pass
        if has_magic(bag):
            cause = str(error).rstrip(".") or type(error).__name__
            raise ValueError(f"{cause[:100]}; no whole chunk of messages lies before the damage") from error
        raise error from None
    return open_unindexed(bag) or _reopen(reader)


def _open_without_metadata(bag: Path) -> Any:
    """Open the only file of a ROS 2 bag whose metadata cannot be read; None where there is another number of files."""
    files = [file for file in bag.iterdir() if file.suffix in SUFFIXES] if bag.is_dir() else []
    if len(files) != 1:
        return None
    check_topics(files[0])
    reader = _reopen(_new_reader(files[0]))
    reader.damage = BagDamage(0, 0, is_metadata=True)
    return reader


def _new_reader(bag: Path) -> Any:
    """Return a reader of a bag that is not open yet, with the types of its messages as they are needed."""
    from rosbags.highlevel import AnyReader  # noqa: PLC0415 - heavy, and used for bags only

    from evalkit_datasets.parsing.bag_types import NeededTypes  # noqa: PLC0415 - as above

    types: Any = NeededTypes()
    types.reader = AnyReader([bag], default_typestore=types)
    return types.reader


def _reopen(reader: Any) -> Any:
    reader.open()
    return reader


def _check_path(path: Path) -> None:
    """Raise BadData for a path that cannot be a bag, with a clearer message than the library's."""
    if path.is_dir() and not (path / METADATA).is_file():
        files = sorted(str(file) for file in path.iterdir() if file.suffix in SUFFIXES)
        remedy = f"give one of {', '.join(files)}" if files else "give the folder of a ROS 2 bag, or its file"
        raise BadData(str(path), "", f"a folder without {METADATA}", remedy)
    if path.is_file() and path.suffix not in SUFFIXES:
        raise BadData(str(path), "", f"'{path.suffix}' is not the suffix of a bag", "give a .bag, .db3 or .mcap file")
    if path.is_file() and path.stat().st_size == 0:
        raise BadData(str(path), "", "the file is empty", FETCH_AGAIN)


def _check_beginning(file: Path) -> None:
    if file.suffix in SUFFIXES:
        with file.open("rb") as content:
            check_beginning(file, content.read(100))


def _suggest_repair(bag: Path) -> str:
    tool = "ros2 bag" if bag.is_dir() else "rosbag" if bag.suffix == ".bag" else ""
    return f"{FETCH_AGAIN}, or try '{tool} reindex'" if tool else FETCH_AGAIN
