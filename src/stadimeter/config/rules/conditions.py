"""The table of a condition, and the core's conditions of it: each kind is a key, its table if it has one, and its line.

A table that says several things at once, such as a limit on the distance and a time of day, is short for ``all`` of
them. Defaults are those of the core. Annotations are no texts here, as in every file of tables.
"""

import re
from calendar import monthrange
from collections.abc import Callable, Mapping
from typing import Annotated, Any, ClassVar, Literal, NamedTuple, Self

from msgspec import Struct
from pydantic import BeforeValidator, Discriminator, Field, Tag, WithJsonSchema, model_validator

from stadimeter.config.models import DurationAboveZero, Section
from stadimeter.config.rules import limits
from stadimeter.config.units import (
    DURATIONS_S,
    Length,
    LengthOrZero,
    TimeOfDay,
    Voltage,
    as_written,
    parse_any_quantity,
    parse_duration,
    parse_time_of_day,
)
from stadimeter.core.clock import DAY_S
from stadimeter.core.conditions.compounds import AllOf, AnyOf, Condition, Not
from stadimeter.core.conditions.distance import DistanceCondition
from stadimeter.core.conditions.evidence import Quantity
from stadimeter.core.conditions.leaf import Leaf
from stadimeter.core.conditions.measured import FigureCondition
from stadimeter.core.conditions.of_rules import (
    BatteryCondition,
    ContactSensorCondition,
    RuleCondition,
    SequenceCondition,
    UndeliveredCondition,
)
from stadimeter.core.conditions.quantities import AXES, STILL_WITHIN_M
from stadimeter.core.conditions.remembered import FigureQuantity, RememberedCondition, RememberedFigure, Window
from stadimeter.core.conditions.schedule import DateSpan, ScheduleCondition, Sun
from stadimeter.core.conditions.sight import CountCondition, PresenceCondition
from stadimeter.core.decision import Severity
from stadimeter.core.observation import MonthDay
from stadimeter.core.words import duration

# What is remembered: counts and sums of other rules, and figures with a name ------------------------

MAX_WINDOW_S = 366 * DAY_S
MAX_RAISES = 1000

_WRITE_ONE = 'write one of within = "1 min", within = "today" and since = "06:00"'


def _bounded(least_s: float) -> Callable[[object], float]:
    def parse(text: object) -> float:
        seconds = parse_duration(text)
        if not least_s <= seconds <= MAX_WINDOW_S:
            raise ValueError(f"{text!r} is not within {duration(least_s)} and {duration(MAX_WINDOW_S)}, a year")
        return seconds

    return parse


_parse_window = _bounded(0.1)
Within = Annotated[
    float | Literal["today"],
    BeforeValidator(lambda text: text if text == "today" else _parse_window(text)),
    WithJsonSchema({"type": "string", "examples": ["1 min", "today"]}),
]
Every = Annotated[float, BeforeValidator(_bounded(1.0)), as_written(DURATIONS_S, "1 min")]
TimesOfDay = Annotated[
    list[TimeOfDay],
    BeforeValidator(lambda value: value if isinstance(value, list) else [value]),
    Field(min_length=1, max_length=100),
    WithJsonSchema({"type": ["string", "array"], "items": {"type": "string"}, "examples": ["22:30"]}),
]


class WindowTable(Section):
    """The part of the past that counts."""

    within: Within | None = None
    """In seconds: the newest part of the past; or ``"today"``, since midnight."""
    since: TimeOfDay | None = None
    """Since this time of day, in place of `within`."""

    @property
    def window(self) -> Window:
        """The same as the core sees it."""
        return Window(for_s=self.within) if isinstance(self.within, float) else Window(from_second=self.since or 0.0)

    @model_validator(mode="after")
    def _one_window(self) -> Self:
        written, needs = (self.within is not None) + (self.since is not None), getattr(self, "rule", "") is not None
        if written != needs:
            raise ValueError(_WRITE_ONE if needs else "name a rule to count how often it was raised")
        return self


class CountTable(WindowTable):
    """A condition on how many targets are in sight, or on how often a rule was raised."""

    at_least: Annotated[int, Field(ge=1)] | None = None
    """Holds with no fewer."""
    at_most: Annotated[int, Field(ge=0)] | None = None
    """Holds with no more."""
    of: Annotated[list[str], Field(min_length=1)] | None = None
    """Of these targets; all if left out."""
    below: Length | None = None
    """In metres; counts only those that are nearer."""
    rule: str | None = None
    """In place of targets: how often this rule was raised."""

    @model_validator(mode="after")
    def _raises_at_least(self) -> Self:
        least, others = self.at_least or 0, (self.at_most, self.of, self.below)
        if self.at_least is None and self.at_most is None:
            raise ValueError("how many is not said; write at_least, at_most, or both")
        if self.at_most is not None and least > self.at_most:
            raise ValueError(f"no count is at least {least} and at most {self.at_most}; exchange the two")
        if self.rule is not None and not (1 <= least <= MAX_RAISES and others == (None, None, None)):
            raise ValueError(f"beside rule stands at_least, 1 to {MAX_RAISES}, and none of at_most, of and below")
        return self

    def to_plan(self) -> CountCondition | RememberedCondition:
        """Return the condition as the core sees it."""
        if self.rule is None:
            targets = tuple(self.of or ())
            return CountCondition(targets=targets, at_least=self.at_least, at_most=self.at_most, below_m=self.below)
        above = (self.at_least or 1) - 1.0
        return RememberedCondition(rules=(self.rule,), window=self.window, unit="times", above=above)


class ActiveForTable(WindowTable):
    """A condition on how long a rule was active in all."""

    rule: str
    """The rule."""
    at_least: DurationAboveZero
    """In seconds; holds from this time on."""

    def to_plan(self) -> RememberedCondition:
        """Return the condition as the core sees it."""
        return RememberedCondition(rules=(self.rule,), window=self.window, unit="s", above=self.at_least)


# A quantity in the SI unit, and that unit: it must be that of the figure.
AnyQuantity = Annotated[
    tuple[float, str], BeforeValidator(lambda value: parse_any_quantity(str(value))), WithJsonSchema({"type": "string"})
]


class FigureLimitsTable(limits.LimitsTable):
    """A condition on a remembered figure."""

    name: str
    """Its name, as in ``[figures.NAME]``."""
    above: AnyQuantity | None = None  # type: ignore[assignment]
    """Holds above this; in a unit of its quantity."""
    below: AnyQuantity | None = None  # type: ignore[assignment]
    """Holds below this."""
    between: Annotated[list[AnyQuantity], Field(min_length=2, max_length=2)] | None = None  # type: ignore[assignment]
    """The same two at once, the lower end first."""
    deadband: AnyQuantity | None = None
    """How far the figure must come back."""

    def to_plan(self) -> RememberedCondition:
        """Return the condition as the core sees it."""
        low, high = self.between or (self.above, self.below)
        found = {key: each for key, each in (("above", low), ("below", high), ("deadband", self.deadband)) if each}
        values: dict[str, Any] = {key: value for key, (value, _) in found.items()}
        units = {unit: None for _, unit in found.values()}  # of several units, the check names the figure's own
        return RememberedCondition(name=self.name, unit=" and ".join(units), **values)


class FigureTable(WindowTable):
    """A figure that is remembered; see `stadimeter.core.conditions.remembered.RememberedFigure`."""

    target: str | None = None
    """The target; may be left out where there is only one."""
    of: FigureQuantity = "distance"
    """Which figure of it."""
    statistic: Literal["minimum", "maximum", "mean", "median", "percentile"]
    """What of all values within the window."""
    percentile: Annotated[float, Field(ge=0, le=100, strict=False)] | None = None
    """In percent, for ``percentile``: that share of the values is no larger."""

    @model_validator(mode="after")
    def _percentile_named(self) -> Self:
        if (self.statistic == "percentile") is (self.percentile is None):
            raise ValueError('statistic = "percentile" goes with percentile, such as percentile = 90')
        return self

    def to_plan(self, name: str, targets: tuple[str, ...]) -> RememberedFigure:
        """Return the figure as the core sees it; it is of the first target if it names none."""
        return RememberedFigure(
            name=name,
            target=self.target or next(iter(targets), ""),
            quantity=self.of,
            statistic="percentile" if self.statistic == "median" else self.statistic,
            percentile=50.0 if self.percentile is None else self.percentile,
            window=self.window,
        )


# Time: schedules by the clock, the calendar and the sun, and the order of rules ---------------------

# The days of the week as they are written, Monday first.
DAYS = ("mon", "tue", "wed", "thu", "fri", "sat", "sun")

# A time further from the sun than this is nearer to the sunrise or sunset of another day.
MAX_FROM_SUN_S = 12 * 3600.0

_SUN = re.compile(r"\s*(sunrise|sunset)\s*(?:([+-])\s*(.+))?")
_CLOCK = r"^\s*([0-9]{1,2}:[0-9]{2}(:[0-9.]+)?|(sunrise|sunset)(\s*[+-].+)?)\s*$"
_DAYS = re.compile(r"\s*([0-9]{1,2})-([0-9]{1,2})\s*(?:\.\.\s*([0-9]{1,2})-([0-9]{1,2})\s*)?")

# 29 February is a day, though not of every year.
_LEAP_YEAR = 2000


def parse_hour(text: object) -> tuple[Sun, float]:
    """Read a time of day such as ``"22:30"`` or ``"sunset + 30 min"``; raises ValueError if it is none.

    Returns:
        What it is counted from, empty for midnight, and how many seconds after that it is.
    """
    match = _SUN.fullmatch(text) if isinstance(text, str) else None
    if match is None:
        return "", parse_time_of_day(text)
    sun: Sun = "sunrise" if match[1] == "sunrise" else "sunset"
    away_s = parse_duration(match[3].strip()) if match[3] else 0.0
    if away_s > MAX_FROM_SUN_S:
        raise ValueError(f"{text!r} is more than 12 h away from the {sun}; count from the other one, or name an hour")
    return sun, -away_s if match[2] == "-" else away_s


def parse_dates(text: object) -> DateSpan:
    """Read days such as ``"12-24..12-26"``; raises ValueError if they are none."""
    match = _DAYS.fullmatch(text) if isinstance(text, str) else None
    if match is None:
        raise ValueError(f"{text!r} is no span of days; write months and days, such as '12-24..12-26'")
    numbers = [int(number) for number in match.groups(default=0)]
    first, last = MonthDay(*numbers[:2]), MonthDay(*(numbers[2:] if match[3] else numbers[:2]))
    for each in (first, last):
        if not 1 <= each.month <= 12 or not 1 <= each.day <= monthrange(_LEAP_YEAR, each.month)[1]:
            raise ValueError(f"{each.month:02d}-{each.day:02d} is on no calendar; write the month first, then the day")
    return DateSpan(first, last)


Hour = Annotated[Any, BeforeValidator(parse_hour), WithJsonSchema({"type": "string", "pattern": _CLOCK})]
Dates = Annotated[
    Any, BeforeValidator(parse_dates), WithJsonSchema({"type": "string", "pattern": f"^{_DAYS.pattern}$"})
]


class TimeTable(Section):
    """A condition on the time of day, local time."""

    between: Annotated[list[Hour], Field(min_length=2, max_length=2)]
    """The beginning first, each by the clock, or by the sun of the place; over midnight if the end is earlier."""
    days: Annotated[list[Literal["mon", "tue", "wed", "thu", "fri", "sat", "sun"]], Field(min_length=1)] | None = None
    """The days on which it begins; every day if left out."""
    dates: Annotated[list[Dates], Field(min_length=1, max_length=100)] | None = None
    """The dates of every year on which it begins; every day if left out."""

    @model_validator(mode="after")
    def _takes_time(self) -> Self:
        if self.between[0] == self.between[1]:
            raise ValueError('the time ends when it begins; write ["00:00", "24:00"] for the whole day')
        return self

    def to_plan(self) -> ScheduleCondition:
        """Return the condition as the core sees it."""
        weekdays = tuple(sorted({DAYS.index(day) for day in self.days or ()}))
        (from_sun, from_s), (to_sun, to_s) = self.between
        by_sun = {"from_sun": from_sun, "to_sun": to_sun}
        return ScheduleCondition(from_s=from_s, to_s=to_s, weekdays=weekdays, dates=tuple(self.dates or ()), **by_sun)


class SequenceTable(Section):
    """A condition on the order in which rules were raised."""

    rules: Annotated[list[str], Field(min_length=2, max_length=10)]
    """Their names, the first to be raised first."""
    within: DurationAboveZero
    """In seconds, from the first to the last."""
    for_: Annotated[DurationAboveZero | None, Field(alias="for")] = None
    """For how long it holds then, in seconds, written ``for``; None for as long as the last is active."""

    @model_validator(mode="after")
    def _each_once(self) -> Self:
        if len({*self.rules}) < len(self.rules):
            raise ValueError("a rule is named twice, and only when it was raised last counts; name each once")
        return self

    def to_plan(self) -> SequenceCondition:
        """Return the condition as the core sees it."""
        return SequenceCondition(rules=tuple(self.rules), within_s=self.within, for_s=self.for_)


# Kinds that are on one target, or on the base -------------------------------------------------------


def _true_or_time(value: object) -> float:
    """Read for how long something must be so: true for no time at all."""
    if value is False:
        raise ValueError("write true, or a time such as '5 min'; the opposite of 'seen = true' is 'lost = true'")
    return 0.0 if value is True else parse_duration(value)


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

    def to_plan(self, _: Severity, target: str) -> FigureCondition:
        """Return the condition as the core sees it."""
        return FigureCondition(
            quantity="still", above=self.for_, within_m=self.within, target=target, **limits.AS_IT_IS
        )


class BatteryTable(Section):
    """A condition on the battery of the base."""

    battery_below: Voltage
    """In volts; holds while it has less."""


# What a sensor of the base tells, or a table on its battery.
OfBase = Annotated[
    Annotated[BatteryTable, Tag("table")] | Annotated[Literal["bumped", "at_cliff"], Tag("word")],
    Discriminator(lambda value: "word" if isinstance(value, str) else "table"),
]


def _of_base(base: Any) -> Condition:
    if isinstance(base, BatteryTable):
        return BatteryCondition(below=base.battery_below)
    return ContactSensorCondition(sensor="is_bumped" if base == "bumped" else "is_at_cliff")


# The table of a condition ---------------------------------------------------------------------------

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


class Kind(NamedTuple):
    """A kind of condition, in the annotation of its key.

    Attributes:
        convert: Makes the core's condition of what is written, of how much the rule matters, and of the target that is
            named, empty for that of the rule.
        is_about: What it is on: one ``target``, ``nothing`` that `target` could name, or ``others``, conditions too.
    """

    convert: Callable[[Any, Severity, str], Condition]
    is_about: Literal["target", "nothing", "others"] = "target"


def _quantity(name: str) -> Kind:
    return Kind(lambda table, severity, target: table.to_plan(name, severity, target))


def _compared(key: str) -> Kind:
    return Kind(lambda other, severity, target: limits.comparison_of(other).compare(key, severity, target))


def _seen(*, seen: bool) -> Kind:
    return Kind(lambda for_s, _, target: PresenceCondition(seen=seen, for_s=for_s, target=target))


def _of_itself(convert: Callable[[Any], Condition]) -> Kind:
    return Kind(lambda written, *_: convert(written), "nothing")


def _parts(tables: list["WhenTable"], severity: Severity) -> tuple[Condition, ...]:
    return tuple(part.to_plan(severity) for part in tables)


class OfEach(Leaf, Struct, frozen=True, kw_only=True):
    """A condition on any, or on all, of a group of targets; compiling puts its members in its place."""

    group: str
    condition: Condition
    whole: type[AllOf | AnyOf]


class WhenTable(limits.LimitsTable, limits.LikelihoodTable):
    """A condition: limits on the distance, one of the keys from `seen` to `negated`, or all of several such."""

    written_elsewhere: ClassVar[dict[str, str]] = {
        "for": 'write on_delay = "10 s" beside when, or lost = "5 min" in place of true',
        "on_delay": "write it beside when",
        "off_delay": "write it beside when",
        "hysteresis": "it is called deadband",
        **LEFT,
    }
    needs_limit: ClassVar[bool] = False

    above: Length | None = None
    """In metres; holds when the target is further."""
    below: Length | None = None
    """In metres; holds when it is nearer."""
    between: Annotated[list[Length], Field(min_length=2, max_length=2)] | None = None
    """In metres, the lower end first."""
    of: Quantity = _DISTANCE.quantity
    """Whether the limits are on the distance or on the depth along the optical axis."""
    deadband: LengthOrZero = _DISTANCE.deadband
    """In metres; how far the target must come back."""
    target: str | None = None
    """The target, if it is another one than the rule's."""
    any_of: str | None = None
    """Instead of a target, several of one kind: holds while it does for one of them at least."""
    all_of: str | None = None
    """Likewise; holds while it does for each of them."""
    seen: Annotated[TrueOrTime | None, _seen(seen=True)] = None
    """``true``: holds while the target is tracked; a time: once it has been tracked for this long."""
    lost: Annotated[TrueOrTime | None, _seen(seen=False)] = None
    """Likewise while it is not tracked."""
    bearing: Annotated[limits.DirectionTable | None, _quantity("bearing")] = None
    """Holds while the target is in this direction."""
    elevation: Annotated[limits.DirectionTable | None, _quantity("elevation")] = None
    """Holds while the target is in this direction."""
    closing_speed: Annotated[limits.SpeedTable | None, _quantity("closing_speed")] = None
    """Holds while the target comes nearer at this speed."""
    time_to_contact: Annotated[limits.ContactTable | None, Kind(limits.ContactTable.to_plan)] = None
    """Holds while the target will be here this soon."""
    place: Annotated[limits.AxisTable | None, Kind(limits.AxisTable.on_axis)] = None
    """Holds while the target is this far along an axis."""
    speed: Annotated[limits.AnySpeedTable | None, Kind(limits.AnySpeedTable.on_axis)] = None
    """Holds while the target moves at this speed."""
    size: Annotated[limits.SizeTable | None, _quantity("size")] = None
    """Holds while the target appears this large in the picture."""
    still: Annotated[StillTable | None, Kind(StillTable.to_plan)] = None
    """Holds once the target has not moved for this long."""
    nearer_than: Annotated[limits.Comparison | None, _compared("nearer_than")] = None
    """Holds while the target is nearer than another one."""
    left_of: Annotated[limits.DirectionComparison | None, _compared("left_of")] = None
    """Holds while the target is to the left of another one, as seen by the camera."""
    higher_than: Annotated[limits.Comparison | None, _compared("higher_than")] = None
    """Holds while the target is higher above the floor than another one."""
    separation: Annotated[limits.SeparationTable | None, Kind(limits.SeparationTable.apart, "nothing")] = None
    """Holds while two targets are this far apart."""
    count: Annotated[CountTable | None, _of_itself(CountTable.to_plan)] = None
    """Holds while this many targets are in sight, or once a rule was raised this often."""
    active_for: Annotated[ActiveForTable | None, _of_itself(ActiveForTable.to_plan)] = None
    """Holds once a rule was active for this long in all."""
    figure: Annotated[FigureLimitsTable | None, _of_itself(FigureLimitsTable.to_plan)] = None
    """Holds while a remembered figure is within limits."""
    rule: Annotated[str | None, _of_itself(lambda name: RuleCondition(rule=name))] = None
    """Holds while the rule of this name is active."""
    sequence_of: Annotated[SequenceTable | None, _of_itself(SequenceTable.to_plan)] = None
    """Holds when these rules were raised one after the other."""
    time: Annotated[TimeTable | None, _of_itself(TimeTable.to_plan)] = None
    """Holds at this time of day."""
    base: Annotated[OfBase | None, _of_itself(_of_base)] = None
    """``"bumped"``: holds while a bumper of the base is pressed; ``"at_cliff"``: while a sensor below it sees no floor,
    or one of its wheels hangs down; or a table on its battery."""
    undelivered_for: Annotated[
        DurationAboveZero | None, _of_itself(lambda for_s: UndeliveredCondition(for_s=for_s))
    ] = None
    """In seconds; holds while an alarm's message or notification has been undelivered for this long."""
    all: Annotated[
        Annotated[list["WhenTable"], Field(min_length=1)] | None,
        Kind(lambda parts, severity, _: AllOf(conditions=_parts(parts, severity)), "others"),
    ] = None
    """Holds while each of these does."""
    any: Annotated[
        Annotated[list["WhenTable"], Field(min_length=1)] | None,
        Kind(lambda parts, severity, _: AnyOf(conditions=_parts(parts, severity)), "others"),
    ] = None
    """Holds while at least one of these does."""
    negated: Annotated[
        "WhenTable | None",
        Kind(lambda part, severity, _: Not(condition=part.to_plan(severity)), "others"),
        Field(alias="not"),
    ] = None
    """Written ``not``; holds while this does not."""

    @model_validator(mode="after")
    def _is_of_one_piece(self) -> Self:
        kinds = {key: kind for field, (key, kind) in _BY_FIELD.items() if getattr(self, field) is not None}
        low_m, high_m = self.limits
        has_limits = (low_m, high_m) != (None, None)
        about = [key for key in KEYS_ABOUT_WHOM if getattr(self, key) is not None]
        if not kinds and not has_limits:
            raise ValueError(f"the condition is empty; write one of {', '.join((*LIMITS, *KINDS))}")
        if len(about) > 1:
            raise ValueError(f"'{about[0]}' says already whom this is about; leave out '{about[1]}'")
        stray = [key for key in KEYS_ABOUT_DISTANCE if key in self.model_fields_set and not has_limits]
        if self.target is not None and not has_limits and "target" not in [kind.is_about for kind in kinds.values()]:
            stray.append("target")
        if stray:
            beside = " and ".join(f"'{key}'" for key in kinds)
            raise ValueError(f"'{stray[0]}' has no meaning beside {beside}; write it inside, or leave it out")
        if high_m is None and low_m is not None and self.deadband >= low_m:
            raise ValueError(f"with a deadband of {self.deadband:g} m above {low_m:g} m the alarm could never clear")
        return self

    def to_plan(self, severity: Severity) -> Condition:
        """Return the condition as the core sees it; a default depends on how much the rule matters."""
        written = [(kind, getattr(self, field)) for field, (_, kind) in _BY_FIELD.items()]
        plans = [kind.convert(each, severity, self.target or "") for kind, each in written if each is not None]
        if not plans or any(limit is not None for limit in self.limits):
            plans.insert(0, self._distance(severity))
        plan = plans[0] if len(plans) == 1 else AllOf(conditions=tuple(plans))
        group = self.any_of or self.all_of
        return OfEach(group=group, condition=plan, whole=AnyOf if self.any_of else AllOf) if group else plan

    def _distance(self, severity: Severity) -> DistanceCondition:
        above_m, below_m = self.limits
        return DistanceCondition(
            above=above_m,
            below=below_m,
            quantity=self.of,
            deadband=self.deadband,
            **self.likelihood(severity),
            target=self.target or "",
        )


# The kinds with their keys by the names of their fields, in the order of `to_plan`; and by their keys.
_BY_FIELD: dict[str, tuple[str, Kind]] = {
    name: (field.alias or name, kind)
    for name, field in WhenTable.model_fields.items()
    for kind in field.metadata
    if isinstance(kind, Kind)
}
KINDS: dict[str, Kind] = dict(_BY_FIELD.values())

# The keys that say whom a condition is about, of which one is written.
KEYS_OF_GROUPS = ("any_of", "all_of")
KEYS_ABOUT_WHOM = ("target", *KEYS_OF_GROUPS)

# The keys that are limits on the distance, and those that belong to them.
LIMITS = ("above", "below", "between")
KEYS_ABOUT_DISTANCE = ("of", "deadband", "deadband_sigmas", "probability", "probability_off")


def kinds_in(table: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return the conditions that a table is short for, each as a table of its own, in the order of `to_plan`.

    Keys that say something about the distance go with the limits on it, `target` with each condition on a target.
    """
    groups: list[tuple[tuple[str, ...], tuple[str, ...]]] = [(LIMITS, (*KEYS_ABOUT_DISTANCE, "target"))]
    groups += [((key,), ("target",) if kind.is_about == "target" else ()) for key, kind in KINDS.items()]
    return [
        {key: value for key, value in table.items() if key in group or key in beside}
        for group, beside in groups
        if any(key in table for key in group)
    ]
