"""The experiment for one recording, from options of the command line instead of a file."""

from __future__ import annotations

import hashlib
import json
import re
import shlex
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

from evalkit.config.experiment import Experiment
from evalkit.config.experiment_file import experiment_from_tables
from evalkit.core.errors import BadData, BadParameter, EvalkitError, NotInstalled, UnknownName
from evalkit.core.scan import Frame
from evalkit.plugins import defaults, registry
from evalkit.plugins.parameter_parsing import from_text
from evalkit.plugins.parameters import MAP_START, Value, resolve_parameters
from evalkit.plugins.specs import Choice, DatasetSpec

NO_KEYS: Mapping[str, Value] = {}

MAPPER = "mapper."
"""Prefix of a choice for the mapper."""


@dataclass(frozen=True)
class Recording:
    """A recording with its reader: ``given`` are the reader's parameters, the path included."""

    path: Path
    reader: str
    given: Mapping[str, Value]

    @property
    def spec(self) -> DatasetSpec:
        """The spec of the reader."""
        return registry.dataset(self.reader)

    def choose(self) -> tuple[Choice, ...]:
        """Return what the reader finds in the recording and beside it.

        Raises UnknownName or BadParameter for a given parameter, BadData if the recording cannot be read.
        """
        if self.path.is_file() and self.path.stat().st_size == 0:
            raise BadData(str(self.path), "", "the file is empty", "give a bag or a log")
        resolve_parameters(self.reader, self.spec.parameters, self.given)
        if self.spec.choose is None:
            return ()
        with _as_bad_data(self.path.name):
            return tuple(self.spec.choose(self.given))


def open_recording(path: Path, settings: Mapping[str, str], reader: str = "") -> Recording:
    """Find the reader of a recording by its content or suffix; ``settings``: parameters of the reader, as text.

    ``reader``: the name of the data set to read it with instead. Raises BadData if no reader fits, UnknownName.
    """
    if reader:
        recording, spec = path, _named_reader(path, reader)
    else:
        recording, reader, spec = _find_recording(path)
    if "path" in settings:
        raise BadParameter(reader, "path", settings["path"], f"one path, but {path} is given too")
    return Recording(recording, reader, {"path": str(recording), **from_text(reader, spec.parameters, settings)})


def experiment_from_recording(
    recording: Recording,
    choices: Iterable[Choice],
    methods: Sequence[str | Mapping[str, object]],
    source: str,
    keys: Mapping[str, Value] = NO_KEYS,
) -> Experiment:
    """The given methods on one recording, with the choices for reader and mapper that are not given.

    ``methods``: names, or tables of an experiment file. ``source``: the command line, for the commands in the report.
    ``keys``: further keys of the sequence: for a known map, and ``nuisance``.
    """
    choices = tuple(choices)
    chosen = {one.name: one.value for one in choices if one.value is not None}
    reading = {name: value for name, value in chosen.items() if not name.startswith(MAPPER)} | dict(recording.given)
    mapping = {name.removeprefix(MAPPER): value for name, value in chosen.items() if name.startswith(MAPPER)}
    known = {each.name for each in registry.mapper(defaults.find_default_mapper()).parameters}
    many = "one method" if len(methods) == 1 else f"{len(methods)} methods"
    content = {
        "title": f"{recording.path.name}: {many} on one recording",
        "sequence": [{"use": recording.reader, "label": label_of(recording.path), **reading, **keys}],
        "method": [{"use": one} if isinstance(one, str) else dict(one) for one in methods],
        "mapper": {name: value for name, value in mapping.items() if name in known},
    }
    experiment = experiment_from_tables(content, f"compare {recording.path}", name_experiment(recording, keys), source)
    warnings = tuple(one.reason for one in choices if one.warns)
    return replace(experiment, sequences=tuple(replace(one, warnings=warnings) for one in experiment.sequences))


def read_first_frame(experiment: Experiment) -> Frame:
    """Read the first frame of the first sequence. Raises BadData if it cannot be read, before anything runs."""
    spec = experiment.sequences[0]
    with _as_bad_data(spec.label):
        sequence = registry.dataset(spec.dataset).make(**spec.parameters)
        frame = next(iter(sequence.frames()), None)
    if frame is None:
        raise BadData(spec.label, "", "it contains no scan", "give a recording with laser scans")
    return frame


def format_command(
    source: Path,
    given: Mapping[str, str],
    keys: Mapping[str, Value],
    backends: Sequence[str],
    settings: Sequence[str],
    as_is: bool = False,
    reader: str = "",
) -> str:
    """Return the command line of a comparison on one recording, without "evalkit".

    ``given``: files and topic, by the name of the reader's parameter. ``keys``: as for the experiment. ``settings``:
    other parameters of the reader, as NAME=VALUE.
    """
    words = ["compare", word_of(source)]
    words += [word for name, value in given.items() for word in (f"--{option_name(name)}", value)]
    for name, value in keys.items():
        words += [f"--{option_name(name)}", *([] if value is True else [str(value)])]
    words += ["--backends", ",".join(backends), *(["--as-is"] if as_is else [])]
    words += ["--reader", reader] if reader else []
    words += [word for item in settings for word in ("--set", item)]
    return shlex.join(words)


def label_of(path: Path) -> str:
    """Return the label of a recording: its name, without characters with which a label must not begin."""
    return path.name.lstrip("=+-@")


def word_of(path: Path) -> str:
    """Return a path as a word of a command line, where one that begins with "-" would be an option."""
    return f"./{path}" if str(path).startswith("-") else str(path)


def option_name(parameter: str) -> str:
    """Return the name of the option of a parameter."""
    return "start" if parameter == MAP_START else parameter.replace("_", "-")


def split_names(text: str) -> list[str]:
    """Return the back ends of a list separated by commas; the comma of "?tf=map,base_link" separates no names."""
    return [name for word in re.findall(r"(?:\?tf=[^,]*,|[^,])+", text) if (name := word.strip())]


@contextmanager
def _as_bad_data(name: str) -> Iterator[None]:
    """Raise any other exception as BadData: damage in a file can raise anything in a reader."""
    try:
        yield
    except EvalkitError:
        raise
    except Exception as error:
        what = f"cannot be read ({type(error).__name__}: {' '.join(str(error).split())[:160]})"
        raise BadData(name, "", what, "is the file whole?") from error


def name_experiment(recording: Recording, keys: Mapping[str, Value]) -> str:
    """Return the name of the experiment of a recording: file, topic, and a hash of path and settings.

    So every combination has its own results folder.
    """
    settings = {name: value for name, value in recording.given.items() if name != "path"}
    identity = json.dumps([str(recording.path.resolve()), {**settings, **keys}], sort_keys=True)
    digest = hashlib.sha256(identity.encode()).hexdigest()[:6]
    words = [recording.path.name, str(settings.get("topic", "")), digest]
    cleaned = ("".join(char if char.isalnum() else "-" for char in word).strip("-") for word in words)
    return "-".join(word for word in cleaned if word)


def _find_recording(path: Path) -> tuple[Path, str, DatasetSpec]:
    """The recording and its reader: the file or folder itself, or the only folder in it with a recording."""
    if not path.exists():
        raise BadData(str(path), "", "no such file or folder", "give the path of a bag or a log")
    if (path / "results.json").is_file() and (path / "runs").is_dir():
        what = "a folder of results; evalkit export and evalkit diff read it"
        raise BadData(str(path), "", what, "to run it again, give its recording or experiment (*.toml)")
    if (fitting := find_reader(path)) is not None:
        return path, *fitting
    readers = _find_readers()
    below = {folder: reader for folder in _list_folder(path) if folder.is_dir() and (reader := find_reader(folder))}
    if len(below) == 1:
        return next((folder, *reader) for folder, reader in below.items())
    if below:
        choice = f"give one of {', '.join(map(str, below))}"
        raise BadData(str(path), "", f"{len(below)} folders with a recording in it", choice)
    known = ", ".join(f"{name} ({' '.join(spec.suffixes)})" for name, spec in readers.items())
    more = f"evalkit inspect {shlex.quote(str(path))} says more" if path.is_file() else "give a file"
    raise BadData(str(path), "", f"no reader for '{path.suffix or path.name}'", f"known readers: {known}; {more}")


def _named_reader(path: Path, name: str) -> DatasetSpec:
    if not path.exists():
        raise BadData(str(path), "", "no such file or folder", "give the path of a recording")
    readers = _find_readers()
    if name not in readers:
        hint = "a data set, but its spec has no suffixes of files" if name in registry.names("datasets") else ""
        raise UnknownName("reader", name, readers, hint=hint)
    return readers[name]


def _find_readers() -> dict[str, DatasetSpec]:
    """The data sets that open a file given by the user."""
    return {name: spec for name, spec in _loadable_datasets().items() if spec.suffixes or spec.recognises is not None}


def find_reader(path: Path) -> tuple[str, DatasetSpec] | None:
    """The reader that recognises the file, else the first with the suffix of the file, or of a file in the folder."""
    readers = _find_readers()
    if path.is_file():
        for name, spec in readers.items():
            if spec.recognises is not None and spec.recognises(path):
                return name, spec
    names = [path.name, *(file.name for file in _list_folder(path))]
    suffixed = {name: spec for name, spec in readers.items() if spec.suffixes}
    fits = ((name, spec) for name, spec in suffixed.items() if any(n.lower().endswith(spec.suffixes) for n in names))
    return next(fits, None)


def _list_folder(path: Path) -> list[Path]:
    try:
        return sorted(path.iterdir()) if path.is_dir() else []
    except OSError as error:
        raise BadData(
            str(path), "", f"cannot be read ({error.strerror})", "check the permissions of this folder"
        ) from error


def _loadable_datasets() -> dict[str, DatasetSpec]:
    """Every data set that loads; a broken plug-in must not affect the others."""
    specs = {}
    for name in registry.names("datasets"):
        try:
            specs[name] = registry.dataset(name)
        except NotInstalled:
            continue
    return specs
