"""The tables of what is remembered over a window of time: counts and sums of other rules, and figures with a name.

Annotations are no texts here, as in every file of tables.
"""

from typing import Annotated, Any, Literal, Self

from pydantic import BeforeValidator, Field, WithJsonSchema, model_validator

from stadimeter.config.models import DurationAboveZero, Section
from stadimeter.config.units import DURATIONS_S, TimeOfDay, as_written, parse_any_quantity, parse_duration
from stadimeter.core.conditions.discrete import CountCondition
from stadimeter.core.conditions.remembered import FigureCondition
from stadimeter.core.conditions.tallies import MAX_RAISES, ActiveForCondition, RaisedCondition
from stadimeter.core.conditions.window import DAY_S, Window
from stadimeter.core.remembered import FigureQuantity, RememberedFigure

# Nothing is remembered for longer.
MAX_WINDOW_S = 366 * DAY_S

_TODAY = "today"

# Messages at times come no more often than this, and at no more times of a day.
MIN_EVERY_S = 1.0
MAX_TIMES = 100

_TIME = {"type": "string", "pattern": r"^\s*[0-9]{1,2}:[0-9]{2}(:[0-9.]+)?\s*$", "examples": ["22:30"]}


def _parse_within(text: object) -> float:
    """Read a window; 0 for ``today``."""
    if text == _TODAY:
        return 0.0
    for_s = parse_duration(text)
    if not 0 < for_s <= MAX_WINDOW_S:
        raise ValueError(f'{text!r} is no window: write a time above zero and up to 8784 h, a year, or "today"')
    return for_s


Within = Annotated[
    float,
    BeforeValidator(_parse_within),
    WithJsonSchema({"anyOf": [as_written(DURATIONS_S, "1 min").json_schema, {"const": _TODAY}]}),
]


def _parse_every(text: object) -> float:
    every_s = parse_duration(text)
    if not MIN_EVERY_S <= every_s <= MAX_WINDOW_S:
        raise ValueError(f"{text!r} is too often or too rare for messages: write 1 s to 8784 h, a year")
    return every_s


Every = Annotated[float, BeforeValidator(_parse_every), as_written(DURATIONS_S, "1 min")]
TimesOfDay = Annotated[
    list[TimeOfDay],
    BeforeValidator(lambda value: value if isinstance(value, list) else [value]),
    Field(min_length=1, max_length=MAX_TIMES),
    WithJsonSchema({"anyOf": [_TIME, {"type": "array", "items": _TIME, "minItems": 1}]}),
]


class WindowTable(Section):
    """What of the past counts."""

    within: Within | None = None
    """In seconds: the newest part of the past; or ``"today"``, since midnight."""
    since: TimeOfDay | None = None
    """Since this time of day, in place of `within`."""

    @property
    def window(self) -> Window:
        """The same as the core sees it."""
        return Window(for_s=self.within) if self.within else Window(from_second=self.since or 0.0)

    @model_validator(mode="after")
    def _one_window(self) -> Self:
        if self.within is not None and self.since is not None:
            raise ValueError('it has within and since; write one of them, such as within = "1 min"')
        if self.is_windowed and self.within is None and self.since is None:
            raise ValueError('it does not say within which time; add within = "1 min", within = "today" or since')
        return self

    @property
    def is_windowed(self) -> bool:
        """Whether it must say what of the past counts."""
        return True


class CountTable(WindowTable):
    """A condition on how many targets are in sight, or on how often a rule was raised."""

    at_least: Annotated[int, Field(ge=1)] | None = None
    """Holds with no fewer."""
    at_most: Annotated[int, Field(ge=0)] | None = None
    """Holds with no more."""
    of: Annotated[list[str], Field(min_length=1)] | None = None
    """Of these targets; all if left out."""
    rule: str | None = None
    """In place of targets: how often this rule was raised."""

    @property
    def is_windowed(self) -> bool:
        """Only raises are counted over a time."""
        return self.rule is not None

    @model_validator(mode="after")
    def _of_one_kind(self) -> Self:
        if self.rule is None:
            if self.within is not None or self.since is not None:
                raise ValueError("targets in sight are counted now; name a rule to count how often it was raised")
        elif self.at_least is None or self.at_most is not None or self.of is not None:
            raise ValueError("how often a rule was raised has at_least, and neither at_most nor of; write not = { … }")
        elif self.at_least > MAX_RAISES:
            raise ValueError(f"at_least is {MAX_RAISES} at most where a rule is counted: count in a shorter window")
        return self

    def to_plan(self) -> CountCondition | RaisedCondition:
        """Return the condition as the core sees it."""
        if self.rule is not None:
            return RaisedCondition(rules=(self.rule,), at_least=self.at_least or 1, window=self.window)
        return CountCondition(targets=tuple(self.of or ()), at_least=self.at_least, at_most=self.at_most)


class ActiveForTable(WindowTable):
    """A condition on how long a rule was active in all."""

    rule: str
    """The rule."""
    at_least: DurationAboveZero
    """In seconds; holds from this time on."""

    def to_plan(self) -> ActiveForCondition:
        """Return the condition as the core sees it."""
        return ActiveForCondition(rules=(self.rule,), at_least_s=self.at_least, window=self.window)


def _parse_figure(text: object) -> tuple[float, str]:
    if not isinstance(text, str):
        raise ValueError(f"{text!r} is not a quantity; write it as text, such as '50 cm'")
    return parse_any_quantity(text)


# A quantity in the SI unit, and that unit: it must be that of the figure.
AnyQuantity = Annotated[tuple[float, str], BeforeValidator(_parse_figure), WithJsonSchema({"type": "string"})]


class FigureLimitsTable(Section):
    """A condition on a remembered figure."""

    name: str
    """Its name, as in ``[figures.NAME]``."""
    above: AnyQuantity | None = None
    """Holds above this; in a unit of its quantity."""
    below: AnyQuantity | None = None
    """Holds below this."""
    between: Annotated[list[AnyQuantity], Field(min_length=2, max_length=2)] | None = None
    """The same two at once, the lower end first."""
    deadband: AnyQuantity | None = None
    """How far the figure must come back."""

    @property
    def quantities(self) -> dict[str, tuple[float, str]]:
        """The quantities that it names, by key."""
        low, high = self.between if self.between is not None else (self.above, self.below)
        found = {"above": low, "below": high, "deadband": self.deadband}
        return {key: value for key, value in found.items() if value is not None}

    def to_plan(self) -> FigureCondition:
        """Return the condition as the core sees it."""
        values: dict[str, Any] = {key: value for key, (value, _) in self.quantities.items()}
        unit = next((unit for _, unit in self.quantities.values()), "m")
        return FigureCondition(figure_name=self.name, unit=unit, **values)


class FigureTable(WindowTable):
    """A figure that is remembered; see `stadimeter.core.remembered.RememberedFigure`."""

    target: str | None = None
    """The target; may be left out where there is only one."""
    of: FigureQuantity = "distance"
    """Which figure of it."""
    statistic: Literal["minimum", "maximum", "mean", "median", "percentile"]
    """What of all values within the window."""
    percentile: Annotated[float, Field(ge=0, le=100, strict=False)] | None = None
    """In percent, for ``percentile``: so many of the values are no larger."""

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
