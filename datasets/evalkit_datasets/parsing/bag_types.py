"""The message types of bags that contain no definitions, as those recorded before ROS 2 Iron."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from rosbags.highlevel import AnyReader
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_typestore


class NeededTypes:
    """The types of ROS 2 Humble that the messages of a bag need; in place of a ``Typestore``, for ``AnyReader``.

    A reader makes a class of every type that it is given: all 190 take 0.1 s of CPU time each time a bag is opened.
    Set ``reader`` before it is opened.
    """

    def __init__(self) -> None:
        self.reader: AnyReader | None = None

    @property
    def fielddefs(self) -> dict[str, Any]:
        """The definitions of the types of all connections and of their parts, by name."""
        known = get_typestore(Stores.ROS2_HUMBLE).fielddefs
        readers = () if self.reader is None else self.reader.readers
        waiting = [connection.msgtype for reader in readers for connection in reader.connections]
        needed: dict[str, Any] = {}
        while waiting:
            name = waiting.pop()
            if name in known and name not in needed:
                needed[name] = known[name]
                waiting += [part for _, node in known[name][1] for part in _list_names(node)]
        return needed


def _list_names(node: tuple[Nodetype, Any]) -> Iterator[str]:
    """Yield the names of types in the description of a field."""
    kind, inner = node
    if kind == Nodetype.NAME:
        yield inner
    elif kind in (Nodetype.ARRAY, Nodetype.SEQUENCE):
        yield from _list_names(inner[0])
