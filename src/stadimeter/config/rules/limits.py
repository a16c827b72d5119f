"""The tables of limits on a figure and of how sure it must be, and the core's conditions of them.

Limits on the distance stand in the table of a condition itself; each other figure has a table inside it. Annotations
are no texts here, as in every file of tables: pydantic would compile each once more whenever the program starts.
"""

from typing import Annotated, Any, ClassVar, Generic, Literal, Self, TypedDict, TypeVar

from msgspec.structs import replace
from pydantic import BeforeValidator, Discriminator, Field, Tag, WithJsonSchema, model_validator

from stadimeter.config import units
from stadimeter.config.models import DurationAboveZero, Section
from stadimeter.core.bounds import SIZE_UNIT
from stadimeter.core.conditions.contact import TimeToContactCondition
from stadimeter.core.conditions.distance import DistanceCondition
from stadimeter.core.conditions.measured import COMPARISONS, FigureCondition
from stadimeter.core.conditions.quantities import QUANTITIES, Axis, noun_of
from stadimeter.core.decision import Severity

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
    """Holds above this."""
    below: float | None = None
    """Holds below this."""
    between: list[float] | None = None
    """The same two at once, the lower end first."""

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
    """How many standard deviations of its noise the figure must come back before the condition ends."""
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
# is found 0.1 s later, one at 1.1 times 0.3 to 0.6 s. Measured by ``tests/benchmarks/closing_speeds.py``.
PROBABILITY_OF_SPEED_FOR_SAFETY = 0.8

# Of a figure that is compared as it is.
AS_IT_IS = Likelihood(deadband_sigmas=0.0, probability_on=None, probability_off=0.5)

# By the SI unit, how a quantity is written: its units, what that is, and an example.
_WRITTEN = {
    "m": (units.LENGTHS_M, "a length", "2 m"),
    "rad": (units.ANGLES_RAD, "an angle", "20 deg"),
    "m/s": (units.SPEEDS_MPS, "a speed", "0.5 m/s"),
    "s": (units.DURATIONS_S, "a time", "10 min"),
    SIZE_UNIT: (units.SIZES, "a share of the picture's width", "20 %"),
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
    known, kind, example = _WRITTEN[QUANTITIES[quantity].unit]
    try:
        value = units.parse_quantity(text, known, example)
    except ValueError:
        _, unit = units.parse_any_quantity(str(text))  # one of no quantity at all is an error here
        if unit == known.si_unit:
            raise
        message = f"{text!r} is in {unit}, and the {noun_of(quantity)} is {kind}, such as {example!r}"
        raise ValueError(message) from None
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
    """How far the figure must come back."""

    def to_plan(self, quantity: str, severity: Severity, target: str, other: str = "") -> FigureCondition:
        """Return the condition as the core sees it."""
        (low, high), band = self.limits, float(self.deadband)
        sure = self.likelihood(severity) if isinstance(self, LikelihoodTable) else AS_IT_IS
        condition = FigureCondition(quantity=quantity, target=target, other=other, **sure)
        return replace(condition, above=low, below=high, deadband=band)


class DirectionTable(QuantityTable[units.Angle, units.AngleOrZero]):
    """A condition on the bearing, positive to the right, or the elevation, positive upwards; compared as they are."""

    deadband: units.AngleOrZero = 0.02
    """How far the target must come back."""


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
    """The two targets."""

    def apart(self, severity: Severity, _: str) -> FigureCondition:
        """Return the condition as the core sees it."""
        return self.to_plan("separation", severity, *self.of)


class ContactTable(LikelihoodTable):
    """A condition on how soon a target will be here, if it goes on as it does."""

    written_elsewhere: ClassVar[dict[str, str]] = dict.fromkeys(
        ("min_closing_speed", "speed_sigmas"), "leave it out: it is fixed"
    )

    below: DurationAboveZero
    """In seconds."""
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
    """The other target."""
    by: units.LengthOrZero = 0.0
    """In metres; how much nearer, further, higher or lower at least."""
    deadband: units.LengthOrZero = 0.0
    """In metres; how far the difference must come back."""

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
    """In radians; how far the difference must come back."""


# The name of the other target alone, or a table.
_Name = Annotated[str, Tag("name")]
_form = Discriminator(lambda value: "name" if isinstance(value, str) else "table")
Comparison = Annotated[Annotated[ComparisonTable, Tag("table")] | _Name, _form]
DirectionComparison = Annotated[Annotated[DirectionComparisonTable, Tag("table")] | _Name, _form]


def comparison_of(written: Any) -> ComparisonTable:
    """Return the table of a comparison, of which the name of the other target may stand alone."""
    return ComparisonTable(target=written) if isinstance(written, str) else written
