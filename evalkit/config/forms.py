"""The keys of experiment, study and tuning files, declared once: type, meaning, default and bounds of each.

The readers take them from here (``toml_tables``), as do the search for all mistakes of a file (``mistakes``) and its
JSON Schema (``json_schema``).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Literal

from evalkit.config.limits import Limits
from evalkit.plugins.parameters import ALIGN_TRUTH, EXCERPT, MAP, MAP_START, NUISANCE

FileKind = Literal["experiment", "study", "tuning"]
Type = Literal["text", "texts", "flag", "whole", "wholes", "number", "positive", "table", "tables", "any"]
"""``wholes``: a list of whole numbers from 0. ``positive``: a number above 0. ``table``, ``tables``: [KEY], [[KEY]]."""

MAX_WHOLES = 1000
"""Numbers of one list: more seeds would take minutes to list, before the first run."""

MAX_POINTS = 5000
"""Points of one design or of the search of one method: more fill the memory, or take months to run."""

Plugins = Literal["", "backends", "datasets", "mappers"]


@dataclass(frozen=True, slots=True)
class Key:
    """A key of a table. ``default``: its value where it is absent, None if there is none.

    ``low``, ``high``: its bounds.
    ``form``: the keys of the table that it holds, None: any.
    """

    type: Type
    meaning: str = ""
    default: Any = None
    low: float | None = None
    required: bool = False
    form: Form | None = None
    high: int | None = None


@dataclass(frozen=True, slots=True)
class Form:
    """The keys of a table by name. ``plugins``: other keys are parameters of the plug-in of this kind in ``use``."""

    name: str = ""
    meaning: str = ""
    keys: Mapping[str, Key] = field(default_factory=dict)
    plugins: Plugins = ""

    def default(self, key: str) -> Any:
        """Return the default of a key."""
        return self.keys[key].default

    def extend(self, name: str, **keys: Key) -> Form:
        """Return a form with further keys."""
        return replace(self, name=name, keys={**self.keys, **keys})


OPEN = Form()
"""A table of any keys."""

LABEL = Key("text", "its name in the report")

METHOD = Form("MethodTable", "A method: a back end and its parameters.", {
    "use": Key("text", "a back end, 'module:SPEC', 'lib:FILE', 'exec:COMMAND' or 'file:POSES'", required=True),
    "label": LABEL,
    "tuned_on": Key("texts", "data sets that its parameters were chosen on"),
}, "backends")  # fmt: skip

REPEATS = {
    NUISANCE: Key("whole", "number of small perturbations of a recording", 0, 0),
    EXCERPT: Key("whole", "scans of each perturbation; 0: all", 0, 0),
}

SEQUENCE = Form("SequenceTable", "A sequence: a data set or a reader, and its parameters.", {
    "use": Key("text", "a data set, or the reader of a recording", required=True),
    "label": LABEL,
    "seeds": Key("wholes", "one simulated drive each", [0]),
    **REPEATS,
    MAP: Key("text", "a known map (map_server YAML) that every method tracks the robot in", ""),
    MAP_START: Key("text", "where the robot starts in the known map: 'x,y,yaw' in m, m, deg", ""),
    ALIGN_TRUTH: Key("flag", "the ground truth is in another frame than the known map", False),
}, "datasets")  # fmt: skip

MAPPER = Form("MapperTable", "The mapper and its parameters.", {
    "use": Key("text", "a mapper"),
    "scans": Key("whole", "scans of a map, at most", 400, 2),
}, "mappers")  # fmt: skip

LIMITS = Form("LimitsTable", "Limits of one run.", {
    "run_s": Key("positive", "s", Limits.run_s),
    "scan_s": Key("positive", "s without an answer", Limits.scan_s),
    "run_cpu_s": Key("positive", "s of CPU time", Limits.run_cpu_s),
    "scan_cpu_s": Key("positive", "s of CPU time without an answer", Limits.scan_cpu_s),
    "memory_mib": Key("positive", "MiB", Limits.memory_mib),
})  # fmt: skip

TEXTS = {"title": Key("text"), "description": Key("text", default="")}

EXPERIMENT = Form("ExperimentFile", "An experiment: methods on sequences (``evalkit compare FILE``).", {
    **TEXTS,
    "timed": Key("flag", "whether times count", True),
    **REPEATS,
    "mapper": Key("table", form=MAPPER),
    "limits": Key("table", form=LIMITS),
    "method": Key("tables", required=True, form=METHOD),
    "sequence": Key("tables", required=True, form=SEQUENCE),
})  # fmt: skip

RESPONSE = Form("ResponseTable", "A metric that a study explains.", {
    "metric": Key("text", "a metric", required=True),
    "scale": Key("text", "linear or log", "linear"),
    "lost": Key("number", "value of a run that failed"),
})  # fmt: skip

FACTOR = Form("FactorTable", "A factor: settings and their levels.", {
    "name": Key("text"),
    "sets": Key("any", "'method.NAME', 'sequence.NAME' or 'mapper.NAME', or a list of them"),
    "levels": Key("any", "a list of values, or a table of named settings", required=True),
    "scale": Key("text", "linear or log", "linear"),
    "unit": Key("text", default=""),
})  # fmt: skip

DESIGN = Form("DesignTable", "Points that a study runs.", {
    "name": Key("text"),
    "kind": Key("text", "kind of design", required=True),
    "factors": Key("texts", "names of factors", required=True),
    "points": Key("whole", "of an optimal, sobol or latin design", low=1, high=MAX_POINTS),
    "resolution": Key("whole", "of a fractional design", low=1),
    "seed": Key("whole", "of the points", 0, 0),
    "seeds": Key("wholes", "of the simulated drives", []),
    "deal": Key("flag", "one seed a point, in turn", False),
    "with": Key("table", "settings that it fixes"),
})  # fmt: skip

ENVELOPE = Form("EnvelopeTable", "Where a response stays below a limit, over two factors of a grid.", {
    **{name: Key("text", meaning, required=True) for name, meaning in (
        ("design", "a grid"), ("x", "a factor"), ("y", "another factor"), ("metric", "a response"))},
    "limit": Key("number", required=True),
})  # fmt: skip

STUDY = Form("StudyFile", "A study: factors, designs and responses (``evalkit study FILE``).", {
    **TEXTS,
    "seeds": Key("wholes", "of the simulated drives", [0]),
    "method": Key("table", required=True, form=METHOD),
    "sequence": Key("table", required=True, form=SEQUENCE),
    "mapper": Key("table", form=MAPPER),
    "limits": Key("table", form=replace(LIMITS, name="StudyLimitsTable", keys={"run_s": LIMITS.keys["run_s"]})),
    "response": Key("tables", required=True, form=RESPONSE),
    "factor": Key("tables", required=True, form=FACTOR),
    "design": Key("tables", required=True, form=DESIGN),
    "envelope": Key("tables", form=ENVELOPE),
})  # fmt: skip

OBJECTIVE = Form("ObjectiveTable", "What a tuning minimises.", {
    "metric": Key("text", "an error of a trajectory", "ate_rmse_m"),
    "lost": Key("number", "value of a run that failed", 1.0, 1e-9),
})  # fmt: skip

TUNING = Form("TuningFile", "A tuning with equal budgets (``evalkit tune FILE``).", {
    **TEXTS,
    "points": Key("whole", "points that each method is tried at", 24, 2, high=MAX_POINTS),
    "seed": Key("whole", "of the points", 0, 0),
    "run_cpu_s": Key("number", "s of CPU time of a training run", 60.0, 1e-3),
    "objective": Key("table", form=OBJECTIVE),
    "mapper": Key("table", form=MAPPER),
    "limits": Key("table", form=LIMITS),
    "method": Key("tables", required=True, form=METHOD.extend(
        "TunedMethodTable", search=Key("table", "the parameters to search, and their levels"))),
    "training": Key("tables", required=True, form=SEQUENCE.extend(
        "TrainingTable", confirm=Key("wholes", "the seeds that confirm the best settings", []))),
    "held-out": Key("tables", required=True, form=SEQUENCE),
})  # fmt: skip

FORMS: Mapping[FileKind, Form] = {"experiment": EXPERIMENT, "study": STUDY, "tuning": TUNING}
