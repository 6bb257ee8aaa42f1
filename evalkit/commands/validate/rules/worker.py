"""The process that checks rules: ``python -m evalkit.commands.validate.rules.worker FOLDER`` reads its request there.

It writes the name of each rule before the check and the result after it, so that a crash can be attributed to a rule.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any, TextIO

from evalkit.commands.validate.rules import odometry_rules, registration_rules
from evalkit.commands.validate.rules.rule import Rule, check_rule
from evalkit.core.errors import NotInstalled
from evalkit.execution.subprocesses import end_with_parent
from evalkit.plugins import registry
from evalkit.plugins.address import Address, spec_at
from evalkit.plugins.parameters import Value
from evalkit.plugins.specs import BackendSpec, RegistrationSpec

REQUEST = "request.json"
RESULTS = "results.jsonl"
NOT_INSTALLED = "not installed"
"""In place of an outcome: a library that ``make`` needs is not installed."""

STARTS = "starts"
"""The first rule of every kind; if it is broken, the others cannot be checked."""

RULES: Mapping[str, Mapping[str, Rule]] = {
    "registration": registration_rules.RULES,
    "odometry": odometry_rules.RULES,
}


@dataclass(frozen=True)
class RuleRequest:
    """The back end's address and parameters, the names of the rules, and the module search path."""

    address: dict[str, str]
    parameters: dict[str, Value]
    rules: list[str]
    path: list[str]


def main() -> int:
    """Checks the rules of the request in the folder named on the command line, writing lines to ``results.jsonl``."""
    end_with_parent()
    folder = Path(sys.argv[1]).resolve()  # a back end may change the working directory
    request = RuleRequest(**json.loads((folder / REQUEST).read_text(encoding="utf-8")))
    sys.path.extend(entry for entry in request.path if entry not in sys.path)
    spec = spec_at(Address(**request.address), BackendSpec, registry.backend)
    fixture = _make_fixture(spec, request.parameters)
    with (folder / RESULTS).open("a", encoding="utf-8") as file:
        for name in request.rules:
            _write_line(file, {"begun": name})
            result = _check(RULES[spec.kind][name], fixture)
            _write_line(file, result)
            if name == STARTS and result["outcome"] != "passed":
                break
    return 0


def _make_fixture(spec: BackendSpec, parameters: Mapping[str, Value]) -> object:
    make = partial(spec.make, **parameters)
    if isinstance(spec, RegistrationSpec):
        return registration_rules.RegistrationFixture(make)
    return odometry_rules.OdometryFixture(make, spec.role)


def _check(rule: Rule, fixture: object) -> dict[str, Any]:
    try:
        return asdict(check_rule(rule, fixture))
    except NotInstalled as error:
        return {"outcome": NOT_INSTALLED, "observed": error.args}


def _write_line(file: TextIO, line: Mapping[str, Any]) -> None:
    file.write(json.dumps(line) + "\n")
    file.flush()


if __name__ == "__main__":
    sys.exit(main())
