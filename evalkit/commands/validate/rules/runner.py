"""Check the rules of a back end in a child process, so that a crash or a hang is a broken rule like any other.

``python -m evalkit.commands.validate.rules.runner FOLDER`` is the child. It writes the name of each rule before the
check and the result after it, so that a crash can be attributed to a rule.
"""

from __future__ import annotations

import gc
import json
import math
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import IO, Any

from evalkit.commands.validate.rules import odometry_rules, registration_rules, slam_rules
from evalkit.commands.validate.rules.odometry_fixture import OdometryFixture
from evalkit.commands.validate.rules.registration_fixture import RegistrationFixture
from evalkit.commands.validate.rules.rule import ProcessRule, Rule, RuleReport, RuleResult, check_rule
from evalkit.commands.validate.rules.slam_rules import SlamFixture
from evalkit.core.errors import BackendFailed, NotInstalled, UnknownName
from evalkit.execution.parent import end_with_parent
from evalkit.execution.subprocesses import ChildProcess
from evalkit.execution.usage import Usage
from evalkit.plugins import registry
from evalkit.plugins.address import Address, address_of, backend_at, spec_at
from evalkit.plugins.parameters import Value, resolve_parameters
from evalkit.plugins.specs import BackendSpec, RegistrationSpec, SlamSpec

MAX_CRASHES = 3
"""Ends of the process after which the remaining rules are skipped."""

LOADING_S = 60.0
"""Time limit (s) until the first rule begins: Python and the plug-in's module."""

REQUEST, RESULTS = "request.json", "results.jsonl"
NOT_INSTALLED = "not installed"
"""In place of an outcome: a library that ``make`` needs is not installed."""

PROCESS_RULES = {
    "alive": "The process survives all rules, within its memory limit.",
    "in-time": "Every call returns in time.",
}
"""Rules about the process as a whole, after those of every kind."""

SLOW_S = 10.0
"""A rule that takes longer (s) is reported while it runs."""

STARTS, NOT_STARTED = "starts", "it does not start"
"""The first rule of every kind; if it is broken, the others cannot be checked."""

RULES: Mapping[str, Mapping[str, Rule]] = {
    "registration": registration_rules.RULES,
    "odometry": odometry_rules.RULES,
    "slam": slam_rules.RULES,
}

RECORDED_REMEDY = (
    "compare it with the truth and with other methods (evalkit compare RECORDING --backends 'NAME,file:...'), or "
    "check the program that wrote it (exec:..., lib:...)"
)


def refuse_recorded(name: str, spec: BackendSpec) -> None:
    """Raise BackendFailed for a file of results."""
    if spec.recorded:
        raise BackendFailed(name, "holds recorded results: there is no behaviour to check", RECORDED_REMEDY)


def check(
    backend: str | BackendSpec,
    parameters: Mapping[str, object] | None = None,
    limit_s: float = 30.0,
    memory_mib: int = 2048,
    only: Sequence[str] = (),
    seed: int = 0,
    report_slow: Callable[[str], None] = lambda _: None,
) -> RuleReport:
    """The results of all rules for a back end: a registered name, "module:SPEC", or a spec.

    ``limit_s``: wall clock limit of one rule (s), or of each call where a rule makes a few long ones; ``memory_mib``:
    memory limit of the process; ``only``: names of the rules, () for all; ``seed``: of the drawn questions;
    ``report_slow``: called with the name of a rule that takes longer than ``SLOW_S``. Raises
    NotInstalled if the back end cannot run here, BackendFailed if it does not load or is a file of results,
    BadParameter or UnknownName for parameters and rules.
    """
    address, spec = address_of(backend), backend_at(backend)
    refuse_recorded(address.label, spec)
    if why := spec.missing():
        raise NotInstalled(address.label, "cannot be checked here", why)
    if spec.broken:
        raise BackendFailed(address.label, "cannot be checked here", spec.broken)
    rules = RULES[spec.kind]
    for name in only:
        if name not in rules:
            raise UnknownName("rule", name, rules)
    complete = resolve_parameters(address.label, spec.parameters, parameters or {})
    request = {
        "address": asdict(address),
        "parameters": complete,
        "seed": seed,
        "path": [str(Path(entry or ".").resolve()) for entry in sys.path],
    }
    chosen = {name: rule for name, rule in rules.items() if name in only or not only}
    if address.module == "__main__" and not address.file:
        return RuleReport(address.label, _check_here(spec, complete, chosen, seed))
    return RuleReport(address.label, _RuleRunner(request, chosen, limit_s, memory_mib, report_slow).results())


def _check_here(
    spec: BackendSpec, parameters: Mapping[str, Value], rules: Mapping[str, Rule], seed: int
) -> tuple[RuleResult, ...]:
    """The results of rules for a spec of an interactive session, which no other process can load: in this process."""
    fixture = _make_fixture(spec, parameters, seed, {})
    why = "checked in this process: another one cannot load an interactive session; save it in a file to isolate it"
    of_process = [RuleResult(name, sentence, "not applicable", why) for name, sentence in PROCESS_RULES.items()]
    return (*(_check_rule(rule, fixture) for rule in rules.values()), *of_process)


def _check_rule(rule: Rule, fixture: object) -> RuleResult:
    """The result of a rule; after a failure the next rule has a new object, because this one may have ended."""
    result = check_rule(rule, fixture)
    if result.outcome == "failed" and isinstance(fixture, RegistrationFixture):
        fixture.renew()
    return result


class _RuleRunner:
    """Check all rules of one back end, with a new process after each early end, also of the program behind it."""

    def __init__(
        self,
        request: Mapping[str, Any],
        rules: Mapping[str, Rule],
        limit_s: float,
        memory_mib: int,
        report_slow: Callable[[str], None],
    ) -> None:
        self._request, self._rules, self._report_slow = request, rules, report_slow
        self._limit_s, self._memory_mib = limit_s, memory_mib
        self._results: dict[str, RuleResult] = {}
        self._crashes: list[str] = []
        self._hangs: list[str] = []

    def results(self) -> tuple[RuleResult, ...]:
        """All results; the last two rules concern the process as a whole."""
        while waiting := [name for name in self._rules if name not in self._results]:
            if reason := self._stop_reason():
                for name in waiting:
                    self._results[name] = RuleResult(name, self._rules[name].sentence, "not judged", reason)
            else:
                self._run_process(waiting)
        return (
            *self._results.values(),
            self._process_rule("alive", self._crashes),
            self._process_rule("in-time", self._hangs),
        )

    def _process_rule(self, name: str, ends: list[str]) -> RuleResult:
        """The result of a rule about the process as a whole."""
        sentence = PROCESS_RULES[name]
        if ends:
            return RuleResult(name, sentence, "failed", "; ".join(ends))
        if self._does_not_start():
            return RuleResult(name, sentence, "not judged", NOT_STARTED)
        return RuleResult(name, sentence, "passed", "through all rules")

    def _does_not_start(self) -> bool:
        starts = self._results.get(STARTS)
        return starts is not None and starts.outcome == "failed"

    def _stop_reason(self) -> str:
        if self._does_not_start():
            return NOT_STARTED
        ends = len(self._crashes) + len(self._hangs)
        return f"its process had ended {MAX_CRASHES} times" if ends >= MAX_CRASHES else ""

    def _run_process(self, names: list[str]) -> None:
        """Check rules until all are done or the process ends early, which breaks the current rule."""
        with tempfile.TemporaryDirectory(prefix="evalkit-rules-") as root:
            folder = Path(root)
            (folder / REQUEST).write_text(json.dumps({**self._request, "rules": names}), encoding="utf-8")
            with ChildProcess(__name__, folder) as child:
                hang, limit = self._watch(child, folder)
            lines = _read_lines(folder)
            self._take_results(lines)
            at = lines[-1].get("begun", "") if lines else names[0]
            if at:
                text = limit or child.describe_end()
                step = lines[-1].get("step", "") if lines else ""
                text += f", in {step}" if step else ""
                ended: ProcessRule = "in-time" if hang else "alive"
                self._results[at] = RuleResult(at, self._rules[at].sentence, "failed", text, also_breaks=ended)
                (self._hangs if hang else self._crashes).append(f"{at}: {text}")

    def _watch(self, child: ChildProcess, folder: Path) -> tuple[bool, str]:
        """Watches the process until it ends; whether it hangs, and the limit it exceeded or ""."""
        count, begin = 0, Usage(0.0, 0.0, 0)
        rule, since_s = "", math.inf
        for used in child.watch():
            lines = _read_lines(folder)
            if (size := len(lines)) > count:
                count, begin = size, used
            if lines and (now := lines[-1].get("begun", "")) != rule:
                rule, since_s = now, used.wall_s
            if rule and used.wall_s - since_s > SLOW_S:
                self._report_slow(rule)
                since_s = math.inf
            limit_s = self._limit_s if count else LOADING_S
            if used.exceeds(limit_s, begin):
                return True, f"no answer for {limit_s:g} s"
            if used.resident_bytes > self._memory_mib * 2**20:
                return False, f"used more than {self._memory_mib} MiB"
        return False, ""

    def _take_results(self, lines: list[dict[str, Any]]) -> None:
        for line in lines:
            if line.get("outcome") == NOT_INSTALLED:
                raise NotInstalled(*line["observed"])
            if "begun" not in line:
                result = self._results[line["rule"]] = RuleResult(**line)
                if result.also_breaks:
                    ends = self._hangs if result.also_breaks == "in-time" else self._crashes
                    ends.append(f"{result.rule}: {result.observed}")


def _read_lines(folder: Path) -> list[dict[str, Any]]:
    """The complete lines that the process has written so far."""
    try:
        text = (folder / RESULTS).read_text(encoding="utf-8")
    except FileNotFoundError:
        return []
    return [json.loads(line) for line in text.splitlines(keepends=True) if line.endswith("\n")]


def main() -> int:
    """Check the rules of the request in the folder named on the command line, writing lines to ``results.jsonl``."""
    end_with_parent()
    gc.enable()
    folder = Path(sys.argv[1]).resolve()  # a back end may change the working directory
    request = json.loads((folder / REQUEST).read_text(encoding="utf-8"))
    sys.path.extend(entry for entry in request["path"] if entry not in sys.path)
    address = Address(**request["address"])
    spec = spec_at(address, BackendSpec, registry.backend)
    if spec.broken:  # a program that answered before this process began
        raise BackendFailed(address.label, "cannot be used any more", spec.broken)
    fixture = load_fixture(request["address"], request["parameters"], request["seed"])
    with (folder / RESULTS).open("a", encoding="utf-8", buffering=1) as file:
        for name in request["rules"]:
            _note_step(file, name)
            fixture.note_progress = partial(_note_step, file, name)
            try:
                result: dict[str, Any] = asdict(_check_rule(RULES[spec.kind][name], fixture))
            except NotInstalled as error:
                result = {"outcome": NOT_INSTALLED, "observed": error.args}
            file.write(json.dumps(result) + "\n")
            if (name == STARTS and result["outcome"] != "passed") or result.get("also_breaks"):
                break  # the program behind it has ended: it counts as an end of this process
    return 0


def _note_step(file: IO[str], rule: str, step: str = "") -> None:
    """Write that a rule has begun, or a step of it."""
    file.write(json.dumps({"begun": rule, "step": step}) + "\n")


def load_fixture(address: Mapping[str, str], parameters: Mapping[str, Value], seed: int) -> Any:
    """What the rules are checked on: the back end at an address, with its complete parameters."""
    spec = spec_at(Address(**address), BackendSpec, registry.backend)
    elsewhere = {"address": dict(address), "parameters": dict(parameters), "seed": seed}
    return _make_fixture(spec, parameters, seed, elsewhere)


def _make_fixture(
    spec: BackendSpec, parameters: Mapping[str, Value], seed: int, elsewhere: Mapping[str, Any]
) -> RegistrationFixture | OdometryFixture:
    if isinstance(spec, RegistrationSpec):
        return RegistrationFixture(spec.make, seed, spec.parameters, parameters, elsewhere, spec.runs_in)
    fixture = SlamFixture if isinstance(spec, SlamSpec) else OdometryFixture
    return fixture(partial(spec.make, **parameters), spec.role, seed, elsewhere, spec.runs_in)


if __name__ == "__main__":
    sys.exit(main())
