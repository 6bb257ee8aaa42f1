"""``evalkit realtime``: simulate slower devices; from which factor on a back end drops scans and is broken."""

from __future__ import annotations

import shlex
from typing import TYPE_CHECKING, Annotated, Any

import typer

from evalkit.commands.realtime.virtual_clock import BreakingRule, Policy, find_breaking_factor
from evalkit.config.experiment import RESULTS
from evalkit.core.errors import DataMissing
from evalkit.execution.task import Task, make_task
from evalkit.execution.task_runner import run_tasks
from evalkit.execution.task_store import TaskStore
from evalkit.odometry import frontend
from evalkit.plugins import defaults, registry
from evalkit.plugins.parameter_parsing import from_text, parse_dataset
from evalkit.plugins.parameters import Value, resolve_parameters, split_settings
from evalkit.terminal import options, progress
from evalkit.terminal.console import err, out, print_json, table_width
from evalkit.terminal.options import Json

if TYPE_CHECKING:
    from evalkit.commands.realtime.simulation import RealtimeResult
    from evalkit.terminal.ranked_table import RankedRow

RULE = BreakingRule()
MAX_FACTOR = 1e6

MIN_WAIT_PERIODS, MIN_WAIT_COSTS = 0.1, 2.0
"""A scan that waits is named where the wait exceeds this share of the period and this many times its CPU time."""


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
    setting: options.BackendSettings = None,
    factors: Annotated[
        str,
        typer.Option(
            help="Device factors: how many times slower than this machine, separated by commas.",
            show_default="ten from 1 to 1000",
        ),
    ] = "1,2,5,10,20,50,100,200,500,1000",
    policy: Annotated[
        Policy,
        typer.Option(metavar="<policy>", help="What happens to a scan that arrives early: drop or queue-of-one."),
    ] = "queue-of-one",
    odometry: Annotated[bool, typer.Option(help="Use wheel odometry between estimates.")] = True,
    repetitions: Annotated[int, options.count(1, high=1000, help="Time measurements per scan; the median counts.")] = 3,
    folder: options.Out = RESULTS / "realtime",
    as_json: Json = False,
) -> None:
    """Simulate a slower device and measure the drift caused by dropped scans.

    The CPU time per scan is measured once on this machine and stored: the same command again drops the same scans.
    """
    devices = {
        "factors": _parse_factors(factors), "policies": [policy], "repetitions": repetitions,
        "bridged": odometry,
    }  # fmt: skip
    on = on or defaults.find_simulated_dataset()
    dataset, given_on = parse_dataset(on)
    task = _make_task(backend, dataset, split_settings("--set", setting or []), given_on, devices)
    store = TaskStore(folder or RESULTS / "realtime")
    with progress.show_tasks(err, 1, 1) as done:
        result = run_tasks(store, [task], 1, done)[task.name]
    content = _as_json(backend, dataset, result)
    if as_json:
        print_json(content)
    else:
        _print(content, on)


def _make_task(
    backend: str, on: str, given: dict[str, str], given_on: dict[str, Value], devices: dict[str, Any]
) -> Task[RealtimeResult]:
    """Make the task that measures and simulates; ``devices``: the other arguments of ``simulate_realtime``."""
    from evalkit.commands.realtime.simulation import ProfiledMethod, simulate_realtime  # noqa: PLC0415 - loads scipy

    parameters = from_text(backend, frontend.settable_parameters(registry.backend(backend)), given)
    ProfiledMethod.load(backend, parameters)
    spec = registry.dataset(on)
    of_sequence = resolve_parameters(on, spec.parameters, given_on)
    if why := spec.missing(**of_sequence):
        raise DataMissing(on, "is not available", why)
    return make_task(
        f"{backend} on {on}", simulate_realtime, backend=backend, parameters=parameters, dataset=on,
        dataset_parameters=of_sequence, **devices, code=registry.hash_run_code(backend, on),
    )  # fmt: skip


def _parse_factors(text: str) -> list[float]:
    try:
        factors = [float(word) for word in text.split(",")]
    except ValueError:
        factors = [-1.0]
    if not all(0.0 < factor <= MAX_FACTOR for factor in factors):
        expected = f"positive numbers of at most {MAX_FACTOR:,.0f}: 1,5,10"
        raise typer.BadParameter(f"--factors: found '{text}', expected {expected}")
    return sorted(factors)


def _as_json(backend: str, on: str, result: RealtimeResult) -> dict[str, Any]:
    """The result as JSON values; a device is ``broken`` compared with the first one, which takes no time.

    Without ground truth that is unknown, None, unless a device or the first one is lost.
    """
    first = result["devices"][0]
    devices: list[dict[str, Any]] = [device | {"broken": _is_broken(device, first)} for device in result["devices"]]
    return {
        "backend": backend,
        "sequence": on,
        "median_cost_ms": float(sorted(result["costs_ns"])[len(result["costs_ns"]) // 2] * 1e-6),
        "period_ms": result["period_ns"] * 1e-6,
        "headroom": result["headroom"],
        "slowest": _describe_slowest(result),
        "waits": _find_waits(result),
        "growth": dict(zip(map(str, result["gaps"].tolist()), result["growth"].tolist(), strict=True)),
        "linear": result["linear"],
        "breaks_at": find_breaking_factor([one["factor"] for one in devices], [bool(one["broken"]) for one in devices]),
        "devices": devices,
    }


def _describe_slowest(result: RealtimeResult) -> dict[str, float]:
    """The scan that limits the headroom: its number, its CPU time, and the time until the next one is complete."""
    number = result["slowest_scan"]
    cost_ms = float(result["costs_ns"][number - 1] * 1e-6)
    return {"scan": number, "cpu_ms": cost_ms, "period_ms": result["slowest_period_ns"] * 1e-6}


def _find_waits(result: RealtimeResult) -> dict[str, float] | None:
    """How many scans wait much longer than they compute, and the longest wait with its scan; None without any."""
    waits = result["waits_ns"]
    far_above = waits > MIN_WAIT_COSTS * result["costs_ns"]
    count = int((far_above & (waits > MIN_WAIT_PERIODS * result["period_ns"])).sum())
    longest = int(waits.argmax())
    return {"scans": count, "scan": longest + 1, "longest_ms": float(waits[longest] * 1e-6)} if count else None


def _is_broken(device: dict[str, Any], first: dict[str, Any]) -> bool | None:
    reference = first["at_hand"]["ate_rmse_m"]
    if first["lost"] or device["lost"]:
        return True
    return None if reference is None else RULE.is_broken(device["at_hand"]["ate_rmse_m"], reference)


def _print(content: dict[str, Any], on: str) -> None:
    """Print the limit of the device, a line for each factor (equal ones together), and the next command.

    ``on``: the data set with its parameters.
    """
    from evalkit.terminal.ranked_table import format_rows  # noqa: PLC0415 - loads scipy

    backend, slowest, waits = content["backend"], content["slowest"], content["waits"]
    if content["headroom"] < 1.0:
        limit = (
            f"even this machine is too slow for the slowest scan: scan {slowest['scan']} took "
            f"{slowest['cpu_ms']:.3g} ms of CPU time, and the next one came after {slowest['period_ms']:.3g} ms"
        )
    else:
        limit = f"by its CPU time, a device up to {content['headroom']:.3g} times slower answers every scan in time"
    for text in (
        f"{backend} on {content['sequence']}: {limit}; {_describe_breaking(content)}.",
        f"{content['median_cost_ms']:.2f} ms of CPU time per scan on this machine (median). Broken: {RULE}.",
    ):
        out.print(text)
    if waits:
        others = f"; so did {waits['scans'] - 1} more" if waits["scans"] > 1 else ""
        out.print(
            f"Not counted: scan {waits['scan']} waited {waits['longest_ms']:.3g} ms besides its CPU time (for a timer, "
            f"a file, a device){others}. A device that waits as long is late, however fast it computes.",
            style="yellow",
        )
    out.print()
    head = "device: error of the newest pose, dropped and late scans, age (95 %)"
    for line in format_rows(head, _make_rows(content), table_width(out), cost=""):
        out.print(line)
    without_seed = shlex.join(word for word in shlex.split(on) if not word.startswith("seed="))  # a tuning has its own
    where = ["--on", without_seed]
    if not registry.dataset(shlex.split(on)[0]).seeded:  # a recording cannot be drawn again: it judges
        where = ["--on", defaults.find_simulated_dataset(), "--held-out", without_seed]
    words = shlex.join(["evalkit", "tune", content["backend"], *where])
    out.print(f"\nnext: {words} (cheaper or better parameters)", soft_wrap=True)


def _describe_breaking(content: dict[str, Any]) -> str:
    """From which factor on the devices are broken, and larger ones that are not."""
    devices, least = content["devices"], content["breaks_at"]
    if least is None:
        unknown = any(device["broken"] is None for device in devices)
        return "without a true trajectory, its errors are unknown" if unknown else "not broken at any factor"
    held = [f"{device['factor']:g}" for device in devices if device["factor"] > least and not device["broken"]]
    return f"broken at {least:g}, but not at {', '.join(held)}" if held else f"broken from {least:g} on"


def _make_rows(content: dict[str, Any]) -> list[RankedRow]:
    """Return a row for each device; neighbours that answer the same scans equally well and as punctually are one."""
    from evalkit.terminal.ranked_table import RankedRow  # noqa: PLC0415 - as above

    rows: dict[tuple[int, bool, bool], RankedRow] = {}
    for device in content["devices"]:
        same = (device["answered"], device["broken"], device["late"] > 0.0)
        late = f", {100 * device['late']:.1f} % late" if device["late"] else ""
        error = device["at_hand"]["ate_rmse_m"]
        name = f"{device['factor']:g} x slower" if device["factor"] else "no drops"
        rows[same] = RankedRow(
            f"up to {name}" if same in rows else name,
            _format_error(device), f"{100 * device['dropped']:.1f} % dropped{late}",
            f"{device['age_ms'][1]:.3g} ms", f"broken {device['lost']}".strip() if device["broken"] else "",
            error or 0.0,
        )  # fmt: skip
    return list(rows.values())


def _format_error(device: dict[str, Any]) -> str:
    error = device["at_hand"]["ate_rmse_m"]
    if error is None:
        return "unknown" if device["broken"] is None else "lost"
    return f"{1000.0 * error:.0f} mm"
