"""Results of a comparison in Python: tables, trajectories, maps, figures and the page of a results folder."""

from __future__ import annotations

import html
import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from io import BytesIO
from numbers import Real
from pathlib import Path
from typing import TYPE_CHECKING, Any

from evalkit.core.errors import BadParameter, StoreError, UnknownName
from evalkit.core.grid import OccupancyGrid
from evalkit.core.ground_truth import Truth
from evalkit.core.loop_closure import LoopClosure
from evalkit.core.trajectory import Trajectory
from evalkit.io.output_files import write_bytes
from evalkit.io.untrusted_io import read_bytes
from evalkit.results.reader import REMEDY, load_results_json, load_run
from evalkit.results.run_record import RunRecord
from evalkit.results.seal import read_vouched

if TYPE_CHECKING:
    import pandas as pd

    from evalkit.api.plots import Plots

PAGE = "index.html"


@dataclass(frozen=True, eq=False)
class ComparisonResults:
    """The results of a comparison, read from its folder when asked for.

    ``folder``: the results folder. ``content``: its results.json.
    """

    folder: Path
    content: Mapping[str, Any]

    @classmethod
    def load(cls, folder: Path) -> ComparisonResults:
        """Load a results folder. Raises StoreError if it holds no report, or one of another version."""
        return cls(folder, load_results_json(folder))

    def __repr__(self) -> str:
        """Return one line: folder, runs and methods."""
        count = len(self.content["runs"])
        shown = f"{count} run{'s' * (count != 1)} of {', '.join(self.methods) or 'no method'}"
        return f"ComparisonResults({str(self.folder)!r}: {shown})"

    @property
    def methods(self) -> tuple[str, ...]:
        """The labels of the methods that have runs, in the order of the experiment."""
        present = {run["method"] for run in self.content["runs"]}
        return tuple(label for label in self.content["methods"] if label in present)

    @property
    def sequences(self) -> tuple[str, ...]:
        """The labels of the sequences that have runs, in the order of the experiment."""
        present = {run["sequence"] for run in self.content["runs"]}
        return tuple(label for label in self.content["sequences"] if label in present)

    @property
    def units(self) -> dict[str, str]:
        """The unit of every metric, "" for a plain number."""
        return {metric["name"]: metric["unit"] for metric in self.content["metrics"]}

    def summary(self) -> pd.DataFrame:
        """Return one row per sequence, method and metric: median, 95 % interval, rank; units in ``attrs["units"]``."""
        return self._table("summary")

    def scores(self) -> pd.DataFrame:
        """Return one row per run: names, status, and a column per metric; units in ``attrs["units"]``."""
        return self._table("runs")

    def trajectory(
        self, method: str, sequence: str | None = None, seed: int | None = None, aligned: bool = False,
        final: bool = False,
    ) -> Trajectory:  # fmt: skip
        """Return the estimated trajectory of a run: ``start_from_base``, m and rad.

        ``sequence``, ``seed``: needed only where there are several; the lowest seed if not given. ``aligned``: in the
        frame of the ground truth instead, by the alignment of the report. ``final``: the corrected poses of a SLAM
        instead of its answers. Raises UnknownName, or StoreError where the run has none.
        """
        run = self._load(method, sequence, seed)
        if not final:
            return run.result.estimate.moved(run.scores.world_from_start, "world") if aligned else run.result.estimate
        if run.result.final is None or run.scores.final is None:
            raise StoreError(run.key, "this run has no corrected poses", "only a complete run of a SLAM has them")
        corrected = run.result.final
        return corrected.moved(run.scores.final.world_from_start, "world") if aligned else corrected

    def loop_closures(
        self, method: str, sequence: str | None = None, seed: int | None = None
    ) -> tuple[LoopClosure, ...]:
        """Return the loop closures of a run, rejected candidates included; () for a method without any."""
        return self._load(method, sequence, seed).result.loop_closures

    def map(self, method: str, sequence: str | None = None, seed: int | None = None) -> OccupancyGrid:
        """Return the map drawn from a run's trajectory, see ``trajectory``. Raises StoreError if it has none."""
        run = self._load(method, sequence, seed)
        if run.scores.grid is None:
            raise StoreError(run.key, "this run has no map", f"it ended with status {run.result.status}")
        return run.scores.grid

    @cached_property
    def plot(self) -> Plots:
        """Figures: ``plot.dots()``, ``plot.maps()``, ``plot.error_time()``."""
        from evalkit.api.plots import Plots  # noqa: PLC0415 - loads matplotlib

        return Plots(self)

    def require(
        self, metric: str, method: str, *, below: float | None = None, above: float | None = None,
        sequence: str | None = None,
    ) -> None:  # fmt: skip
        """Require that every run of a method over a sequence has a metric within limits, in the metric's unit.

        Without limits, every run must have a value. Raises AssertionError with every run beyond the limits or without
        a value; UnknownName for unknown names, BadParameter for a limit that is no number.
        """
        chosen = self._sequence(sequence)
        given: dict[str, object] = {"below": below, "above": above}
        for name, limit in given.items():
            if limit is not None and (not isinstance(limit, Real) or math.isnan(limit)):
                raise BadParameter("require", name, limit, f"a number in the unit of {metric}")
        if metric not in self.units:
            raise UnknownName("metric", metric, self.units)
        if method not in self.methods:
            raise UnknownName("method", method, self.methods)
        beyond = []
        for run in self.content["runs"]:
            if (run["method"], run["sequence"]) != (method, chosen):
                continue
            score = run["scores"].get(metric, {"value": None, "reason": f"{run['status']} {run['reason']}".strip()})
            value = score["value"]
            if value is None:
                beyond.append(f"{run['key']}: no value ({score['reason']})")
            elif (below is not None and not value < below) or (above is not None and not value > above):
                beyond.append(f"{run['key']}: {value:.6g} {self.units[metric]}".rstrip())
        if beyond:
            limits = [f"{word} {limit:g}" for word, limit in (("below", below), ("above", above)) if limit is not None]
            expected = f"{metric} of {method} {' and '.join(limits) or 'with a value'} {self.units[metric]}".rstrip()
            raise AssertionError("\n  ".join([f"expected {expected}, found", *beyond, f"report: {self.to_html()}"]))

    def to_html(self, path: str | Path | None = None) -> Path:
        """Return the report's page, a single offline file; with a path, a copy there.

        A page that is a symbolic link is not copied: a received folder could lead to any file.
        """
        page = self.folder / PAGE
        if path is None:
            return page
        try:
            content = read_bytes(page)
        except (OSError, ValueError) as error:
            raise StoreError(str(page), f"cannot be copied ({error})", REMEDY) from error
        write_bytes(Path(path), content)
        return Path(path)

    def _repr_html_(self) -> str:
        """Return title, page and the table of the deciding metrics, for a notebook."""
        parts = [f"<p><strong>{html.escape(str(self.content['title']))}</strong><br>"]
        parts.append(f'<a href="{html.escape((self.folder / PAGE).as_posix(), quote=True)}">report</a></p>')
        parts += [f"<p>{html.escape(' '.join(one['sentences']))}</p>" for one in self.content["verdicts"]]
        return "".join(parts)

    def runs(self, sequence: str | None = None) -> tuple[RunRecord, ...]:
        """Return the run of each method at the lowest seed of a sequence, of those that answered a scan."""
        chosen = self._sequence(sequence)
        entries: dict[str, Mapping[str, Any]] = {}
        for entry in sorted(self.content["runs"], key=lambda run: run["seed"] or 0):
            if entry["sequence"] == chosen and entry["scans_answered"]:
                entries.setdefault(entry["method"], entry)
        return tuple(load_run(self.folder, entries[label], _NO_TRUTH) for label in self.methods if label in entries)

    def _table(self, name: str) -> pd.DataFrame:
        import pandas as pd  # noqa: PLC0415 - slow to load

        path = self.folder / f"{name}.csv"
        try:
            table = pd.read_csv(BytesIO(read_vouched(path, self.content)), keep_default_na=False, na_values=[""])
        except (OSError, ValueError) as error:
            raise StoreError(str(path), f"cannot be read ({error})", REMEDY) from error
        table.attrs["units"] = self.units
        return table

    def _sequence(self, sequence: str | None) -> str:
        if sequence is None and len(self.sequences) == 1:
            return self.sequences[0]
        if sequence not in self.sequences:
            raise UnknownName("sequence", sequence or "", self.sequences)
        return sequence

    def _load(self, method: str, sequence: str | None, seed: int | None) -> RunRecord:
        """Load one run; the lowest seed if none is given."""
        chosen = self._sequence(sequence)
        if method not in self.methods:
            raise UnknownName("method", method, self.methods)
        runs = [run for run in self.content["runs"] if (run["method"], run["sequence"]) == (method, chosen)]
        fitting = sorted((run for run in runs if seed in (None, run["seed"])), key=lambda run: run["seed"] or 0)
        if not fitting:
            raise UnknownName("seed", str(seed), [str(run["seed"]) for run in runs])
        if not fitting[0]["scans_answered"]:
            raise StoreError(fitting[0]["key"], f"this run has no result ({fitting[0]['reason']})", "run it again")
        return load_run(self.folder, fitting[0], _NO_TRUTH)


_NO_TRUTH = Truth("not loaded")
