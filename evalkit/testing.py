"""Assertions for a plug-in's own tests: a back end, a data set or a mapper follows evalkit's rules.

from evalkit.testing import check_backend

def test_my_icp_follows_the_rules():
    check_backend("mypackage.icp:SPEC", max_iterations=20)

They also work in a script without a main guard, and in an interactive session.
"""

from __future__ import annotations

from evalkit.commands.validate.equivalence.comparison import NotEquivalent, assert_equivalent
from evalkit.commands.validate.rules import dataset_rules, mapper_rules, runner
from evalkit.commands.validate.rules.rule import RuleReport, RuleResult
from evalkit.core.errors import UnknownName
from evalkit.plugins.address import backend_at, stop_loading
from evalkit.plugins.specs import BackendSpec, DatasetSpec, MapperSpec

__all__ = [
    "NotEquivalent", "RulesBroken", "assert_equivalent", "backend_rules", "check_backend", "check_dataset",
    "check_mapper", "check_rule",
]  # fmt: skip


class RulesBroken(AssertionError):
    """A plug-in breaks rules: ``RulesBroken(label, results, number of rules checked)``."""

    def __init__(self, label: str, broken: tuple[RuleResult, ...], checked: int) -> None:
        super().__init__(label, broken, checked)

    def __str__(self) -> str:
        label, broken, checked = self.args
        lines = [f"{label} breaks {len(broken)} of {checked} rules"]
        for result in broken:
            lines += [f"  {result.rule}: {result.sentence}", f"      {result.observed}"]
        return "\n".join(lines)


def check_backend(backend: str | BackendSpec, /, **parameters: object) -> RuleReport:
    """Check all rules of a back end: a registered name, "module:SPEC", or a spec that has a name in a module.

    Raises RulesBroken with every broken rule, NotInstalled if the back end cannot run here.
    """
    stop_loading()
    return _require_unbroken(runner.check(backend, parameters))


def backend_rules(backend: str | BackendSpec, /) -> tuple[str, ...]:
    """The names of a back end's rules, for ``pytest.mark.parametrize("rule", backend_rules(SPEC))``."""
    return (*runner.RULES[backend_at(backend).kind], *runner.PROCESS_RULES)


def check_rule(backend: str | BackendSpec, rule: str, /, **parameters: object) -> RuleResult:
    """Check one rule of a back end; the first call for a back end checks all of them, the others read the results.

    Raises RulesBroken if this rule is broken, UnknownName if there is no rule of this name.
    """
    stop_loading()
    report = _find_report(backend, parameters)
    results = {one.rule: one for one in report.results}
    if rule not in results:
        raise UnknownName("rule", rule, results)
    if results[rule].outcome == "failed":
        raise RulesBroken(report.label, (results[rule],), 1)
    return results[rule]


_reports: list[tuple[str | BackendSpec, dict[str, object], RuleReport]] = []
"""What ``check_rule`` has checked in this process; a spec with parameters has no hash."""


def _find_report(backend: str | BackendSpec, parameters: dict[str, object]) -> RuleReport:
    for known, given, report in _reports:
        if known == backend and given == parameters:
            return report
    report = runner.check(backend, parameters)
    _reports.append((backend, parameters, report))
    return report


def check_dataset(dataset: str | DatasetSpec, /, frames: int = 50, **parameters: object) -> RuleReport:
    """Check all rules on the first ``frames`` frames of a data set; see ``check_backend``.

    Raises RulesBroken with every broken rule, DataMissing if its files are not here.
    """
    stop_loading()
    return _require_unbroken(dataset_rules.check(dataset, frames, parameters))


def check_mapper(mapper: str | MapperSpec, /, **parameters: object) -> RuleReport:
    """Check all rules of a mapper; see ``check_backend``. Raises RulesBroken, NotInstalled if it cannot run here."""
    stop_loading()
    return _require_unbroken(mapper_rules.check(mapper, parameters))


def _require_unbroken(report: RuleReport) -> RuleReport:
    if report.broken:
        raise RulesBroken(report.label, report.broken, len(report.results))
    return report
