"""One planted fault."""

from __future__ import annotations

from dataclasses import dataclass

STATE = "rule (stateless|call-order|many-calls|buffers|instances|thread|process|later|deterministic)"
"""The rules on the state of a back end, any of which may find that an answer depends on more than the question."""


@dataclass(frozen=True)
class Fault:
    """Number, what it does wrong, and the name that a report must give it.

    ``name``: a regular expression that the broken rules, or the first difference, must match. Empty: the change is no
    fault, and the report must not fail.
    """

    number: int
    what: str
    name: str
