"""Rules asked in this process: ``python -m evalkit.commands.validate.rules.worker FOLDER`` reads the request there.

Each rule's beginning and verdict are on disk before the next one begins, so that whatever ends this process, it is
known which question did.
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
from evalkit.commands.validate.rules.rule import Rule, verdict
from evalkit.core.errors import NotInstalled
from evalkit.execution.subprocesses import end_with_parent
from evalkit.plugins import registry
from evalkit.plugins.address import Address, spec_at
from evalkit.plugins.parameters import Value
from evalkit.plugins.specs import BackendSpec, RegistrationSpec

REQUEST = "request.json"
VERDICTS = "verdicts.jsonl"
NOT_INSTALLED = "not installed"
"""In place of an outcome: what ``make`` needs turns out to be absent."""

STARTS = "starts"
"""The first rule of every kind; where it is broken, the others cannot be asked."""

RULES: Mapping[str, Mapping[str, Rule]] = {
    "registration": registration_rules.RULES,
    "odometry": odometry_rules.RULES,
}


@dataclass(frozen=True)
class Request:
    """What to ask: the back end's address and parameters, the rules' names, and where modules are looked for."""

    address: dict[str, str]
    parameters: dict[str, Value]
    rules: list[str]
    path: list[str]


def main() -> int:
    """Asks the rules of the request in the folder named on the command line, one line each to ``verdicts.jsonl``."""
    end_with_parent()
    folder = Path(sys.argv[1]).resolve()  # a back end may change the working directory
    request = Request(**json.loads((folder / REQUEST).read_text(encoding="utf-8")))
    sys.path.extend(entry for entry in request.path if entry not in sys.path)
    spec = spec_at(Address(**request.address), BackendSpec, registry.backend)
    bench = _bench(spec, request.parameters)
    with (folder / VERDICTS).open("a", encoding="utf-8") as file:
        for name in request.rules:
            _tell(file, {"begun": name})
            answer = _answer(RULES[spec.kind][name], bench)
            _tell(file, answer)
            if name == STARTS and answer["outcome"] != "passed":
                break
    return 0


def _bench(spec: BackendSpec, parameters: Mapping[str, Value]) -> object:
    make = partial(spec.make, **parameters)
    if isinstance(spec, RegistrationSpec):
        return registration_rules.Bench(make)
    return odometry_rules.Bench(make, spec.role)


def _answer(rule: Rule, bench: object) -> dict[str, Any]:
    try:
        return asdict(verdict(rule, bench))
    except NotInstalled as error:
        return {"outcome": NOT_INSTALLED, "observed": error.args}


def _tell(file: TextIO, line: Mapping[str, Any]) -> None:
    file.write(json.dumps(line) + "\n")
    file.flush()


if __name__ == "__main__":
    sys.exit(main())
