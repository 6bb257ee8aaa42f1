"""Back ends under development: ICPs of the paper, each with one injected fault."""

from __future__ import annotations

import ctypes
from dataclasses import replace

import answer_faults
import numpy as np

from evalkit.core.scan import Cloud
from evalkit_baselines import paper
from evalkit_baselines.paper import icp
from evalkit_baselines.paper.icp import Icp


class Transposed(Icp):
    """Every step rotates in the wrong direction: R = U V^T as printed."""

    def _step(self, source, target, normals, share):
        theta = -super()._step(source, target, normals, share)[2]
        return icp._about(icp._centroid(source), icp._centroid(target), theta)


class Degrees(answer_faults.Degrees, Icp):
    """Returns the angle in degrees."""


class Rounded(Icp):
    """Computes on points rounded to single precision."""

    def register(self, target, source, guess):
        """Return a result from rounded points."""
        return super().register(*(Cloud(np.float32(cloud.points)) for cloud in (target, source)), guess)


class Crashes(Icp):
    """Crashes on clouds of the size of a real scan."""

    def register(self, target, source, guess):
        """Return a result, or crash."""
        if 600 < len(source) < 1200 and len(target) < 1200:
            ctypes.string_at(0)
        return super().register(target, source, guess)


def _with(make, **fixed):
    return replace(paper.SPEC, make=lambda **given: make(**{**given, **fixed}), role="")


TRANSPOSED = _with(Transposed)
DEGREES = _with(Degrees)
MANY_TO_ONE = _with(Icp, one_to_one=False)
ROUNDED_AND_FEWER = _with(Rounded, max_iterations=2)
CRASHES_ON_SCANS = _with(Crashes)
