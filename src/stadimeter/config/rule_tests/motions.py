"""How a target moves in a test of rules: it stands, comes, goes, jumps, or is where a list of points says.

Whatever the motion, it becomes one path of points. Between two points everything changes evenly; two points at one time
are a jump.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from pydantic import Field

from stadimeter.config.models import DurationAboveZero, Section
from stadimeter.config.units import Angle, Duration, Length, Speed

STAND_S = 1.0
"""How long a target that comes or goes stands still before and after, unless the test says otherwise: long enough for a
track to be sure that it stands."""

MOTIONS = ("hover", "approach", "recede", "skip", "points")
"""The ways to move; a motion has exactly one of them."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PathPoint:
    """Where a target truly is at some time.

    Attributes:
        at_s: Seconds from the start of the test.
        distance_m: Length of the straight line from the camera to the target's centre.
        bearing_rad: Angle from the optical axis, positive to the right.
        elevation_rad: Angle from the optical axis, positive upwards.
    """

    at_s: float
    distance_m: float
    bearing_rad: float = 0.0
    elevation_rad: float = 0.0


class SpanTable(Section):
    """A stretch of time."""

    start: Annotated[Duration, Field(alias="from")]
    """When it begins, written ``from``; in seconds from the start of the test."""
    duration: Annotated[DurationAboveZero, Field(alias="for")]
    """How long it is, written ``for``; in seconds."""

    @property
    def end_s(self) -> float:
        """When it ends, in seconds from the start of the test."""
        return self.start + self.duration

    def holds(self, at_s: float) -> bool:
        """Return whether a moment lies in it.

        Args:
            at_s: The moment, in seconds from the start of the test.

        Returns:
            Whether it does; the end itself does not.
        """
        return self.start <= at_s < self.end_s


class HoverTable(Section):
    """Stand at a distance."""

    at: Length
    """In metres."""
    duration: Annotated[DurationAboveZero, Field(alias="for")]
    """How long, written ``for``; in seconds."""

    def legs(self) -> list[tuple[float, float]]:
        """Return times in seconds and distances in metres."""
        return [(0.0, self.at), (self.duration, self.at)]


class TravelTable(Section):
    """Stand, go from one distance to another at a steady speed, and stand again."""

    start: Annotated[Length, Field(alias="from")]
    """In metres, written ``from``."""
    end: Annotated[Length, Field(alias="to")]
    """In metres, written ``to``."""
    speed: Annotated[Speed, Field(gt=0)]
    """In m/s."""
    wait: Duration = STAND_S
    """How long to stand at first, in seconds."""
    stay: Duration = STAND_S
    """How long to stand at the end, in seconds."""

    def legs(self) -> list[tuple[float, float]]:
        """Return times in seconds and distances in metres."""
        there_s = self.wait + abs(self.end - self.start) / self.speed
        return [(0.0, self.start), (self.wait, self.start), (there_s, self.end), (there_s + self.stay, self.end)]


class SkipTable(Section):
    """Stand at one distance, and from one frame to the next at another."""

    start: Annotated[Length, Field(alias="from")]
    """In metres, written ``from``."""
    end: Annotated[Length, Field(alias="to")]
    """In metres, written ``to``."""
    wait: Duration = STAND_S
    """How long to stand at first, in seconds."""
    stay: Duration = STAND_S
    """How long to stand at the end, in seconds."""

    def legs(self) -> list[tuple[float, float]]:
        """Return times in seconds and distances in metres."""
        return [(0.0, self.start), (self.wait, self.start), (self.wait, self.end), (self.wait + self.stay, self.end)]


class PointTable(Section):
    """Where the target is at some time."""

    at: Duration
    """In seconds from the start of the test."""
    distance: Length
    """In metres."""
    bearing: Angle | None = None
    """In radians, positive to the right; None for that of the motion."""
    elevation: Angle | None = None
    """In radians, positive upwards; None for that of the motion."""


class MotionTable(Section):
    """How one target moves; exactly one of the first five keys says it."""

    hover: HoverTable | None = None
    """Stand at a distance."""
    approach: TravelTable | None = None
    """Come nearer at a steady speed."""
    recede: TravelTable | None = None
    """Go away at a steady speed."""
    skip: SkipTable | None = None
    """Jump from one distance to another."""
    points: Annotated[list[PointTable], Field(min_length=1)] | None = None
    """Be at certain distances at certain times, and move evenly between them."""
    bearing: Angle = 0.0
    """In radians, positive to the right."""
    elevation: Angle = 0.0
    """In radians, positive upwards."""
    lost: list[SpanTable] = Field(default_factory=list)
    """When the target is out of sight."""

    def path(self) -> tuple[PathPoint, ...]:
        """Return where the target is when.

        Returns:
            The points, in the order of their times; none if no motion is given.
        """
        if self.points is not None:
            return tuple(self._point(point) for point in self.points)
        motion = self.hover or self.approach or self.recede or self.skip
        legs = motion.legs() if motion else []
        return tuple(
            PathPoint(at_s=at_s, distance_m=distance_m, bearing_rad=self.bearing, elevation_rad=self.elevation)
            for at_s, distance_m in legs
        )

    @property
    def duration_s(self) -> float:
        """How long it takes, in seconds; 0 if no motion is given."""
        path = self.path()
        return path[-1].at_s if path else 0.0

    def _point(self, point: PointTable) -> PathPoint:
        return PathPoint(
            at_s=point.at,
            distance_m=point.distance,
            bearing_rad=self.bearing if point.bearing is None else point.bearing,
            elevation_rad=self.elevation if point.elevation is None else point.elevation,
        )
