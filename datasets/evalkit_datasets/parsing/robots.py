"""Find the robot that a laser belongs to in a bag of several robots, by the namespaces of the topics."""

from __future__ import annotations

from collections.abc import Collection
from itertools import takewhile


def find_foreign_topics(
    laser: str, lasers: Collection[str], motions: Collection[str], named: str = ""
) -> frozenset[str]:
    """Return the topics of other robots than the laser's: their lasers, and their ``motions`` (odometry, transforms).

    A robot is a namespace with a laser and motions: /robot1 of /robot1/sensors/scan and /robot1/odom. What lies in none
    of the namespaces is one robot more. A laser whose robot has no motions of its own keeps all.
    ``named``: the topic of an odometry that the user names: it is of the laser's robot.
    """
    own, robots = _find_robot(laser, motions), {_find_robot(one, motions) for one in lasers}
    others = {one for one in robots if one and one != own and not _is_below(own, one)}
    foreign = {topic for topic in (*lasers, *motions) if any(_is_below(topic, one) for one in others)}
    foreign = {topic for topic in foreign if topic.strip("/") != named.strip("/")}
    has_own = any(_is_below(topic, own) for topic in set(motions) - foreign)
    return frozenset(foreign) if has_own else frozenset()


def count_common_spaces(one: str, other: str) -> int:
    """Return how many namespaces, from the first on, two topics have in common."""
    pairs = zip(one.strip("/").split("/")[:-1], other.strip("/").split("/")[:-1], strict=False)
    return sum(1 for _ in takewhile(lambda pair: pair[0] == pair[1], pairs))


def _find_robot(laser: str, motions: Collection[str]) -> str:
    """Return the deepest namespace of a laser that holds motions as well, "" if none does."""
    parts = laser.strip("/").split("/")[:-1]
    spaces = ("/" + "/".join(parts[:count]) for count in range(len(parts), 0, -1))
    return next((space for space in spaces if any(_is_below(topic, space) for topic in motions)), "")


def _is_below(topic: str, space: str) -> bool:
    return f"/{topic.strip('/')}/".startswith(f"{space}/")  # everything is below ""
