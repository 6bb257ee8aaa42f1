"""What a Registration must keep, rule by rule, each asked with a small scene whose answer is known."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import astuple
from functools import cached_property

import numpy as np

from evalkit.commands.validate.rules.memory_leak import grown_bytes
from evalkit.commands.validate.rules.rule import Broken, Rule, raised, table
from evalkit.commands.validate.rules.scenes import Pair, away, clear_pair, noisy_pair, told, wall_pair
from evalkit.core.match import Match
from evalkit.core.pose import Pose
from evalkit.core.scan import Cloud
from evalkit.plugins.protocols import Registration

EXACT_M = 0.02
"""Without noise and with a good guess: 1 cm and 0.15 degrees. Voxels and stop rules may blur that much."""

SAME_M = 0.04
"""The same question asked otherwise, with noise: other pairs and other cells, but less than the noise of one point."""

SHUFFLED_M = 0.01
"""The order of the points may change the last bits of a sum, and which point of a cell is kept."""

MENDED = 0.75
"""At most this share of the guess's error may be left: a coarse stop rule may stop early, but it must have moved."""

LEAK_BYTES = 100_000
"""Per call: half a gigabyte in 5,000 scans. Less is not told from what an allocator holds back."""

FAR = Pose(5.0, -3.0, 2.0)
NEAR_ENOUGH = 0.2
"""Share of a true length, or radians, by which an answer may be wrong before its unit or sign is in doubt."""


class Bench:
    """A back end on the bench: makes it, and asks it with everything as it should be."""

    def __init__(self, make: Callable[[], Registration]) -> None:
        self.make = make

    @cached_property
    def one(self) -> Registration:
        """The object most rules share: a registration is stateless."""
        return self.make()

    def ask(self, pair: Pair) -> Pose:
        """Its answer to a pair."""
        return self.one.register(pair.target, pair.source, pair.guess).target_from_source


def starts(bench: Bench) -> str:
    """It can be made, and answers a sound Match."""
    pair = clear_pair()
    match = bench.make().register(pair.target, pair.source, pair.guess)
    sound(match)
    return f"a Match of {match.inliers} pairs"


def sound(match: object) -> Match:
    """The same Match, if it is one and its values are possible; Broken otherwise."""
    if not isinstance(match, Match):
        raise Broken(f"register() answers a {type(match).__name__}, expected an evalkit.Match")
    pose = match.target_from_source
    if not isinstance(pose, Pose) or not np.isfinite(pose.row).all():
        raise Broken(f"target_from_source is {pose!r}, expected a finite evalkit.Pose")
    if not isinstance(match.converged, bool):
        raise Broken(f"converged is {match.converged!r}, expected True or False")
    if match.iterations < 0 or match.inliers < 0 or match.error < 0.0:
        raise Broken(
            f"iterations {match.iterations}, inliers {match.inliers}, error {match.error}: expected none below 0"
        )
    return match


def identity(bench: Bench) -> str:
    """Same cloud, identity guess."""
    cloud = noisy_pair().target
    answer = bench.ask(Pair(cloud, cloud, Pose(), Pose()))
    return _near(answer, Pose(), EXACT_M, "the identity")


def recovers(bench: Bench) -> str:
    """A known motion, without noise."""
    pair = clear_pair(Pose(0.2, -0.15, -0.2))
    return _near(bench.ask(pair), pair.truth, EXACT_M, "the truth")


def moves(bench: Bench) -> str:
    """A guess 5 cm and 2 degrees off must be mended on noisy, planar scans."""
    pair = noisy_pair()
    answer = bench.ask(pair)
    before, left = away(pair.guess, pair.truth), away(answer, pair.truth)
    if answer == pair.guess:
        raise Broken(
            f"the guess came back unchanged, {100 * before:.0f} cm off half a room away; if a 3D library estimates "
            "normals of points at z = 0, they stand upright and hold nothing: "
            "evalkit.odometry.planar3d makes them in the plane"
        )
    if left > MENDED * before:
        raise Broken(f"of {100 * before:.1f} cm half a room away, {100 * left:.1f} cm were left")
    return f"of {100 * before:.1f} cm half a room away, {100 * left:.1f} cm were left"


def metres(bench: Bench) -> str:
    """A motion of 0.3 m comes back as 0.3."""
    pair = clear_pair()
    answer = bench.ask(pair)
    wanted, found = math.hypot(pair.truth.x, pair.truth.y), math.hypot(answer.x, answer.y)
    if abs(found - wanted) > NEAR_ENOUGH * wanted:
        hints = {1000.0: "millimetres", 100.0: "centimetres", 0.001: "kilometres", 0.01: "hundreds of metres"}
        unit = next((u for f, u in hints.items() if abs(found / f - wanted) < NEAR_ENOUGH * wanted), "")
        raise Broken(f"{wanted:g} m came back as {found:.4g}" + (f": the answer is in {unit}?" if unit else ""))
    return f"{wanted:g} m came back as {found:.4f}"


def radians(bench: Bench) -> str:
    """A turn of 0.3 rad comes back as 0.3."""
    pair = clear_pair()
    answer = bench.ask(pair)
    return turn_in_radians(answer.theta, pair.truth.theta)


def turn_in_radians(found: float, wanted: float) -> str:
    """What was observed of a turn (rad); Broken with a guess at the reason where it is wrong."""
    if abs(found - wanted) <= NEAR_ENOUGH:
        return f"{wanted:.3g} rad came back as {found:.4f}"
    hint = ""
    if abs(Pose(0.0, 0.0, found - math.degrees(wanted)).theta) < NEAR_ENOUGH:
        hint = f": these are {math.degrees(wanted):.1f} degrees, taken for radians?"
    elif abs(found + wanted) <= NEAR_ENOUGH:
        hint = ": it has the wrong sign?"
    raise Broken(f"{wanted:.3g} rad came back as {found:.4f}{hint}")


def direction(bench: Bench) -> str:
    """target_from_source, not its inverse."""
    pair = clear_pair()
    answer = bench.ask(pair)
    if away(answer, pair.truth.inverse()) < away(answer, pair.truth):
        raise Broken(f"{told(answer)} is source_from_target; target_from_source is {told(pair.truth)}")
    return f"{told(answer)} takes the source's points to the target's frame"


def inverse(bench: Bench) -> str:
    """Target and source exchanged."""
    pair = clear_pair()
    swapped = Pair(pair.source, pair.target, pair.truth.inverse(), pair.guess.inverse())
    return _near(bench.ask(swapped), bench.ask(pair).inverse(), EXACT_M, "the inverse")


def equivariance(bench: Bench) -> str:
    """The answer moves along with either cloud."""
    pair = noisy_pair()
    answer = bench.ask(pair)
    target = Pair(Cloud(FAR.transform(pair.target.points)), pair.source, FAR, FAR @ pair.guess)
    source = Pair(pair.target, Cloud(FAR.inverse().transform(pair.source.points)), FAR, pair.guess @ FAR)
    first = _near(bench.ask(target), FAR @ answer, SAME_M, "the answer moved with the target")
    return f"{first}; {_near(bench.ask(source), answer @ FAR, SAME_M, 'the answer moved with the source')}"


def order(bench: Bench) -> str:
    """Shuffled points."""
    pair, rng = noisy_pair(), np.random.default_rng(1)
    shuffled = Pair(
        Cloud(rng.permutation(pair.target.points)), Cloud(rng.permutation(pair.source.points)), pair.truth, pair.guess
    )
    return _near(bench.ask(shuffled), bench.ask(pair), SHUFFLED_M, "the answer in the first order")


def duplicates(bench: Bench) -> str:
    """Every point twice."""
    pair = noisy_pair()
    doubled = Pair(_twice(pair.target), _twice(pair.source), pair.truth, pair.guess)
    return _near(bench.ask(doubled), bench.ask(pair), SAME_M, "the answer with every point once")


def empty(bench: Bench) -> str:
    """No points."""
    none, some = Cloud(np.zeros((0, 2))), clear_pair().target
    return _survives(bench, {"empty source": (some, none), "empty target": (none, some), "both empty": (none, none)})


def few_points(bench: Bench) -> str:
    """One point, two points."""
    some = clear_pair().target
    one, two, same = (Cloud(some.points[rows]) for rows in ([0], [0, 1], [3] * 20))
    return _survives(
        bench,
        {"one point": (some, one), "one point as target": (one, some), "one point each": (one, one),
         "two points": (some, two), "two points as target": (two, some), "20 times the same point": (some, same),
         "20 times the same point as target": (same, some)},
    )  # fmt: skip


def wall(bench: Bench) -> str:
    """A single straight wall."""
    pair = wall_pair()
    try:
        answer = sound(bench.one.register(pair.target, pair.source, pair.guess)).target_from_source
    except Broken:
        raise
    except Exception as error:  # noqa: BLE001 - refusing is allowed, and it is the back end's own exception
        return raised(error)
    if away(answer, pair.truth) > 1.0:
        raise Broken(f"5 cm beside a single wall it flies off to {told(answer)}")
    return f"answers {told(answer)}; across the wall {told(pair.truth)} is right"


def hopeless(bench: Bench) -> str:
    """Two clouds 100 m apart."""
    pair = noisy_pair()
    away_100 = Pose(100.0, 0.0, 0.0)
    match = sound(bench.one.register(pair.target, Cloud(away_100.transform(pair.source.points)), Pose()))
    wrong = away(match.target_from_source @ away_100, pair.truth)
    if match.converged and wrong > 1.0:
        raise Broken(f"clouds 100 m apart: says converged on {match.inliers} pairs, and is {wrong:.0f} m wrong")
    return f"clouds 100 m apart: converged is {match.converged}, {match.inliers} pairs, {wrong:.1f} m wrong"


def inliers(bench: Bench) -> str:
    """How many pairs the answer stands on."""
    pair = clear_pair()
    match = bench.one.register(pair.target, pair.source, pair.guess)
    count = len(pair.source)
    if not count // 2 <= match.inliers <= count:
        raise Broken(
            f"{count} points that all have a partner: inliers {match.inliers}; where there are few, evalkit's front "
            "end keeps its guess"
        )
    return f"{match.inliers} of {count} points that all have a partner"


def stateless(bench: Bench) -> str:
    """A, B, A."""
    a, b = noisy_pair(), clear_pair()
    one = bench.make()
    first = one.register(a.target, a.source, a.guess)
    one.register(b.target, b.source, b.guess)
    one.register(a.source, a.target, a.guess)
    return _same(first, one.register(a.target, a.source, a.guess), "after other questions")


def deterministic(bench: Bench) -> str:
    """The same question, asked of fresh objects."""
    pair = noisy_pair()
    first, *others = (bench.make().register(pair.target, pair.source, pair.guess) for _ in range(4))
    for other in others:
        _same(first, other, "of a fresh object")
    return "4 fresh objects agree to the bit"


def read_only(bench: Bench) -> str:
    """Its arguments."""
    pair = noisy_pair()
    before = pair.target.points.tobytes(), pair.source.points.tobytes()
    try:
        bench.one.register(pair.target, pair.source, pair.guess)
    except ValueError as error:
        if "read-only" in str(error) or "not writeable" in str(error):
            raise Broken(f"it tries to write into a cloud's points ({error}): work on a copy") from error
        raise
    if (pair.target.points.tobytes(), pair.source.points.tobytes()) != before:
        raise Broken("a cloud's points are not the same after the call: work on a copy")
    return "both clouds are the same after the call"


def memory(bench: Bench) -> str:
    """What stays behind of each call."""
    pair = clear_pair()

    def call() -> None:
        bench.one.register(Cloud(pair.target.points), Cloud(pair.source.points), pair.guess)

    return grown_bytes(call, LEAK_BYTES)


def _near(answer: Pose, wanted: Pose, tolerance_m: float, name: str) -> str:
    off = away(answer, wanted)
    left = wanted.inverse() @ answer
    gap = f"{1000 * math.hypot(left.x, left.y):.1f} mm and {math.degrees(abs(left.theta)):.2f} deg from {name}"
    if off > tolerance_m:
        raise Broken(f"{told(answer)} is {gap}, {told(wanted)}")
    return gap


def _same(first: Match, other: Match, when: str) -> str:
    if _bits(first) != _bits(other):
        before, after = told(first.target_from_source), told(other.target_from_source)
        off = away(other.target_from_source, first.target_from_source)
        raise Broken(f"the same question has another answer {when}: {after} and before {before}, {off:.1e} m apart")
    return f"the same to the bit {when}"


def _bits(match: Match) -> tuple[object, ...]:
    return (*astuple(match.target_from_source), match.converged, match.iterations, repr(match.error), match.inliers)


def _twice(cloud: Cloud) -> Cloud:
    return Cloud(np.repeat(cloud.points, 2, axis=0))


def _survives(bench: Bench, questions: dict[str, tuple[Cloud, Cloud]]) -> str:
    """An answer or an exception is fine; an answer that cannot be is not. The process's end is seen from outside."""
    guess = Pose(0.1, 0.2, 0.3)
    refused = []
    for name, (target, source) in questions.items():
        try:
            match = bench.one.register(target, source, guess)
        except Exception as error:  # noqa: BLE001 - refusing is allowed, and it is the back end's own exception
            refused.append(f"{name}: {raised(error)}")
            continue
        try:
            sound(match)
        except Broken as found:
            raise Broken(f"{name}: {found}") from found
    note = "; an exception ends a run that meets this" if refused else ""
    return "; ".join(refused) + note if refused else f"answers: {', '.join(questions)}"


RULES = table(
    Rule("starts", "It is made from its parameters and answers a Match whose values are possible.", starts),
    Rule("identity", "A cloud on itself, guessed so, answers the identity.", identity),
    Rule("recovers", "A known motion is found where nearest neighbours are right and there is no noise.", recovers),
    Rule("moves", "A guess 5 cm and 2 degrees off is mended on noisy planar scans.", moves),
    Rule("metres", "A motion of 0.3 m comes back as 0.3.", metres),
    Rule("radians", "A turn to the left of 0.3 rad comes back as 0.3.", radians),
    Rule("direction", "The answer is target_from_source: it takes the source's points to the target.", direction),
    Rule("inverse", "With target and source exchanged the answer is the inverse.", inverse),
    Rule("equivariance", "Where a cloud is moved and the guess with it, the answer moves along.", equivariance),
    Rule("order", "The order of the points does not matter.", order),
    Rule("duplicates", "Every point given twice changes little.", duplicates),
    Rule("empty", "Clouds may be empty: an answer or an exception, never a crash.", empty),
    Rule("few-points", "One or two points, or coinciding ones: an answer or an exception, never a crash.", few_points),
    Rule("wall", "A single straight wall, which leaves one direction open, does not throw the answer away.", wall),
    Rule("converged", "converged is not True for a far wrong answer.", hopeless),
    Rule("inliers", "inliers counts the source points that have a partner.", inliers),
    Rule("stateless", "The answer does not depend on what was asked before.", stateless),
    Rule("deterministic", "The same question has the same answer, to the bit.", deterministic),
    Rule("read-only", "It does not write into its arguments.", read_only),
    Rule("memory", "Calls leave no memory behind.", memory),
)  # fmt: skip
