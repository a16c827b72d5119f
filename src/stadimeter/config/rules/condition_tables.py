"""The table of a condition, those inside it that are on no figure of a target, and the core's conditions of them.

A table that says several things at once, such as a limit on the distance and a time of day, is short for ``all`` of
them. Defaults are those of the core. Annotations are no texts here, as in every file of tables: pydantic would compile
each of them once more, whenever the program starts.
"""

from collections.abc import Callable, Mapping
from typing import Annotated, Any, ClassVar, Literal

from pydantic import BeforeValidator, Field, WithJsonSchema

from stadimeter.config.models import DurationAboveZero, Section
from stadimeter.config.rules.limit_tables import (
    ClosingTable,
    ContactTable,
    DirectionTable,
    LikelihoodTable,
    LimitsTable,
    SeparationTable,
)
from stadimeter.config.rules.memory_tables import ActiveForTable, CountTable, FigureLimitsTable
from stadimeter.config.units import Duration, Length, LengthOrZero, TimeOfDay, Voltage
from stadimeter.core.conditions.compounds import AllOf, AnyOf, Condition, Not
from stadimeter.core.conditions.discrete import PresenceCondition, RuleCondition, ScheduleCondition
from stadimeter.core.conditions.distance import DistanceCondition
from stadimeter.core.conditions.figures import Quantity
from stadimeter.core.conditions.of_base import BatteryCondition, ContactSensorCondition
from stadimeter.core.conditions.undelivered import UndeliveredCondition
from stadimeter.core.decision import Severity

# Greatest depth of nested conditions.
MAX_DEPTH = 20

# The days of the week as they are written, Monday first.
DAYS = ("mon", "tue", "wed", "thu", "fri", "sat", "sun")

_DISTANCE = DistanceCondition()


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
    """Holds while this many targets are in sight, or once a rule was raised this often."""
    active_for: ActiveForTable | None = None
    """Holds once a rule was active for this long in all."""
    figure: FigureLimitsTable | None = None
    """Holds while a remembered figure is within limits."""
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
    "active_for": lambda when, _: when.active_for.to_plan(),
    "figure": lambda when, _: when.figure.to_plan(),
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
