"""The table of a condition, those inside it that are on no figure of a target, and the core's conditions of them.

A table that says several things at once, such as a limit on the distance and a time of day, is short for ``all`` of
them. Defaults are those of the core. Annotations are no texts here, as in every file of tables: pydantic would compile
each of them once more, whenever the program starts.
"""

from collections.abc import Callable, Mapping
from typing import Annotated, Any, ClassVar

from msgspec import Struct
from pydantic import BeforeValidator, Field, WithJsonSchema

from stadimeter.config.models import DurationAboveZero
from stadimeter.config.rules import figure_tables as figures
from stadimeter.config.rules.limit_tables import ContactTable, LikelihoodTable, LimitsTable
from stadimeter.config.rules.memory_tables import ActiveForTable, CountTable, FigureLimitsTable
from stadimeter.config.rules.schedule_tables import SequenceTable, TimeTable
from stadimeter.config.units import Duration, Length, LengthOrZero, Voltage
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
}


def _only_true(value: object) -> bool:
    if value is not True:
        raise ValueError("only true can be written here; the opposite of 'seen = true' is 'lost = true'")
    return value


class OfEach(Leaf, Struct, frozen=True, kw_only=True):
    """A condition on any, or on all, of a group of targets; compiling puts its members in its place."""

    group: str
    condition: Condition
    whole: type[AllOf | AnyOf]


Flag = Annotated[bool, BeforeValidator(_only_true), WithJsonSchema({"const": True})]


class WhenTable(LimitsTable, LikelihoodTable):
    """A condition: limits on the distance, one of the keys from `seen` to `negated`, or all of several such."""

    written_elsewhere: ClassVar[dict[str, str]] = {
        "for": 'write on_delay = "10 s" beside when, or lost_for = "5 min" in place of lost',
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
    seen: Flag | None = None
    """Holds while the target is tracked."""
    lost: Flag | None = None
    """Holds while it is not."""
    seen_for: Duration | None = None
    """In seconds; holds once the target has been tracked for this long."""
    lost_for: Duration | None = None
    """In seconds; holds once it has not been tracked for this long."""
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
    sideways_speed: figures.SpeedTable | None = None
    """Holds while the target moves to the right at this speed."""
    speed: figures.SpeedTable | None = None
    """Holds while the target moves at this speed, in whatever direction."""
    size: figures.SizeTable | None = None
    """Holds while the target appears this large in the picture."""
    still_for: DurationAboveZero | None = None
    """In seconds; holds once the target has not moved for this long."""
    still_within: LengthOrZero = STILL_WITHIN_M
    """In metres; for `still_for`, the target has moved when it is further than this from where it began to stand."""
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
    if group[0] == "still_for":
        beside = (KEY_ABOUT_STANDING, "target")
    if "below" in group:
        beside = (*KEYS_ABOUT_DISTANCE, "target")
    return {key: value for key, value in table.items() if key in group or key in beside}


def _presence(when: WhenTable, *, seen: bool, for_s: float | None = 0.0) -> PresenceCondition:
    return PresenceCondition(seen=seen, for_s=for_s or 0.0, target=when.target or "")


def _parts(tables: list[WhenTable] | None, severity: Severity) -> tuple[Condition, ...]:
    return tuple(part.to_plan(severity) for part in tables or ())


_Conversion = Callable[[Any, Severity], Condition]

# The quantities that have a table of their own shape, and are converted alike.
KEYS_OF_QUANTITIES = ("sideways_speed", "speed", "size")
KEYS_OF_COMPARISONS = tuple(COMPARISONS)


def _on_quantity(key: str) -> _Conversion:
    return lambda when, severity: getattr(when, key).to_plan(key, severity, when.target or "")


def _compared(key: str) -> _Conversion:
    return lambda when, severity: figures.comparison_of(getattr(when, key)).compare(key, severity, when.target or "")


# Each key that makes a condition something else than one on the distance, and its conversion.
_OF_A_TARGET: dict[str, _Conversion] = {
    "seen": lambda when, _: _presence(when, seen=True),
    "lost": lambda when, _: _presence(when, seen=False),
    "seen_for": lambda when, _: _presence(when, seen=True, for_s=when.seen_for),
    "lost_for": lambda when, _: _presence(when, seen=False, for_s=when.lost_for),
    **{key: _on_quantity(key) for key in ("bearing", "elevation", "closing_speed")},
    "time_to_contact": lambda when, severity: when.time_to_contact.to_plan(severity, when.target or ""),
    "place": lambda when, severity: when.place.to_plan(when.place.axis, severity, when.target or ""),
    **{key: _on_quantity(key) for key in KEYS_OF_QUANTITIES},
    "still_for": lambda when, _: FigureCondition(
        quantity="still", above=when.still_for, within_m=when.still_within, target=when.target or "", **figures.AS_IT_IS
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

# The keys that say whom a condition is about, of which one is written.
KEYS_OF_GROUPS = ("any_of", "all_of")
KEYS_ABOUT_WHOM = ("target", *KEYS_OF_GROUPS)

# The key that belongs to `still_for`.
KEY_ABOUT_STANDING = "still_within"

# The keys that belong to limits on the distance.
KEYS_ABOUT_DISTANCE = ("of", "deadband", "deadband_sigmas", "probability", "probability_off")
