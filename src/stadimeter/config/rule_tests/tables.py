"""The tables ``[[tests]]``: what the target does, and what is expected of the rules."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Literal

from pydantic import BeforeValidator, Field

from stadimeter.config.models import DurationAboveZero, Section
from stadimeter.config.rule_tests.expectations import ExpectTable, SpanTable
from stadimeter.config.units import Angle, Duration, FilePath, Frequency, Length, Speed, TimeOfDay
from stadimeter.core.operator import OperatorAction

FRAMES_MAX = 1_000_000
"""The longest test, in frames: nine hours at 30 a second. More is a slip of the pen."""


def _parse_noise(value: object) -> float:
    if value in ("model", "none"):
        return 1.0 if value == "model" else 0.0
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0 <= value <= 100:
        raise ValueError(f"{value!r} is neither 'model' nor 'none', nor a factor from 0 to 100")
    return float(value)


Noise = Annotated[float, BeforeValidator(_parse_noise)]
Rate = Annotated[Frequency, Field(gt=0, le=1000)]
Rare = Annotated[float, Field(ge=0, lt=1)]

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


class OperatorTable(Section):
    """What somebody tells a rule at some time; exactly one of the keys that name an action holds the rule's name."""

    at: Duration
    """In seconds from the start of the test."""
    acknowledge: str | None = None
    """Acknowledge this rule."""
    reset: str | None = None
    """Reset it."""
    shelve: str | None = None
    """Keep it quiet."""
    unshelve: str | None = None
    """Let it speak again."""
    take_out: str | None = None
    """Take it out of service."""
    put_back: str | None = None
    """Put it back into service."""
    duration: Annotated[DurationAboveZero | None, Field(alias="for")] = None
    """How long to shelve it, written ``for``, in seconds; None for as long as the rule allows."""
    one_shot: bool = False
    """Shelve it until it has returned to normal, or the time is over."""
    by: str = "test"
    """Who does it."""
    why: str = ""
    """Why."""

    def orders(self) -> tuple[tuple[OperatorAction, str], ...]:
        """Return what is to be done to which rule; more or fewer than one is wrong."""
        named = ((action, getattr(self, action.replace("-", "_"))) for action in OperatorAction)
        return tuple((action, rule) for action, rule in named if rule is not None)


class InputTable(MotionTable):
    """What the camera sees in a test, and what people do. Without a journal it is made up."""

    target: str | None = None
    """The target that moves, where there are several; the others are out of sight."""
    targets: dict[str, MotionTable] | None = None
    """How each of several targets moves, by its name."""
    journal: FilePath | None = None
    """A recording that takes the place of all this, relative to the configuration."""
    noise: Noise = 1.0
    """How noisy measured distances are, as a factor of what camera and target are expected to give."""
    dropouts: Rare = 0.0
    """The share of frames in which a target is not found."""
    outliers: Rare = 0.0
    """The share of frames in which a distance is grossly wrong."""
    rate: Rate | None = None
    """Frames in a second, in hertz; None for the camera's, or 30."""
    seed: Annotated[int, Field(ge=0)] = 1
    """Everything random follows from it."""
    frozen: list[SpanTable] = Field(default_factory=list)
    """When the camera gives no frames."""
    clock: TimeOfDay | None = None
    """The time of day at the start, in seconds after midnight; None for a clock that is not synchronised."""
    day: Literal["mon", "tue", "wed", "thu", "fri", "sat", "sun"] = "mon"
    """The day of the week at the start."""
    operator: list[OperatorTable] = Field(default_factory=list)
    """What people tell rules."""

    def motions(self, targets: Sequence[str]) -> Mapping[str, MotionTable]:
        """Return how each target moves.

        Returns:
            The motions by target; without those that are never in sight.
        """
        if self.targets is not None:
            return self.targets
        return {self.target or targets[0]: self}

    @property
    def moving_s(self) -> float:
        """How long the test is, in seconds; 0 for a recording."""
        motions = self.targets.values() if self.targets else (self,)
        return max((motion.duration_s for motion in motions), default=0.0)


class RuleTestTable(Section):
    """One test."""

    name: Annotated[str, Field(min_length=1)] | None = None
    """What it shows; None for one by its number."""
    input: InputTable
    """What happens."""
    expect: dict[str, ExpectTable]
    """What is expected, by the name of a rule or an output."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RuleTest:
    """One test of a configuration.

    Attributes:
        line: Where it stands in the file, counted from 1.
        expect: What is expected, by the name of a rule or an output.
    """

    name: str
    line: int
    input: InputTable
    expect: Mapping[str, ExpectTable]


def name_of(table: RuleTestTable, position: int) -> str:
    """Return the name of a test.

    Args:
        position: Its position among the tests, counted from 0.

    Returns:
        The name; ``test 1`` for a first one without.
    """
    return table.name or f"test {position + 1}"
