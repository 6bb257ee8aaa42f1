"""Find the ground truth of a recording among the files beside it."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np

from evalkit.core.errors import EvalkitError
from evalkit.plugins.parameters import Value
from evalkit.plugins.specs import Choice
from evalkit_datasets.commands.inspect.inspector import Inspection
from evalkit_datasets.commands.inspect.reader_trial import minimal_parameters, try_reader
from evalkit_datasets.parsing.truth_files import TruthPaths, load_truth

TRUTH_NAMES = ("truth", "ground[-_]?truth", "gt", "reference", "mocap", "vicon", "optitrack")
"""Words (regular expressions) that the name of a file with a true trajectory begins with."""

MAX_LISTED = 5


def find_truth_files(recording: Inspection, given: Mapping[str, Value]) -> Iterator[Choice]:
    """Find relations and reference trajectory in the same folder that overlap the recording in time.

    Without a name that says so a trajectory may as well be that of a method: it is told, and not chosen.
    """
    for name, ending in (("relations", "*.relations"), ("ground_truth", "*.tum")):
        if name not in given:
            yield from _choose_truth(recording, name, sorted(recording.path.parent.glob(ending)))


def _choose_truth(recording: Inspection, name: str, files: list[Path]) -> Iterator[Choice]:
    """Choose the only file with the name of a truth; say which other ones, or several, could be chosen."""
    what, option = name.replace("_", " "), f"--{name.replace('_', '-')}"
    named = [file for file in files if is_named_as_truth(file, recording.path)]
    problems = {file: _find_truth_problem(recording, name, file) for file in named}
    fitting = [file for file in named if not problems[file]]
    yield from (Choice(name, None, f"{what} {file.name} not taken: {why}") for file, why in problems.items() if why)
    if len(fitting) == 1:
        yield Choice(name, str(fitting[0]), f"{what} {fitting[0].name}: in the same folder, and overlaps in time")
        return
    others = fitting or [file for file in files if file not in named and _overlaps(recording, name, file)]
    if others:
        listed = ", ".join(file.name for file in others[:MAX_LISTED]) + (", ..." if len(others) > MAX_LISTED else "")
        why = "several have the name of a truth" if fitting else "no name says that it is the truth"
        yield Choice(name, None, f"no {what} taken of {listed}, in the same folder: {why}; choose with {option} FILE")


def is_named_as_truth(file: Path, recording: Path) -> bool:
    """Return whether a file is called like its recording ("drive.tum") or a truth ("gt.tum", "drive-truth.tum").

    The name of a recording may go on behind a hyphen ("drive-merged.log"), unless it begins with a date. Behind the
    name of the recording and the word of a truth anything may follow ("drive-reference-by-hand.tum").
    """
    name, whole = file.stem.lower(), recording.name.split(".")[0].lower()
    begin = whole.split("-")[0]
    own = {whole, recording.stem.lower(), *([] if begin.isdigit() else [begin])}
    words = "|".join(TRUTH_NAMES)
    if name in own or re.fullmatch(rf"({words})([-_.]?(2d|\d+))?", name):
        return True
    rests = (name[len(each) + 1 :] for each in own if name.startswith((f"{each}-", f"{each}_", f"{each}.")))
    return any(re.match(rf"({words})([-_.]|$)", rest) for rest in rests)


def _find_truth_problem(recording: Inspection, name: str, file: Path) -> str:
    """Return why a recording cannot be read with a truth, "" if it can."""
    tried = try_reader(recording.streams.reader, minimal_parameters(recording) | {name: str(file)})
    return tried.problem or ("" if tried.truth else "no pose of it lies within the scans")


def _overlaps(recording: Inspection, name: str, file: Path) -> bool:
    """Return whether a file can be read and overlaps the scans in time, without opening the recording again."""
    stamps = np.sort(recording.streams.lasers[0].stamps_ns)
    try:
        truth, _ = load_truth(TruthPaths(**{name: str(file)}), stamps, (int(stamps[0]), int(stamps[-1])))
    except EvalkitError:
        return False
    return truth.trajectory is not None or truth.relations is not None
