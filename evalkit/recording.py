"""A plan for one recording, made from the words of the command line instead of an experiment file."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from evalkit import experiment, registry
from evalkit.errors import BadData
from evalkit.experiment import Plan
from evalkit.protocols import DatasetSpec
from evalkit.settings import from_text


def plan(path: Path, options: Mapping[str, str], settings: Mapping[str, str], backends: list[str], source: str) -> Plan:
    """All back ends (or those named) over one file, by the reader whose suffix fits.

    ``options``: the reader's parameters that have an option of their own (topic, relations, reference), where given.
    ``settings``: its other parameters, as text. ``source``: the command line, for the commands in the report.
    """
    reader, spec = _reader(path)
    values = from_text(reader, spec.parameters, {**settings, **options})
    content = {
        "title": f"{path.name}: every back end on one recording",
        "sequence": [{"use": reader, "label": path.name, "path": str(path), **values}],
        "contestant": [{"use": name} for name in backends or registry.names("backends")],
    }
    return experiment.plan(content, f"compare {path}", path.name.replace(".", "-"), source)


def _reader(path: Path) -> tuple[str, DatasetSpec]:
    """The reader whose suffix fits the file, or a file within the folder."""
    if not path.exists():
        raise BadData(str(path), "", "no such file or folder", "give the path of a bag or a log")
    inside = [path.name, *(file.name for file in path.iterdir())] if path.is_dir() else [path.name]
    specs = {name: registry.dataset(name) for name in registry.names("datasets")}
    readers = {name: spec for name, spec in specs.items() if spec.suffixes}
    for name, spec in readers.items():
        if any(file.lower().endswith(spec.suffixes) for file in inside):
            return name, spec
    known = ", ".join(f"{name} ({' '.join(spec.suffixes)})" for name, spec in readers.items())
    raise BadData(str(path), "", f"no reader for '{path.suffix or path.name}'", f"known readers: {known}")
