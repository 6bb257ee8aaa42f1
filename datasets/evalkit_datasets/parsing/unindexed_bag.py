"""Read bags whose index is damaged or missing: the records of the file are walked from its beginning, up to the damage.

A recorder that was killed leaves a ROS 1 bag or an MCAP file without an index; a copy that was cut short loses it. The
classes below are readers of rosbags whose ``open`` builds the index from the records themselves.
"""

from __future__ import annotations

import os
from collections import Counter, defaultdict
from io import BytesIO
from pathlib import Path
from typing import Any

from rosbags.highlevel import AnyReader
from rosbags.rosbag1 import reader as ros1
from rosbags.rosbag1.reader import ChunkInfo, Header, IndexData, RecordType
from rosbags.rosbag2 import Reader, ReaderError
from rosbags.rosbag2 import storage_mcap as mcap

from evalkit_datasets.parsing.bag_file import BagDamage
from evalkit_datasets.parsing.bag_types import NeededTypes
from evalkit_datasets.parsing.unpacking import UnpackedTooMuch

MAGIC_1, MAGIC_MCAP = b"#ROSBAG V2.0\n", b"\x89MCAP0\r\n"
MCAP_HEADER, MCAP_MESSAGE, MCAP_CHUNK, MCAP_END = 0x01, 0x05, 0x06, (0x0F, 0x02)
END_NS = 2**63 - 1


class UnindexedBag(ros1.Reader):
    """A ROS 1 bag read without its index. ``open`` raises ReaderError where not even the beginning can be read.

    ``damage``: what lies behind the damage, with the chunks that cannot be unpacked; their messages are left out. Of a
    bag that was cut short the header states the size.
    """

    damage = BagDamage(0, 0)

    def open(self) -> None:
        """Walk the records of the file and collect connections, chunks and the places of messages."""
        self.bio = self.path.open("rb")
        if self.bio.readline() != MAGIC_1:
            self.close()
            raise ros1.ReaderError("File magic is invalid.")
        indexes: dict[int, list[IndexData]] = defaultdict(list)
        size = self.bio.seek(0, os.SEEK_END)
        lost = stated = index = 0
        self.bio.seek(len(MAGIC_1))
        while (begin := self.bio.tell()) < size:
            try:
                header = Header.read(self.bio)
                kind, length = header.get_uint8("op"), ros1.read_uint32(self.bio)
                if kind == RecordType.BAGHEADER:  # where the index begins: 0 as long as the bag is recorded
                    stated = header.get_uint64("index_pos")
                elif kind == RecordType.CHUNK_INFO and not index:
                    stated = index = begin  # the index is here, whatever the header states
            except (ros1.ReaderError, UnicodeDecodeError):
                break  # cut short or overwritten: nothing behind it can be found
            end = self.bio.tell() + length
            self.bio.seek(begin)
            if kind == RecordType.CHUNK:
                lost += self._index_chunk(begin, min(end, size), indexes)
            elif kind == RecordType.CONNECTION and end <= size:
                self._add_connection(self.read_connection())
            self.bio.seek(end)
        lost += max((stated or size) - min(begin, size), 0)
        self.damage = BagDamage(lost, max(stated, size), is_size_stated=stated > 0)
        self.indexes = {one.id: sorted(indexes[one.id]) for one in self.connections}
        self.connections = [one._replace(msgcount=len(self.indexes[one.id])) for one in self.connections]

    def _add_connection(self, found: Any) -> None:
        if all(found.id != one.id for one in self.connections):
            self.connections.append(found)

    def _index_chunk(self, begin: int, end: int, indexes: dict[int, list[IndexData]]) -> int:
        """Add the whole messages of a chunk to the indexes (by connection); return how many of its bytes are lost.

        All of a chunk that cannot be unpacked; of another, the share behind damage in its messages.
        """
        assert self.bio is not None
        chunk = self.read_chunk()
        available = end - chunk.datapos
        self.bio.seek(chunk.datapos)
        try:
            data = chunk.decompressor(ros1.read_bytes(self.bio, available))
        except UnpackedTooMuch:
            raise
        except (ValueError, EOFError, RuntimeError, OSError, ros1.ReaderError):
            return end - begin
        file, inner = self.bio, BytesIO(data)
        times, counts = [], Counter[int]()
        lost = offset = 0
        try:
            while (offset := inner.tell()) < len(data):
                header = Header.read(inner)
                kind, length = header.get_uint8("op"), ros1.read_uint32(inner)
                if inner.tell() + length > len(data):
                    break
                if kind == RecordType.CONNECTION:
                    inner.seek(offset)
                    self.bio = inner  # where read_connection reads from
                    self._add_connection(self.read_connection())
                elif kind == RecordType.MSGDATA:
                    times.append(header.get_time("time"))
                    counts[header.get_uint32("conn")] += 1
                    indexes[header.get_uint32("conn")].append(IndexData(times[-1], begin, offset))
                    inner.seek(length, os.SEEK_CUR)
        except (ros1.ReaderError, UnicodeDecodeError):  # the messages before the damage are kept
            lost = available * (len(data) - offset) // len(data)
        finally:
            self.bio = file
        self.chunks[begin] = chunk._replace(datasize=available)
        if times:
            self.chunk_infos.append(ChunkInfo(begin, min(times), max(times) + 1, dict(counts)))
        return lost


class UnindexedMcap(mcap.McapReader):
    """An MCAP file read without its summary, up to a record that is cut short or a chunk that cannot be unpacked."""

    damage = BagDamage(0, 0)

    def _open(self) -> None:
        assert self.bio is not None
        if self.bio.read(8) != MAGIC_MCAP or self.bio.read(1) != bytes([MCAP_HEADER]):
            raise ReaderError("File magic is invalid.")
        mcap.skip_sized(self.bio)
        self.data_start = self.bio.tell()
        self.data_end = self._find_end()
        self.meta_scan()
        if all(getattr(one.ext, "serialization_format", "") != "cdr" for one in self.connections):
            raise ReaderError("No channel with messages of ROS 2.")
        assert self.statistics is not None
        found = self.statistics
        self.connections = [
            one._replace(msgcount=found.channel_message_counts.get(one.id, 0)) for one in self.connections
        ]
        first, last = (found.start_time, found.end_time + 1) if found.message_count else (END_NS, 0)
        self.metadata = self.metadata._replace(
            duration=max(last - first, 0), start_time=first, end_time=last, message_count=found.message_count
        )

    def _find_end(self) -> int:
        """Return the end of the last whole record, and note the chunks before it and what is lost behind it."""
        assert self.bio is not None
        size = self.bio.seek(0, os.SEEK_END)
        self.bio.seek(self.data_start)
        while (begin := self.bio.tell()) + 9 <= size:
            kind, length = self.bio.read(1)[0], int.from_bytes(self.bio.read(8), "little")
            if kind in MCAP_END:  # only the index lies behind it
                self.damage = BagDamage(0, size, is_size_stated=True)
                return begin
            if begin + 9 + length > size:
                break
            if kind == MCAP_CHUNK:
                chunk = self._read_chunk(begin, length)
                if chunk is None:
                    break
                self.chunks += [chunk] if chunk.channel_count else []
            self.bio.seek(begin + 9 + length)
        self.damage = BagDamage(size - begin, size)
        return begin

    def _read_chunk(self, begin: int, length: int) -> mcap.ChunkInfo | None:
        """Return what an index would say of a chunk, None if it cannot be unpacked."""
        assert self.bio is not None
        record = BytesIO(self.bio.read(length))
        try:
            first, last, unpacked, crc = mcap.deserialize_qqqi(mcap.read_exact(record, 28))
            compression = mcap.read_string(record)
            packed = int.from_bytes(mcap.read_exact(record, 8), "little")
            inner = BytesIO(mcap.decompress(mcap.read_exact(record, packed), compression, unpacked, crc))
        except UnpackedTooMuch:
            raise
        except (ReaderError, ValueError, RuntimeError, EOFError, OSError):
            return None
        counts: Counter[int] = Counter()
        while len(head := inner.read(9)) == 9:
            size = int.from_bytes(head[1:], "little")
            if head[0] == MCAP_MESSAGE:
                counts[int.from_bytes(inner.read(2), "little")] += 1
                size -= 2
            inner.seek(size, os.SEEK_CUR)
        return mcap.ChunkInfo(first, last, begin, length, {}, 0, compression, packed, unpacked, dict(counts))


def find_file_of_records(bag: Path) -> Path | None:
    """Return the file of a bag that can be read without an index, None for a database or several files."""
    files = sorted(bag.glob("*.mcap")) if bag.is_dir() else [bag]
    return files[0] if len(files) == 1 and files[0].suffix in (".bag", ".mcap") else None


def has_magic(bag: Path) -> bool:
    """Return whether the file of a bag that can be read without an index begins as such a bag does."""
    file = find_file_of_records(bag)
    if file is None:
        return False
    with file.open("rb") as content:
        return content.read(len(MAGIC_1)).startswith(MAGIC_1 if file.suffix == ".bag" else MAGIC_MCAP)


def open_unindexed(bag: Path) -> AnyReader | None:
    """Open a ROS 1 bag or an MCAP file without its index; None for another file, or one without any whole message.

    Close it as any reader.
    """
    file = find_file_of_records(bag)
    if file is None:
        return None
    types: Any = NeededTypes()
    reader = types.reader = AnyReader([file], default_typestore=types)
    if file.suffix == ".bag":
        reader.readers = [UnindexedBag(file)]
    else:
        inner = Reader(file)
        inner.storage = UnindexedMcap(file)
        reader.readers = [inner]
    reader.open()
    if any(one.msgcount for one in reader.connections):
        return reader
    reader.close()
    return None


def find_damage(reader: AnyReader) -> BagDamage | None:
    """Return what a reader lost while it walked the records, or read without; None for one with index and metadata."""
    damage: BagDamage | None = getattr(reader, "damage", None)
    inner = [getattr(one, "storage", one) for one in reader.readers]
    return damage or next((one.damage for one in inner if isinstance(one, (UnindexedBag, UnindexedMcap))), None)
