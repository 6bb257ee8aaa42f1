"""Everything evalkit says when something outside it is wrong: what, where, and what to do.

Arguments stay in ``args`` and messages are made in ``__str__``, so that every error survives the way between processes.
"""

from __future__ import annotations

import difflib
from collections.abc import Iterable

LONGEST = 2000
"""Characters of a message: what is longer quotes a file, and loses its middle."""


def plain(text: str) -> str:
    """The text as one line of a message: what cannot be printed escaped, the middle of a long one left out.

    What a file says may hold anything, codes that command a terminal among it.
    """
    if len(text) > LONGEST:
        text = f"{text[: LONGEST // 2]} [...] {text[-LONGEST // 4 :]}"
    if text.isprintable():
        return text
    return "".join(char if char.isprintable() else char.encode("unicode_escape").decode() for char in text)


def brief(value: object) -> str:
    """What was found, at the length of a few words.

    >>> brief([1, "x" * 200])
    "[1, 'xxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxx[...]xxxxxxxxxxxxxxx']"
    """
    said = repr(value)
    return said if len(said) <= 80 else f"{said[:52]}[...]{said[-17:]}"


class EvalkitError(Exception):
    """Any error a user of evalkit can mend; the command line turns it into one line and exit code 2."""


class UnknownName(EvalkitError):
    """A name that nothing is registered under: ``UnknownName(kind, name, known, where="")``."""

    def __init__(self, kind: str, name: str, known: Iterable[str], where: str = "") -> None:
        super().__init__(kind, name, tuple(sorted(known)), where)

    def __str__(self) -> str:
        kind, name, known, where = self.args
        name = name if len(name) <= 100 else f"{name[:100]}[...]"
        close = difflib.get_close_matches(name, known, n=1)
        hint = f" (did you mean '{close[0]}'?)" if close else ""
        place = f"{where}: " if where else ""
        return plain(f"{place}no {kind} named '{name}'{hint}; known: {', '.join(known) or 'none'}")


class BadParameter(EvalkitError):
    """A parameter of a plug-in with a value it cannot take: ``BadParameter(owner, name, found, expected)``."""

    def __init__(self, owner: str, name: str, found: object, expected: str) -> None:
        super().__init__(owner, name, found, expected)

    def __str__(self) -> str:
        owner, name, found, expected = self.args
        return plain(f"{owner}: parameter '{name}': found {brief(found)}, expected {expected}")


class BadExperiment(EvalkitError):
    """An experiment file that cannot be run: ``BadExperiment(file, place, what)``."""

    def __init__(self, file: str, place: str, what: str) -> None:
        super().__init__(file, place, what)

    def __str__(self) -> str:
        file, place, what = self.args
        return plain(f"{file}: {place}: {what}" if place else f"{file}: {what}")


class BadData(EvalkitError):
    """Recorded data that cannot be read: ``BadData(file, place, found, remedy)``."""

    def __init__(self, file: str, place: str, found: str, remedy: str) -> None:
        super().__init__(file, place, found, remedy)

    def __str__(self) -> str:
        file, place, found, remedy = self.args
        return plain(f"{file}: {place}: {found}; {remedy}" if place else f"{file}: {found}; {remedy}")


class DataMissing(EvalkitError):
    """A data set whose files are not on this machine: ``DataMissing(dataset, what, remedy)``."""

    def __init__(self, dataset: str, what: str, remedy: str) -> None:
        super().__init__(dataset, what, remedy)

    def __str__(self) -> str:
        dataset, what, remedy = self.args
        return plain(f"{dataset}: {what}; {remedy}")


class NotInstalled(EvalkitError):
    """An optional library that is absent or does not load: ``NotInstalled(name, why, remedy)``."""

    def __init__(self, name: str, why: str, remedy: str) -> None:
        super().__init__(name, why, remedy)

    def __str__(self) -> str:
        name, why, remedy = self.args
        return plain(f"{name}: {why}; {remedy}")


class BackendFailed(EvalkitError):
    """Somebody else's implementation that cannot go on: ``BackendFailed(name, what, remedy)``."""

    def __init__(self, name: str, what: str, remedy: str) -> None:
        super().__init__(name, what, remedy)

    def __str__(self) -> str:
        name, what, remedy = self.args
        return plain(f"{name}: {what}; {remedy}")


class StoreError(EvalkitError):
    """A results folder that cannot be written or read: ``StoreError(path, what, remedy)``."""

    def __init__(self, path: str, what: str, remedy: str) -> None:
        super().__init__(path, what, remedy)

    def __str__(self) -> str:
        path, what, remedy = self.args
        return plain(f"{path}: {what}; {remedy}")
