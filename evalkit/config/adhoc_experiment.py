"""A plan for one recording, made from the words of the command line instead of an experiment file."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path

from evalkit.config import experiment
from evalkit.config.experiment import Experiment
from evalkit.core.errors import BadData, EvalkitError, NotInstalled
from evalkit.core.scan import Frame
from evalkit.plugins import registry
from evalkit.plugins.parameter_parsing import from_text
from evalkit.plugins.specs import DatasetSpec


def plan(
    path: Path, options: Mapping[str, str], settings: Mapping[str, str], backends: list[str], source: str
) -> Experiment:
    """All back ends (or those named) over one file, by the reader whose suffix fits.

    ``options``: the reader's parameters that have an option of their own (topic, relations, reference, spans), where
    given. ``settings``: its other parameters, as text. ``source``: the command line, for the commands in the report.
    """
    found, reader, spec = _found(path)
    values = from_text(reader, spec.parameters, {**settings, **options})
    many = {0: "every back end", 1: "one back end"}.get(len(backends), f"{len(backends)} back ends")
    content = {
        "title": f"{found.name}: {many} on one recording",
        "sequence": [{"use": reader, "label": found.name, "path": str(found), **values}],
        "method": [{"use": name} for name in backends or registry.names("backends")],
    }
    return experiment.plan(content, f"compare {path}", _name(found, {**settings, **options}), source)


def first_frame(plan: Experiment) -> Frame:
    """The first frame of a plan's first sequence: what cannot be read is known before anything runs (BadData)."""
    spec = plan.sequences[0]
    try:
        sequence = registry.dataset(spec.dataset).make(**spec.parameters)
        frame = next(iter(sequence.frames()), None)
    except EvalkitError:
        raise
    except Exception as error:  # a reader of foreign files meets damage in any way it likes
        what = f"cannot be read ({type(error).__name__}: {' '.join(str(error).split())[:160]})"
        raise BadData(spec.label, "", what, "is the file whole?") from error
    if frame is None:
        raise BadData(spec.label, "", "there is not one scan in it", "give a recording with laser scans")
    return frame


def _name(path: Path, settings: Mapping[str, str]) -> str:
    """File, topic and a digest of path and settings: what differs in any of them has a results folder of its own."""
    identity = json.dumps([str(path.resolve()), dict(settings)], sort_keys=True)
    digest = hashlib.sha256(identity.encode()).hexdigest()[:6]
    words = [path.name, settings.get("topic", ""), digest]
    cleaned = ("".join(char if char.isalnum() else "-" for char in word).strip("-") for word in words)
    return "-".join(word for word in cleaned if word)


def _found(path: Path) -> tuple[Path, str, DatasetSpec]:
    """What to open, and the reader whose suffix fits it: the file, the folder, or the only folder in it that fits."""
    if not path.exists():
        raise BadData(str(path), "", "no such file or folder", "give the path of a bag or a log")
    readers = {name: spec for name, spec in _datasets().items() if spec.suffixes}
    if (fitting := _fitting(path, readers)) is not None:
        return path, *fitting
    below = {folder: reader for folder in _inside(path) if folder.is_dir() and (reader := _fitting(folder, readers))}
    if len(below) == 1:
        return next((folder, *reader) for folder, reader in below.items())
    if below:
        choice = f"give one of {', '.join(map(str, below))}"
        raise BadData(str(path), "", f"{len(below)} folders with a recording in it", choice)
    known = ", ".join(f"{name} ({' '.join(spec.suffixes)})" for name, spec in readers.items())
    raise BadData(str(path), "", f"no reader for '{path.suffix or path.name}'", f"known readers: {known}")


def _fitting(path: Path, readers: Mapping[str, DatasetSpec]) -> tuple[str, DatasetSpec] | None:
    """The reader whose suffix fits the file, or a file within the folder."""
    names = [path.name, *(file.name for file in _inside(path))]
    fits = ((name, spec) for name, spec in readers.items() if any(n.lower().endswith(spec.suffixes) for n in names))
    return next(fits, None)


def _inside(path: Path) -> list[Path]:
    try:
        return sorted(path.iterdir()) if path.is_dir() else []
    except OSError as error:
        raise BadData(str(path), "", f"cannot be read ({error.strerror})", "may you read this folder?") from error


def _datasets() -> dict[str, DatasetSpec]:
    """Every data set that loads: a broken plug-in must not take the others along."""
    found = {}
    for name in registry.names("datasets"):
        try:
            found[name] = registry.dataset(name)
        except NotInstalled:
            continue
    return found
