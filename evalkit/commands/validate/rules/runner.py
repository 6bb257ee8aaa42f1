"""Checks the rules of a back end in a child process, so that a crash or a hang is a broken rule like any other."""

from __future__ import annotations

import json
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

from evalkit.commands.validate.rules.rule import Rule, RuleReport, RuleResult, skip_rules
from evalkit.commands.validate.rules.worker import NOT_INSTALLED, REQUEST, RESULTS, RULES, STARTS, RuleRequest
from evalkit.core.errors import BackendFailed, NotInstalled, UnknownName
from evalkit.execution.subprocesses import ChildProcess
from evalkit.plugins import registry
from evalkit.plugins.address import Address, address_of, spec_at
from evalkit.plugins.parameters import Value, resolve_parameters
from evalkit.plugins.specs import BackendSpec

MAX_CRASHES = 3
"""Ends of the process after which the remaining rules are skipped."""

LOADING_S = 60.0
"""Time limit (s) until the first rule begins: Python and the plug-in's module."""

RECORDED_REMEDY = (
    "compare it with the truth and with other methods (evalkit compare RECORDING --backends 'NAME,file:...'), or "
    "check the program that wrote it (exec:..., lib:...)"
)


@dataclass(frozen=True)
class ProcessEnd:
    """The early end of the process: at which rule, how, and whether by a hang or a crash."""

    rule: str
    kind: Literal["hang", "crash"]
    text: str


def check(
    backend: str | BackendSpec,
    parameters: Mapping[str, object] | None = None,
    limit_s: float = 30.0,
    memory_mib: int = 2048,
    only: Sequence[str] = (),
) -> RuleReport:
    """The results of all rules for a back end: a registered name, "module:SPEC", or a spec.

    ``limit_s``: wall clock limit of one rule (s); ``memory_mib``: memory limit of the process; ``only``: names of the
    rules, () for all. Raises NotInstalled if the back end cannot run here, BackendFailed if it is a file of results,
    BadParameter or UnknownName for parameters and rules.
    """
    address, spec = address_of(backend), spec_of(backend)
    if spec.recorded:
        what = "holds recorded results: there is no behaviour to check"
        raise BackendFailed(address.label, what, RECORDED_REMEDY)
    if why := spec.missing():
        raise NotInstalled(address.label, "cannot be checked here", why)
    complete = resolve_parameters(address.label, spec.parameters, parameters or {})
    rules = _select(RULES[spec.kind], only)
    return RuleReport(address.label, _RuleRunner(address, rules, complete, limit_s, memory_mib).results())


def spec_of(backend: str | BackendSpec) -> BackendSpec:
    """The spec of a registered name, of "module:SPEC", or itself; NotInstalled if there is none."""
    return spec_at(address_of(backend), BackendSpec, registry.backend)


def _select(rules: Mapping[str, Rule], only: Sequence[str]) -> dict[str, Rule]:
    for name in only:
        if name not in rules:
            raise UnknownName("rule", name, rules)
    return {name: rule for name, rule in rules.items() if name in only or not only}


class _RuleRunner:
    """Checks all rules of one back end, with a new process after each early end."""

    def __init__(
        self, address: Address, rules: Mapping[str, Rule], parameters: dict[str, Value], limit_s: float, memory_mib: int
    ) -> None:
        self._address, self._rules, self._parameters = address, rules, parameters
        self._limit_s, self._memory_mib = limit_s, memory_mib
        self._results: dict[str, RuleResult] = {}
        self._ends: list[ProcessEnd] = []

    def results(self) -> tuple[RuleResult, ...]:
        """All results; the last two rules concern the process as a whole."""
        while waiting := [name for name in self._rules if name not in self._results]:
            if reason := self._stop_reason():
                skipped = skip_rules((self._rules[name] for name in waiting), reason)
                self._results |= {result.rule: result for result in skipped}
            else:
                self._run_process(waiting)
        alive = "The process survives all rules, within its memory limit."
        return (
            *self._results.values(),
            _process_rule("alive", alive, [end for end in self._ends if end.kind == "crash"]),
            _process_rule("in-time", "Every call returns in time.", [end for end in self._ends if end.kind == "hang"]),
        )

    def _stop_reason(self) -> str:
        starts = self._results.get(STARTS)
        if starts is not None and starts.outcome == "failed":
            return "it does not start"
        return f"skipped after {MAX_CRASHES} ends of its process" if len(self._ends) >= MAX_CRASHES else ""

    def _run_process(self, names: list[str]) -> None:
        """Checks rules until all are done or the process ends early, which breaks the current rule."""
        with tempfile.TemporaryDirectory(prefix="evalkit-rules-") as root:
            folder = Path(root)
            path = [str(Path(entry or ".").resolve()) for entry in sys.path]
            request = RuleRequest(asdict(self._address), self._parameters, names, path)
            (folder / REQUEST).write_text(json.dumps(asdict(request)), encoding="utf-8")
            with ChildProcess("evalkit.commands.validate.rules.worker", folder) as child:
                hang, limit = self._watch(child, folder)
            lines = _read_lines(folder)
            self._take_results(lines)
            at = lines[-1].get("begun", "") if lines else names[0]
            if at:
                text = limit or child.describe_end()
                self._results[at] = RuleResult(at, self._rules[at].sentence, "failed", text)
                self._ends.append(ProcessEnd(at, "hang" if hang else "crash", text))

    def _watch(self, child: ChildProcess, folder: Path) -> tuple[bool, str]:
        """Watches the process until it ends; whether it hangs, and the limit it exceeded or ""."""
        count, since_s = 0, 0.0
        for used in child.watch():
            if (size := len(_read_lines(folder))) > count:
                count, since_s = size, used.wall_s
            limit_s = self._limit_s if count else LOADING_S
            if used.wall_s - since_s > limit_s:
                return True, f"no answer for {limit_s:g} s"
            if used.resident_bytes > self._memory_mib * 2**20:
                return False, f"used more than {self._memory_mib} MiB"
        return False, ""

    def _take_results(self, lines: list[dict[str, Any]]) -> None:
        for line in lines:
            if line.get("outcome") == NOT_INSTALLED:
                raise NotInstalled(*line["observed"])
            if "begun" not in line:
                self._results[line["rule"]] = RuleResult(**line)


def _read_lines(folder: Path) -> list[dict[str, Any]]:
    """The complete lines that the process has written so far."""
    try:
        text = (folder / RESULTS).read_text(encoding="utf-8")
    except FileNotFoundError:
        return []
    return [json.loads(line) for line in text.splitlines(keepends=True) if line.endswith("\n")]


def _process_rule(name: str, sentence: str, ends: list[ProcessEnd]) -> RuleResult:
    """The result of a rule about the process as a whole."""
    observed = "; ".join(f"{end.rule}: {end.text}" for end in ends) or "through all rules"
    return RuleResult(name, sentence, "failed" if ends else "passed", observed)
