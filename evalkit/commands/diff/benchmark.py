"""Benchmark files: all samples of each quantity that a benchmark script measured, with the machine it ran on."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from itertools import chain
from pathlib import Path
from statistics import median, quantiles
from typing import Any

from evalkit.core.errors import BadData
from evalkit.execution import environment
from evalkit.io import untrusted_io
from evalkit.io.json_values import indent_json
from evalkit.io.output_files import write_text
from evalkit.plugins import registry

FOLDER = Path("reports") / "build" / "bench"
SCHEMA = 3


@dataclass(frozen=True)
class BenchmarkSeries:
    """The samples of one quantity, of which less is better. ``unit``: for example "ms", "us", "bytes per scan"."""

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
        """The median of the samples."""
        return median(self.samples)

    @property
    def quartiles(self) -> tuple[float, float]:
        """The lower and the upper quartile of the samples."""
        if len(self.samples) == 1:
            return self.samples[0], self.samples[0]
        low, _, high = quantiles(self.samples, n=4, method="inclusive")
        return low, high


@dataclass(frozen=True)
class Benchmark:
    """Everything one benchmark script measured. ``written``: when, ISO 8601."""

    name: str
    series: tuple[BenchmarkSeries, ...]
    environment: Mapping[str, str] = field(default_factory=dict)
    written: str = ""

    @property
    def processor(self) -> str:
        """The processor of the machine, "" if the file does not name it."""
        return self.environment.get("processor", "")


def write_benchmark(
    name: str, series: Sequence[BenchmarkSeries], ran_on: Mapping[str, str], folder: Path = FOLDER
) -> Path:
    """Write samples, medians, quartiles, the environment (read before measuring) and the load now; return the path."""
    after = {"load after": environment.load_average()}
    measured = [{**asdict(one), "median": one.median, "quartiles": one.quartiles} for one in series]
    content = {
        "schema": SCHEMA,
        "name": name,
        "written": datetime.now(UTC).isoformat(),
        "environment": {**ran_on, **after},
    }
    path = folder / f"{name}.json"
    write_text(path, indent_json({**content, "series": measured}), folder)
    return path


def describe_environment() -> dict[str, str]:
    """Return machine, commit and versions of the back ends' libraries; call it before the measurement."""
    required = (registry.find_backend(name).requires for name in registry.names("backends"))
    return environment.describe(dict.fromkeys(("numpy", "scipy", *chain.from_iterable(required))))


def load_benchmarks(path: Path) -> dict[str, Benchmark]:
    """Load the benchmarks of a file, or of all files of a folder, by name.

    Raises BadData if there is none, if a file is no benchmark, or if two files hold the same benchmark.
    """
    files = sorted(path.glob("*.json")) if path.is_dir() else [path]
    if not files:
        raise BadData(str(path), "", "no benchmark (*.json) in it", "write one with 'make bench'")
    loaded = [_load(file) for file in files]
    by_name = {one.name: one for one in loaded}
    if len(by_name) < len(loaded):
        names = ", ".join(sorted(name for name in by_name if [one.name for one in loaded].count(name) > 1))
        raise BadData(
            str(path), "", f"several files in it hold the benchmark {names}", "keep one of them, or give a file"
        )
    return by_name


def _load(path: Path) -> Benchmark:
    try:
        content: Any = untrusted_io.parse_json(untrusted_io.read_bytes(path.resolve()))
    except OSError as error:
        raise BadData(str(path), "", f"cannot be read ({error.strerror})", "give a file of 'make bench'") from None
    except ValueError as error:
        raise BadData(str(path), "", f"no JSON: {error}", "give a file of 'make bench'") from None
    schema = content.get("schema") if isinstance(content, dict) else None
    if schema != SCHEMA:
        raise BadData(str(path), "'schema'", f"{schema!r}, expected {SCHEMA}", "measure again with this version")
    try:
        series = tuple(
            BenchmarkSeries(str(one["name"]), str(one["unit"]), tuple(map(float, one["samples"])))
            for one in content["series"]
        )
        ran_on = {str(name): str(value) for name, value in content["environment"].items()}
        return Benchmark(str(content["name"]), series, ran_on, str(content["written"]))
    except (ArithmeticError, AttributeError, KeyError, TypeError, ValueError) as error:
        raise BadData(str(path), "", f"no benchmark ({error!r})", "give a file of 'make bench'") from None
