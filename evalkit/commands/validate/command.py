"""``evalkit validate``: check a back end, a mapper or a data set, level by level, with one report."""

from __future__ import annotations

import os
import re
import secrets
import shlex
import shutil
from collections.abc import Collection, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, get_args

import typer

from evalkit.config.experiment import RESULTS
from evalkit.core.errors import BadData, BadParameter, NotInstalled, brief
from evalkit.execution import environment
from evalkit.io.input_files import read_text
from evalkit.plugins import defaults, registry
from evalkit.plugins.address import address_of, dataset_at, mapper_at
from evalkit.plugins.parameters import split_settings
from evalkit.terminal import options, progress
from evalkit.terminal.console import err
from evalkit.terminal.options import Jobs, Json, Out

if TYPE_CHECKING:
    from evalkit.commands.validate.acceptance import AcceptanceReport
    from evalkit.commands.validate.plan import Only, ValidationRequest
    from evalkit.commands.validate.run import ProgressDisplay
    from evalkit.config.experiment import Experiment
    from evalkit.execution.executors import Progress

SEED_FILE = "seed.txt"
"""In the results folder: the seed of its drawn questions."""

SEED = re.compile(r"[0-9]{1,4000}")

CheckGroup = Literal["rules", "registrations", "lockstep", "determinism"]
CHECK_GROUPS: tuple[CheckGroup, ...] = get_args(CheckGroup)

Subject = Literal["back end", "mapper", "data set"]

RULES, LOCKSTEP, DETERMINISM = "Rules", "Lockstep", "Only determinism"
"""Panels of the help."""


def validate(
    backends: Annotated[
        list[str] | None,
        typer.Argument(
            help="A back end, a mapper or a data set: a registered name, module:SPEC, lib:./libmine.so or "
            "'exec:ssh board ./my_icp'.",
            show_default=False,
            autocompletion=options.complete("backends"),
        ),
    ] = None,
    only: Annotated[
        list[str] | None,
        typer.Option(
            metavar="<checks>",
            autocompletion=lambda: list(CHECK_GROUPS),
            help="Only one group of checks: rules, registrations, lockstep or determinism.",
            show_default="levels 0 to 5",
        ),
    ] = None,
    reference: Annotated[
        str,
        typer.Option(
            help="The implementation to compare with.",
            show_default="by its role",
            autocompletion=options.complete("backends"),
        ),
    ] = "",
    peer: Annotated[
        list[str] | None,
        typer.Option(
            help="Another method, for context (repeatable).",
            show_default="by their role, quick: none",
            autocompletion=options.complete("backends"),
        ),
    ] = None,
    on: options.On = None,
    seeds: Annotated[
        int | None,
        options.count(1, high=options.MAX_SEEDS, help="Seeds of simulated sequences.", show_default="3, quick: 1"),
    ] = None,
    claim: Annotated[
        Literal["equal", "as-good"], typer.Option(help="equal: the answers of the reference; as-good: no worse.")
    ] = "equal",
    margin: Annotated[
        str,
        typer.Option(help="auto, exact (1e-9), float32 (computed), or metres, radians, log-odds: 0.01,0.002,0.1."),
    ] = "auto",
    share: Annotated[float, options.number(0.01, 1.0, help="as-good: the tolerated share of the noise level.")] = 0.5,
    setting: Annotated[
        list[str] | None, typer.Option("--set", help="NAME=VALUE, also for the reference if it has it (repeatable).")
    ] = None,
    set_reference: Annotated[list[str] | None, typer.Option(help="NAME=VALUE of the reference.")] = None,
    mapper: Annotated[
        str,
        typer.Option(
            help="The mapper of the back end.",
            show_default="of the same module",
            autocompletion=options.complete("mappers"),
        ),
    ] = "",
    seed: Annotated[
        int | None,
        typer.Option(min=0, help="Seed of the drawn questions; printed.", show_default="drawn, kept in --out"),
    ] = None,
    waivers: Annotated[
        list[str] | None,
        typer.Option("--except", help="NAME=REASON: this rule or check may fail; the report says why (repeatable)."),
    ] = None,
    junit: Annotated[Path | None, typer.Option(help="Also write a JUnit XML file.", show_default=False)] = None,
    quick: Annotated[bool, typer.Option("--quick", help="Fewer questions: under a minute.")] = False,
    fresh: Annotated[bool, typer.Option("--fresh", help="Discard earlier results, and measure times again.")] = False,
    rule: Annotated[
        list[str] | None,
        typer.Option(help="Only this rule (repeatable); implies --only rules.", rich_help_panel=RULES),
    ] = None,
    limit: Annotated[
        float, options.number(0.1, options.MAX_SECONDS, help="Time limit of a rule (s).", rich_help_panel=RULES)
    ] = 30.0,
    frames: Annotated[
        int, options.count(1, high=1_000_000, help="Frames of a data set to check.", rich_help_panel=RULES)
    ] = 50,
    scans: Annotated[
        int | None,
        options.count(
            3, high=1_000_000, help="Scans compared.", show_default="150, quick: 45", rich_help_panel=LOCKSTEP
        ),
    ] = None,
    disturb: Annotated[
        bool, typer.Option(help="Repeat questions with disturbed guesses.", rich_help_panel=LOCKSTEP)
    ] = True,
    threads: Annotated[
        int, options.count(2, help="Threads of libraries, beside one.", rich_help_panel=DETERMINISM)
    ] = 2,
    repetitions: Annotated[int, options.count(2, help="Runs of each.", rich_help_panel=DETERMINISM)] = 2,
    folder: Out = None,
    jobs: Jobs = None,
    as_json: Json = False,
) -> None:
    """Validate an implementation against a reference, level by level.

    The levels are rules, registrations, lockstep, trajectories, maps, and time and memory. Exit code 1 if the claim
    does not hold. A data set has rules alone, a mapper rules and lockstep. --only determinism takes any number of back
    ends, none for every installed one.
    """
    from evalkit.commands.validate import plan, printing, run  # noqa: PLC0415 - imports scipy and matplotlib

    _add_module_path(*(backends or []), reference, *(peer or []))
    group = _find_group(only or [], bool(rule))
    names = backends or []
    name = _single_name(names, group)
    effort = plan.QUICK if quick else plan.FULL
    out_folder = folder or RESULTS / f"validate-{_file_name(name or 'determinism')}"
    excepted = _parse_waivers(waivers or [])
    request = plan.ValidationRequest(
        backend=name, given=split_settings("--set", setting or []), reference=reference,
        given_reference=split_settings("--set-reference", set_reference or []),
        peers=tuple(filter(None, _default_peers(quick) if peer is None else peer)),
        on=tuple(on or _default_sequences(quick=quick or group == "determinism", simulated=group == "determinism")),
        seeds=seeds or (1 if quick else 3), claim=claim, margin=_parse_margin(margin), noise_share=share,
        mapper=mapper, effort=replace(effort, scans=scans or effort.scans), only=group, disturbed=disturb,
        seed=_choose_seed(seed, out_folder, fresh), waivers=excepted,
    )  # fmt: skip
    if fresh:
        for part in ("tasks", "runs"):  # only what this command writes: the folder may contain other files
            shutil.rmtree(out_folder / part, ignore_errors=True)
    display = run.ProgressDisplay(lambda total, count: progress.show_tasks(err, total, count), _show_runs)
    execution = _Execution(out_folder, jobs or environment.physical_cores(), display)
    if group == "rules" and _subject(name) == "back end":
        report = run.report_rules(
            name, request.given, tuple(rule or ()), limit, request.seed, excepted,
            lambda rule: err.print(f"rule {rule} takes longer than usual: are some calls slow?"),
        )  # fmt: skip
    elif group == "determinism" and (not name or _subject(name) == "back end"):
        report = run.report_determinism(names, request.given, request.on, threads, repetitions, _announce)
    else:
        report = _report(request, execution, frames)
    _keep_seed(out_folder, request.seed)
    printing.finish(report, out_folder, as_json, junit)


@dataclass(frozen=True)
class _Execution:
    """Results folder, number of workers, progress display."""

    folder: Path
    workers: int
    display: ProgressDisplay


def _find_group(only: Collection[str], has_rules: bool) -> Only:
    """The only group of checks, "" for all; single rules (``has_rules``) are of one. Raises BadParameter for others."""
    groups = dict.fromkeys([*only, "rules"] if has_rules else only)
    if unknown := [name for name in groups if name not in CHECK_GROUPS]:
        raise typer.BadParameter(f"--only: {unknown[0]!r} is not one of {', '.join(map(repr, CHECK_GROUPS))}")
    if len(groups) > 1:
        raise typer.BadParameter(f"--only takes one group of checks, found {' and '.join(groups)}")
    for group in CHECK_GROUPS:
        if group in groups:
            return group
    return ""


def _report(request: ValidationRequest, execution: _Execution, frames: int) -> AcceptanceReport:
    """The report of a data set, a mapper, or the levels of a back end that need a reference."""
    from evalkit.commands.validate import mapper_run, run  # noqa: PLC0415 - as above

    name, group, subject = request.backend, request.only, _subject(request.backend)
    if subject == "data set":
        _refuse_only(group, ("", "rules"), name, subject)
        return run.report_dataset(name, request.given, frames)
    if subject == "mapper":
        _refuse_only(group, ("", "rules", "lockstep"), name, subject)
        return mapper_run.report_mapper(request, execution.folder, execution.workers, execution.display)
    return _compare(request, execution.folder, execution.workers, execution.display)


def _compare(request: ValidationRequest, folder: Path, workers: int, display: ProgressDisplay) -> AcceptanceReport:
    """The levels that need a reference."""
    from evalkit.commands.validate import plan, run  # noqa: PLC0415 - as above

    planned = plan.make_plan(request)
    if any(registry.find_backend(method).device for method in planned.methods):
        workers = 1  # a device has one session
    _keep_seed(folder, request.seed)
    for name, why in planned.unavailable.items():
        err.print(f"not available here: {name}: {why}")
    return run.ValidationRun(planned, folder, workers, display).report()


@contextmanager
def _show_runs(plan: Experiment, workers: int) -> Iterator[Progress]:
    with progress.show_runs(err, list(plan.runs()), workers) as shown:
        yield shown


def _announce(name: str) -> None:
    err.print(f"{name} ...")


def _subject(name: str) -> Subject:
    """The kind of plug-in behind a name; a name that is unknown counts as a back end."""
    address = address_of(name)
    if address.module:
        with suppress(NotInstalled):  # its error is raised where the back end is loaded
            dataset_at(name)
            return "data set"
        with suppress(NotInstalled):
            mapper_at(name)
            return "mapper"
    elif name not in registry.names("backends"):
        if name in registry.names("mappers"):
            return "mapper"
        if name in registry.names("datasets"):
            return "data set"
    return "back end"


def _single_name(names: list[str], only: str) -> str:
    """The subject; "" if there is another number of names than one, which only determinism accepts."""
    if len(names) == 1:
        return names[0]
    if only == "determinism":
        return ""
    raise typer.BadParameter(f"found {len(names)} names, expected one (--only determinism accepts any number)")


def _refuse_only(only: str, allowed: tuple[str, ...], name: str, subject: str) -> None:
    if only not in allowed:
        raise typer.BadParameter(f"--only {only}: '{name}' is a {subject}, expected --only {' or '.join(allowed[1:])}")


def _default_sequences(quick: bool, simulated: bool) -> list[str]:
    """The excerpts that data sets declare, as texts "NAME key=value"; ``simulated``: only one simulated data set."""
    excerpts = defaults.find_excerpts("quick" if quick else "full")
    chosen = [defaults.find_simulated_dataset()] if simulated else list(excerpts)
    if not chosen:
        raise NotInstalled("sequence", "no installed data set declares an excerpt", "name one with --on")
    return [shlex.join([name, *(f"{key}={value}" for key, value in excerpts[name].items())]) for name in chosen]


def _default_peers(quick: bool) -> list[str]:
    """The peers by their role; none in a quick validation, which they do not decide."""
    return [] if quick else list(defaults.find_backends_with_role("peer"))


def _choose_seed(given: int | None, folder: Path, fresh: bool) -> int:
    """The seed given, that of the folder so that its results count, or a new one."""
    if given is not None:
        return given
    file = folder / SEED_FILE
    if fresh or not file.exists():
        return secrets.randbelow(1_000_000)
    expected = "a file with one whole number, --seed or --fresh"
    text = read_text(file, expected).strip()
    if not SEED.fullmatch(text):
        raise BadData(str(file), "", f"found {brief(text)}", f"give {expected}")
    return int(text)


def _keep_seed(folder: Path, seed: int) -> None:
    """Write the seed to the folder, which it creates: once all names are known."""
    from evalkit.io.output_files import write_texts  # noqa: PLC0415 - as above

    write_texts(folder, {SEED_FILE: f"{seed}\n"})


def _parse_waivers(texts: list[str]) -> dict[str, str]:
    """Reasons by the name of a check."""
    expected = "NAME=REASON, such as order='it samples its points'"
    waivers = {}
    for name, reason in split_settings("--except", texts, expected).items():
        if not (name.strip() and reason.strip()):
            raise BadParameter("--except", name, reason, expected)
        waivers[name.strip()] = reason.strip()
    return waivers


def _parse_margin(text: str) -> str:
    from evalkit.commands.validate.probes import parse_margin  # noqa: PLC0415 - imports scipy

    if text != "auto":
        try:
            parse_margin(text)
        except ValueError as error:
            wanted = "auto, exact, float32 or METRES[,RADIANS[,LOG_ODDS]]"
            raise BadParameter("validate", "margin", text, wanted) from error
    return text


def _add_module_path(*names: str) -> None:
    """Make modules in the working directory importable in this process and in those it starts."""
    options.add_working_directory()
    if any(":" in name and name.partition(":")[0] not in registry.names("schemes") for name in names):
        path = [entry for entry in os.environ.get("PYTHONPATH", "").split(os.pathsep) if entry]
        os.environ["PYTHONPATH"] = os.pathsep.join([*path, str(Path.cwd())])


def _file_name(name: str) -> str:
    return re.sub(r"[^\w.=+-]+", "-", name)[:60].strip("-.") or "backend"
