"""Protocols that plug-ins implement: Registration, Odometry, Slam, Mapper, Sequence."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING, Protocol, runtime_checkable

from evalkit.core.loop_closure import LoopClosure
from evalkit.core.match import Match
from evalkit.core.odometry_estimate import OdometryEstimate
from evalkit.core.pose import Pose
from evalkit.core.scan import Cloud, Frame, Scan
from evalkit.core.trajectory import Trajectory

if TYPE_CHECKING:
    from evalkit.core.grid import OccupancyGrid
    from evalkit.core.ground_truth import Truth


class Registration(Protocol):
    """Aligns one cloud with another. Stateless: equal arguments give equal answers, independent of earlier calls."""

    def register(self, target: Cloud, source: Cloud, guess: Pose) -> Match:
        """Return the motion ``target_from_source``, starting from ``guess``; must not write into its arguments."""
        ...


class Odometry(Protocol):
    """Estimates the motion of a robot over one sequence; every sequence gets a new object."""

    def update(self, frame: Frame) -> OdometryEstimate:
        """Process one frame. The estimate's pose is ``start_from_base`` at the first beam; the first is the identity.

        Raises NoAnswer where this frame has no estimate; the next frame follows as usual.
        """
        ...


class Slam(Odometry, Protocol):
    """An odometry that also corrects poses it has given, by closing loops or by optimising a map.

    ``update`` returns what the robot has at that moment (*online*). ``trajectory`` returns the poses as corrected since
    then (*final*). Neither ``trajectory`` nor ``loop_closures`` changes an answer given later.
    """

    def trajectory(self) -> Trajectory:
        """Return the corrected poses ``start_from_base`` of all frames answered so far.

        Stamps are those of the frames; a frame for which ``update`` raised NoAnswer has none. The first pose is the
        identity. It is asked after each frame whose estimate says ``corrected``, outside its time, and after the last.
        """
        ...

    def loop_closures(self) -> tuple[LoopClosure, ...]:
        """Return all candidates so far, in the order of ``stamp_ns``; () for a method that corrects by other means."""
        ...


@runtime_checkable
class Remarking(Protocol):
    """What an odometry may have as well: a word on what limited its answers, for the report."""

    def remarks(self) -> tuple[str, ...]:
        """Return what limited the answers so far: a clause each, with its numbers and what to change; or ()."""
        ...


class NoAnswer(Exception):
    """Raised by ``Odometry.update`` for a scan without an estimate; the text is the reason.

    It is not an error. A run with too many such scans has failed.
    """


class Mapper(Protocol):
    """Draws scans with known poses into an occupancy grid."""

    def update(self, scan: Scan, world_from_sensor: Pose) -> None:
        """Add one scan."""
        ...

    def grid(self) -> OccupancyGrid:
        """Return the map of all scans so far."""
        ...


class Sequence(Protocol):
    """Scans in the order of time, with the ground truth."""

    def __len__(self) -> int:
        """Return the number of frames (for progress; exact unless the file is damaged)."""
        ...

    def frames(self) -> Iterator[Frame]:
        """Yield the frames, stamps strictly increasing; every call yields the same frames."""
        ...

    def truth(self) -> Truth:
        """Return the ground truth."""
        ...

    def notes(self) -> Mapping[str, int]:
        """Return the defects found while reading, counted by name ("scans out of order", "invalid ranges", ...)."""
        ...


@runtime_checkable
class Seekable(Protocol):
    """What a sequence may have as well: excerpts of a long recording are then read without all that is before them."""

    def frames_from(self, first: int) -> Iterator[Frame]:
        """Yield the frames of ``frames`` from number ``first`` on."""
        ...
