"""Asks a back end whether it keeps the rules, in a process apart: a crash and a hang are broken rules like others."""

from __future__ import annotations

import json
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from evalkit.commands.validate.rules.rule import Conformance, Rule, Verdict, not_asked
from evalkit.commands.validate.rules.worker import NOT_INSTALLED, REQUEST, RULES, STARTS, VERDICTS, Request
from evalkit.core.errors import BackendFailed, NotInstalled, UnknownName
from evalkit.execution.subprocesses import ChildProcess
from evalkit.plugins import registry
from evalkit.plugins.address import Address, address_of, spec_at
from evalkit.plugins.parameters import Value, resolve_parameters
from evalkit.plugins.specs import BackendSpec

PATIENCE = 3
"""After so many ends of the process the rest is not asked any more."""

LOADING_S = 60.0
"""What the process may take before its first question: Python and the plug-in's module, not a rule's fault."""

_NO_ANSWER = "no answer"

RECORDED = (
    "hold it against the truth and others (evalkit compare RECORDING --backends 'wheel-odometry,file:...'), or check "
    "the program that made it (exec:..., lib:...)"
)
"""What can be done with a file of results instead."""

Heard = Callable[[Verdict], None]


def check(
    backend: str | BackendSpec,
    parameters: Mapping[str, object] | None = None,
    limit_s: float = 30.0,
    memory_mib: int = 2048,
    only: Sequence[str] = (),
    heard: Heard = lambda _verdict: None,
) -> Conformance:
    """What every rule finds about a back end: a registered name, "module:SPEC", or a spec.

    ``limit_s``: what one rule may take (s, wall clock, the library's import included). ``memory_mib``: what the process
    may hold. ``only``: names of rules; () asks all. ``heard`` is told each verdict as it comes. Raises NotInstalled
    where the back end cannot run here, BackendFailed where it is a file of results, BadParameter or UnknownName for
    parameters and rules.
    """
    address, spec = address_of(backend), spec_of(backend)
    if spec.recorded:
        raise BackendFailed(address.label, "holds results made elsewhere: there is no behaviour to check", RECORDED)
    if why := spec.missing():
        raise NotInstalled(address.label, "cannot be checked here", why)
    complete = resolve_parameters(address.label, spec.parameters, parameters or {})
    rules = _chosen(RULES[spec.kind], only)
    return Conformance(address.label, _Examination(address, rules, complete, limit_s, memory_mib, heard).verdicts())


def spec_of(backend: str | BackendSpec) -> BackendSpec:
    """The spec of a registered name, of "module:SPEC", or itself; NotInstalled where there is none."""
    return spec_at(address_of(backend), BackendSpec, registry.backend)


def _chosen(rules: Mapping[str, Rule], only: Sequence[str]) -> dict[str, Rule]:
    for name in only:
        if name not in rules:
            raise UnknownName("rule", name, rules)
    return {name: rule for name, rule in rules.items() if name in only or not only}


class _Examination:
    """One back end asked all rules of its kind; one process serves until it ends before its time."""

    def __init__(
        self,
        address: Address,
        rules: Mapping[str, Rule],
        parameters: dict[str, Value],
        limit_s: float,
        memory_mib: int,
        heard: Heard,
    ) -> None:
        self._address, self._parameters = address, parameters
        self._rules = rules
        self._limit_s, self._memory_mib = limit_s, memory_mib
        self._heard = heard
        self._verdicts: list[Verdict] = []
        self._ends: list[str] = []
        self._hangs: list[str] = []
        self._crashes: list[str] = []

    def verdicts(self) -> tuple[Verdict, ...]:
        """All verdicts; the last two are about what is only seen from outside."""
        waiting = list(self._rules)
        while waiting:
            if reason := self._given_up():
                self._add(not_asked((self._rules[name] for name in waiting), reason))
                break
            self._asked(waiting)
            waiting = [name for name in self._rules if name not in {found.rule for found in self._verdicts}]
        self._add([
            _through("alive", "Its process lives through all questions, within the memory allowed.", self._crashes),
            _through("in-time", "It always answers.", self._hangs),
        ])  # fmt: skip
        return tuple(self._verdicts)

    def _given_up(self) -> str:
        if any(found.rule == STARTS and found.outcome == "failed" for found in self._verdicts):
            return "it does not start"
        return f"given up after {PATIENCE} ends of its process" if len(self._ends) >= PATIENCE else ""

    def _asked(self, names: list[str]) -> None:
        """Asks until all are answered or the process ends; then the rule it was at is broken."""
        with tempfile.TemporaryDirectory(prefix="evalkit-check-") as place:
            folder = Path(place)
            path = [str(Path(entry or ".").resolve()) for entry in sys.path]
            request = Request(asdict(self._address), self._parameters, names, path)
            (folder / REQUEST).write_text(json.dumps(asdict(request)), encoding="utf-8")
            with ChildProcess("evalkit.commands.validate.rules.worker", folder) as child:
                limit = self._watched(child, folder)
            self._told(folder)
            lines = _lines(folder)
            at = lines[-1].get("begun", "") if lines else names[0]
            if at:
                self._ended(self._rules[at], limit or child.describe_end())

    def _watched(self, child: ChildProcess, folder: Path) -> str:
        """Waits for the process's end, telling each verdict as it comes; which limit it broke, or ""."""
        told, since_s = 0, 0.0
        for used in child.watch():
            if (size := len(_lines(folder))) > told:
                told, since_s = size, used.wall_s
                self._told(folder)
            limit_s = self._limit_s if told else LOADING_S
            if used.wall_s - since_s > limit_s:
                return f"{_NO_ANSWER} for {limit_s:g} s"
            if used.resident_bytes > self._memory_mib * 2**20:
                return f"used more than {self._memory_mib} MiB"
        return ""

    def _told(self, folder: Path) -> None:
        """Takes in the verdicts that are new."""
        known = {found.rule for found in self._verdicts}
        for line in _lines(folder):
            if line.get("outcome") == NOT_INSTALLED:
                raise NotInstalled(*line["observed"])
            if "begun" not in line and line["rule"] not in known:
                self._add([Verdict(**line)])

    def _ended(self, at: Rule, how: str) -> None:
        self._add([Verdict(at.name, at.sentence, "failed", how)])
        self._ends.append(how)
        (self._hangs if how.startswith(_NO_ANSWER) else self._crashes).append(f"{at.name}: {how}")

    def _add(self, found: list[Verdict]) -> None:
        for one in found:
            self._verdicts.append(one)
            self._heard(one)


def _lines(folder: Path) -> list[dict[str, Any]]:
    """What the process has told so far; a line that is not yet complete is not there yet."""
    try:
        text = (folder / VERDICTS).read_text(encoding="utf-8")
    except FileNotFoundError:
        return []
    return [json.loads(line) for line in text.splitlines(keepends=True) if line.endswith("\n")]


def _through(name: str, sentence: str, ends: list[str]) -> Verdict:
    """The verdict of a rule that every question asks along the way."""
    return Verdict(name, sentence, "failed" if ends else "passed", "; ".join(ends) or "through all questions")
