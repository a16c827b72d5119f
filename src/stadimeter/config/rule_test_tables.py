"""The tables ``[[tests]]``: what the target does, and what is expected of the rules."""

import datetime as dt
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, Literal, Self

from msgspec import Struct
from msgspec.structs import replace
from pydantic import BeforeValidator, Discriminator, Field, Tag, model_validator

from stadimeter.config.models import ButtonAction, DurationAboveZero, Section, Share
from stadimeter.config.units import Angle, Duration, FilePath, Frequency, Length, Speed, TimeOfDay
from stadimeter.core.decision import RuleStatus
from stadimeter.operator_actions import OperatorAction

# How far a level may be from the expected one, unless the test says otherwise.
TOLERANCE = 0.05


class SpanTable(Section):
    """A stretch of time."""

    start: Annotated[Duration, Field(alias="from")]
    """When it begins, written ``from``; in seconds from the start of the test."""
    duration: Annotated[DurationAboveZero, Field(alias="for")]
    """How long it is, written ``for``; in seconds."""

    @property
    def end_s(self) -> float:
        """Its end, in seconds from the start of the test."""
        return self.start + self.duration

    def holds(self, at_s: float) -> bool:
        """Check whether a moment lies in it; its end does not."""
        return self.start <= at_s < self.end_s


def _parse_date(text: object) -> object:
    """Read a date such as ``"2026-12-24"``; raises ValueError for another text, and leaves what is no text."""
    try:
        return dt.date.fromisoformat(text) if isinstance(text, str) else text
    except ValueError:
        raise ValueError(f"{text!r} is no date; write it such as '2026-12-24'") from None


def _as_list(value: Any) -> Any:
    return value if isinstance(value, list) else [value]


# Moments such as ``"3 s"``, stretches of time such as ``{ from = "3 s", for = "2 s" }``, or a list of both.
Moment = Annotated[
    Annotated[SpanTable, Tag("throughout")] | Annotated[Duration, Tag("at")],
    Discriminator(lambda value: "throughout" if isinstance(value, dict | SpanTable) else "at"),
]
Moments = Annotated[list[Moment], BeforeValidator(_as_list), Field(min_length=1)]
Count = Annotated[int, Field(ge=0)]


class LevelAtTable(Section):
    """The level of an actuator at some time."""

    at: Duration
    """In seconds from the start of the test."""
    level: Share | None = None
    """What it is, or nearly."""
    tolerance: Share = TOLERANCE
    """How far the level may be off."""
    min: Share | None = None
    """The least that the level may be."""
    max: Share | None = None
    """The most that the level may be."""

    @model_validator(mode="after")
    def _check_level(self) -> Self:
        if self.level is None and self.min is None and self.max is None:
            raise ValueError("which level? Add level, or min and max")
        if self.limits[0] > self.limits[1]:
            raise ValueError(f"no level is from {self.limits[0]:g} to {self.limits[1]:g}")
        return self

    @property
    def limits(self) -> tuple[float, float]:
        """The lowest and the highest level that will do."""
        if self.level is not None:
            return self.level - self.tolerance, self.level + self.tolerance
        return 0.0 if self.min is None else self.min, 1.0 if self.max is None else self.max


class ExpectTable(Section):
    """The state expected of a rule or of an output. Times are in seconds from the start of the test."""

    raised: Count | None = None
    """How often the rule is raised, exactly."""
    cleared: Count | None = None
    """How often it is cleared, exactly."""
    transitions_max: Count | None = None
    """How often it is raised or cleared, at most."""
    raised_by: Duration | None = None
    """When it is raised for the first time, at the latest."""
    raised_after: Duration | None = None
    """When it is raised for the first time, at the earliest."""
    cleared_by: Duration | None = None
    """When it is cleared for the first time, at the latest."""
    cleared_after: Duration | None = None
    """When it is cleared for the first time, at the earliest."""
    active_at: Moments | None = None
    """When the rule is active."""
    inactive_at: Moments | None = None
    """When the rule is not active."""
    status: Annotated[RuleStatus, Field(strict=False)] | None = None
    """What it is doing at the end."""
    acknowledged: bool | None = None
    """Whether, at the end, it needs no acknowledgement any more."""
    sent: Count | None = None
    """How many messages and notifications it sends."""
    level_at: Annotated[list[LevelAtTable], BeforeValidator(_as_list), Field(min_length=1)] | None = None
    """What the level of an actuator is at certain times."""
    speed_max: Speed | None = None
    """What a base's speed never exceeds, either way, in m/s."""
    stopped_at: Moments | None = None
    """When the output is at its safe value; for a base that is standing still."""
    acts_at: Moments | None = None
    """When the output acts."""

    @model_validator(mode="after")
    def _can_be(self) -> Self:
        if not self.model_fields_set:
            raise ValueError("nothing is expected; write such as { raised = 1 }")
        return self


# Keys of the table, by what they can be expected of.
OF_ACTUATORS = ("level_at",)
OF_BASES = ("speed_max",)
OF_OUTPUTS = ("stopped_at", "acts_at")
OF_RULES = tuple(key for key in ExpectTable.model_fields if key not in {*OF_ACTUATORS, *OF_BASES, *OF_OUTPUTS})

# The keys of one target, which have no place beside several.
_OF_ONE_TARGET = {"target", "hover", "approach", "recede", "skip", "points", "lost", "bearing", "elevation", "repeat"}
_MAX_RATE_HZ = 30.0

# The longest test, in frames: nine hours at 30 a second. More is a slip of the pen.
FRAMES_MAX = 1_000_000


def _parse_noise(value: object) -> float:
    if value in ("model", "none"):
        return 1.0 if value == "model" else 0.0
    if isinstance(value, bool) or not isinstance(value, int | float) or not 0 <= value <= 100:
        raise ValueError(f"{value!r} is neither 'model' nor 'none', nor a factor from 0 to 100")
    return float(value)


Noise = Annotated[float, BeforeValidator(_parse_noise)]
Rate = Annotated[Frequency, Field(gt=0, le=1000)]
Rare = Annotated[float, Field(ge=0, lt=1)]

# How long a target that comes or goes stands still before and after, unless the test says otherwise: long enough for a
# track to be sure that it stands.
STAND_S = 1.0

# The ways to move; a motion has exactly one of them.
MOTIONS = ("hover", "approach", "recede", "skip", "points")


class PathPoint(Struct, frozen=True, kw_only=True):
    """The true place of a target at some time.

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
    """The distance at which it stands."""
    duration: Annotated[DurationAboveZero, Field(alias="for")]
    """How long, written ``for``; in seconds."""

    def legs(self) -> list[tuple[float, float]]:
        """Return times in seconds and distances in metres."""
        return [(0.0, self.at), (self.duration, self.at)]


class SkipTable(Section):
    """Stand at one distance, and from one frame to the next at another."""

    start: Annotated[Length, Field(alias="from")]
    """Where it is at first."""
    end: Annotated[Length, Field(alias="to")]
    """Where it is from one frame to the next."""
    wait: Duration = STAND_S
    """How long to stand at first, in seconds."""
    stay: Duration = STAND_S
    """How long to stand at the end, in seconds."""

    @property
    def going_s(self) -> float:
        """Time it takes from one distance to the other, in seconds."""
        return 0.0

    def legs(self) -> list[tuple[float, float]]:
        """Return times in seconds and distances in metres."""
        there_s = self.wait + self.going_s
        return [(0.0, self.start), (self.wait, self.start), (there_s, self.end), (there_s + self.stay, self.end)]


class TravelTable(SkipTable):
    """Stand, go from one distance to another at a steady speed, and stand again."""

    speed: Annotated[Speed, Field(gt=0)]
    """How fast it goes."""

    @property
    def going_s(self) -> float:
        """Time it takes at that speed, in seconds."""
        return abs(self.end - self.start) / self.speed


class PathPointTable(Section):
    """The place of the target at some time."""

    at: Duration
    """In seconds from the start of the test."""
    distance: Length
    """Where the target is at that time."""
    bearing: Angle | None = None
    """In radians, positive to the right; None for that of the motion."""
    elevation: Angle | None = None
    """In radians, positive upwards; None for that of the motion."""


class MotionTable(Section):
    """The motion of one target; exactly one of the first five keys says it."""

    hover: HoverTable | None = None
    """The target stands at a distance."""
    approach: TravelTable | None = None
    """Come nearer at a steady speed."""
    recede: TravelTable | None = None
    """Go away at a steady speed."""
    skip: SkipTable | None = None
    """Jump from one distance to another."""
    points: Annotated[list[PathPointTable], Field(min_length=1)] | None = None
    """Be at certain distances at certain times, and move evenly between them."""
    bearing: Angle = 0.0
    """In radians, positive to the right."""
    elevation: Angle = 0.0
    """In radians, positive upwards."""
    lost: list[SpanTable] = Field(default_factory=list)
    """When the target is out of sight."""
    repeat: Annotated[int, Field(ge=1, le=1000)] = 1
    """How often in a row it moves like that; each time begins where the target was at first."""

    @model_validator(mode="after")
    def _moves_one_way(self) -> Self:
        given = [key for key in MOTIONS if getattr(self, key) is not None]
        if len(given) > 1:
            raise ValueError(f"a target cannot {' and '.join(given)} at once; use points")
        for travel, is_nearer in ((self.approach, True), (self.recede, False)):
            if travel is not None and (travel.end < travel.start) is not is_nearer:
                wanted, other = ("nearer", "recede") if is_nearer else ("further", "approach")
                raise ValueError(f"from {travel.start:g} m to {travel.end:g} m is not {wanted}; write {other}")
        times_s = [point.at for point in self.points or ()]
        if times_s and (times_s[0] != 0 or times_s != sorted(times_s) or times_s[-1] == 0):
            raise ValueError("points begin at '0 s', are in order, and end later; to stand at one distance write hover")
        return self

    def path(self) -> tuple[PathPoint, ...]:
        """Return where the target is when, in the order of time; nothing if no motion is given."""
        motion = self.hover or self.approach or self.recede or self.skip
        legs = motion.legs() if motion else []
        once = [self._point(point) for point in self.points or ()] or [
            PathPoint(at_s=at_s, distance_m=distance_m, bearing_rad=self.bearing, elevation_rad=self.elevation)
            for at_s, distance_m in legs
        ]
        return tuple(
            replace(each, at_s=each.at_s + turn * once[-1].at_s) for turn in range(self.repeat) for each in once
        )

    @property
    def duration_s(self) -> float:
        """Time it takes, in seconds; 0 if no motion is given."""
        path = self.path()
        return path[-1].at_s if path else 0.0

    def _point(self, point: PathPointTable) -> PathPoint:
        return PathPoint(
            at_s=point.at,
            distance_m=point.distance,
            bearing_rad=self.bearing if point.bearing is None else point.bearing,
            elevation_rad=self.elevation if point.elevation is None else point.elevation,
        )


class OperatorTable(Section):
    """An operator command at some time."""

    at: Duration
    """In seconds from the start of the test."""
    do: ButtonAction
    """What is done, as in the section of a button."""
    rule: str = ""
    """To which rule; empty for what concerns every output."""
    duration: Annotated[DurationAboveZero | None, Field(alias="for")] = None
    """How long to shelve it, written ``for``, in seconds; None for as long as the rule allows."""

    @model_validator(mode="after")
    def _names_a_rule(self) -> Self:
        if OperatorAction(self.do).is_on_outputs is bool(self.rule):
            raise ValueError('what is done is to a rule or to every output, such as { do = "reset", rule = "near" }')
        return self


class InputTable(MotionTable):
    """The things the camera sees in a test, and those people do. Without a journal they are made up."""

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
    date: Annotated[dt.date | None, BeforeValidator(_parse_date)] = None
    """The date at the start, in place of the day of the week; None for one that is not known."""
    operator: list[OperatorTable] = Field(default_factory=list)
    """What people tell rules."""

    @model_validator(mode="after")
    def _says_what_happens(self) -> Self:
        given = self.model_fields_set
        if self.journal is not None:
            if len(given) > 1:
                raise ValueError(f"a recording has its own '{min(given - {'journal'})}': take it out, or the journal")
            return self
        if self.targets is None and self.moving_s == 0:
            raise ValueError(f"the test does not say what happens; known are: {', '.join(MOTIONS)}, journal")
        if self.targets is not None and (beside := given & _OF_ONE_TARGET):
            raise ValueError(f"'{min(beside)}' does not go with 'targets'; put it inside one of them, or out")
        if self.targets is not None and any(motion.duration_s == 0 for motion in self.targets.values() or [self]):
            raise ValueError("no target moves, or one does not; write such as targets.NAME = { … } for each that does")
        if self.date is not None and (self.clock is None or "day" in given):
            raise ValueError("a date goes with clock, and has a day of the week of its own")
        if self.moving_s * (self.rate or _MAX_RATE_HZ) > FRAMES_MAX:
            raise ValueError(f"{self.moving_s:g} s are more than {FRAMES_MAX:,} frames, the most that a test may have")
        return self

    def motions(self, targets: Sequence[str]) -> Mapping[str, MotionTable]:
        """Return the motion of each target, without those that are never in sight."""
        if self.targets is not None:
            return self.targets
        return {self.target or targets[0]: self}

    @property
    def moving_s(self) -> float:
        """Length of the test, in seconds; 0 for a recording."""
        motions = self.targets.values() if self.targets else (self,)
        return max((motion.duration_s for motion in motions), default=0.0)


class RuleTestTable(Section):
    """One test of the rules: what happens, and what is expected. `stadimeter test` runs it without a camera."""

    name: Annotated[str, Field(min_length=1)] | None = None
    """What it shows; None for one by its number."""
    input: InputTable
    """What happens in the test."""
    expect: Annotated[dict[str, ExpectTable], Field(min_length=1)]
    """What is expected, by the name of a rule or an output."""


class RuleTest(Struct, frozen=True, kw_only=True):
    """One test of a configuration, and its line in the file, counted from 1."""

    name: str
    line: int
    input: InputTable
    expect: Mapping[str, ExpectTable]
