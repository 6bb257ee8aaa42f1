"""Injected faults of mappers are detected and named."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from evalkit.commands.validate.equivalence.comparison import mapper_equivalence
from evalkit.commands.validate.equivalence.margins import Margin
from evalkit.commands.validate.rules.scenes import drive
from evalkit.core.errors import BackendFailed
from evalkit.core.ground_truth import Truth
from evalkit.core.scan import Frame
from evalkit.plugins import registry
from evalkit.plugins.specs import DatasetSpec
from evalkit_baselines import paper
from evalkit_baselines.paper.grid import LogOddsGrid


class Drive:
    """The drive through the L-shaped room of the rules, as a sequence."""

    def __len__(self) -> int:
        return 12

    def frames(self) -> Iterator[Frame]:
        return iter(drive(scans=12).frames)

    def truth(self) -> Truth:
        return Truth("unknown")

    def notes(self) -> dict[str, int]:
        return {}


ROOM = DatasetSpec(Drive, "a drive", "", "", "", "MIT")


class EndIsFree(LogOddsGrid):
    def _count_once(self, beams, passed, ended, hits, size):
        free, occupied = super()._count_once(beams, passed, ended, hits, size)
        return free, np.zeros_like(occupied)


class Sixteenths(LogOddsGrid):
    def grid(self):
        drawn = super().grid()
        return replace(drawn, log_odds=np.rint(drawn.log_odds * 2048) / 2048)


class Rounded(LogOddsGrid):
    def grid(self):
        drawn = super().grid()
        return replace(drawn, log_odds=np.nextafter(drawn.log_odds, np.float32(9.0)))


class LFreeSubtracted(LogOddsGrid):
    def _count_once(self, beams, passed, ended, hits, size):
        free, occupied = super()._count_once(beams, passed, ended, hits, size)
        return -free, occupied


class RaisesAtOnce(LogOddsGrid):
    def update(self, scan, world_from_sensor):
        raise ZeroDivisionError("no cells")


MAPPERS = {
    "wrong sign of l_free": (LFreeSubtracted, "sign", 1, "A adds along a beam what B subtracts"),
    "no occupied ends": (EndIsFree, "endpoint rule", 1, "different at their ends"),
    "another traversal": (lambda **given: LogOddsGrid(**{**given, "traversal": "bresenham"}), "traversal", 1, ""),
    "a nearer bound": (lambda **given: LogOddsGrid(**{**given, "l_max": 2.0}), "clamp", 3, "B stops at 2"),
    "every beam counts": (lambda **given: LogOddsGrid(**{**given, "once_per_scan": False}), "counting rule", 1, ""),
    "another l_free": (lambda **given: LogOddsGrid(**{**given, "l_free": -0.4}), "increment", 1, "0.4723 times"),
    "fixed point": (Sixteenths, "precision", 1, "B counts in steps of 2^-11"),
    "larger cells": (lambda **given: LogOddsGrid(**{**given, "resolution_m": 0.1}), "different", 1, "0.05 m against"),
    "a crash": (RaisesAtOnce, "different", 1, "B raises ZeroDivisionError: no cells"),
}


@pytest.mark.parametrize("name", MAPPERS)
def test_an_injected_fault_of_a_mapper_is_detected_and_named(name):
    make, kind, scan, words = MAPPERS[name]
    found = mapper_equivalence("log-odds", replace(paper.MAPPER, make=make), ROOM, scans=5)
    assert found.first is not None
    assert (found.first.kind, found.first.scan) == (kind, scan), str(found)
    assert words in found.first.what
    assert not found.equivalent


def test_a_mapper_is_equal_to_itself_and_fixed_point_is_within_half_a_step():
    assert mapper_equivalence("log-odds", "log-odds", ROOM, scans=5).first is None
    fixed = replace(paper.MAPPER, make=Sixteenths)
    assert mapper_equivalence("log-odds", fixed, ROOM, scans=5, margin=Margin(log_odds=2.0**-11)).equivalent


def test_a_last_digit_is_equal_and_named_where_even_that_must_agree():
    rounded = replace(paper.MAPPER, make=Rounded)
    assert mapper_equivalence("log-odds", rounded, ROOM, scans=2).equivalent
    found = mapper_equivalence("log-odds", rounded, ROOM, scans=2, margin=Margin(log_odds=1e-12))
    assert found.first is not None
    assert (found.first.kind, found.equivalent) == ("precision", False)
    assert "within rounding to float32" in found.first.what


def test_a_failure_of_the_first_mapper_raises_an_error_with_its_label():
    with pytest.raises(BackendFailed, match="A: scan 1: raises ZeroDivisionError: no cells"):
        mapper_equivalence(replace(paper.MAPPER, make=RaisesAtOnce), "log-odds", ROOM, scans=3)


def test_the_compiled_mapper_is_equivalent_to_the_python_implementation():
    name = "embedded-log-odds"
    if name not in registry.names("mappers"):
        pytest.skip(f"no mapper named '{name}' is registered")
    if why := registry.mapper(name).missing():
        pytest.skip(why)
    found = mapper_equivalence("log-odds", name, ROOM, scans=8, margin=Margin(log_odds=1e-2))
    assert found.equivalent, str(found)
