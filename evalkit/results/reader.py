"""Read a results folder: results.json of a finished report, the stored runs, and the tables beside them."""

from __future__ import annotations

import csv
import io
import json
import re
import shlex
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from evalkit.config.experiment import Experiment, Method, RunSpec, SequenceSpec
from evalkit.core.arrays import Ints
from evalkit.core.errors import StoreError, brief
from evalkit.core.ground_truth import Truth
from evalkit.core.run_result import DISTURBED, LostTrack, RunConditions, RunResult
from evalkit.core.se2 import Floats
from evalkit.io import untrusted_io
from evalkit.plugins.parameters import EXCERPT, NUISANCE
from evalkit.results.results_schema import check_schema
from evalkit.results.run_record import RunRecord
from evalkit.results.seal import check_seal, read_sealed, read_vouched
from evalkit.results.store import ERRORS, RESULT, SCORES, STEPS, Store, count_sound, parse_lost, whole_records

REPETITION = ("seed", NUISANCE, EXCERPT)
"""Parameters of a sequence that belong to one repetition."""

RESULTS_NAME, RESULTS_VERSION = "evalkit-results", 4
"""Name and schema version of results.json."""

_KEY = re.compile(r"(?!\.)[\w.=+-]{1,200}")
"""The name of a run's folder."""

AGAIN = "repeat the comparison with --resume, which keeps finished runs of the same code and data"
REMEDY = f"name a folder that `evalkit compare` has written, or {AGAIN}"

RunName = tuple[str, str, int | None]
"""Method, sequence and seed."""


@dataclass(frozen=True, eq=False)
class StoredRun:
    """What comparisons of two folders need of one run.

    ``parameters``: of the sequence, without the number of the repetition, with the scans of an excerpt. ``scores``:
    values by metric, without those that have none; ``supports``: of how many samples each of them is.
    ``stamps_ns``, ``errors_m`` (N,): distance to the ground truth of each scan that has one; empty if not stored.
    ``key``: equal for equal code, data and parameters. ``conditions``: of the machine during the run, if known.
    ``lost``: where it lost the track, None if it held it. ``perturbed``: it is a perturbation of a recording.
    """

    status: str
    reason: str
    parameters: Mapping[str, Any]
    scores: Mapping[str, float]
    stamps_ns: Ints = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    errors_m: Floats = field(default_factory=lambda: np.zeros(0))
    key: str = ""
    conditions: RunConditions = field(default_factory=RunConditions)
    lost: LostTrack | None = None
    perturbed: bool = False
    supports: Mapping[str, int] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class StoredResults:
    """All runs of a results folder.

    ``processor``: "" if unknown. ``unfinished``: the number of runs without a result. ``defaults``: default values of
    the sequences' parameters, by sequence, as far as results.json states them.
    """

    folder: str
    runs: Mapping[RunName, StoredRun]
    processor: str
    unfinished: int = 0
    defaults: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)


def load_results_json(folder: Path) -> dict[str, Any]:
    """Load results.json of a folder.

    Raises StoreError if the file is missing, half-written or of another schema version.
    """
    path = folder / "results.json"
    if not path.exists():
        unreported = (folder / "runs").is_dir()
        remedy = "a comparison with --no-page writes none: repeat it with --collect in place of --no-page"
        raise StoreError(str(path), "there is no such file", remedy if unreported else REMEDY)
    content = _load_object(path)
    schema = content.get("schema")
    if not isinstance(schema, dict) or (schema.get("name"), schema.get("version")) != (RESULTS_NAME, RESULTS_VERSION):
        found = f"{schema.get('name')} version {schema.get('version')}" if isinstance(schema, dict) else "no schema"
        raise StoreError(
            str(path),
            f"found {found}, expected {RESULTS_NAME} version {RESULTS_VERSION}",
            f"{AGAIN}; this evalkit reads version {RESULTS_VERSION}",
        )
    try:
        check_seal(content)
        json.dumps(content, ensure_ascii=False, allow_nan=False).encode()  # raises for NaN and half a character
        check_schema(content)
    except ValueError as error:
        raise StoreError(str(path), str(error), AGAIN) from error
    _check_keys(path, content)
    return content


def check_same_experiment(folder: Path, experiment: Experiment) -> None:
    """Raise StoreError if a folder holds the report of another experiment, which a new one would replace.

    Another experiment has another command and either no sequence of the same label, or another file name and another
    title: methods, parameters and sequences may be added to an experiment and removed, and its file may be moved or
    renamed. A report that cannot be read is no obstacle, as a run writes it again.
    """
    path = folder / "results.json"
    try:
        content = _load_object(path)
        labels, command, title = content["sequences"].keys(), content["command"], content["title"]
        mine = experiment.whole_command
        renamed = _find_file_name(command) != _find_file_name(mine) and title != experiment.title
    except (StoreError, KeyError, AttributeError, TypeError, ValueError):
        return
    if command != mine and (renamed or labels.isdisjoint(one.label for one in experiment.sequences)):
        what = f"holds the results of another experiment, {brief(title)} ({brief(command)})"
        raise StoreError(str(folder), what, "name another folder, or delete this one")


def _find_file_name(command: str) -> str:
    """Return the name of the file of a command "evalkit compare FILE ..." or "python -c CODE FILE"; "" without one."""
    words = [word for word in shlex.split(command) if not word.startswith("PYTHONPATH=")]
    return Path(next(iter(words[3 if words[:1] == ["python"] else 2 :]), "")).name


def _check_keys(path: Path, content: Mapping[str, Any]) -> None:
    """Raise StoreError where the key of a run is no plain name: keys name folders and files."""
    runs = content.get("runs")
    for index, entry in enumerate(runs if isinstance(runs, list) else ()):
        key = entry.get("key") if isinstance(entry, dict) else None
        if not isinstance(key, str) or not _KEY.fullmatch(key):
            what = f"runs[{index}].key: found {brief(key)}, expected the name of a folder in runs/"
            raise StoreError(str(path), what, "repeat the comparison in another folder; do not trust this one")


def load_stored_results(folder: Path) -> StoredResults:
    """Load the runs of a folder, from results.json if there is one, else from the folders of the runs.

    Raises StoreError if the folder is missing, holds no finished run, or if a file is damaged or of another version.
    """
    if not folder.is_dir():
        raise StoreError(str(folder), "there is no such folder", REMEDY)
    results = _load_reported(folder) if (folder / "results.json").exists() else _load_unreported(folder)
    if not results.runs:
        why = f"{results.unfinished} runs were begun and none finished" if results.unfinished else "it holds no run"
        raise StoreError(str(folder), why, REMEDY)
    return results


@contextmanager
def as_incomplete(path: Path) -> Iterator[None]:
    """Turn the error of a value that is missing or of another type into a StoreError that names the file."""
    try:
        yield
    except (KeyError, TypeError, ValueError, AttributeError, IndexError) as error:
        raise StoreError(str(path), f"is not complete ({error!r})", AGAIN) from error


def load_run(folder: Path, entry: Mapping[str, Any], truth: Truth) -> RunRecord:
    """Load one run in full: ``entry`` is its entry in results.json.

    Raises StoreError if its files hold less than results.json states.
    """
    store = Store.existing(folder)
    try:
        result: RunResult | None = store.read_result(entry["key"])
    except OSError as error:
        result, damage = None, f" ({Path(error.filename or store.run_folder(entry['key'])).name}: {error.strerror})"
    except (ValueError, TypeError, KeyError, AttributeError) as error:
        result, damage = None, f" ({error})"
    else:
        damage = ""
    scores = store.load_scores(entry["key"])
    answered, expected = 0 if result is None else len(result.steps), entry["scans_answered"]
    if result is None or scores is None or answered != expected:
        missing = (
            "its alignment and map are missing" if answered == expected else f"{answered} of {expected} poses{damage}"
        )
        raise StoreError(str(store.run_folder(entry["key"])), f"incomplete: {missing}", AGAIN)
    for errors in (scores.errors_m, scores.final.errors_m if scores.final else None):
        if errors is not None and len(errors) != answered:
            what = f"{len(errors)} errors of {answered} poses"
            raise StoreError(str(store.run_folder(entry["key"])), what, AGAIN)
    parameters = {name: value for name, value in entry["dataset_parameters"].items() if name not in REPETITION}
    method = Method(entry["method"], entry["backend"], entry["backend_parameters"])
    given = entry["dataset_parameters"]
    sequence = SequenceSpec(
        entry["sequence"], entry["dataset"], parameters, (entry["seed"],), "", NUISANCE in given, given.get(EXCERPT, 0)
    )
    spec = RunSpec(entry["key"], method, sequence, entry["seed"])
    return RunRecord(spec, result, replace(scores, alignment=entry["alignment"]), truth, entry["command"])


def find_working_folder(folder: Path, key: str) -> Path | None:
    """Return the folder from which relative paths of a run's data count, None if its result does not state it."""
    try:
        working: str = read_sealed(folder / "runs" / key / RESULT)["provenance"]["folder"]
        return (folder / working).resolve()
    except (OSError, KeyError, TypeError, ValueError):
        return None


def load_table(path: Path) -> tuple[list[str], list[dict[str, str]]]:
    """Load a CSV table of the report beside its results.json: its columns, and its rows by column.

    Raises StoreError if the file cannot be read or is not the one that results.json vouches for.
    """
    content = load_results_json(path.parent)
    try:
        text = read_vouched(path, content).decode("utf-8")
        reader = csv.DictReader(io.StringIO(text, newline=""), strict=True)
        rows = list(reader)
        return list(reader.fieldnames or ()), rows
    except (OSError, ValueError, csv.Error) as error:
        raise StoreError(str(path), f"cannot be read ({error})", REMEDY) from error


def _load_reported(folder: Path) -> StoredResults:
    content = load_results_json(folder)
    with as_incomplete(folder / "results.json"):
        runs = {(one["method"], one["sequence"], one["seed"]): _entry_run(folder, one) for one in content["runs"]}
        defaults = {
            label: {setting["name"]: setting["default"] for setting in card.get("settings", ())}
            for label, card in content["sequences"].items()
        }
        processor = str(content["environment"].get("processor", ""))
    return StoredResults(str(folder), runs, processor, defaults=defaults)


def _entry_run(folder: Path, entry: Mapping[str, Any]) -> StoredRun:
    given = entry["dataset_parameters"]
    own = folder / "runs" / Path(str(entry["key"])).name  # stays inside the folder, whatever the file says
    return StoredRun(
        entry["status"], entry["reason"], _data_parameters(given), _score_values(entry["scores"]), *_load_errors(own),
        entry["key"], _parse_conditions(entry["conditions"]), parse_lost(entry), NUISANCE in given,
        _score_supports(entry["scores"]),
    )  # fmt: skip


def _data_parameters(given: Mapping[str, Any]) -> dict[str, Any]:
    """Return what makes runs comparable: all parameters but the number of the repetition; 0 scans: the whole."""
    kept = {name: value for name, value in given.items() if name not in ("seed", NUISANCE)}
    return {EXCERPT: 0, **kept} if NUISANCE in given else kept


def _parse_conditions(values: Mapping[str, Any] | None) -> RunConditions:
    """Return the stored conditions of a run, unknown ones if there are none. Raises TypeError or ValueError."""
    return RunConditions(**{name: value for name, value in (values or {}).items() if name != DISTURBED})


def _load_unreported(folder: Path) -> StoredResults:
    """Load the newest run of each method, sequence and seed."""
    runs: dict[RunName, tuple[str, StoredRun]] = {}
    unfinished, processor = 0, ""
    for own in sorted((folder / "runs").glob("*")):
        if not (own / RESULT).exists():
            unfinished += 1
            continue
        try:
            result = read_sealed(own / RESULT)
            scored = read_sealed(own / SCORES) if (own / SCORES).exists() else {"scores": {}, "lost_at_s": None}
            provenance, given = result["provenance"], result["dataset_parameters"]
            when, processor = str(provenance.get("executed_at", "")), str(provenance.get("processor", processor))
            name = _parse_name(result["method"], result["sequence"], given.get("seed", given.get(NUISANCE)))
            errors = _load_errors(own)
            conditions = _parse_conditions(result.get("conditions"))
            run = StoredRun(
                result["status"], result["reason"], _data_parameters(given), _score_values(scored["scores"]), *errors,
                own.name, conditions, parse_lost(scored), NUISANCE in given, _score_supports(scored["scores"]),
            )  # fmt: skip
        except (OSError, KeyError, TypeError, ValueError, AttributeError) as error:
            raise StoreError(str(own), f"is not complete ({error!r})", "repeat the run") from error
        if name not in runs or runs[name][0] <= when:
            runs[name] = when, run
    return StoredResults(str(folder), {name: run for name, (_, run) in runs.items()}, processor, unfinished)


def _parse_name(method: object, sequence: object, seed: object) -> RunName:
    """Return the name of a run; raises TypeError for values that are none."""
    if not isinstance(method, str) or not isinstance(sequence, str) or not (seed is None or type(seed) is int):
        raise TypeError(
            f"method {brief(method)}, sequence {brief(sequence)}, seed {brief(seed)}: not the name of a run"
        )
    return method, sequence, seed


def _score_values(scores: Mapping[str, Mapping[str, Any]]) -> dict[str, float]:
    return {name: score["value"] for name, score in scores.items() if score["value"] is not None}


def _score_supports(scores: Mapping[str, Mapping[str, Any]]) -> dict[str, int]:
    return {name: score["support"] for name, score in scores.items() if score["value"] is not None}


def _load_errors(own: Path) -> tuple[Ints, Floats]:
    """Return stamps and distances to the ground truth of a run; empty if not stored or damaged."""
    try:
        result, scores = read_sealed(own / RESULT), read_sealed(own / SCORES)
        steps = whole_records(read_vouched(own / STEPS, result))
        errors = untrusted_io.parse_floats(read_vouched(own / ERRORS, scores), 1)
    except (OSError, ValueError):  # the score remains, without an interval
        return np.zeros(0, dtype=np.int64), np.zeros(0)
    if len(steps) != len(errors) or count_sound(steps) < len(steps):
        return np.zeros(0, dtype=np.int64), np.zeros(0)
    known = np.isfinite(errors)
    return steps["stamp_ns"][known], errors[known]


def _load_object(path: Path) -> dict[str, Any]:
    try:
        content = untrusted_io.parse_json(untrusted_io.read_bytes(path))
    except (OSError, ValueError) as error:
        raise StoreError(str(path), f"cannot be read, perhaps half-written ({error})", REMEDY) from error
    if not isinstance(content, dict):
        raise StoreError(str(path), "holds no JSON object", REMEDY)
    return content
