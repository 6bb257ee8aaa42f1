"""Assertions for a plug-in's own tests: a back end or a data set follows evalkit's rules.

from evalkit.testing import check_backend

def test_my_icp_follows_the_rules():
    check_backend("mypackage.icp:SPEC", max_iterations=20)
"""

from __future__ import annotations

from evalkit.commands.validate.equivalence.comparison import NotEquivalent, assert_equivalent
from evalkit.commands.validate.rules import dataset_rules, runner
from evalkit.commands.validate.rules.rule import RuleReport, RuleResult
from evalkit.plugins.specs import BackendSpec, DatasetSpec

__all__ = ["NotEquivalent", "RulesBroken", "assert_equivalent", "check_backend", "check_dataset"]


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
    """Checks all rules of a back end: a registered name, "module:SPEC", or a spec that has a name in a module.

    Raises RulesBroken with every broken rule, NotInstalled if the back end cannot run here.
    """
    return _require_unbroken(runner.check(backend, parameters))


def check_dataset(dataset: str | DatasetSpec, /, frames: int = 50, **parameters: object) -> RuleReport:
    """Checks all rules on the first ``frames`` frames of a data set; see ``check_backend``.

    Raises RulesBroken with every broken rule, DataMissing if its files are not here.
    """
    return _require_unbroken(dataset_rules.check(dataset, frames, parameters))


def _require_unbroken(report: RuleReport) -> RuleReport:
    if report.broken:
        raise RulesBroken(report.label, report.broken, len(report.results))
    return report
