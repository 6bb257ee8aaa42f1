"""What changed between two results folders, and whether it is worse by more than the noise and a stated limit."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from statistics import median
from typing import Any, Literal

import numpy as np

from evalkit.commands.diff.snapshot import Finished, Place, Snapshot
from evalkit.core.errors import StoreError
from evalkit.core.run_result import NOT_EXECUTED
from evalkit.metrics.table import Metric
from evalkit.report.analysis.cells import Apart, Cell, apart
from evalkit.report.analysis.standings import DECIDING, noise_floor
from evalkit.stats.bootstrap import BootstrapDraws, Series, bootstrap_score

Said = Literal["regression", "improvement", "within the limit", "no difference shown", "unchanged", "not comparable"]

TIME = "cpu_median_ms"
TICK_MS = 0.01

MIN_FOR_SESSION = 3
NAMED_SESSION = 0.03

ONE_RUN = 2.0
"""Times the limit: one run's CPU time holds the noise of its session, and nothing else tells how large that is."""


@dataclass(frozen=True, slots=True)
class Limits:
    """By how much more (a share) an error or a CPU time is still no regression."""

    error: float = 0.05
    time: float = 0.10


@dataclass(frozen=True, slots=True)
class Change:
    """One metric of one method over one sequence, before and after: medians over the runs both folders have.

    ``low``, ``high``: bounds of the 95 % interval of the difference new - old, None where there is none; ``why`` says
    what decided.
    """

    method: str
    sequence: str
    metric: str
    unit: str
    old: float
    new: float
    low: float | None
    high: float | None
    runs: int
    said: Said
    why: str


@dataclass(frozen=True, slots=True)
class Ended:
    """A run that ended otherwise than before."""

    method: str
    sequence: str
    seed: int | None
    old: str
    new: str
    reason: str
    said: Said


@dataclass(frozen=True, slots=True)
class Difference:
    """All that changed. ``only_old``, ``only_new``: "method over sequence" that one folder alone has.

    ``apart``: what cannot be compared, and why. ``notes``: what to bear in mind.
    """

    old: str
    new: str
    limits: Limits
    ended: tuple[Ended, ...]
    changes: tuple[Change, ...]
    only_old: tuple[str, ...]
    only_new: tuple[str, ...]
    apart: tuple[str, ...]
    notes: tuple[str, ...]

    @property
    def regressions(self) -> int:
        """How many changes and ends are regressions."""
        told = [one.said for one in self.ended] + [one.said for one in self.changes]
        return told.count("regression")

    def as_json(self) -> dict[str, Any]:
        """All of it in plain values."""
        return {"regressions": self.regressions, **asdict(self)}


def difference(old: Snapshot, new: Snapshot, metrics: Sequence[Metric], limits: Limits) -> Difference:
    """What changed from one folder to another, over the runs both have.

    StoreError where they have nothing in common that could be compared.
    """
    pairs = {(who, where): None for who, where, _ in (*old.runs, *new.runs)}
    held = [{(who, where) for who, where, _ in one.runs} for one in (old, new)]
    common = [pair for pair in pairs if pair in held[0] and pair in held[1]]
    reasons = {pair: reason for pair in common if (reason := _incomparable(old, new, pair))}
    comparable = [pair for pair in common if pair not in reasons]
    if not comparable:
        why = "; ".join(dict.fromkeys(reasons.values())) or "no method ran over the same sequence in both"
        raise StoreError(new.folder, f"not comparable with {old.folder}: {why}", "compare results of one experiment")
    session = _session(old, new, comparable)
    return Difference(
        old.folder,
        new.folder,
        limits,
        tuple(one for pair in comparable for one in _ends(old, new, pair)),
        tuple(one for pair in comparable for one in _changes(old, new, pair, metrics, limits, session)),
        tuple(f"{who} over {where}" for who, where in pairs if (who, where) not in held[1]),
        tuple(f"{who} over {where}" for who, where in pairs if (who, where) not in held[0]),
        tuple(_grouped(reasons)),
        tuple(_notes(old, new, session)),
    )


def _session(old: Snapshot, new: Snapshot, comparable: Sequence[tuple[str, str]]) -> float:
    """By what the CPU times of all methods changed together (a factor): that is the machine, not one of them.

    The median over the methods; 1 for fewer than three, among whom nobody can tell.
    """
    ratios: dict[str, list[float]] = {}
    for pair in comparable:
        before, after = _runs(old, pair), _runs(new, pair)
        for place in before:
            times = [runs[place].scores.get(TIME, 0.0) for runs in (before, after) if place in runs]
            if len(times) == 2 and min(times) > TICK_MS:
                ratios.setdefault(pair[0], []).append(times[1] / times[0])
    return median(median(own) for own in ratios.values()) if len(ratios) >= MIN_FOR_SESSION else 1.0


def _grouped(reasons: Mapping[tuple[str, str], str]) -> Iterator[str]:
    """What cannot be compared, methods with one reason on one sequence together."""
    together: dict[tuple[str, str], list[str]] = {}
    for (who, where), why in reasons.items():
        together.setdefault((where, why), []).append(who)
    for (where, why), whose in together.items():
        yield f"{where}: not comparable: {why} ({', '.join(whose)})"


def _incomparable(old: Snapshot, new: Snapshot, pair: tuple[str, str]) -> str:
    """Why the runs of a pair are not of the same sequence, "" where they are."""
    before, after = _runs(old, pair), _runs(new, pair)
    seeds = [place[2] for place in before if place in after]
    if not seeds:
        return f"seeds {_listed(before)} against {_listed(after)}"
    one, other = before[(*pair, seeds[0])].parameters, after[(*pair, seeds[0])].parameters
    defaults = {**old.defaults.get(pair[1], {}), **new.defaults.get(pair[1], {})}
    values = {
        name: (_value(name, one, defaults, other), _value(name, other, defaults, one)) for name in {**one, **other}
    }
    told = [f"{name} {ours} against {theirs}" for name, (ours, theirs) in values.items() if ours != theirs]
    return f"the sequence differs: {', '.join(told)}" if told else ""


def _value(name: str, own: Mapping[str, Any], defaults: Mapping[str, Any], other: Mapping[str, Any]) -> Any:
    """A parameter's value; one that a version did not know yet was at what is its default now, if anybody tells."""
    return own[name] if name in own else defaults.get(name, other[name])


def _ends(old: Snapshot, new: Snapshot, pair: tuple[str, str]) -> Iterator[Ended]:
    before, after = _runs(old, pair), _runs(new, pair)
    for place, run in after.items():
        if place in before and before[place].status != run.status:
            said: Said = "not comparable"
            if run.status == "complete":
                said = "improvement"
            elif before[place].status == "complete":
                said = "regression"
            yield Ended(*place, before[place].status, run.status, run.reason, said)


def _changes(
    old: Snapshot,
    new: Snapshot,
    pair: tuple[str, str],
    metrics: Sequence[Metric],
    limits: Limits,
    session: float,
) -> Iterator[Change]:
    """Every headline metric of the estimate's quality, and the CPU time."""
    before, after = _runs(old, pair), _runs(new, pair)
    both = [place for place in before if place in after and before[place].status == after[place].status == "complete"]
    for metric in metrics:
        if metric.headline and metric.better and (metric.group in DECIDING or metric.name == TIME):
            scored = [p for p in both if metric.name in before[p].scores and metric.name in after[p].scores]
            if scored:
                runs = [(place, before[place], after[place]) for place in scored]
                yield _change(pair, metric, runs, limits, session if _same_machine(old, new) else None)


def _change(
    pair: tuple[str, str],
    metric: Metric,
    runs: Sequence[tuple[Place, Finished, Finished]],
    limits: Limits,
    session: float | None,
) -> Change:
    """One metric before and after. ``session``: what all CPU times changed by, None for another machine's."""
    pairs = [_cells(metric.name, *run) for run in runs]
    before, after = _cell(pair[0], [one for one, _ in pairs]), _cell(pair[0], [other for _, other in pairs])
    found = None if metric.name == TIME else apart(after, before)  # no interval within a session knows another one
    said, why = (
        _timed(before, after, limits, session) if metric.name == TIME else _said(metric, before, after, found, limits)
    )
    low, high = (found.interval.low, found.interval.high) if found else (None, None)
    medians = median(before.values), median(after.values)
    return Change(*pair, metric.name, metric.unit, *medians, low, high, len(runs), said, why)


def _said(metric: Metric, old: Cell, new: Cell, found: Apart | None, limits: Limits) -> tuple[Said, str]:
    if old.values == new.values:
        return "unchanged", "the same to the last digit"
    before, after = median(old.values), median(new.values)
    if abs(after - before) <= max(limits.error * abs(before), noise_floor(metric)):
        return "within the limit", f"at most {100 * limits.error:g} %, or less than the truth can tell"
    if found is not None and not found.interval.excludes(0.0):
        return "no difference shown", "the 95 % interval of the difference holds zero"
    worse = after > before if metric.better == "lower" else after < before
    noise = "beyond the noise" if found is not None else "of one run, whose noise is not known"
    return ("regression" if worse else "improvement"), f"more than {100 * limits.error:g} %, {noise}"


def _timed(old: Cell, new: Cell, limits: Limits, session: float | None) -> tuple[Said, str]:
    """Of CPU times: the ratio, by what all changed together, in every run beyond the limit or not."""
    if session is None:
        return "not comparable", "another processor"
    if old.values == new.values:
        return "unchanged", "the same to the last digit"
    expected = [session * value for value in old.values]
    before, after = median(expected), median(new.values)
    limit = limits.time * (ONE_RUN if len(old.values) == 1 else 1.0)
    if abs(after - before) <= max(limit * before, TICK_MS):
        return "within the limit", f"at most {100 * limit:g} % beside all others"
    if min(new.values) < before < max(new.values) or min(expected) < after < max(expected):
        return "no difference shown", "the runs before and after overlap"
    return ("regression" if after > before else "improvement"), f"more than {100 * limit:g} % beside all others"


def _cells(metric: str, place: Place, old: Finished, new: Finished) -> tuple[Cell, Cell]:
    """One run before and after, drawn from the same stretches where both kept what the score was made of."""
    one, other = _drawn(metric, old, new), _drawn(metric, new, old)
    if one is None or other is None:
        one = other = None
    return _run(place, old.scores[metric], one), _run(place, new.scores[metric], other)


def _run(place: Place, score: float, draws: BootstrapDraws | None) -> Cell:
    return Cell(place[0], (score,), (), 1, 1, 0, "", (place[2],), drawn=(draws,))


def _drawn(metric: str, own: Finished, beside: Finished) -> BootstrapDraws | None:
    """The draws of a run over the scans that both have."""
    series, other = own.series.get(metric), beside.series.get(metric)
    if series is None or other is None:
        return None
    kept = np.isin(series.keys, other.keys)
    shared = Series(series.keys[kept], series.values[kept], series.statistic, series.period_s)
    return bootstrap_score(shared, own.scores[metric], np.random.default_rng(0))


def _cell(method: str, cells: Sequence[Cell]) -> Cell:
    """The cells of single runs as one."""
    return Cell(
        method,
        tuple(value for cell in cells for value in cell.values),
        (),
        len(cells),
        len(cells),
        0,
        "",
        tuple(seed for cell in cells for seed in cell.seeds),
        drawn=tuple(cell.drawn[0] for cell in cells),
    )


def _same_machine(old: Snapshot, new: Snapshot) -> bool:
    return not old.made_on or not new.made_on or old.made_on == new.made_on


def _notes(old: Snapshot, new: Snapshot, session: float) -> Iterator[str]:
    if not _same_machine(old, new):
        yield f"times are not compared: {old.made_on} against {new.made_on}"
    elif abs(session - 1.0) > NAMED_SESSION:
        yield (
            f"all methods together took {100.0 * (session - 1.0):+.0f} % CPU time: taken for the machine's, so a "
            "change that all have alike is not seen"
        ).replace("-", "\u2212")
    for one in (old, new):
        if one.unfinished:
            yield f"{one.folder}: {one.unfinished} runs were begun and did not end; they are left out"
        missing = sum(run.status in NOT_EXECUTED for run in one.runs.values())
        if missing:
            yield f"{one.folder}: {missing} runs could not be made there"


def _runs(snapshot: Snapshot, pair: tuple[str, str]) -> dict[Place, Finished]:
    return {place: run for place, run in snapshot.runs.items() if place[:2] == pair}


def _listed(runs: dict[Place, Finished]) -> str:
    return ", ".join("none" if seed is None else str(seed) for *_, seed in runs)
