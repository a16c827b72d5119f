"""The table of a condition, and the core's conditions of it: each kind is a key, its table if it has one, and its line.

A table that says several things at once, such as a limit on the distance and a time of day, is short for ``all`` of
them. Defaults are those of the core. Annotations are no texts here, as in every file of tables.
"""

import re
from calendar import monthrange
from collections.abc import Callable, Mapping
from typing import Annotated, Any, ClassVar, Generic, Literal, NamedTuple, Self, TypedDict, TypeVar

from msgspec import Struct
from msgspec.structs import replace
from pydantic import BeforeValidator, Discriminator, Field, Tag, WithJsonSchema, model_validator

from stadimeter.config import units
from stadimeter.config.models import DurationAboveZero, Section
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
from stadimeter.core.bounds import SIZE_UNIT
from stadimeter.core.clock import DAY_S
from stadimeter.core.conditions.compounds import AllOf, AnyOf, Condition, Not
from stadimeter.core.conditions.contact import TimeToContactCondition
from stadimeter.core.conditions.distance import DistanceCondition
from stadimeter.core.conditions.leaf import Leaf
from stadimeter.core.conditions.measured import COMPARISONS, FigureCondition
from stadimeter.core.conditions.of_rules import (
    BatteryCondition,
    ContactSensorCondition,
    RuleCondition,
    SequenceCondition,
    UndeliveredCondition,
)
from stadimeter.core.conditions.quantities import AXES, QUANTITIES, STILL_WITHIN_M, Axis, DistanceKind
from stadimeter.core.conditions.remembered import FigureQuantity, RememberedCondition, RememberedFigure, Window
from stadimeter.core.conditions.schedule import DateSpan, ScheduleCondition, Sun
from stadimeter.core.conditions.sight import CountCondition, PresenceCondition
from stadimeter.core.decision import Severity
from stadimeter.core.observation import MonthDay
from stadimeter.core.words import duration

# The tables of limits on a figure and of how sure it must be, and the core's conditions of them.
#
# Limits on the distance stand in the table of a condition itself; each other figure has a table inside it.
# Annotations are no texts here, as in every file of tables: pydantic would compile each once more whenever the
# program starts.

# A safety rule acts as soon as danger is as likely as not.
PROBABILITY_FOR_SAFETY = 0.5

_DISTANCE = DistanceCondition()
_CONTACT = TimeToContactCondition(below_s=1.0)

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

    needs_limit: ClassVar[bool] = True
    """Whether a table without a limit says nothing."""

    above: float | None = None
    """Holds above this figure."""
    below: float | None = None
    """Holds below this figure."""
    between: list[float] | None = None
    """Holds between these two, the lower end first."""

    @property
    def limits(self) -> _Bounds:
        """The values the figure must be above and below, in the SI unit; None for no such limit."""
        if self.between is not None:
            return self.between[0], self.between[1]
        return self.above, self.below

    @model_validator(mode="after")
    def _in_order(self) -> Self:
        low, high = self.limits
        if self.between is not None and (self.above is not None or self.below is not None):
            raise ValueError("above and below have no meaning beside between, which says both")
        if low is None and high is None and self.needs_limit:
            raise ValueError("there is no limit; write above, below, both of these, or between")
        if low is not None and high is not None and low >= high:
            raise ValueError("nothing is between these limits; write the lower one first, or as above")
        return self


class Likelihood(TypedDict):
    """The certainty it needs, as the conditions of the core have it."""

    deadband_sigmas: float
    probability_on: float | None
    probability_off: float


class LikelihoodTable(Section):
    """The certainty needed that a figure is within its limits."""

    deadband_sigmas: Sigmas = _DISTANCE.deadband_sigmas
    """How many standard deviations of its noise past the threshold the figure must go before the rule ends."""
    probability: Probability = _DISTANCE.probability_on
    """How likely the condition must be to begin; None compares the figures alone."""
    probability_off: ProbabilityOff = _DISTANCE.probability_off
    """How likely it may be at most to end."""

    probability_for_safety: ClassVar[float] = PROBABILITY_FOR_SAFETY
    """How likely it must be for a safety rule that does not say so."""

    @model_validator(mode="after")
    def _does_not_chatter(self) -> Self:
        on, off = self.probability, self.probability_off
        if on is not None and off > on:
            raise ValueError(f"probability_off {off:g} is above probability {on:g}: the alarm would chatter")
        return self

    def likelihood(self, severity: Severity) -> Likelihood:
        """Return the same as the core sees it, for a rule that matters so much."""
        is_default = severity is Severity.SAFETY and "probability" not in self.model_fields_set
        return {
            "deadband_sigmas": self.deadband_sigmas,
            "probability_on": self.probability_for_safety if is_default else self.probability,
            "probability_off": self.probability_off,
        }


# A speed is estimated from many frames, and overshoots for some tenths of a second after a target has set off. At even
# odds the estimate alone decides, and every third target that sets off to 70 % of a limit is taken to be above it; at
# 0.8 its standard deviation, which says that it has not settled, keeps all but 1 in 50 out. A target at twice the limit
# is found 0.1 s later, one at 1.1 times 0.3 to 0.6 s. Measured once; ``scenario/test_rules_on_noise.py`` holds it.
PROBABILITY_OF_SPEED_FOR_SAFETY = 0.8

# Of a figure that is compared as it is.
AS_IT_IS = Likelihood(deadband_sigmas=0.0, probability_on=None, probability_off=0.5)

# By the SI unit, how a quantity is written: its units, and an example.
_WRITTEN = {
    "m": (units.LENGTHS_M, "2 m"),
    "rad": (units.ANGLES_RAD, "20 deg"),
    "m/s": (units.SPEEDS_MPS, "0.5 m/s"),
    "s": (units.DURATIONS_S, "10 min"),
    SIZE_UNIT: (units.SIZES, "20 %"),
}
_ANY = units.Units(
    units.LENGTHS_M.most, {unit: size for known, *_ in _WRITTEN.values() for unit, size in known.items()}
)


# The text of a figure of some quantity, which `parse_figure` reads once the quantity is known.
WrittenFigure = Annotated[str, units.as_written(_ANY, "2 m", is_signed=True)]


def parse_figure(text: object, quantity: str) -> float:
    """Read a figure of a quantity, such as ``"20 deg"`` of a bearing; return it in the SI unit.

    Raises:
        ValueError: It is none, has the unit of another quantity, or is below zero where the quantity cannot be.
    """
    value = units.parse_quantity(text, *_WRITTEN[QUANTITIES[quantity].unit])
    if value < 0 and not QUANTITIES[quantity].is_signed:
        raise ValueError(f"{text!r} is below zero")
    return value


Size = Annotated[float, BeforeValidator(lambda text: parse_figure(text, "size")), units.as_written(units.SIZES, "20 %")]
FigureT = TypeVar("FigureT", bound=float)
WidthT = TypeVar("WidthT", bound=float)


class QuantityTable(LimitsTable, Generic[FigureT, WidthT]):
    """Limits on a quantity, of one type, and a deadband, of another that has no sign."""

    above: FigureT | None = None
    """Holds above this."""
    below: FigureT | None = None
    """Holds below this."""
    between: Annotated[list[FigureT], Field(min_length=2, max_length=2)] | None = None  # type: ignore[assignment]
    """The same two at once, the lower end first."""
    deadband: WidthT = Field(default=0.0)  # type: ignore[assignment]
    """How far past the threshold the figure must go before the rule ends."""

    def to_plan(self, quantity: str, severity: Severity, target: str, other: str = "") -> FigureCondition:
        """Return the condition as the core sees it."""
        (low, high), band = self.limits, float(self.deadband)
        sure = self.likelihood(severity) if isinstance(self, LikelihoodTable) else AS_IT_IS
        condition = FigureCondition(quantity=quantity, target=target, other=other, **sure)
        return replace(condition, above=low, below=high, deadband=band)


class DirectionTable(QuantityTable[units.Angle, units.AngleOrZero]):
    """A condition on the bearing, positive to the right, or the elevation, positive upwards; compared as they are."""

    deadband: units.AngleOrZero = 0.02
    """How far past the threshold the target must go before the rule ends."""


class AxisTable(QuantityTable[units.Coordinate, units.LengthOrZero], LikelihoodTable):
    """A condition on where the target is, along one axis."""

    axis: Axis
    """From the camera: `x` to the right in the picture, `y` down, `z` ahead along the optical axis, and
    `height_above_camera` along the vertical. From the middle of the robot, along the floor: `ahead` and `left`. Above
    the floor: `height`, which needs `height` in the section of the camera."""

    def on_axis(self, severity: Severity, target: str) -> FigureCondition:
        """Return the condition as the core sees it."""
        return self.to_plan(self.axis, severity, target)


class SizeTable(QuantityTable[Size, Size], LikelihoodTable):
    """A condition on how large the target appears in the picture."""


class SpeedTable(QuantityTable[units.Velocity, units.Speed], LikelihoodTable):
    """A condition on a speed: towards the camera, sideways, or in all directions."""

    deadband_sigmas: Sigmas = 2.0
    probability: Probability = 0.95
    probability_for_safety: ClassVar[float] = PROBABILITY_OF_SPEED_FOR_SAFETY


class AnySpeedTable(SpeedTable):
    """A condition on the speed in all directions together, or across the line of sight."""

    axis: Literal["sideways"] | None = None
    """``"sideways"`` for the speed to the right."""

    def on_axis(self, severity: Severity, target: str) -> FigureCondition:
        """Return the condition as the core sees it."""
        return self.to_plan(f"{self.axis}_speed" if self.axis else "speed", severity, target)


class SeparationTable(QuantityTable[units.Length, units.LengthOrZero], LikelihoodTable):
    """A condition on how far two targets are from each other."""

    of: Annotated[list[str], Field(min_length=2, max_length=2)]
    """The names of the two targets."""

    def apart(self, severity: Severity, _: str) -> FigureCondition:
        """Return the condition as the core sees it."""
        return self.to_plan("separation", severity, *self.of)


class ContactTable(LikelihoodTable):
    """A condition on how soon a target will be here, if it goes on as it does."""

    below: DurationAboveZero
    """Holds if it will be here within this time."""
    contact: units.LengthOrZero = _CONTACT.contact_m
    """In metres; the distance that counts as contact."""
    deadband: units.Duration = _CONTACT.deadband_s
    """In seconds; how much later the contact must be before the condition ends."""
    deadband_sigmas: Sigmas = _CONTACT.deadband_sigmas

    def to_plan(self, severity: Severity, target: str) -> TimeToContactCondition:
        """Return the condition as the core sees it."""
        return TimeToContactCondition(
            below_s=self.below,
            contact_m=self.contact,
            deadband_s=self.deadband,
            **self.likelihood(severity),
            target=target,
        )


class ComparisonTable(LikelihoodTable):
    """A condition on how a target is in relation to another one; `by` and `deadband` are lengths."""

    target: str
    """The other target that it is compared with."""
    by: units.LengthOrZero = 0.0
    """In metres; how much nearer, further, higher or lower at least."""
    deadband: units.LengthOrZero = 0.0
    """In metres; how far past the threshold the difference must go before the rule ends."""

    def compare(self, key: str, severity: Severity, target: str) -> FigureCondition:
        """Return the condition as the core sees it.

        Args:
            key: One of `COMPARISONS`.
        """
        quantity, is_more = COMPARISONS[key]
        low, high = (self.by, None) if is_more else (None, 0.0 - self.by)
        condition = FigureCondition(quantity=quantity, target=target, other=self.target, **self.likelihood(severity))
        return replace(condition, above=low, below=high, deadband=self.deadband)


class DirectionComparisonTable(ComparisonTable):
    """The same for directions; `by` and `deadband` are angles."""

    by: units.AngleOrZero = 0.0
    """In radians; how much further to that side at least."""
    deadband: units.AngleOrZero = 0.0
    """In radians; how far past the threshold the difference must go before the rule ends."""


# The name of the other target alone, or a table.
_Name = Annotated[str, Tag("name")]
_form = Discriminator(lambda value: "name" if isinstance(value, str) else "table")
Comparison = Annotated[Annotated[ComparisonTable, Tag("table")] | _Name, _form]
DirectionComparison = Annotated[Annotated[DirectionComparisonTable, Tag("table")] | _Name, _form]


def comparison_of(written: Any) -> ComparisonTable:
    """Return the table of a comparison, of which the name of the other target may stand alone."""
    return ComparisonTable(target=written) if isinstance(written, str) else written


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
    """Holds with this many or more."""
    at_most: Annotated[int, Field(ge=0)] | None = None
    """Holds with this many or fewer."""
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
    """The rule whose active time is summed up."""
    at_least: DurationAboveZero
    """In seconds; holds from this time on."""

    def to_plan(self) -> RememberedCondition:
        """Return the condition as the core sees it."""
        return RememberedCondition(rules=(self.rule,), window=self.window, unit="s", above=self.at_least)


# A quantity in the SI unit, and that unit: it must be that of the figure.
AnyQuantity = Annotated[
    tuple[float, str], BeforeValidator(lambda value: parse_any_quantity(str(value))), WithJsonSchema({"type": "string"})
]


class FigureLimitsTable(LimitsTable):
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
    """How far past the threshold the figure must go before the rule ends."""

    def to_plan(self) -> RememberedCondition:
        """Return the condition as the core sees it."""
        low, high = self.between or (self.above, self.below)
        found = {key: each for key, each in (("above", low), ("below", high), ("deadband", self.deadband)) if each}
        values: dict[str, Any] = {key: value for key, (value, _) in found.items()}
        units = {unit: None for _, unit in found.values()}  # of several units, the check names the figure's own
        return RememberedCondition(name=self.name, unit=" and ".join(units), **values)


class FigureTable(WindowTable):
    """A figure that is remembered over a window of time: for conditions, messages (`{NAME}`) and MQTT.

    It is unknown without a measurement in the window, and outlasts a restart.
    """

    target: str | None = None
    """The target; may be left out where there is only one."""
    of: FigureQuantity = "distance"
    """Which figure of the target."""
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
    """From the first time to the second, over midnight if that is earlier; also `"sunset + 30 min"` with `[place]`."""
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
    """A condition on the order in which rules were raised.

    Each must be raised after the one before. Two that are raised by one picture are in no order.
    """

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
    """How long it must have stood; out of sight it is unknown."""
    within: LengthOrZero = STILL_WITHIN_M
    """In metres; the target has moved when it is further than this from where it began to stand."""

    def to_plan(self, _: Severity, target: str) -> FigureCondition:
        """Return the condition as the core sees it."""
        return FigureCondition(quantity="still", above=self.for_, within_m=self.within, target=target, **AS_IT_IS)


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
    return Kind(lambda other, severity, target: comparison_of(other).compare(key, severity, target))


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


class WhenTable(LimitsTable, LikelihoodTable):
    """A condition: limits on the distance, one of the keys from `seen` to `negated`, or all of several such."""

    written_elsewhere: ClassVar[dict[str, str]] = {
        "for": 'write on_delay = "10 s" beside when, or lost = "5 min" in place of true',
        **dict.fromkeys(("distance", "range", "depth"), 'write below = "50 cm", or above, or between'),
        "on_delay": "write it beside when",
        "off_delay": "write it beside when",
        **dict.fromkeys(("less_than", "closer_than", "within"), 'write below = "50 cm"'),
        **dict.fromkeys(("more_than", "greater_than", "farther_than"), 'write above = "50 cm"'),
        "further_than": 'write above = "50 cm", or of two targets { target = "tag", nearer_than = "ball" }',
        "right_of": 'write { target = "tag", left_of = "ball" }',
        "lower_than": 'write { target = "tag", higher_than = "ball" }',
        **{axis: f'write place = {{ axis = "{axis}", above = … }}, or below, or between' for axis in AXES},
    }
    needs_limit: ClassVar[bool] = False

    above: Length | None = None
    """In metres; holds when the target is further."""
    below: Length | None = None
    """In metres; holds when it is nearer."""
    between: Annotated[list[Length], Field(min_length=2, max_length=2)] | None = None
    """Holds when it is between these two, the lower end first."""
    of: DistanceKind = _DISTANCE.quantity
    """Whether the limits are on the distance or on the depth along the optical axis."""
    deadband: LengthOrZero = _DISTANCE.deadband
    """In metres; how far past the threshold the target must go before the rule ends."""
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
    bearing: Annotated[DirectionTable | None, _quantity("bearing")] = None
    """Holds while the target is in this direction."""
    elevation: Annotated[DirectionTable | None, _quantity("elevation")] = None
    """Holds while the target is in this direction."""
    closing_speed: Annotated[SpeedTable | None, _quantity("closing_speed")] = None
    """Holds while the target comes nearer at this speed."""
    time_to_contact: Annotated[ContactTable | None, Kind(ContactTable.to_plan)] = None
    """Holds while the target will be here this soon."""
    place: Annotated[AxisTable | None, Kind(AxisTable.on_axis)] = None
    """Holds while the target is this far along an axis."""
    speed: Annotated[AnySpeedTable | None, Kind(AnySpeedTable.on_axis)] = None
    """Holds while the target moves at this speed."""
    size: Annotated[SizeTable | None, _quantity("size")] = None
    """Holds while the target appears this large in the picture."""
    still: Annotated[StillTable | None, Kind(StillTable.to_plan)] = None
    """Holds once the target has not moved for this long."""
    nearer_than: Annotated[Comparison | None, _compared("nearer_than")] = None
    """Holds while the target is nearer than another one."""
    left_of: Annotated[DirectionComparison | None, _compared("left_of")] = None
    """Holds while the target is to the left of another one, as seen by the camera."""
    higher_than: Annotated[Comparison | None, _compared("higher_than")] = None
    """Holds while the target is higher above the floor than another one."""
    separation: Annotated[SeparationTable | None, Kind(SeparationTable.apart, "nothing")] = None
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
