"""The options of the simulated world: the table ``[world]`` of a configuration."""

from __future__ import annotations

from enum import StrEnum
from itertools import pairwise
from typing import Annotated

from pydantic import BeforeValidator, Field, field_validator, model_validator

from stadimeter.config.plugins import Options
from stadimeter.config.units import LENGTHS_M, Angle, Duration, Length, LengthOrZero, as_written, parse_quantity


def parse_coordinate(text: object) -> float:
    """Read a coordinate such as ``"-1.5 m"``, return it in metres; raises ValueError if it is not a length."""
    return parse_quantity(text, LENGTHS_M, "-1.5 m")


Coordinate = Annotated[float, BeforeValidator(parse_coordinate), as_written(LENGTHS_M, "-1.5 m", is_signed=True)]


class WayPoint(Options):
    """The position of the ball at some time."""

    at: Duration
    """When, in seconds from the start of the run."""
    x: Coordinate
    """Metres to the east."""
    y: Coordinate
    """Metres to the north."""


class FaultKind(StrEnum):
    """The faults of the simulated world."""

    HIDE_TARGET = "hide-target"
    FREEZE_CAMERA = "freeze-camera"
    BLOCK_CAMERA = "block-camera"
    UNPLUG_BASE = "unplug-base"
    BROKER_GONE = "broker-gone"


class ScheduledFault(Options):
    """Something that goes wrong at some time, and comes right again."""

    at: Duration
    """When, in seconds from the start of the run."""
    duration: Duration | None = Field(default=None, alias="for")
    """For how many seconds, written ``for``; None for the rest of the run."""
    kind: FaultKind
    """What goes wrong."""


THERE_AND_BACK = tuple(
    WayPoint.model_validate({"at": at, "x": x, "y": y})
    for at, x, y in (
        ("0 s", "1.5 m", "0 m"),
        ("6 s", "4 m", "0.6 m"),
        ("12 s", "2.5 m", "-0.5 m"),
        ("18 s", "1.5 m", "0 m"),
    )
)


class WorldOptions(Options):
    """The simulated world. Lengths are in metres and angles in radians once they are read."""

    seed: int = Field(default=1, ge=0)
    """Everything random follows from it: the same seed gives the same run."""
    ball_diameter: Length = 0.2
    """The ball's diameter."""
    ball_height: LengthOrZero | None = None
    """Height of the ball's centre above the floor; None if it lies on the floor."""
    path: tuple[WayPoint, ...] = Field(default=THERE_AND_BACK, min_length=1)
    """Where the ball is when. In between it moves smoothly and never beyond its way points."""
    loop: bool = True
    """Whether the ball begins its path again at the end, or stays there."""
    robot_x: Coordinate = 0.0
    """Where the robot starts, to the east."""
    robot_y: Coordinate = 0.0
    """Where the robot starts, to the north."""
    robot_heading: Angle = 0.0
    """Where the robot faces at the start, counter-clockwise from east."""
    track_width: Length = 0.2
    """Distance between the robot's two wheels."""
    ticks_per_metre: float = Field(default=4000.0, gt=0)
    """Ticks that a wheel's encoder counts on a metre."""
    camera_height: Length = 0.25
    """Height of the camera above the floor. It looks straight ahead, level, from between the wheels."""
    faults: tuple[ScheduledFault, ...] = ()
    """What goes wrong when."""

    @field_validator("path")
    @classmethod
    def _check_times(cls, path: tuple[WayPoint, ...]) -> tuple[WayPoint, ...]:
        if path[0].at != 0:
            raise ValueError(f"the path begins at {path[0].at:g} s; its first way point must be at '0 s'")
        for before, after in pairwise(path):
            if after.at <= before.at:
                raise ValueError(f"the way point at {after.at:g} s follows one at {before.at:g} s; order them by time")
        return path

    @model_validator(mode="after")
    def _check_loop(self) -> WorldOptions:
        first, last = self.path[0], self.path[-1]
        if self.loop and (first.x, first.y) != (last.x, last.y):
            raise ValueError(
                f"the path begins at ({first.x:g}, {first.y:g}) m and ends at ({last.x:g}, {last.y:g}) m; "
                "end it where it begins, or set loop = false"
            )
        return self
