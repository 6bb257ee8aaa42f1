"""A registration under test: new objects, and the answers to questions drawn from a seed."""

from __future__ import annotations

import itertools
import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np

from evalkit.commands.validate.rules.endurance import ResourceUse, measure_resource_use
from evalkit.commands.validate.rules.process_state import StateWatch
from evalkit.commands.validate.rules.scenes import CloudPair, drawn_pair
from evalkit.commands.validate.rules.state_rules import Bits, answer_bits
from evalkit.core.pose import Pose
from evalkit.core.scan import Cloud
from evalkit.plugins.parameters import Parameter, Value
from evalkit.plugins.protocols import Registration
from evalkit.plugins.specs import RunsIn


class RegistrationFixture:
    """A back end under test, with valid questions drawn from a seed.

    ``parameters``, ``given``: what it declares, and the complete values it is made with. ``elsewhere``: the arguments
    of ``state_rules.answers_elsewhere``, by which another process finds the same back end; {} if none can.
    ``note_progress(*step)``: what a rule calls before each of several calls that are long, from which the time limit
    then counts, or that may end the process, where a step in words says in which one it was. ``runs_in``: where it
    computes.
    """

    def __init__(
        self,
        make: Callable[..., Registration],
        seed: int = 0,
        parameters: Sequence[Parameter] = (),
        given: Mapping[str, Value] = {},
        elsewhere: Mapping[str, Any] = {},
        runs_in: RunsIn = "evalkit",
    ) -> None:
        self._make, self.seed, self.elsewhere = make, seed, elsewhere
        self.runs_in: RunsIn = runs_in
        self._parameters, self._given = parameters, given
        self.asked_s = math.inf
        self.watch = StateWatch()
        self.worn: Registration | None = None  # the object of the endurance run
        self.note_progress: Callable[..., object] = lambda *_: None

    def make(self) -> Registration:
        """A new object."""
        made = self._make(**self._given)
        self.watch.note_loaded()
        return made

    def make_with(self, **changes: Value) -> Registration:
        """A new object with some parameters changed."""
        return self._make(**{**self._given, **changes})

    def variants(self) -> Iterator[dict[str, Value]]:
        """Changes of each numeric parameter of the method, up and down, within its bounds."""
        for one in self._parameters:
            value = self._given.get(one.name, one.default)
            if isinstance(value, (int, float)) and not isinstance(value, bool) and not one.name.endswith("_timeout_s"):
                for factor in (2.0, 0.25):
                    changed = type(value)(min(max(factor * value, one.low), one.high))
                    if changed not in (value, 0):
                        yield {one.name: changed}

    @cached_property
    def shared(self) -> Registration:
        """The object that most rules share: a registration is stateless."""
        return self.make()

    def renew(self) -> None:
        """Share a new object from here on: the one so far has ended."""
        self.__dict__.pop("shared", None)

    @cached_property
    def questions(self) -> list[CloudPair]:
        """Questions drawn from the seed: three of one size, others larger, smaller, without pairs, answered at once."""
        rng = np.random.default_rng([self.seed, 1])
        sizes = [(60, 40)] * 3 + [(90, 70), (40, 60), (300, 200), (5, 3), (12, 1)]
        pairs = [drawn_pair(rng, *size) for size in sizes]
        far = pairs[0]
        nothing = CloudPair(far.target, Cloud(far.source.points + 50.0), far.truth, far.guess)
        answered = replace(far, target=Cloud(far.truth.transform(far.source.points)), guess=far.truth)
        return [*pairs, nothing, answered]

    @cached_property
    def first_answers(self) -> list[Bits]:
        """The answers of new objects to the questions."""
        answers = [answer_bits(self.make(), pair) for pair in self.questions]
        self.asked_s = time.monotonic()
        return answers

    @cached_property
    def endurance(self) -> ResourceUse:
        """What many calls do to the process."""

        def calls(one: Registration) -> Callable[[], object]:
            cycle = itertools.cycle(self.questions)
            self.worn = one
            return lambda: answer_bits(one, next(cycle))

        return measure_resource_use(self.make, calls, self.watch)

    def register(self, pair: CloudPair) -> Pose:
        """The answer to a pair."""
        return self.shared.register(pair.target, pair.source, pair.guess).target_from_source
