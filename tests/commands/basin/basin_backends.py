"""Back ends that keep the guess, raise, or end their process, found by ``basin_backends:SPEC``."""

import os

from evalkit.core.match import Match
from evalkit.plugins.specs import RegistrationSpec


class KeepsGuess:
    def register(self, target, source, guess):
        return Match(guess, converged=True, iterations=0, error=0.0, inliers=len(source))


class Raises:
    def register(self, target, source, guess):
        raise RuntimeError("it is out of tune")


class EndsItsProcess:
    def register(self, target, source, guess):
        os._exit(3)


KEEPS = RegistrationSpec(KeepsGuess, "", "", "")
RAISES = RegistrationSpec(Raises, "", "", "")
ENDS = RegistrationSpec(EndsItsProcess, "", "", "")
