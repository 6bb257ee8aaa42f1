"""Check a bag before it is opened: not too many topics, and a database that only stores what is read from it."""

from __future__ import annotations

import re
import sqlite3
import struct
from contextlib import closing
from pathlib import Path
from urllib.parse import quote

from evalkit.core.errors import BadData

MAX_TOPICS = 100_000
"""Recorded bags have tens to hundreds. rosbags makes an object of each: so many take seconds and 100 MB. An MCAP file
cannot hold more."""

METADATA = "metadata.yaml"

MAX_METADATA_BYTES = 8 * 2**20
"""Of metadata.yaml, with some 250 bytes a topic; parsing takes seconds."""

_HEAD_BYTES = 4096


def check_topics(bag: Path) -> None:
    """Raise BadData for a bag with too many topics. Other damage is left to the reader."""
    metadata = bag / METADATA
    if metadata.is_file() and metadata.stat().st_size > MAX_METADATA_BYTES:
        found = f"its {METADATA} has {metadata.stat().st_size / 2**20:.0f} MiB"
        raise _too_many(bag, f"{found}: more topics than the {MAX_METADATA_BYTES // 2**20} MiB that are read")
    if bag.is_file() and bag.suffix == ".db3":
        check_tables(bag)
    count = {".bag": _count_ros1, ".db3": _count_sqlite}.get(bag.suffix)
    if bag.is_file() and count is not None and (topics := count(bag)) > MAX_TOPICS:
        raise _too_many(bag, f"it has {topics:,} topics, and at most {MAX_TOPICS:,} are read")


def list_files(folder: Path) -> list[str]:
    """Return the names of the files of a ROS 2 bag by its metadata, also where that is damaged; [] if it names none."""
    metadata = folder / METADATA
    if metadata.stat().st_size > MAX_METADATA_BYTES:  # refused later
        return []
    found = _FILE_NAME.findall(metadata.read_bytes())
    return list(dict.fromkeys(Path(name.decode(errors="replace")).name for name in found))


_FILE_NAME = re.compile(rb"""(?m)^[ \t]*(?:- )?(?:path: )?['"]?([^\s'":][^'":\n]*\.(?:db3|mcap)(?:\.\w+)?)['"]?\s*$""")


def check_tables(base: Path) -> None:
    """Raise BadData for an SQLite database with views or computed columns: a few bytes can take hours or gigabytes.

    Other damage is left to the reader.
    """
    try:
        with closing(_open_sqlite(base)) as opened:
            strange = opened.execute(_NOT_STORED).fetchone() or opened.execute(_COMPUTED).fetchone()
    except (sqlite3.Error, UnicodeDecodeError):  # also a message that is not UTF-8
        return
    if strange is not None:
        what = f"its database computes '{strange[0]}' instead of storing it"
        raise BadData(str(base), "", what, "record or fetch the bag again: only tables and indices are read")


_NOT_STORED = """SELECT name FROM sqlite_master WHERE sql NOT NULL AND sql NOT LIKE 'CREATE TABLE %'
    AND sql NOT LIKE 'CREATE INDEX %' AND sql NOT LIKE 'CREATE UNIQUE INDEX %'"""
_COMPUTED = """SELECT held.name || '.' || part.name FROM sqlite_master held, pragma_table_xinfo(held.name) part
    WHERE held.type = 'table' AND part.hidden"""


def uri_of(base: Path) -> str:
    """Return the URI, without its scheme, that opens an SQLite database for reading.

    A recorder that was killed leaves the last messages in a write-ahead log beside it, which only ``mode=ro`` reads.
    Else the file is ``immutable``: SQLite needs no right to write to its folder.
    """
    return f"{quote(bytes(base.absolute()))}?{'mode=ro' if has_write_ahead_log(base) else 'immutable=1'}"


def has_write_ahead_log(base: Path) -> bool:
    """Whether messages may lie in a file beside an SQLite database."""
    log = base.with_name(f"{base.name}-wal")
    return log.is_file() and log.stat().st_size > 0


def _open_sqlite(base: Path) -> sqlite3.Connection:
    return sqlite3.connect(f"file:{uri_of(base)}", uri=True)


def _too_many(bag: Path, what: str) -> BadData:
    remedy = "copy the topics you need: rosbags-convert --src BAG --dst NEW --include-topic /scan /odom /tf /tf_static"
    return BadData(str(bag), "", what, remedy)


def _count_ros1(bag: Path) -> int:
    """Return the number of connections in the header of a ROS 1 bag, 0 if it cannot be read."""
    with bag.open("rb") as file:
        head = file.read(_HEAD_BYTES)
    name = b"conn_count="
    at = head.find(name) + len(name)
    return struct.unpack_from("<I", head, at)[0] if name in head and at + 4 <= len(head) else 0


def _count_sqlite(bag: Path) -> int:
    """Return the number of rows in the table of topics, 0 if it cannot be read."""
    try:
        with closing(_open_sqlite(bag)) as base:
            found = base.execute("SELECT count(*) FROM (SELECT 1 FROM topics LIMIT 10000000)").fetchone()
    except (sqlite3.Error, UnicodeDecodeError):
        return 0
    return int(found[0])
