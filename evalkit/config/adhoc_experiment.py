"""The experiment for one recording, from options of the command line instead of a file."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from pathlib import Path

from evalkit.config.experiment import Experiment, experiment_from_tables
from evalkit.core.errors import BadData, EvalkitError, NotInstalled
from evalkit.core.scan import Frame
from evalkit.plugins import registry
from evalkit.plugins.parameter_parsing import from_text
from evalkit.plugins.specs import DatasetSpec


def experiment_from_recording(
    path: Path,
    options: Mapping[str, str],
    settings: Mapping[str, str],
    methods: Sequence[str | Mapping[str, object]],
    source: str,
) -> Experiment:
    """All back ends, or the given methods, on one recording; the reader is chosen by the suffix of the file.

    ``options``: parameters of the reader with an option of their own (topic, relations, ground_truth, spans), if given.
    ``settings``: its other parameters, as text. ``methods``: names, or tables of an experiment file. ``source``: the
    command line, for the commands in the report.
    Raises BadData if no reader fits.
    """
    recording, reader, spec = _find_recording(path)
    values = from_text(reader, spec.parameters, {**settings, **options})
    many = {0: "every back end", 1: "one method"}.get(len(methods), f"{len(methods)} methods")
    content = {
        "title": f"{recording.name}: {many} on one recording",
        "sequence": [{"use": reader, "label": recording.name, "path": str(recording), **values}],
        "method": [
            {"use": one} if isinstance(one, str) else dict(one) for one in methods or registry.names("backends")
        ],
    }
    return experiment_from_tables(
        content, f"compare {path}", _make_experiment_name(recording, {**settings, **options}), source
    )


def read_first_frame(experiment: Experiment) -> Frame:
    """Read the first frame of the first sequence. Raises BadData if it cannot be read, before anything runs."""
    spec = experiment.sequences[0]
    try:
        sequence = registry.dataset(spec.dataset).make(**spec.parameters)
        frame = next(iter(sequence.frames()), None)
    except EvalkitError:
        raise
    except Exception as error:  # damage in a file can raise anything in a reader
        what = f"cannot be read ({type(error).__name__}: {' '.join(str(error).split())[:160]})"
        raise BadData(spec.label, "", what, "is the file whole?") from error
    if frame is None:
        raise BadData(spec.label, "", "it contains no scan", "give a recording with laser scans")
    return frame


def _make_experiment_name(path: Path, settings: Mapping[str, str]) -> str:
    """File, topic, and a hash of path and settings, so that every combination has its own results folder."""
    identity = json.dumps([str(path.resolve()), dict(settings)], sort_keys=True)
    digest = hashlib.sha256(identity.encode()).hexdigest()[:6]
    words = [path.name, settings.get("topic", ""), digest]
    cleaned = ("".join(char if char.isalnum() else "-" for char in word).strip("-") for word in words)
    return "-".join(word for word in cleaned if word)


def _find_recording(path: Path) -> tuple[Path, str, DatasetSpec]:
    """The recording and its reader: the file or folder itself, or the only folder in it with a recording."""
    if not path.exists():
        raise BadData(str(path), "", "no such file or folder", "give the path of a bag or a log")
    readers = {name: spec for name, spec in _loadable_datasets().items() if spec.suffixes}
    if (fitting := _find_reader(path, readers)) is not None:
        return path, *fitting
    below = {
        folder: reader for folder in _list_folder(path) if folder.is_dir() and (reader := _find_reader(folder, readers))
    }
    if len(below) == 1:
        return next((folder, *reader) for folder, reader in below.items())
    if below:
        choice = f"give one of {', '.join(map(str, below))}"
        raise BadData(str(path), "", f"{len(below)} folders with a recording in it", choice)
    known = ", ".join(f"{name} ({' '.join(spec.suffixes)})" for name, spec in readers.items())
    raise BadData(str(path), "", f"no reader for '{path.suffix or path.name}'", f"known readers: {known}")


def _find_reader(path: Path, readers: Mapping[str, DatasetSpec]) -> tuple[str, DatasetSpec] | None:
    """The first reader with the suffix of the file, or of a file in the folder."""
    names = [path.name, *(file.name for file in _list_folder(path))]
    fits = ((name, spec) for name, spec in readers.items() if any(n.lower().endswith(spec.suffixes) for n in names))
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
