"""For the tests of your own package: does your back end or data set keep the rules evalkit asks for?

from evalkit.testing import check_backend

def test_my_icp_keeps_the_rules():
    check_backend("mypackage.icp:SPEC", max_iterations=20)
"""

from __future__ import annotations

from evalkit.commands.validate.equivalence.comparison import NotEquivalent, assert_equivalent
from evalkit.commands.validate.rules import dataset_rules
from evalkit.commands.validate.rules import runner as conformance
from evalkit.commands.validate.rules.rule import Conformance, Verdict
from evalkit.plugins.specs import BackendSpec, DatasetSpec

__all__ = ["ConformanceError", "NotEquivalent", "assert_equivalent", "check_backend", "check_dataset"]


class ConformanceError(AssertionError):
    """Rules that are not kept: ``ConformanceError(label, verdicts, asked)``."""

    def __init__(self, label: str, broken: tuple[Verdict, ...], asked: int) -> None:
        super().__init__(label, broken, asked)

    def __str__(self) -> str:
        label, broken, asked = self.args
        lines = [f"{label} breaks {len(broken)} of {asked} rules"]
        for verdict in broken:
            lines += [f"  {verdict.rule}: {verdict.sentence}", f"      {verdict.observed}"]
        return "\n".join(lines)


def check_backend(backend: str | BackendSpec, /, **parameters: object) -> Conformance:
    """What every rule finds about a back end: a registered name, "module:SPEC" or a spec that stands in a module.

    Raises ConformanceError with every broken rule, NotInstalled where the back end cannot run here.
    """
    return _kept(conformance.check(backend, parameters))


def check_dataset(dataset: str | DatasetSpec, /, frames: int = 50, **parameters: object) -> Conformance:
    """What every rule finds about the first ``frames`` frames of a data set; see ``check_backend``.

    Raises ConformanceError with every broken rule, DataMissing where its files are not here.
    """
    return _kept(dataset_rules.check(dataset, frames, parameters))


def _kept(found: Conformance) -> Conformance:
    if found.broken:
        raise ConformanceError(found.label, found.broken, len(found.verdicts))
    return found
