"""What a benchmark measured, every sample of it, as a file that a later one can be held against."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from statistics import median
from typing import Any

from evalkit.core.errors import BadData
from evalkit.execution import environment

FOLDER = Path("reports") / "build" / "bench"
SCHEMA = 1


@dataclass(frozen=True)
class Series:
    """One thing measured again and again: less is better. ``unit``: "ms", "us", "bytes per scan"."""

    name: str
    unit: str
    samples: tuple[float, ...]

    def __post_init__(self) -> None:
        if not self.samples:
            raise ValueError(f"samples: '{self.name}' has none")
        if not all(math.isfinite(sample) for sample in self.samples):
            raise ValueError(f"samples: '{self.name}' has one that is not finite")

    @property
    def median(self) -> float:
        """The middle of the samples."""
        return median(self.samples)


@dataclass(frozen=True)
class Benchmark:
    """All that one script measured, and where. ``made``: ISO 8601."""

    name: str
    series: tuple[Series, ...]
    environment: Mapping[str, str] = field(default_factory=dict)
    made: str = ""

    @property
    def processor(self) -> str:
        """The processor it ran on, "" where untold."""
        return self.environment.get("processor", "")


def keep(name: str, series: Sequence[Series], ran_on: Mapping[str, str], folder: Path = FOLDER) -> Path:
    """The path of the file written: what was measured, its medians, and what it ran on (asked before it began)."""
    measured = [{**asdict(one), "median": one.median} for one in series]
    content = {"schema": SCHEMA, "name": name, "made": datetime.now(UTC).isoformat(), "environment": dict(ran_on)}
    path = folder / f"{name}.json"
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(path.name + ".part")
    partial.write_text(json.dumps({**content, "series": measured}, indent=1) + "\n", encoding="utf-8")
    partial.replace(path)
    return path


def before() -> dict[str, str]:
    """What the machine is and does before anything is measured: processor, governor, load, versions, commit."""
    return environment.describe(("numpy", "scipy", "open3d", "kiss-icp", "small-gicp", "rosbags"))


def is_benchmark(path: Path) -> bool:
    """Return whether a path is a benchmark's file, or a folder of files that is no results folder."""
    if not path.is_dir():
        return path.suffix == ".json"
    return not (path / "results.json").exists() and not (path / "runs").exists() and any(path.glob("*.json"))


def read(path: Path) -> dict[str, Benchmark]:
    """The benchmarks of a file, or of all files of a folder, by name; BadData where there is none."""
    files = sorted(path.glob("*.json")) if path.is_dir() else [path]
    if not files:
        raise BadData(str(path), "", "no benchmark (*.json) in it", "make one with 'make bench'")
    found = [_read(file) for file in files]
    by_name = {one.name: one for one in found}
    if len(by_name) < len(found):
        names = ", ".join(sorted(name for name in by_name if [one.name for one in found].count(name) > 1))
        raise BadData(
            str(path), "", f"several files in it hold the benchmark {names}", "keep one of them, or give a file"
        )
    return by_name


def _read(path: Path) -> Benchmark:
    try:
        content: Any = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise BadData(str(path), "", f"cannot be read ({error.strerror})", "give a file of 'make bench'") from None
    except (ValueError, RecursionError) as error:
        raise BadData(str(path), "", f"no JSON ({error})", "give a file of 'make bench'") from None
    schema = content.get("schema") if isinstance(content, dict) else None
    if schema != SCHEMA:
        raise BadData(str(path), "'schema'", f"{schema!r}, expected {SCHEMA}", "make it again with this version")
    try:
        series = tuple(
            Series(str(one["name"]), str(one["unit"]), tuple(map(float, one["samples"]))) for one in content["series"]
        )
        ran_on = {str(name): str(value) for name, value in content["environment"].items()}
        return Benchmark(str(content["name"]), series, ran_on, str(content["made"]))
    except (ArithmeticError, AttributeError, KeyError, TypeError, ValueError) as error:
        raise BadData(str(path), "", f"no benchmark ({error!r})", "give a file of 'make bench'") from None
