"""``evalkit realtime``: the device factor from which a back end drops scans, and from which it loses track."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.table import Table

from evalkit.commands.realtime.virtual_clock import POLICIES, Policy, Rule, first_broken
from evalkit.core.errors import DataMissing
from evalkit.execution.task import Task, make_task
from evalkit.execution.task_runner import run_tasks
from evalkit.execution.task_store import TaskStore
from evalkit.odometry import frontend
from evalkit.plugins import defaults, registry
from evalkit.plugins.parameter_parsing import from_text
from evalkit.plugins.parameters import Value, resolve_parameters
from evalkit.terminal import options, progress
from evalkit.terminal.options import Json, err, out

if TYPE_CHECKING:
    from evalkit.commands.realtime.simulation import PacedResult

RULE = Rule()


def realtime(
    backend: options.Backend,
    on: Annotated[
        str,
        typer.Option(
            help="A data set with its parameters, 'NAME laps=0.3'.",
            show_default="a simulated data set",
            autocompletion=options.complete("datasets"),
        ),
    ] = "",
    setting: options.Settings = None,
    factors: Annotated[
        str, typer.Option(help="Device factors: how many times slower than this machine, separated by commas.")
    ] = "1,2,5,10,20,50,100,200,500,1000",
    policy: Annotated[
        str,
        typer.Option(
            help=f"What happens to a scan that arrives early: {' or '.join(POLICIES)}.",
            autocompletion=lambda: list(POLICIES),
        ),
    ] = "queue-of-one",
    odometry: Annotated[bool, typer.Option(help="Use wheel odometry between estimates.")] = True,
    repetitions: Annotated[int, typer.Option(min=1, help="Time measurements per scan; the median counts.")] = 3,
    folder: options.Out = Path("reports") / "build" / "realtime",
    as_json: Json = False,
) -> None:
    """Simulate a slower device and measure the drift caused by dropped scans.

    The time per scan is measured on this machine once and kept: the same command again drops the same scans.
    """
    known = _factors(factors)
    ladder = _Ladder(known, _policy(policy), repetitions, odometry)
    dataset, given_on = options.split_sequence(on or defaults.simulated_dataset())
    task = _task(backend, dataset, options.settings(setting or []), given_on, ladder)
    store = TaskStore(folder or Path("reports") / "build" / "realtime")
    with progress.show_tasks(err, 1, 1) as done:
        found = run_tasks(store, [task], 1, done)[task.name]
    rows = _rows(found)
    if as_json:
        options.print_json(_as_json(backend, dataset, found, rows))
    else:
        _show(backend, dataset, found, rows)


@dataclass(frozen=True)
class _Ladder:
    """The device factors to simulate and how; see ``simulation.paced``."""

    factors: list[float]
    policy: Policy
    repetitions: int
    bridged: bool


def _task(backend: str, on: str, given: dict[str, str], given_on: dict[str, str], ladder: _Ladder) -> Task[PacedResult]:
    """The task that measures and simulates, with its arguments checked."""
    from evalkit.commands.realtime.simulation import Method, paced  # noqa: PLC0415 - loads scipy

    parameters = from_text(backend, frontend.settable_parameters(registry.backend(backend)), given)
    Method.of(backend, parameters)
    spec = registry.dataset(on)
    of_sequence: dict[str, Value] = resolve_parameters(on, spec.parameters, from_text(on, spec.parameters, given_on))
    if why := spec.missing(**of_sequence):
        raise DataMissing(on, "is not here", why)
    return make_task(
        f"{backend} on {on}", paced, backend=backend, parameters=parameters, dataset=on,
        dataset_parameters=of_sequence, factors=ladder.factors, policies=[ladder.policy],
        repetitions=ladder.repetitions, bridged=ladder.bridged, code=registry.run_fingerprint(backend, on),
    )  # fmt: skip


def _factors(text: str) -> list[float]:
    try:
        found = [float(word) for word in text.split(",")]
    except ValueError:
        found = [-1.0]
    if not all(0.0 < factor < math.inf for factor in found):
        raise typer.BadParameter(f"--factors: found '{text}', expected positive numbers: 1,5,10")
    return sorted(found)


def _policy(text: str) -> Policy:
    for policy in POLICIES:
        if text == policy:
            return policy
    raise typer.BadParameter(f"--policy: found '{text}', expected one of: {', '.join(POLICIES)}")


def _rows(found: PacedResult) -> list[dict[str, Any]]:
    """Every device factor, and whether its run is broken compared with a device that takes no time."""
    reference = found["rungs"][0]["at_hand"]["ate_rmse_m"]
    return [rung | {"broken": _broken(rung, reference)} for rung in found["rungs"]]


def _broken(rung: dict[str, Any], reference: float | None) -> bool:
    ate = rung["at_hand"]["ate_rmse_m"]
    return reference is None or RULE.broken(None if rung["lost"] else ate, reference)


def _as_json(backend: str, on: str, found: PacedResult, rows: list[dict[str, Any]]) -> dict[str, Any]:
    return {
        "backend": backend,
        "sequence": on,
        "median_cost_ms": float(sorted(found["costs_ns"])[len(found["costs_ns"]) // 2] * 1e-6),
        "period_ms": found["period_ns"] * 1e-6,
        "headroom": found["headroom"],
        "growth": dict(zip(map(str, found["gaps"].tolist()), found["growth"].tolist(), strict=True)),
        "linear": found["linear"],
        "breaks_at": _breaks(rows),
        "rungs": rows,
    }


def _breaks(rows: list[dict[str, Any]]) -> float | None:
    return first_broken([row["factor"] for row in rows], [row["broken"] for row in rows])


def _show(backend: str, on: str, found: PacedResult, rows: list[dict[str, Any]]) -> None:
    told = _as_json(backend, on, found, rows)
    columns = ("device factor", "answered", "dropped %", "late %", "age p95 ms", "ATE of answers m", "ATE at hand m")
    table = Table(*columns, "", title=f"{backend} on {on}", title_justify="left", expand=out.is_terminal)
    for row in rows:
        table.add_row(
            f"{row['factor']:g}" if row["factor"] else "no drops", str(row["answered"]), f"{100 * row['dropped']:.1f}",
            f"{100 * row['late']:.1f}", f"{row['age_ms'][1]:.1f}", _metres(row["of_answers"]), _metres(row["at_hand"]),
            f"broken {row['lost']}".strip() if row["broken"] else "",
        )  # fmt: skip
    progress.print_table(out, table)
    breaks = f"breaks at {told['breaks_at']:g}" if told["breaks_at"] is not None else "holds at every factor"
    out.print(
        f"{told['median_cost_ms']:.2f} ms per scan here (median); a device up to {told['headroom']:.3g} times slower "
        f"answers every scan in time; {breaks}. Broken: {RULE}.",
        markup=False, emoji=False, highlight=False,
    )  # fmt: skip


def _metres(measures: dict[str, float | None]) -> str:
    value = measures["ate_rmse_m"]
    return "-" if value is None else f"{value:.3f}"
