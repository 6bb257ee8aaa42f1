"""The rules of a Registration, each checked on a small scene with a known answer."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from evalkit.commands.validate.rules.range_rules import RANGE_RULES, validate_match
from evalkit.commands.validate.rules.registration_fixture import RegistrationFixture
from evalkit.commands.validate.rules.resource_rules import RESOURCE_RULES
from evalkit.commands.validate.rules.rule import (
    RuleBroken,
    RuleNotApplicable,
    is_refusal,
    require_own_process,
    rule_table,
)
from evalkit.commands.validate.rules.scenes import (
    CloudPair,
    clear_pair,
    distance_m,
    format_pose,
    noisy_pair,
    wall_pair,
)
from evalkit.commands.validate.rules.state_rules import STATE_RULES, match_bits
from evalkit.core.errors import format_exception
from evalkit.core.match import Match
from evalkit.core.pose import Pose
from evalkit.core.scan import Cloud

EXACT_M = 0.02
"""Tolerance without noise and with a good guess: 1 cm and 0.15 degrees, the effect of voxels and stop rules."""

SAME_M = 0.04
"""Tolerance for a question in another form, with noise: other pairs and cells, less than the noise of one point."""

SHUFFLED_M = 0.01
"""Tolerance for another order of the points: the last bits of a sum, and the point that represents a cell."""

MAX_REMAINING = 0.75
"""The largest share of the error of the guess that may remain; a coarse stop rule may stop early."""

FAR = Pose(5.0, -3.0, 2.0)
UNIT_TOLERANCE = 0.2
"""Error, as a share of a true length or in radians, beyond which the unit or sign of an answer is in doubt."""

MIRRORED_M = 0.25
"""Distance from the mirror image of a true motion of 0.3 m or more up to which an answer is taken as mirrored."""


def check_starts(fixture: RegistrationFixture) -> str:
    """It is created from its parameters and returns a Match with valid values."""
    pair = clear_pair()
    match = fixture.make().register(pair.target, pair.source, pair.guess)
    validate_match(match)
    return f"a Match of {match.inliers} pairs"


def check_identity(fixture: RegistrationFixture) -> str:
    """A cloud registered onto itself from the identity returns the identity."""
    cloud = noisy_pair().target
    answer = fixture.register(CloudPair(cloud, cloud, Pose(), Pose()))
    return _near(answer, Pose(), EXACT_M, "the identity")


def check_recovers(fixture: RegistrationFixture) -> str:
    """Without noise, and with right nearest neighbours, a known motion is found."""
    pair = clear_pair(Pose(0.2, -0.15, -0.2))
    return _near(fixture.register(pair), pair.truth, EXACT_M, "the truth")


def check_moves(fixture: RegistrationFixture) -> str:
    """A guess 5 cm and 2 degrees off is corrected on noisy planar scans."""
    pair = noisy_pair()
    answer = fixture.register(pair)
    before, left = distance_m(pair.guess, pair.truth), distance_m(answer, pair.truth)
    if answer == pair.guess:
        raise RuleBroken(
            f"the guess was returned unchanged, {100 * before:.0f} cm off at 4 m; a 3D library estimates vertical "
            "normals for points at z = 0, which constrain nothing: evalkit.odometry.planar3d computes them in the plane"
        )
    if left > MAX_REMAINING * before:
        raise RuleBroken(f"of {100 * before:.1f} cm at 4 m, {100 * left:.1f} cm remained")
    return f"of {100 * before:.1f} cm at 4 m, {100 * left:.1f} cm remained"


def check_metres(fixture: RegistrationFixture) -> str:
    """A motion of 0.3 m is returned as 0.3."""
    pair = clear_pair()
    answer = fixture.register(pair)
    wanted, length = math.hypot(pair.truth.x, pair.truth.y), math.hypot(answer.x, answer.y)
    if abs(length - wanted) > UNIT_TOLERANCE * wanted:
        hints = {1000.0: "millimetres", 100.0: "centimetres", 0.001: "kilometres", 0.01: "hundreds of metres"}
        unit = next((u for f, u in hints.items() if abs(length / f - wanted) < UNIT_TOLERANCE * wanted), "")
        raise RuleBroken(f"{wanted:g} m was returned as {length:.4g}", f"the answer is in {unit}?" if unit else "")
    return f"{wanted:g} m was returned as {length:.4f}"


def check_radians(fixture: RegistrationFixture) -> str:
    """A left turn of 0.3 rad is returned as 0.3."""
    pair = clear_pair()
    answer = fixture.register(pair)
    return check_turn(answer, pair.truth)


def check_turn(answer: Pose, truth: Pose) -> str:
    """The observation of the turn (rad) of an answer; raises RuleBroken, with a likely cause, if it is wrong."""
    turn, wanted = answer.theta, truth.theta
    if abs(turn - wanted) <= UNIT_TOLERANCE:
        return f"{wanted:.3g} rad was returned as {turn:.4f}"
    observed, cause, degrees = f"{wanted:.3g} rad was returned as {turn:.4f}", "", math.degrees(wanted)
    if abs(Pose(0.0, 0.0, turn - degrees).theta) < UNIT_TOLERANCE:
        turns = round((degrees - turn) / (2.0 * math.pi))
        modulo = f", that is {degrees:.4g} {'-' if turns > 0 else '+'} {abs(turns)} * 2 pi" if turns else ""
        observed, cause = f"{observed}{modulo}", f"is the angle in degrees? {wanted:.3g} rad are {degrees:.4g} degrees"
    elif distance_m(answer, Pose(truth.x, -truth.y, -wanted)) <= MIRRORED_M:
        cause = "it has the wrong sign, as in a mirror: does y point to the right, or do angles turn clockwise?"
    elif abs(turn + wanted) <= UNIT_TOLERANCE:
        observed = f"{observed}: it has the wrong sign?"  # no cause yet: that of the inverse, as of a turned angle
    raise RuleBroken(observed, cause)


def check_direction(fixture: RegistrationFixture) -> str:
    """The answer is target_from_source: it maps source points to the target frame."""
    pair = clear_pair()
    answer = fixture.register(pair)
    truth, inverse = pair.truth, pair.truth.inverse()
    right = f"target_from_source is {format_pose(truth)}"
    for step in (pair.guess.inverse() @ truth, truth @ pair.guess.inverse()):
        if distance_m(answer, step) <= EXACT_M:
            raise RuleBroken(
                f"{format_pose(answer)} is the correction of the guess {format_pose(pair.guess)}; {right}",
                "the answer is the step from the guess alone: return step * guess",
            )
    if distance_m(answer, inverse) >= distance_m(answer, truth):
        return f"{format_pose(answer)} maps source points into the target frame"
    if math.dist(answer.row[:2], inverse.row[:2]) < math.dist(answer.row[:2], truth.row[:2]):
        is_inverse = distance_m(answer, inverse) <= EXACT_M
        near = "is source_from_target" if is_inverse else f"is nearer to source_from_target, {format_pose(inverse)}"
        cause = "the answer is the inverse: return target_from_source" if is_inverse else ""
        raise RuleBroken(f"{format_pose(answer)} {near}; {right}", cause)
    return f"x and y of {format_pose(answer)} are nearer to those of target_from_source, {format_pose(truth)}"


def check_inverse(fixture: RegistrationFixture) -> str:
    """With target and source exchanged the answer is the inverse."""
    pair = clear_pair()
    swapped = CloudPair(pair.source, pair.target, pair.truth.inverse(), pair.guess.inverse())
    return _near(fixture.register(swapped), fixture.register(pair).inverse(), EXACT_M, "the inverse")


def check_equivariance(fixture: RegistrationFixture) -> str:
    """If a cloud and the guess are moved, the answer moves with them."""
    pair = noisy_pair()
    answer = fixture.register(pair)
    target = CloudPair(Cloud(FAR.transform(pair.target.points)), pair.source, FAR, FAR @ pair.guess)
    source = CloudPair(pair.target, Cloud(FAR.inverse().transform(pair.source.points)), FAR, pair.guess @ FAR)
    try:
        first = _near(fixture.register(target), FAR @ answer, SAME_M, "the answer moved with the target")
    except RuleBroken as broken:
        if _answers(fixture, replace(pair, guess=FAR @ pair.guess)) == answer:
            raise RuleBroken(str(broken), "the guess changes nothing, is it used?") from None
        raise
    return f"{first}; {_near(fixture.register(source), answer @ FAR, SAME_M, 'the answer moved with the source')}"


def check_order(fixture: RegistrationFixture) -> str:
    """The order of the points does not matter."""
    pair, rng = noisy_pair(), np.random.default_rng(1)
    shuffled = CloudPair(
        Cloud(rng.permutation(pair.target.points)), Cloud(rng.permutation(pair.source.points)), pair.truth, pair.guess
    )
    return _near(fixture.register(shuffled), fixture.register(pair), SHUFFLED_M, "the answer in the first order")


def check_duplicates(fixture: RegistrationFixture) -> str:
    """Duplicating every point changes the answer little."""
    pair = noisy_pair()
    doubled = CloudPair(_twice(pair.target), _twice(pair.source), pair.truth, pair.guess)
    return _near(fixture.register(doubled), fixture.register(pair), SAME_M, "the answer with every point once")


def check_wall(fixture: RegistrationFixture) -> str:
    """A single straight wall, which leaves one direction open, gives no distant answer."""
    pair = wall_pair()
    try:
        answer = validate_match(fixture.shared.register(pair.target, pair.source, pair.guess)).target_from_source
    except Exception as error:
        if not is_refusal(error):
            raise
        return format_exception(error)
    if distance_m(answer, pair.truth) > 1.0:
        raise RuleBroken(f"5 cm beside a single wall the answer is far off, {format_pose(answer)}")
    return f"answers {format_pose(answer)}; across the wall {format_pose(pair.truth)} is right"


def check_converged(fixture: RegistrationFixture) -> str:
    """converged is not True for an answer far from the truth."""
    pair = noisy_pair()
    away_100 = Pose(100.0, 0.0, 0.0)
    try:
        match = fixture.shared.register(pair.target, Cloud(away_100.transform(pair.source.points)), Pose())
    except Exception as error:
        error.add_note("clouds without pairs: return a Match with converged=False, because an exception ends a run")
        raise
    validate_match(match)
    wrong = distance_m(match.target_from_source @ away_100, pair.truth)
    if match.converged and wrong > 1.0:
        raise RuleBroken(f"clouds 100 m apart: reports converged on {match.inliers} pairs, {wrong:.0f} m off")
    return f"clouds 100 m apart: converged is {match.converged}, {match.inliers} pairs, {wrong:.1f} m off"


def check_inliers(fixture: RegistrationFixture) -> str:
    """inliers counts the source points that have a partner."""
    pair = clear_pair()
    match = fixture.shared.register(pair.target, pair.source, pair.guess)
    count = len(pair.source)
    if not count // 2 <= match.inliers <= count:
        raise RuleBroken(
            f"{count} points that all have a partner: inliers {match.inliers}; with too few, evalkit's front end keeps "
            "the guess"
        )
    return f"{match.inliers} of {count} points that all have a partner"


def check_ends(fixture: RegistrationFixture) -> str:
    """The first and the last point of a cloud count as the others do."""
    pair, one = clear_pair(), fixture.make()
    expected = match_bits(one.register(pair.target, pair.source, pair.guess))

    def counts(name: str, index: int) -> bool:
        fixture.note_progress()  # for a slow back end, which may be asked for every other point
        points = getattr(pair, name).points.copy()
        points[index] += 0.01
        cloud = Cloud(points)
        moved = replace(pair, source=cloud) if name == "source" else replace(pair, target=cloud)
        return match_bits(one.register(moved.target, moved.source, moved.guess)) != expected

    for name in ("source", "target"):  # a target point without its source point has no effect either
        count = len(getattr(pair, name))
        if not all(counts(name, index) for index in range(count // 10, count - 1, count // 10)):
            raise RuleNotApplicable(f"not every point of the {name} decides its answer")
        for index, which in ((0, "first"), (count - 1, "last")):
            if not counts(name, index):
                if left_out := next((other for other in range(1, count - 1, 2) if not counts(name, other)), None):
                    number = f"number {left_out + 1}"
                    raise RuleNotApplicable(f"not every point of the {name} decides its answer: {number} does not")
                raise RuleBroken(
                    f"the {which} of {count} {name} points, moved by 1 cm, changes nothing in the answer; others do: "
                    "does a loop leave it out?"
                )
    return "moved by 1 cm, the first and the last point change the answer, as others do"


def check_stateless(fixture: RegistrationFixture) -> str:
    """The answer does not depend on earlier questions."""
    a, b = noisy_pair(), clear_pair()
    one = fixture.make()
    first = one.register(a.target, a.source, a.guess)
    one.register(b.target, b.source, b.guess)
    one.register(a.source, a.target, a.guess)
    return _same(first, one.register(a.target, a.source, a.guess), "after other questions")


def check_deterministic(fixture: RegistrationFixture) -> str:
    """The same question has the same answer, to the bit."""
    pair = noisy_pair()
    first, *others = (fixture.make().register(pair.target, pair.source, pair.guess) for _ in range(4))
    for other in others:
        _same(first, other, "from a new object")
    return "4 new objects agree to the bit"


def check_read_only(fixture: RegistrationFixture) -> str:
    """It does not write to its arguments."""
    require_own_process(fixture.runs_in)
    pair = noisy_pair()
    before = pair.target.points.tobytes(), pair.source.points.tobytes()
    try:
        fixture.shared.register(pair.target, pair.source, pair.guess)
    except ValueError as error:
        if "read-only" in str(error) or "not writeable" in str(error):
            raise RuleBroken(f"it writes to the points of a cloud ({error}): use a copy") from error
        raise
    if (pair.target.points.tobytes(), pair.source.points.tobytes()) != before:
        raise RuleBroken("the points of a cloud changed in the call: use a copy")
    return "both clouds are unchanged after the call"


def _answers(fixture: RegistrationFixture, pair: CloudPair) -> Pose | None:
    """The answer to a pair, None where it refuses the question."""
    try:
        return fixture.register(pair)
    except Exception as error:
        if not is_refusal(error):
            raise
        return None


def _near(answer: Pose, wanted: Pose, tolerance_m: float, name: str) -> str:
    off = distance_m(answer, wanted)
    left = wanted.inverse() @ answer
    gap = f"{1000 * math.hypot(left.x, left.y):.1f} mm and {math.degrees(abs(left.theta)):.2f} deg from {name}"
    if off > tolerance_m:
        raise RuleBroken(f"{format_pose(answer)} is {gap}, {format_pose(wanted)}")
    return gap


def _same(first: Match, other: Match, when: str) -> str:
    if match_bits(first) != match_bits(other):
        before, after = first.target_from_source.row.tolist(), other.target_from_source.row.tolist()
        off = distance_m(other.target_from_source, first.target_from_source)
        raise RuleBroken(f"the same question has another answer {when}: {after}, before {before}, {off:.1e} m apart")
    return f"the same to the bit {when}"


def _twice(cloud: Cloud) -> Cloud:
    return Cloud(np.repeat(cloud.points, 2, axis=0))


RULES = rule_table(
    check_starts, check_identity, check_recovers, check_moves, check_metres, check_radians, check_direction,
    check_inverse, check_equivariance, check_order, check_duplicates, *RANGE_RULES, check_wall, check_converged,
    check_inliers, check_ends, check_stateless, check_deterministic, check_read_only, *RESOURCE_RULES, *STATE_RULES,
)  # fmt: skip
