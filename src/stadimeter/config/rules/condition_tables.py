"""The table of a condition, those inside it that are on no figure of a target, and the core's conditions of them.

A table that says several things at once, such as a limit on the distance and a time of day, is short for ``all`` of
them. Defaults are those of the core. Annotations are no texts here, as in every file of tables: pydantic would compile
each of them once more, whenever the program starts.
"""

from collections.abc import Callable, Mapping
from typing import Annotated, Any, ClassVar, Literal

from msgspec import Struct
from pydantic import BeforeValidator, Discriminator, Field, Tag, WithJsonSchema

from stadimeter.config.models import DurationAboveZero, Section
from stadimeter.config.rules import figure_tables as figures
from stadimeter.config.rules.limit_tables import ContactTable, LikelihoodTable, LimitsTable
from stadimeter.config.rules.memory_tables import ActiveForTable, CountTable, FigureLimitsTable
from stadimeter.config.rules.schedule_tables import SequenceTable, TimeTable
from stadimeter.config.units import Length, LengthOrZero, Voltage, parse_duration
from stadimeter.core.conditions.compounds import AllOf, AnyOf, Condition, Not
from stadimeter.core.conditions.discrete import PresenceCondition, RuleCondition
from stadimeter.core.conditions.distance import DistanceCondition
from stadimeter.core.conditions.figures import Quantity
from stadimeter.core.conditions.leaf import Leaf
from stadimeter.core.conditions.measured import COMPARISONS, FigureCondition
from stadimeter.core.conditions.of_base import BatteryCondition, ContactSensorCondition
from stadimeter.core.conditions.quantities import AXES, STILL_WITHIN_M
from stadimeter.core.conditions.undelivered import UndeliveredCondition
from stadimeter.core.decision import Severity

# Greatest depth of nested conditions.
MAX_DEPTH = 20

_DISTANCE = DistanceCondition()

# Keys that a condition no longer has, and what says the same.
LEFT = {
    **{axis: f'write place = {{ axis = "{axis}", above = … }}, or below, or between' for axis in AXES},
    "further_than": 'write { target = "tag", nearer_than = "ball" }',
    "right_of": 'write { target = "tag", left_of = "ball" }',
    "lower_than": 'write { target = "tag", higher_than = "ball" }',
    "seen_for": 'write seen = "5 s"',
    "lost_for": 'write lost = "5 min"',
    "still_for": 'write still = { for = "10 min" }',
    "still_within": 'write still = { for = "10 min", within = "10 cm" }',
    "sideways_speed": 'write speed = { axis = "sideways", above = … }, or below, or between',
    "bumped": 'write base = "bumped"',
    "at_cliff": 'write base = "at_cliff"',
    "battery_below": 'write base = { battery_below = "11 V" }',
}


def _true_or_time(value: object) -> float:
    """Read for how long something must be so: true for no time at all."""
    if value is False:
        raise ValueError("write true, or a time such as '5 min'; the opposite of 'seen = true' is 'lost = true'")
    return 0.0 if value is True else parse_duration(value)


class OfEach(Leaf, Struct, frozen=True, kw_only=True):
    """A condition on any, or on all, of a group of targets; compiling puts its members in its place."""

    group: str
    condition: Condition
    whole: type[AllOf | AnyOf]


TrueOrTime = Annotated[
    float,
    BeforeValidator(_true_or_time),
    WithJsonSchema({"anyOf": [{"const": True}, {"type": "string"}], "examples": ["5 min"]}),
]


class StillTable(Section):
    """A condition on how long the target has not moved."""

    for_: Annotated[DurationAboveZero, Field(alias="for")]
    """In seconds, written ``for``."""
    within: LengthOrZero = STILL_WITHIN_M
    """In metres; the target has moved when it is further than this from where it began to stand."""


class BatteryTable(Section):
    """A condition on the battery of the base."""

    battery_below: Voltage
    """In volts; holds while it has less."""


# What a sensor of the base tells, or a table on its battery.
OfBase = Annotated[
    Annotated[BatteryTable, Tag("table")] | Annotated[Literal["bumped", "at_cliff"], Tag("word")],
    Discriminator(lambda value: "word" if isinstance(value, str) else "table"),
]


class WhenTable(LimitsTable, LikelihoodTable):
    """A condition: limits on the distance, one of the keys from `seen` to `negated`, or all of several such."""

    written_elsewhere: ClassVar[dict[str, str]] = {
        "for": 'write on_delay = "10 s" beside when, or lost = "5 min" in place of true',
        "on_delay": "write it beside when",
        "off_delay": "write it beside when",
        "hysteresis": "it is called deadband",
        **LEFT,
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
    any_of: str | None = None
    """Instead of a target, several of one kind: holds while it does for one of them at least."""
    all_of: str | None = None
    """Likewise; holds while it does for each of them."""
    seen: TrueOrTime | None = None
    """``true``: holds while the target is tracked; a time: once it has been tracked for this long."""
    lost: TrueOrTime | None = None
    """Likewise while it is not tracked."""
    bearing: figures.DirectionTable | None = None
    """Holds while the target is in this direction."""
    elevation: figures.DirectionTable | None = None
    """Holds while the target is in this direction."""
    closing_speed: figures.SpeedTable | None = None
    """Holds while the target comes nearer at this speed."""
    time_to_contact: ContactTable | None = None
    """Holds while the target will be here this soon."""
    place: figures.AxisTable | None = None
    """Holds while the target is this far along an axis."""
    speed: figures.AnySpeedTable | None = None
    """Holds while the target moves at this speed."""
    size: figures.SizeTable | None = None
    """Holds while the target appears this large in the picture."""
    still: StillTable | None = None
    """Holds once the target has not moved for this long."""
    nearer_than: figures.Comparison | None = None
    """Holds while the target is nearer than another one."""
    left_of: figures.DirectionComparison | None = None
    """Holds while the target is to the left of another one, as seen by the camera."""
    higher_than: figures.Comparison | None = None
    """Holds while the target is higher above the floor than another one."""
    separation: figures.SeparationTable | None = None
    """Holds while two targets are this far apart."""
    count: CountTable | None = None
    """Holds while this many targets are in sight, or once a rule was raised this often."""
    active_for: ActiveForTable | None = None
    """Holds once a rule was active for this long in all."""
    figure: FigureLimitsTable | None = None
    """Holds while a remembered figure is within limits."""
    rule: str | None = None
    """Holds while the rule of this name is active."""
    sequence_of: SequenceTable | None = None
    """Holds when these rules were raised one after the other."""
    time: TimeTable | None = None
    """Holds at this time of day."""
    base: OfBase | None = None
    """``"bumped"``: holds while a bumper of the base is pressed; ``"at_cliff"``: while a sensor below it sees no floor,
    or one of its wheels hangs down; or a table on its battery."""
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
        plan = plans[0] if len(plans) == 1 else AllOf(conditions=tuple(plans))
        group = self.any_of or self.all_of
        return OfEach(group=group, condition=plan, whole=AnyOf if self.any_of else AllOf) if group else plan

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


def _of_base(base: Any) -> Condition:
    if isinstance(base, BatteryTable):
        return BatteryCondition(below_v=base.battery_below)
    return ContactSensorCondition(sensor="is_bumped" if base == "bumped" else "is_at_cliff")


def _parts(tables: list[WhenTable] | None, severity: Severity) -> tuple[Condition, ...]:
    return tuple(part.to_plan(severity) for part in tables or ())


_Conversion = Callable[[Any, Severity], Condition]

# The quantities that have a table of limits.
KEYS_OF_QUANTITIES = ("place", "speed", "size")
KEYS_OF_COMPARISONS = tuple(COMPARISONS)


def _on_quantity(key: str) -> _Conversion:
    return lambda when, severity: getattr(when, key).to_plan(key, severity, when.target or "")


def _compared(key: str) -> _Conversion:
    return lambda when, severity: figures.comparison_of(getattr(when, key)).compare(key, severity, when.target or "")


# Each key that makes a condition something else than one on the distance, and its conversion.
_OF_A_TARGET: dict[str, _Conversion] = {
    "seen": lambda when, _: PresenceCondition(seen=True, for_s=when.seen, target=when.target or ""),
    "lost": lambda when, _: PresenceCondition(seen=False, for_s=when.lost, target=when.target or ""),
    **{key: _on_quantity(key) for key in ("bearing", "elevation", "closing_speed", "size")},
    "time_to_contact": lambda when, severity: when.time_to_contact.to_plan(severity, when.target or ""),
    "place": lambda when, severity: when.place.to_plan(when.place.axis, severity, when.target or ""),
    "speed": lambda when, severity: when.speed.to_plan(when.speed.quantity, severity, when.target or ""),
    "still": lambda when, _: FigureCondition(
        quantity="still",
        above=when.still.for_,
        within_m=when.still.within,
        target=when.target or "",
        **figures.AS_IT_IS,
    ),
    **{key: _compared(key) for key in KEYS_OF_COMPARISONS},
}
_OF_NO_TARGET: dict[str, _Conversion] = {
    "separation": lambda when, severity: when.separation.to_plan("separation", severity, *when.separation.of),
    "count": lambda when, _: when.count.to_plan(),
    "active_for": lambda when, _: when.active_for.to_plan(),
    "figure": lambda when, _: when.figure.to_plan(),
    "rule": lambda when, _: RuleCondition(rule=when.rule),
    "sequence_of": lambda when, _: when.sequence_of.to_plan(),
    "time": lambda when, _: when.time.to_plan(),
    "base": lambda when, _: _of_base(when.base),
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

# The keys that say whom a condition is about, of which one is written.
KEYS_OF_GROUPS = ("any_of", "all_of")
KEYS_ABOUT_WHOM = ("target", *KEYS_OF_GROUPS)

# The keys that belong to limits on the distance.
KEYS_ABOUT_DISTANCE = ("of", "deadband", "deadband_sigmas", "probability", "probability_off")
