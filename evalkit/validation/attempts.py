"""A back end asked from many wrong guesses about pairs of scans with a known answer: the work behind a basin."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from evalkit import registry
from evalkit.fingerprint import fingerprint
from evalkit.protocols import BackendSpec, Registration, Value
from evalkit.se2 import Floats
from evalkit.study.ledger import Job
from evalkit.types import Pose
from evalkit.validation import basin, surroundings
from evalkit.validation.address import address_of, spec_at
from evalkit.validation.rules import raised
from evalkit.validation.surroundings import Seen

AT_ONCE = 512
"""Attempts in one job: a few seconds of a compiled back end."""


@dataclass(frozen=True)
class Trials:
    """What all back ends are asked alike at one place; metres and radians.

    ``offsets``: how many guesses, spread over ``pairs`` pairs of scans with ``beams`` beams and ``noise_m`` of noise.
    """

    place: str
    offsets: int
    pairs: int
    beams: int
    noise_m: float
    reach_m: float
    reach_rad: float
    seed: int

    def rng(self) -> np.random.Generator:
        """A generator that starts the same for the same trials."""
        number = list(surroundings.PLACES).index(surroundings.place(self.place).name)
        return np.random.default_rng([self.seed, number])

    def seen(self) -> tuple[Seen, ...]:
        """The pairs of scans; attempt i is about pair i modulo their number."""
        where, rng = surroundings.place(self.place), self.rng()
        return tuple(surroundings.seen(where, rng, self.beams, self.noise_m) for _ in range(self.pairs))

    def drawn(self) -> Floats:
        """By how much each guess (N, 3) is off, along the world's axes."""
        return basin.offsets(self.offsets, self.reach_m, self.reach_rad, np.random.default_rng([self.seed, 99]))

    def truths(self, seen: tuple[Seen, ...]) -> tuple[Floats, Floats]:
        """For each attempt the true ``target_from_source`` and the ``world_from_target`` (both (N, 3))."""
        of = np.arange(self.offsets) % self.pairs
        rows = np.array([pair.target_from_source.row for pair in seen])
        return rows[of], np.array([pair.world_from_target.row for pair in seen])[of]


def jobs(label: str, spec: BackendSpec, values: Mapping[str, Value], trials: Trials) -> tuple[Job, ...]:
    """The jobs that ask one back end; together their answers are those of all attempts."""
    code = fingerprint((spec.make.__module__,), ("numpy", "scipy", *spec.requires)) + spec.digest
    return tuple(
        Job(
            f"{label} {trials.place} {begin}",
            f"{__name__}:answers",
            {
                "backend": label,
                "values": dict(values),
                "trials": vars(trials),
                "begin": begin,
                "end": min(begin + AT_ONCE, trials.offsets),
                "code": code,
            },
        )
        for begin in range(0, trials.offsets, AT_ONCE)
    )


def answers(
    *, backend: str, values: Mapping[str, Value], trials: Mapping[str, Any], begin: int, end: int, code: str
) -> dict[str, Any]:
    """What a back end answers to attempts [begin, end): "rows" (N, 3) with nan for none, "claimed" (N,), and "reason".

    ``code`` changes with the back end's own code, so that old answers are not taken for new ones. "reason": what it
    raised first, "" if nothing.
    """
    del code
    registration: Registration = spec_of(backend).make(**values)
    asked = Trials(**trials)
    seen = asked.seen()
    guesses = basin.guesses(asked.drawn(), *asked.truths(seen))
    rows, claimed, reason = np.full((end - begin, 3), np.nan), np.zeros(end - begin, dtype=np.bool_), ""
    for number in range(begin, end):
        pair = seen[number % asked.pairs]
        try:
            match = registration.register(pair.target, pair.source, Pose.of(guesses[number]))
            rows[number - begin] = match.target_from_source.row
            claimed[number - begin] = match.converged
        except Exception as error:  # noqa: BLE001 - a third party's crash is an answer it did not give
            reason = reason or raised(error)
    return {"rows": rows, "claimed": claimed, "reason": reason}


def spec_of(backend: str) -> BackendSpec:
    """The back end of a registered name or of "module:SPEC"."""
    return spec_at(address_of(backend), BackendSpec, registry.backend)
