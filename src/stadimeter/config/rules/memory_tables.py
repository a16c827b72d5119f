"""The tables of what is remembered over a window of time: counts and sums of other rules, and figures with a name.

Annotations are no texts here, as in every file of tables.
"""

from collections.abc import Callable
from typing import Annotated, Any, Literal, Self

from pydantic import BeforeValidator, Field, WithJsonSchema, model_validator

from stadimeter.config.models import DurationAboveZero, Section
from stadimeter.config.units import DURATIONS_S, Length, TimeOfDay, as_written, parse_any_quantity, parse_duration
from stadimeter.core.clock import DAY_S
from stadimeter.core.conditions.discrete import CountCondition
from stadimeter.core.conditions.remembered import RememberedCondition
from stadimeter.core.conditions.summary import FigureQuantity, RememberedFigure, Window
from stadimeter.core.words import duration

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

    def to_plan(self) -> RememberedCondition:
        """Return the condition as the core sees it."""
        low, high = self.between or (self.above, self.below)
        found = {key: each for key, each in (("above", low), ("below", high), ("deadband", self.deadband)) if each}
        values: dict[str, Any] = {key: value for key, (value, _) in found.items()}
        units = {unit: None for _, unit in found.values()}  # of several units, the check names the figure's own
        return RememberedCondition(name=self.name, unit=" and ".join(units), **values)


class FigureTable(WindowTable):
    """A figure that is remembered; see `stadimeter.core.conditions.summary.RememberedFigure`."""

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
