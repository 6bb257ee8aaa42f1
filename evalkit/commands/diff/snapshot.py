"""What a results folder holds, read back: how every run ended, its scores, and what these were made of."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from evalkit.core.errors import StoreError
from evalkit.io import untrusted_io
from evalkit.report.results_json import NAME, VERSION
from evalkit.results.store import RESULT, read_steps
from evalkit.stats.bootstrap import Series

AGAIN = "name a folder that `evalkit compare` has written"

Place = tuple[str, str, int | None]
"""Method, sequence and seed."""


@dataclass(frozen=True, eq=False)
class Finished:
    """One run as it was left. ``parameters`` of the sequence, without the seed. ``scores``: what has a value.

    ``series``: what a score was made of, for metrics whose values lie in the folder.
    """

    status: str
    reason: str
    parameters: Mapping[str, Any]
    scores: Mapping[str, float]
    series: Mapping[str, Series] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Snapshot:
    """A results folder. ``made_on``: the processor, "" where nobody knows. ``unfinished``: runs without an end.

    ``defaults``: of the sequences' parameters, by sequence, as far as the folder tells.
    """

    folder: str
    runs: Mapping[Place, Finished]
    made_on: str
    unfinished: int = 0
    defaults: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)


def read(folder: Path) -> Snapshot:
    """Read a results folder, with a report (results.json) or without (only runs).

    StoreError says what is missing, of another version or half-written.
    """
    if not folder.is_dir():
        raise StoreError(str(folder), "there is no such folder", AGAIN)
    path = folder / "results.json"
    found = _of_report(folder, _content(path)) if path.exists() else _of_runs(folder)
    if not found.runs:
        begun = f"{found.unfinished} runs were begun and none ended" if found.unfinished else "it holds no run"
        raise StoreError(str(folder), begun, AGAIN)
    return found


def _of_report(folder: Path, content: dict[str, Any]) -> Snapshot:
    schema = content.get("schema")
    if not isinstance(schema, dict) or (schema.get("name"), schema.get("version")) != (NAME, VERSION):
        told = f"{schema.get('name')} version {schema.get('version')}" if isinstance(schema, dict) else "of no schema"
        remedy = f"make the report again; this evalkit reads {NAME} version {VERSION}"
        raise StoreError(str(folder / "results.json"), f"its results are {told}", remedy)
    try:
        runs = {(t["method"], t["sequence"], t["seed"]): _finished(folder, t) for t in content["trials"]}
        defaults = {
            label: {setting["name"]: setting["default"] for setting in card.get("settings", ())}
            for label, card in content["sequences"].items()
        }
        return Snapshot(str(folder), runs, str(content["environment"].get("processor", "")), defaults=defaults)
    except (KeyError, TypeError, AttributeError) as error:
        raise StoreError(str(folder / "results.json"), f"is not whole ({error!r})", "make the report again") from error


def _finished(folder: Path, trial: Mapping[str, Any]) -> Finished:
    scores = {name: score["value"] for name, score in trial["scores"].items() if score["value"] is not None}
    parameters = {name: value for name, value in trial["dataset_parameters"].items() if name != "seed"}
    own = folder / "runs" / Path(str(trial["key"])).name  # a folder there, whatever the file says
    return Finished(trial["status"], trial["reason"], parameters, scores, _series(own))


def _of_runs(folder: Path) -> Snapshot:
    """The newest run of every place; a label is not told apart from another of the same name."""
    runs: dict[Place, tuple[str, Finished]] = {}
    unfinished, processor = 0, ""
    for own in sorted((folder / "runs").glob("*")):
        if not (own / RESULT).exists() or not (own / "request.json").exists():
            unfinished += 1
            continue
        result = _content(own / RESULT)
        provenance = result.get("provenance", {})
        when, processor = str(provenance.get("executed_at", "")), str(provenance.get("processor", processor))
        try:
            place, finished = _stored(own, result)
            if place not in runs or runs[place][0] <= when:
                runs[place] = when, finished
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise StoreError(str(own), f"is not whole ({error!r})", "make the run again") from error
    return Snapshot(str(folder), {place: run for place, (_, run) in runs.items()}, processor, unfinished)


def _stored(own: Path, result: Mapping[str, Any]) -> tuple[Place, Finished]:
    """Where a stored run belongs, and how it ended."""
    request = _content(own / "request.json")
    scored = _content(own / "scores.json")["scores"] if (own / "scores.json").exists() else {}
    parameters = dict(request.get("dataset_parameters", {}))
    place = (result["method"], result["sequence"], parameters.pop("seed", None))
    scores = {name: score["value"] for name, score in scored.items() if score["value"] is not None}
    return place, Finished(result["status"], result["reason"], parameters, scores, _series(own))


def _series(own: Path) -> dict[str, Series]:
    """The distances to the truth of a run, scan by scan, where they were kept."""
    if not (own / "errors.npy").exists():
        return {}
    steps = read_steps(own / "steps.bin")
    try:
        errors = untrusted_io.read_array(own / "errors.npy")
    except (OSError, ValueError):  # half-written: the score still stands, only without its interval
        return {}
    if len(steps) != len(errors) or len(steps) < 2:
        return {}
    known = np.isfinite(errors)
    stamps = steps["stamp_ns"][known]
    period_s = float(np.median(np.diff(stamps))) * 1e-9 if len(stamps) > 1 else 1.0
    return {"ate_rmse_m": Series(stamps, errors[known], "rms", period_s)}


def _content(path: Path) -> dict[str, Any]:
    try:
        content = untrusted_io.parse_json(path.read_bytes())
    except (OSError, ValueError) as error:
        raise StoreError(str(path), f"cannot be read, perhaps half-written ({error})", "make it again") from error
    if not isinstance(content, dict):
        raise StoreError(str(path), "holds no object", "make it again")
    return content
