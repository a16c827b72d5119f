"""The table of a condition, those inside it for each kind of figure, and the core's conditions of them.

A table that says several things at once, such as a limit on the distance and a time of day, is short for ``all`` of
them. Defaults are those of the core. Annotations are no texts here, as in every file of tables: pydantic would compile
each of them once more, whenever the program starts.
"""

from collections.abc import Callable, Mapping
from typing import Annotated, Any, ClassVar, Literal, TypedDict

from pydantic import BeforeValidator, Field, WithJsonSchema

from stadimeter.config.models import DurationAboveZero, Section
from stadimeter.config.units import (
    Angle,
    AngleOrZero,
    Duration,
    Length,
    LengthOrZero,
    Speed,
    TimeOfDay,
    Velocity,
    Voltage,
)
from stadimeter.core.conditions.compounds import AllOf, AnyOf, Condition, Not
from stadimeter.core.conditions.contact import TimeToContactCondition
from stadimeter.core.conditions.discrete import CountCondition, PresenceCondition, RuleCondition, ScheduleCondition
from stadimeter.core.conditions.distance import DistanceCondition
from stadimeter.core.conditions.figures import Direction, Quantity
from stadimeter.core.conditions.limits import ClosingCondition, DirectionCondition, SeparationCondition
from stadimeter.core.conditions.of_base import BatteryCondition, ContactSensorCondition
from stadimeter.core.conditions.undelivered import UndeliveredCondition
from stadimeter.core.decision import Severity

# Greatest depth of nested conditions.
MAX_DEPTH = 20

# A safety rule acts as soon as danger is as likely as not.
PROBABILITY_FOR_SAFETY = 0.5

# A speed is estimated from many frames, and overshoots for some tenths of a second after a target has set off. At even
# odds the estimate alone decides, and every third target that sets off to 70 % of a limit is taken to be above it; at
# 0.8 its standard deviation, which says that it has not settled, keeps all but 1 in 50 out. A target at twice the limit
# is found 0.1 s later, one at 1.1 times 0.3 to 0.6 s. Measured by ``tests/benchmarks/closing_speeds.py``.
PROBABILITY_OF_SPEED_FOR_SAFETY = 0.8

# The days of the week as they are written, Monday first.
DAYS = ("mon", "tue", "wed", "thu", "fri", "sat", "sun")

_DISTANCE = DistanceCondition()
_DIRECTION = DirectionCondition()
_CLOSING = ClosingCondition()
_CONTACT = TimeToContactCondition(below_s=1.0)
_SEPARATION = SeparationCondition(targets=("", ""))

_Bounds = tuple[float | None, float | None]


def _parse_probability(value: object) -> float | None:
    if value == "none":
        return None
    if isinstance(value, int | float) and 0 < value < 1:  # neither of true and false is within
        return float(value)
    raise ValueError(f"{value!r} is not a probability between 0 and 1, such as 0.8, and not 'none'")


_BETWEEN_0_AND_1 = {"type": "number", "exclusiveMinimum": 0, "exclusiveMaximum": 1}

Probability = Annotated[
    float | None, BeforeValidator(_parse_probability), WithJsonSchema({"anyOf": [_BETWEEN_0_AND_1, {"const": "none"}]})
]
ProbabilityOff = Annotated[float, Field(gt=0, lt=1)]
Sigmas = Annotated[float, Field(ge=0)]


class LimitsTable(Section):
    """Limits on a figure."""

    above: float | None = None
    """Holds above this."""
    below: float | None = None
    """Holds below this."""
    between: list[float] | None = None
    """The same two at once, the lower end first."""

    @property
    def limits(self) -> _Bounds:
        """What the figure must be above and below, in the SI unit; None for no such limit."""
        if self.between is not None:
            return self.between[0], self.between[1]
        return self.above, self.below


class Likelihood(TypedDict):
    """How sure it must be, as the conditions of the core have it."""

    deadband_sigmas: float
    probability_on: float | None
    probability_off: float


class LikelihoodTable(Section):
    """How sure it must be that a figure is within its limits."""

    deadband_sigmas: Sigmas = _DISTANCE.deadband_sigmas
    """How many standard deviations of its noise the figure must come back before the condition ends."""
    probability: Probability = _DISTANCE.probability_on
    """How likely the condition must be to begin; None compares the figures alone."""
    probability_off: ProbabilityOff = _DISTANCE.probability_off
    """How likely it may be at most to end."""

    probability_for_safety: ClassVar[float] = PROBABILITY_FOR_SAFETY
    """How likely it must be for a safety rule that does not say so."""

    def likelihood(self, severity: Severity) -> Likelihood:
        """Return the same as the core sees it, for a rule that matters so much."""
        is_default = severity is Severity.SAFETY and "probability" not in self.model_fields_set
        return {
            "deadband_sigmas": self.deadband_sigmas,
            "probability_on": self.probability_for_safety if is_default else self.probability,
            "probability_off": self.probability_off,
        }


class DirectionTable(LimitsTable):
    """A condition on the bearing, positive to the right, or the elevation, positive upwards."""

    above: Angle | None = None
    """In radians."""
    below: Angle | None = None
    """In radians."""
    between: Annotated[list[Angle], Field(min_length=2, max_length=2)] | None = None
    """In radians."""
    deadband: AngleOrZero = _DIRECTION.deadband_rad
    """In radians; how far the target must come back."""

    def to_plan(self, quantity: Direction, target: str) -> DirectionCondition:
        """Return the condition as the core sees it."""
        above_rad, below_rad = self.limits
        return DirectionCondition(
            quantity=quantity, above_rad=above_rad, below_rad=below_rad, deadband_rad=self.deadband, target=target
        )


class ClosingTable(LimitsTable, LikelihoodTable):
    """A condition on the speed at which a target comes nearer; that of one that goes away is below zero."""

    above: Velocity | None = None
    """In m/s."""
    below: Velocity | None = None
    """In m/s."""
    between: Annotated[list[Velocity], Field(min_length=2, max_length=2)] | None = None
    """In m/s."""
    deadband: Speed = _CLOSING.deadband_mps
    """In m/s; how far the speed must come back."""
    deadband_sigmas: Sigmas = _CLOSING.deadband_sigmas
    probability: Probability = _CLOSING.probability_on
    probability_for_safety: ClassVar[float] = PROBABILITY_OF_SPEED_FOR_SAFETY

    def to_plan(self, severity: Severity, target: str) -> ClosingCondition:
        """Return the condition as the core sees it."""
        above_mps, below_mps = self.limits
        return ClosingCondition(
            above_mps=above_mps,
            below_mps=below_mps,
            deadband_mps=self.deadband,
            **self.likelihood(severity),
            target=target,
        )


class ContactTable(LikelihoodTable):
    """A condition on how soon a target will be here, if it goes on as it does."""

    below: DurationAboveZero
    """In seconds."""
    contact: LengthOrZero = _CONTACT.contact_m
    """In metres; the distance that counts as contact."""
    min_closing_speed: Speed = _CONTACT.closing_min_mps
    """In m/s; a target that is slower does not come at all."""
    speed_sigmas: Sigmas = _CONTACT.speed_sigmas
    """How many standard deviations the speed must be above zero to be known."""
    deadband: Duration = _CONTACT.deadband_s
    """In seconds; how much later the contact must be before the condition ends."""
    deadband_sigmas: Sigmas = _CONTACT.deadband_sigmas

    def to_plan(self, severity: Severity, target: str) -> TimeToContactCondition:
        """Return the condition as the core sees it."""
        return TimeToContactCondition(
            below_s=self.below,
            contact_m=self.contact,
            closing_min_mps=self.min_closing_speed,
            speed_sigmas=self.speed_sigmas,
            deadband_s=self.deadband,
            **self.likelihood(severity),
            target=target,
        )


class SeparationTable(LimitsTable, LikelihoodTable):
    """A condition on how far two targets are from each other."""

    of: Annotated[list[str], Field(min_length=2, max_length=2)]
    """The two targets."""
    above: Length | None = None
    """In metres."""
    below: Length | None = None
    """In metres."""
    between: Annotated[list[Length], Field(min_length=2, max_length=2)] | None = None
    """In metres."""
    deadband: LengthOrZero = _SEPARATION.deadband_m
    """In metres; how far they must come back."""

    def to_plan(self, severity: Severity) -> SeparationCondition:
        """Return the condition as the core sees it."""
        above_m, below_m = self.limits
        return SeparationCondition(
            targets=(self.of[0], self.of[1]),
            above_m=above_m,
            below_m=below_m,
            deadband_m=self.deadband,
            **self.likelihood(severity),
        )


class CountTable(Section):
    """A condition on how many targets are in sight."""

    at_least: Annotated[int, Field(ge=1)] | None = None
    """Holds with no fewer."""
    at_most: Annotated[int, Field(ge=0)] | None = None
    """Holds with no more."""
    of: Annotated[list[str], Field(min_length=1)] | None = None
    """Of these targets; all if left out."""

    def to_plan(self) -> CountCondition:
        """Return the condition as the core sees it."""
        return CountCondition(targets=tuple(self.of or ()), at_least=self.at_least, at_most=self.at_most)


class TimeTable(Section):
    """A condition on the time of day, local time."""

    between: Annotated[list[TimeOfDay], Field(min_length=2, max_length=2)]
    """In seconds since midnight, the beginning first; over midnight if the end is earlier."""
    days: Annotated[list[Literal["mon", "tue", "wed", "thu", "fri", "sat", "sun"]], Field(min_length=1)] | None = None
    """The days on which it begins; every day if left out."""

    def to_plan(self) -> ScheduleCondition:
        """Return the condition as the core sees it."""
        weekdays = tuple(sorted({DAYS.index(day) for day in self.days or ()}))
        return ScheduleCondition(from_s=self.between[0], to_s=self.between[1], weekdays=weekdays)


def _only_true(value: object) -> bool:
    if value is not True:
        raise ValueError("only true can be written here; the opposite of 'seen = true' is 'lost = true'")
    return value


Flag = Annotated[bool, BeforeValidator(_only_true), WithJsonSchema({"const": True})]


class WhenTable(LimitsTable, LikelihoodTable):
    """A condition: limits on the distance, one of the keys from `seen` to `negated`, or all of several such."""

    written_elsewhere: ClassVar[dict[str, str]] = {
        "for": 'write on_delay = "10 s" beside when, or lost_for = "5 min" in place of lost',
        "on_delay": "write it beside when",
        "off_delay": "write it beside when",
        "hysteresis": "it is called deadband",
    }

    above: Length | None = None
    """In metres; holds when the target is further."""
    below: Length | None = None
    """In metres; holds when it is nearer."""
    between: Annotated[list[Length], Field(min_length=2, max_length=2)] | None = None
    """In metres, the lower end first."""
    of: Quantity = _DISTANCE.quantity
    """Whether the limits are on the distance or on the depth along the optical axis."""
    deadband: LengthOrZero = _DISTANCE.deadband_m
    """In metres; how far the target must come back."""
    target: str | None = None
    """The target, if it is another one than the rule's."""
    seen: Flag | None = None
    """Holds while the target is tracked."""
    lost: Flag | None = None
    """Holds while it is not."""
    seen_for: Duration | None = None
    """In seconds; holds once the target has been tracked for this long."""
    lost_for: Duration | None = None
    """In seconds; holds once it has not been tracked for this long."""
    bearing: DirectionTable | None = None
    """Holds while the target is in this direction."""
    elevation: DirectionTable | None = None
    """Holds while the target is in this direction."""
    closing_speed: ClosingTable | None = None
    """Holds while the target comes nearer at this speed."""
    time_to_contact: ContactTable | None = None
    """Holds while the target will be here this soon."""
    separation: SeparationTable | None = None
    """Holds while two targets are this far apart."""
    count: CountTable | None = None
    """Holds while this many targets are in sight."""
    rule: str | None = None
    """Holds while the rule of this name is active."""
    time: TimeTable | None = None
    """Holds at this time of day."""
    bumped: Flag | None = None
    """Holds while a bumper of the base is pressed."""
    at_cliff: Flag | None = None
    """Holds while a sensor below the base sees no floor, or one of its wheels hangs down."""
    battery_below: Voltage | None = None
    """In volts; holds while the battery of the base has less."""
    undelivered_for: DurationAboveZero | None = None
    """In seconds; holds while an alarm's message or notification has been undelivered for this long."""
    all: Annotated[list["WhenTable"], Field(min_length=1)] | None = None
    """Holds while each of these does."""
    any: Annotated[list["WhenTable"], Field(min_length=1)] | None = None
    """Holds while at least one of these does."""
    negated: Annotated["WhenTable | None", Field(alias="not")] = None
    """Written ``not``; holds while this does not."""

    def to_plan(self, severity: Severity) -> Condition:
        """Return the condition as the core sees it; a default depends on how much the rule matters."""
        others = [key for key in _CONVERSIONS if getattr(self, "negated" if key == "not" else key) is not None]
        plans = [_CONVERSIONS[key](self, severity) for key in others]
        if not plans or any(limit is not None for limit in self.limits):
            plans.insert(0, self._distance(severity))
        return plans[0] if len(plans) == 1 else AllOf(conditions=tuple(plans))

    def _distance(self, severity: Severity) -> DistanceCondition:
        above_m, below_m = self.limits
        return DistanceCondition(
            above_m=above_m,
            below_m=below_m,
            quantity=self.of,
            deadband_m=self.deadband,
            **self.likelihood(severity),
            target=self.target or "",
        )


def kinds_in(table: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return the conditions that a table is short for, each as a table of its own, in the order of `to_plan`.

    Keys that say something about the distance go with the limits on it, `target` with each condition on a target.
    """
    groups = [("above", "below", "between"), *((key,) for key in _CONVERSIONS)]
    return [_of_kind(table, group) for group in groups if any(key in table for key in group)]


def _of_kind(table: Mapping[str, Any], group: tuple[str, ...]) -> dict[str, Any]:
    beside: tuple[str, ...] = ("target",) if group[0] in _OF_A_TARGET else ()
    if "below" in group:
        beside = (*KEYS_ABOUT_DISTANCE, "target")
    return {key: value for key, value in table.items() if key in group or key in beside}


def _presence(when: WhenTable, *, seen: bool, for_s: float | None = 0.0) -> PresenceCondition:
    return PresenceCondition(seen=seen, for_s=for_s or 0.0, target=when.target or "")


def _parts(tables: list[WhenTable] | None, severity: Severity) -> tuple[Condition, ...]:
    return tuple(part.to_plan(severity) for part in tables or ())


_Conversion = Callable[[Any, Severity], Condition]

# Each key that makes a condition something else than one on the distance, and its conversion.
_OF_A_TARGET: dict[str, _Conversion] = {
    "seen": lambda when, _: _presence(when, seen=True),
    "lost": lambda when, _: _presence(when, seen=False),
    "seen_for": lambda when, _: _presence(when, seen=True, for_s=when.seen_for),
    "lost_for": lambda when, _: _presence(when, seen=False, for_s=when.lost_for),
    "bearing": lambda when, _: when.bearing.to_plan("bearing", when.target or ""),
    "elevation": lambda when, _: when.elevation.to_plan("elevation", when.target or ""),
    "closing_speed": lambda when, severity: when.closing_speed.to_plan(severity, when.target or ""),
    "time_to_contact": lambda when, severity: when.time_to_contact.to_plan(severity, when.target or ""),
}
_OF_NO_TARGET: dict[str, _Conversion] = {
    "separation": lambda when, severity: when.separation.to_plan(severity),
    "count": lambda when, _: when.count.to_plan(),
    "rule": lambda when, _: RuleCondition(rule=when.rule),
    "time": lambda when, _: when.time.to_plan(),
    "bumped": lambda *_: ContactSensorCondition(sensor="is_bumped"),
    "at_cliff": lambda *_: ContactSensorCondition(sensor="is_at_cliff"),
    "battery_below": lambda when, _: BatteryCondition(below_v=when.battery_below),
    "undelivered_for": lambda when, _: UndeliveredCondition(for_s=when.undelivered_for),
}
_OF_OTHERS: dict[str, _Conversion] = {
    "all": lambda when, severity: AllOf(conditions=_parts(when.all, severity)),
    "any": lambda when, severity: AnyOf(conditions=_parts(when.any, severity)),
    "not": lambda when, severity: Not(condition=when.negated.to_plan(severity)),
}
_CONVERSIONS = _OF_A_TARGET | _OF_NO_TARGET | _OF_OTHERS

# The keys of conditions on one target, on several or none, and on other conditions.
KEYS_OF_A_TARGET, KEYS_OF_NO_TARGET, KEYS_OF_OTHERS = map(tuple, (_OF_A_TARGET, _OF_NO_TARGET, _OF_OTHERS))

# The keys that belong to limits on the distance.
KEYS_ABOUT_DISTANCE = ("of", "deadband", "deadband_sigmas", "probability", "probability_off")
