"""Errors that a user can fix: each message contains what was found, where, and what to do.

Arguments are kept in ``args`` and messages are built in ``__str__``, so that errors can be pickled between processes.
"""

from __future__ import annotations

import difflib
import errno
import unicodedata
from collections.abc import Iterable

_MACHINE_ERRORS = frozenset(
    {errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EIO, errno.ENOMEM, errno.EMFILE, errno.ENFILE, errno.EAGAIN}
)
"""Errors of the system that no method causes when evalkit itself writes a file or starts a process."""

_NO_THREAD = "can't start new thread"
"""What Python says where the system starts no thread, in an error without a number."""

MAX_MESSAGE = 2000
"""Longest message in characters; the middle of a longer one is removed."""


def plain(text: str) -> str:
    """Return a text as one printable line: other characters are escaped, the middle of a long text is removed.

    Text quoted from a file can contain anything, including terminal control codes.
    """
    if len(text) > MAX_MESSAGE:
        text = f"{text[: MAX_MESSAGE // 2]} [...] {text[-MAX_MESSAGE // 4 :]}"
    return show_controls(text, keep="")


def show_controls(text: str, keep: str = "\n\t") -> str:
    r"""Return a text with what a terminal would obey, or a reader not see, escaped: control and formatting characters.

    ``keep``: characters that stay as they are. Every kind of space stays, unless ``keep`` is empty.

    >>> show_controls("\033[31mred\n")
    '\\x1b[31mred\n'
    """
    if text.isprintable():
        return text
    return "".join(
        char if char.isprintable() or char in keep or (keep and unicodedata.category(char) == "Zs")
        else char.encode("unicode_escape").decode()
        for char in text
    )  # fmt: skip


def brief(value: object) -> str:
    """Return a value as text of at most 80 characters.

    >>> brief([1, "x" * 200])
    "[1, 'xxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxxx[...]xxxxxxxxxxxxxxx']"
    """
    text = repr(value)
    return text if len(text) <= 80 else f"{text[:52]}[...]{text[-17:]}"


class EvalkitError(Exception):
    """Base of all errors that a user can fix; the command line prints their message and exits with code 2."""


def suggest(name: str, known: Iterable[str]) -> str:
    """Return " (did you mean 'NAME'?)" with the known name nearest to a name, "" where none is near.

    >>> suggest("/scn", ["/odom", "/scan"])
    " (did you mean '/scan'?)"
    """
    known = tuple(known)
    name = name[:100]  # the time grows with the square of the length
    close = difflib.get_close_matches(name, known, n=1) or _find_longer(name, known)
    return f" (did you mean {' or '.join(repr(one) for one in close)}?)" if close else ""


class UnknownName(EvalkitError):
    """A name that is not registered: ``UnknownName(kind, name, known, where="", hint="")``.

    ``hint``: what to do, instead of the known name nearest to it.
    """

    def __init__(self, kind: str, name: str, known: Iterable[str], where: str = "", hint: str = "") -> None:
        super().__init__(kind, name, tuple(sorted(known)), where, hint)

    def __str__(self) -> str:
        kind, name, known, where, hint = self.args
        name = name if len(name) <= 100 else f"{name[:100]}[...]"
        hint = f" ({hint})" if hint else suggest(name, known)
        place = f"{where}: " if where else ""
        return plain(f"{place}no {kind} named '{name}'{hint}; known: {', '.join(known) or 'none'}")


def _find_longer(name: str, known: Iterable[str]) -> list[str]:
    """Return up to three names that begin with a name, or else contain it."""
    begin = [one for one in known if name and one.startswith(name)]
    return (begin or [one for one in known if name and name in one])[:3]


class UnknownModule(UnknownName):
    """A module of a name "module:SPEC" that is not found: ``UnknownModule(module, schemes, file)``.

    ``schemes``: those known, because the name may be meant as one. ``file``: of the module in the working directory,
    "" if there is none.
    """

    def __init__(self, module: str, schemes: Iterable[str], file: str) -> None:
        super().__init__("module", module, schemes, file)

    def __str__(self) -> str:
        _, module, schemes, file, _ = self.args
        remedy = f"{file} is in this folder: set PYTHONPATH=." if file else "set PYTHONPATH to the folder that has it"
        return plain(f"no module {module} found: {remedy} (no scheme has this name; known: {', '.join(schemes)})")


class BadParameter(EvalkitError):
    """An invalid value of a plug-in's parameter: ``BadParameter(owner, name, found, expected)``."""

    def __init__(self, owner: str, name: str, found: object, expected: str) -> None:
        super().__init__(owner, name, found, expected)

    def __str__(self) -> str:
        owner, name, found, expected = self.args
        return plain(f"{owner}: parameter '{name}': found {brief(found)}, expected {expected}")


class BadExperiment(EvalkitError):
    """An invalid experiment file: ``BadExperiment(file, place, what)``."""

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


class _RemediedError(EvalkitError):
    """An error of three parts: what it concerns, what is wrong and what to do."""

    def __init__(self, concerned: str, what: str, remedy: str) -> None:
        super().__init__(concerned, what, remedy)

    def __str__(self) -> str:
        concerned, what, remedy = self.args
        return plain(f"{concerned}: {what}; {remedy}")


class DataMissing(_RemediedError):
    """A data set whose files are not on this machine: ``DataMissing(dataset, what, remedy)``."""


class NotInstalled(_RemediedError):
    """An optional library that is missing or cannot be loaded: ``NotInstalled(name, why, remedy)``."""


class BackendFailed(_RemediedError):
    """An external implementation that failed: ``BackendFailed(name, what, remedy)``."""


class BackendRefused(BackendFailed):
    """It answered that it cannot answer this question; it can be asked the next one."""


class BackendLate(BackendFailed):
    """It did not answer in time."""


class BackendEnded(BackendFailed):
    """It ended instead of answering."""


class NotLocalised(_RemediedError):
    """A robot whose place in a known map was not found: ``NotLocalised(map, what, remedy)``."""


class StoreError(_RemediedError):
    """A results folder that cannot be written or read: ``StoreError(path, what, remedy)``."""


class MachineFault(_RemediedError):
    """The machine failed evalkit, not a method: ``MachineFault(where, what, remedy)``."""

    FREE = "free disk, memory, /dev/shm, open files or processes, and repeat"
    REMEDY = f"{FREE} with --resume"
    """What to do after a fault in a comparison, which alone has this option."""

    @classmethod
    def of(cls, where: str, error: BaseException, remedy: str = REMEDY) -> MachineFault | None:
        """Return the fault behind an error of evalkit's own writing or starting, None if it is of another kind."""
        if isinstance(error, RuntimeError) and _NO_THREAD in str(error):
            return cls(where, f"the machine failed ({_NO_THREAD})", remedy)
        system = error if isinstance(error, OSError) else error.__cause__
        if not isinstance(system, OSError) or system.errno not in _MACHINE_ERRORS:
            return None
        return cls(where, f"the machine failed ({system.strerror})", remedy)


def format_exception(error: BaseException) -> str:
    """An exception as an observation."""
    return f"raises {type(error).__name__}: {error}"
